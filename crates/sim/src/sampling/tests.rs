use where2act_core::Seed;

use super::*;
use crate::collect::{ObjectSet, Preparer, Recipe, ScenePrep};

fn drawers() -> ScenePrep {
    let objects =
        ObjectSet::Procedural { categories: vec![where2act_core::Category::StorageFurniture], seeds: 0..20 };
    Preparer::new(Recipe { objects, ..Recipe::default() }).prepare(0).unwrap().unwrap()
}

#[test]
fn random_is_uniform_in_the_hemisphere_and_on_movable_parts() {
    let prep = drawers();
    let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
    let mut rng = Seed(1).rng();
    let mut mean = 0.0;
    let n = 4000;
    for _ in 0..n {
        let c = sampler.random(&mut rng);
        assert!(c.link > 0 && prep.view.link_at(c.pixel) == Some(c.link));
        let against = -c.grasp_in_world.approach().dot(&c.normal_in_world);
        assert!(against >= -1e-5);
        mean += against / n as f32;
    }
    // The cosine to a uniform direction in a hemisphere is uniform in [0, 1].
    assert!((mean - 0.5).abs() < 0.02, "{mean}");
}

#[test]
fn guided_follows_the_joint() {
    let prep = drawers();
    let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
    let mut rng = Seed(2).rng();
    for primitive in Primitive::ALL {
        let mut along = 0;
        for _ in 0..200 {
            let c = sampler.guided(primitive, &mut rng);
            assert!(c.grasp_in_world.approach().dot(&c.normal_in_world) <= 1e-5);
            let motion = sampler.motion_of(c.link, &c.grasp_in_world.point).unwrap();
            let cosine = primitive.intended_direction(&c.grasp_in_world).dot(&motion.direction);
            along += usize::from(cosine.abs() > 0.29);
        }
        assert!(along > 150, "{primitive}: {along} of 200 along the joint's motion");
    }
}

#[test]
fn a_way_is_free_until_the_palm_would_be_in_the_part() {
    let prep = drawers();
    let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
    let mut rng = Seed(3).rng();
    for primitive in [Primitive::Pushing, Primitive::Pulling] {
        let mut free = 0;
        for _ in 0..200 {
            let c = sampler.guided(primitive, &mut rng);
            let allows = |grasp: &Grasp| sampler.clear.allows(primitive, c.link, grasp);
            if !allows(&c.grasp_in_world) {
                continue;
            }
            free += 1;
            let deeper = c.grasp_in_world.point + c.grasp_in_world.approach() * 0.08;
            assert!(!allows(&Grasp { point: deeper, ..c.grasp_in_world }), "{primitive} at {deeper}");
        }
        assert!(free > 20, "{primitive}: {free} free ways");
    }
}

#[test]
fn who_comes_from_the_camera_begins_in_view() {
    let prep = drawers();
    let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
    let mut rng = Seed(4).rng();
    let eye = Point3::from(prep.view.camera.world_from_camera.translation.vector);
    for _ in 0..200 {
        let c = sampler.random(&mut rng);
        let point = c.grasp_in_world.point;
        let towards = |approach: Vector3<f32>| Grasp::new(point, approach, c.grasp_in_world.forward());
        assert!(sampler.begins_in_view(&towards(point - eye)));
        assert!(!sampler.begins_in_view(&towards(eye - point)));
    }
}

#[test]
fn networks_learn_from_hands_that_begin_in_view() {
    let prep = drawers();
    let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
    let mut rng = Seed(5).rng();
    let mut hidden = |next: &dyn Fn(&mut rand_chacha::ChaCha8Rng) -> Candidate| {
        (0..200).filter(|_| !sampler.begins_in_view(&next(&mut rng).grasp_in_world)).count()
    };
    let anywhere = hidden(&|rng| sampler.guided(Primitive::Pushing, rng));
    let in_view = hidden(&|rng| sampler.guided_in_view(Primitive::Pushing, rng));
    assert!(anywhere > 10 && in_view <= 1, "{anywhere} {in_view} of 200 begin behind what is seen");
}
