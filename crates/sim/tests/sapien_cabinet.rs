//! Trials against SAPIEN 3.0.3 (PhysX on the CPU): 180 random trials on a cabinet of boxes with a door, a drawer and
//! a lid. `tests/fixtures/sapien_cabinet/trials.tsv` holds the outcomes SAPIEN gives under the published settings
//! (joint friction 0, density 1000). Two engines never agree on grips that barely hold, hence a few trials in a
//! hundred may differ; most differences are grips that slip there and hold here.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use where2act_core::{GRIPPER, Grasp, Invalid, Primitive};
use where2act_sim::{
    Agreement, Attempt, Batch, Mode, Moment, Observer, Outcome, Scene, SettledScene, object,
};

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/fixtures/sapien_cabinet");

fn batch() -> Batch {
    let cabinet = object::open(&format!("{FIXTURE}/cabinet.urdf")).unwrap();
    let table = std::fs::read_to_string(format!("{FIXTURE}/trials.tsv")).unwrap();
    Batch::parse(&table, Arc::new(cabinet)).unwrap()
}

fn agreement(mode: Mode) -> Agreement {
    let batch = batch();
    let outcomes = batch.run(mode, true, || ());
    batch.agreement(&outcomes)
}

#[test]
fn faithful_trials_end_as_in_sapien() {
    let found = agreement(Mode::Faithful);
    assert!(found.valid.0 == 180 && found.valid.1 >= 178, "valid: {found:?}");
    assert!(found.success.0 == 180 && found.success.1 >= 176, "success: {found:?}");
}

#[test]
fn fast_trials_end_as_in_sapien() {
    let found = agreement(Mode::Fast);
    assert!(found.valid.0 == 180 && found.valid.1 >= 175, "valid: {found:?}");
    assert!(found.success.0 == 180 && found.success.1 >= 175, "success: {found:?}");
}

#[test]
fn outcomes_do_not_depend_on_threads_or_repetition() {
    let batch = batch();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let outcomes = pool.install(|| batch.run(Mode::Fast, true, || ()));
        let bits = |outcome: &Outcome| match outcome {
            Outcome::Run(v) => [v.q_start, v.q_end, v.motion.x, v.motion.y, v.motion.z].map(f32::to_bits),
            Outcome::NoScene(why) => panic!("{why}"),
        };
        outcomes.iter().map(bits).collect::<Vec<_>>()
    };
    let once = run(1);
    assert_eq!(once, run(2));
    assert_eq!(once, run(1));
}

/// The cabinet at rest, and the index of its drawer.
fn closed() -> (SettledScene, usize) {
    let cabinet = Arc::new(object::open(&format!("{FIXTURE}/cabinet.urdf")).unwrap());
    let drawer = cabinet.find_link("drawer").unwrap();
    let q = cabinet.closed();
    (Scene::new(cabinet, q).unwrap().settle().unwrap(), drawer)
}

#[test]
fn an_approach_from_behind_is_refused_and_seen() {
    let (scene, link) = closed();
    let grasp_in_world = Grasp::new(Point3::new(0.37, 0.03, -0.25), Vector3::x(), Vector3::y());
    let normal_in_world = Some(Vector3::x());
    let attempt = Attempt { primitive: Primitive::Pushing, link, grasp_in_world, normal_in_world };
    let mut moments = Vec::new();
    let mut look = |moment: &Moment| moments.push(moment.clone());
    let seen = scene.attempt(&attempt, Mode::Fast, Some(Observer { every: 1, look: &mut look }));
    assert_eq!(seen.invalid, Some(Invalid::ApproachFromBehind));
    assert_eq!(seen, scene.attempt(&attempt, Mode::Fast, None));
    let [start] = &moments[..] else { panic!("{} moments", moments.len()) };
    let expected = attempt.primitive.motion(&grasp_in_world).start;
    assert!((start.world_from_hand.to_homogeneous() - expected.to_homogeneous()).amax() < 1e-5);
}

#[test]
fn a_grip_on_the_drawers_handle_holds() {
    let (scene, drawer) = closed();
    // The handle's front is at x = 0.37; the bar is 2 cm high and 20 cm wide.
    let grasp = Grasp::new(Point3::new(0.37, 0.03, -0.25), -Vector3::x(), Vector3::y());
    let mut moments = Vec::new();
    let mut look = |moment: &Moment| moments.push(moment.clone());
    let attempt =
        Attempt { primitive: Primitive::Pulling, link: drawer, grasp_in_world: grasp, normal_in_world: None };
    let verdict = scene.attempt(&attempt, Mode::Faithful, Some(Observer { every: 100, look: &mut look }));
    assert!(verdict.success && verdict.q_end > 0.04, "{verdict:?}");
    let end = moments.last().unwrap();
    let [left, right] = end.world_from_fingers.map(|f| f.translation.vector);
    let gap = (left - right).norm();
    assert!((gap - 0.02).abs() < 2e-3, "fingers {gap} m apart around a bar of 0.02 m");
    let handle = end.world_from_links[drawer] * Point3::new(0.05, 0.03, 0.0);
    let held = end.world_from_hand.inverse() * handle;
    assert!(
        held.y.abs() < 0.01 && (0.06..GRIPPER.tip + 0.01).contains(&held.z),
        "handle at {held} of the hand"
    );
    assert!((end.world_from_hand.translation.x - (0.37 + 0.15)).abs() < 0.02, "the hand is back");
}
