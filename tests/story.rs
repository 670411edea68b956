//! The whole story, for pictures and for scans: an object settles and is seen, trials on such objects become shards,
//! a network learns from them for a few steps, its weights are loaded again, and what it proposes is executed in the
//! simulator. The networks learn next to nothing here; what is tested is that all stages speak of the same places,
//! directions and poses.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use burn::tensor::Device;
use nalgebra::{Isometry3, Matrix4, Point3, Rotation3, Vector3, center};
use where2act_core::{
    Camera, Category, Grasp, ImageSize, Observation, Pixel, Policy, Prediction, Primitive, Proposal, Seed,
    Trial, Verdict,
};
use where2act_infer::read::{Picture, read_picture, read_scan};
use where2act_infer::{Options, Predictor};
use where2act_model::Modality;
use where2act_sim::collect::{Collector, ObjectSet, Plan, Recipe};
use where2act_sim::render::{Look, View, render, visible_bounds};
use where2act_sim::sampling::Sampler;
use where2act_sim::{Attempt, Mode, Observer, Scene, SettledScene, object};
use where2act_train::run::{Control, files, train};
use where2act_train::{
    BatchConfig, CollectConfig, Dataset, LossConfig, NetworkConfig, Part, ScheduleConfig, TrainConfig,
};

const PRIMITIVES: [Primitive; 2] = [Primitive::Pushing, Primitive::Pulling];

/// A cabinet with a drawer and a door a bit open, at rest, from the front.
fn cabinet() -> (SettledScene, View) {
    let object = Arc::new(object::open("StorageFurniture:17").unwrap());
    let q = vec![0.0, 0.15, 0.0, 0.5, 0.0, 0.0];
    let scene = Scene::new(object, q).unwrap().settle().unwrap();
    let poses = scene.world_from_links();
    let (min, max) = visible_bounds(scene.object(), &poses);
    let size = ImageSize::square(Camera::PUBLISHED_SIDE);
    let distance = Camera::PUBLISHED_DISTANCE;
    let camera = Camera::orbit(center(&min, &max), distance, 3.75, 0.5, size, Camera::PUBLISHED_FOV);
    let view = render(scene.object(), &poses, &camera, &Look::default());
    (scene, view)
}

/// Guided trials on four cabinets, one of which is kept for validation.
fn collect(folder: &Path) -> Arc<Dataset> {
    let part = |seed: u64| Part::of(&format!("StorageFurniture:{seed}"), Some(Category::StorageFurniture));
    let kept = (3..1000).find(|&seed| part(seed) == Part::Validation).unwrap();
    let seeds = kept - 3..kept + 1;
    let recipe = Recipe {
        seed: Seed(1),
        objects: ObjectSet::Procedural { categories: vec![Category::StorageFurniture], seeds },
        primitives: PRIMITIVES.to_vec(),
        trials: 16,
        guided: 1.0,
        ..Recipe::default()
    };
    let plan = Plan { scenes_per_shard: 6, ..Plan::new(12) };
    let collected =
        Collector::new(folder, recipe, plan).unwrap().run(&AtomicBool::new(false), &|_, _| {}).unwrap();
    assert_eq!((collected.scenes, collected.shards_made), (12, 2));
    let dataset = Dataset::open(folder, false).unwrap();
    for part in [Part::Train, Part::Validation] {
        assert!(dataset.scenes(part).unwrap().len() > 1, "{part:?}");
    }
    Arc::new(dataset)
}

fn learn(dataset: &Arc<Dataset>, modality: Modality, out: &Path) -> PathBuf {
    let config = TrainConfig {
        name: "story".to_owned(),
        seed: 5,
        from: None,
        replay: vec![],
        encoder: None,
        teacher: None,
        network: NetworkConfig {
            modality,
            primitives: PRIMITIVES.to_vec(),
            width: 0.125,
            hidden: 16,
            actionability_hidden: None,
            latent: 4,
            points: 1024,
            candidates: 1024,
            surroundings: true,
            second_look: true,
            ways: Some(2.0),
            image_side: 224,
            close_up: None,
            alignments: 0,
        },
        batch: BatchConfig { views: 2, trials_per_view: 16, ..BatchConfig::default() },
        schedule: ScheduleConfig {
            look_steps: 0,
            score_steps: 2,
            joint_steps: 4,
            epoch_steps: 3,
            mean_steps: 0,
            optimiser: Default::default(),
            precision: Default::default(),
            rate: 1e-3,
            trial_rate: None,
            weight_decay: 1e-5,
            decay: Default::default(),
        },
        loss: LossConfig { proposals: 8, motion: 1.0, ..LossConfig::default() },
        adaptive: Default::default(),
        collect: CollectConfig::default(),
    };
    let control =
        Control { stop: &AtomicBool::new(false), on_step: &mut |_| {}, on_epoch: &mut |_| Vec::new() };
    let outcome = train(&config, Arc::clone(dataset), out, &Device::flex(), control).unwrap();
    assert!(outcome.finished && outcome.weights.as_deref() == Some(&out.join(files::LAST)));
    outcome.weights.unwrap()
}

/// The grasp that a proposal's numbers mean, in the camera frame.
fn grasp_of(proposal: &Proposal) -> Grasp {
    let rows = proposal.rotation;
    let rotation = nalgebra::Matrix3::from_fn(|r, c| rows[r][c]);
    Grasp {
        point: Point3::from(proposal.point.unwrap()),
        rotation: Rotation3::from_matrix_unchecked(rotation),
    }
}

fn matrix(rows: &[[f32; 4]; 4]) -> Matrix4<f32> {
    Matrix4::from_fn(|r, c| rows[r][c])
}

#[track_caller]
fn same_pose(a: &Matrix4<f32>, b: &Isometry3<f32>, tolerance: f32) {
    let difference = (a - b.to_homogeneous()).amax();
    assert!(difference < tolerance, "{difference}: {a} {b}");
}

/// Executes a grasp; also returns where the hand was at the start, in the world.
fn execute(
    scene: &SettledScene,
    view: &View,
    (primitive, pixel): (Primitive, Pixel),
    grasp_in_world: &Grasp,
) -> (Verdict, Isometry3<f32>) {
    let attempt = Attempt {
        primitive,
        link: view.link_at(pixel).unwrap(),
        grasp_in_world: *grasp_in_world,
        normal_in_world: None,
    };
    let mut start = None;
    let mut look = |moment: &where2act_sim::Moment| {
        assert!(start.is_none() && moment.step == 0);
        start = Some(moment.world_from_hand);
    };
    let observer = Observer { every: usize::MAX, look: &mut look };
    let verdict = scene.attempt(&attempt, Mode::Fast, Some(observer));
    (verdict, start.unwrap())
}

/// Every frame that a proposal mentions, against the view it was made from; then the simulator's own.
fn frames_agree(scene: &SettledScene, view: &View, primitive: Primitive, proposals: &[Proposal]) {
    let world_from_camera = view.camera.world_from_camera;
    for proposal in proposals {
        let grasp = grasp_of(proposal);
        assert!((grasp.approach() - Vector3::from(proposal.approach)).norm() < 1e-6);
        assert!((grasp.forward() - Vector3::from(proposal.forward)).norm() < 1e-6);
        assert!((grasp.rotation.matrix().determinant() - 1.0).abs() < 1e-5);
        assert!(view.link_at(proposal.pixel).unwrap() > 0, "only parts that move were asked for");
        let seen = view.point_in_world(proposal.pixel).unwrap();
        let meant = world_from_camera * grasp.point;
        assert!((meant - seen).norm() < 1e-3, "{meant} for what is seen at {seen}");

        same_pose(&matrix(&proposal.hand_pose.unwrap()), &grasp.hand_at(0.15), 1e-5);
        let planned: Vec<_> = primitive.motion(&grasp).waypoints().collect();
        assert_eq!(proposal.waypoints.len(), planned.len());
        for (waypoint, pose) in proposal.waypoints.iter().zip(&planned) {
            same_pose(&matrix(waypoint), pose, 1e-5);
        }
    }

    let best = &proposals[0];
    let grasp_in_world = grasp_of(best).transformed(&world_from_camera);
    let trial = (primitive, best.pixel);
    let (verdict, start) = execute(scene, view, trial, &grasp_in_world);
    let promised = world_from_camera.to_homogeneous() * matrix(&best.hand_pose.unwrap());
    same_pose(&promised, &start, 1e-4);
    assert_eq!(verdict.q_start, scene.q()[view.link_at(best.pixel).unwrap() - 1]);
    assert!(verdict.q_end.is_finite() && (!verdict.success || verdict.invalid.is_none()));
    let seen = Trial::seen_from(
        &view.camera.camera_from_world(),
        (primitive, Policy::Adaptive),
        (best.pixel, 1),
        &grasp_in_world,
        &verdict,
    );
    assert!((seen.grasp_in_camera.point - grasp_of(best).point).norm() < 1e-4);
    assert!(seen.grasp_in_camera.rotation.angle_to(&grasp_of(best).rotation) < 1e-3);
    assert_eq!(execute(scene, view, trial, &grasp_in_world), (verdict, start), "a second time");
}

/// The committed examples are what the first commands of the documentation are about.
fn predict_example(predictor: &Predictor, modality: Modality) {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../examples");
    let observation = match modality {
        Modality::Rgb => {
            let Picture { size, rgb, .. } = read_picture(&examples.join("cabinet.png")).unwrap();
            Observation::Image { size, rgb: Some(rgb), depth: None, intrinsics: None, mask: None }
        }
        Modality::Cloud => {
            let points = read_scan(&examples.join("cabinet.ply")).unwrap();
            assert_eq!(points.len(), 20_000);
            // In front of a camera that looks at a thing of about a metre from five metres.
            assert!(points.iter().all(|p| (4.0..6.0).contains(&p.z) && p.x.hypot(p.y) < 1.1));
            Observation::Cloud { points }
        }
    };
    // Of what a network proposes that has hardly learnt anything, few hands have room.
    let options = Options { clearance: false, ..Options::default() };
    let prediction = predictor.predict(&observation, &options).unwrap();
    assert!(prediction.primitives.iter().all(|of| of.proposals.len() == 10));
    assert_eq!(prediction.primitives[0].proposals[0].point.is_some(), modality == Modality::Cloud);
}

#[test]
fn from_an_object_to_executed_proposals() {
    let (scene, view) = cabinet();
    let folder = tempfile::tempdir().unwrap();
    let dataset = collect(&folder.path().join("data"));
    for (name, modality) in [("cloud", Modality::Cloud), ("rgb", Modality::Rgb)] {
        let weights = learn(&dataset, modality, &folder.path().join(name));
        let predictor = Predictor::load(&weights).unwrap();
        let options = Options {
            top_k: 5,
            region: Some(view.link.iter().map(|&link| link > 1).collect()),
            network_from_metres: Some(1.0),
            ..Options::default()
        };
        let prediction = predictor.predict(&view.observation(), &options).unwrap();
        let json = serde_json::to_string(&prediction).unwrap();
        let read: Prediction = serde_json::from_str(&json).unwrap();
        assert_eq!(read.primitives, prediction.primitives, "files say what was predicted, to the last bit");
        assert_eq!(read.primitives.iter().map(|of| of.primitive).collect::<Vec<_>>(), PRIMITIVES);
        for of in &read.primitives {
            assert_eq!(of.proposals.len(), 5, "{name}, {}", of.primitive);
            frames_agree(&scene, &view, of.primitive, &of.proposals);
        }
        predict_example(&predictor, modality);
    }
}

/// The way of a proposal, camera frame to world, with trials that are known to succeed: nothing on it spoils them.
#[test]
fn what_succeeds_in_the_world_succeeds_by_way_of_the_camera() {
    let (scene, view) = cabinet();
    let sampler = Sampler::new(&scene, &view).unwrap();
    let camera = view.camera;
    for primitive in PRIMITIVES {
        let tries = (0..400).map(|n| sampler.guided(primitive, &mut Seed(n).child("story", 0).rng()));
        let mut found = tries.filter_map(|candidate| {
            let trial = (primitive, candidate.pixel);
            let verdict = execute(&scene, &view, trial, &candidate.grasp_in_world).0;
            verdict.success.then_some((candidate, verdict))
        });
        for _ in 0..3 {
            let (candidate, direct) = found.next().expect("the guided policy knows how");
            let stored = Trial::seen_from(
                &camera.camera_from_world(),
                (primitive, Policy::Guided),
                (candidate.pixel, candidate.link as u8),
                &candidate.grasp_in_world,
                &direct,
            );
            let read: Trial = serde_json::from_str(&serde_json::to_string(&stored).unwrap()).unwrap();
            assert_eq!(read, stored);
            let run = |trial: &Trial| {
                let grasp_in_world = trial.grasp_in_camera.transformed(&camera.world_from_camera);
                let (verdict, start) = execute(&scene, &view, (primitive, trial.pixel), &grasp_in_world);
                assert!(
                    (start.inverse() * candidate.grasp_in_world.hand_at(0.15)).translation.vector.norm()
                        < 1e-5
                );
                verdict
            };
            let back = run(&read);
            assert_eq!(back, run(&stored), "bit for bit");
            // Two changes of frame round the pose to about 1e-6, and contacts multiply that.
            assert!(back.success && back.invalid == direct.invalid && back.q_start == direct.q_start);
            assert!((back.q_end - direct.q_end).abs() < 0.02, "{primitive}: {back:?} for {direct:?}");
        }
    }
}
