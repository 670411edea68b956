//! Poses of hands, and the room they have.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use where2act_core::{GRIPPER, Observation, Primitive, Seed};
use where2act_infer::{Backend, Options, Predictor};
use where2act_model::{Modality, ModelConfig, Network, Weights};

use crate::{ball, predictor, step, untimed};

#[test]
fn poses_come_back_in_the_inputs_metres_whatever_its_size_and_place() {
    let predictor = predictor(Modality::Cloud);
    for (radius, distance) in [(0.5, 2.0), (0.02, 0.3), (20.0, 90.0)] {
        let observation = Observation::Cloud { points: ball(4000, radius, distance) };
        let prediction = predictor.predict(&observation, &Options::default()).unwrap();
        let scale = prediction.input.network_from_metres;
        assert_eq!(scale == 1.0, radius == 0.5, "{scale}");
        let mut proposals = 0;
        for p in prediction.primitives.iter().flat_map(|p| &p.proposals) {
            let point = Point3::from(p.point.unwrap());
            let from_centre = point - Point3::new(0.0, 0.0, distance);
            assert!((from_centre.norm() - radius).abs() < 1e-3 * (radius + distance), "on the ball");
            let approach = Vector3::from(p.approach);
            // At the ball's rim the view decides poorly which side is out.
            let rim = from_centre.z > -0.3 * radius;
            assert!(rim || approach.dot(&from_centre.normalize()) < 0.35, "from outside");
            let rotation = Matrix3::from(p.rotation).transpose();
            assert!((rotation.determinant() - 1.0).abs() < 1e-4);
            assert!((rotation.column(2) - approach).norm() < 1e-6);
            let flange = Point3::from(p.poses().next().unwrap().translation.vector);
            // The hand is as large as it is: 0.15 m before the contact.
            assert!(((flange - point).norm() - 0.15).abs() < 1e-4 * (1.0 + distance));
            proposals += 1;
        }
        assert!(proposals > 20, "{proposals}");
        let kept = Options { network_from_metres: Some(1.0), ..Options::default() };
        assert_eq!(predictor.predict(&observation, &kept).unwrap().input.network_from_metres, 1.0);
    }
}

#[test]
fn hands_that_begin_in_what_is_seen_are_left_out() {
    let observation = step();
    let points = observation.foreground_points();
    let in_palm = |pose: &Isometry3<f32>| {
        let pose = pose.inverse();
        let (low, high) = (GRIPPER.hand_min, GRIPPER.hand_max);
        let inside = |p: Point3<f32>| (0..3).all(|i| (low[i] + 0.002..high[i] - 0.002).contains(&p[i]));
        points.iter().filter(|(_, point)| inside(pose.transform_point(point))).count()
    };
    let config = ModelConfig { second_look: true, ..ModelConfig::new(Modality::Cloud, &Primitive::ALL) };
    let network = Network::new(&config.with_points(1024), Seed(7), &burn::tensor::Device::flex());
    let looks_twice = Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, Backend::Fast);
    let predictors = [predictor(Modality::Rgb), predictor(Modality::Cloud), looks_twice.unwrap()];
    for (i, predictor) in predictors.iter().enumerate() {
        let crowded = |clearance| {
            let options = Options { top_k: 3000, per_pixel: Some(100), clearance, ..Options::default() };
            let prediction = predictor.predict(&observation, &options).unwrap();
            let hands: Vec<_> = prediction.primitives.iter().flat_map(|p| &p.proposals).collect();
            assert!(hands.len() > 500, "{i}: {}", hands.len());
            hands.iter().filter(|hand| in_palm(&hand.poses().next().unwrap()) > 1).count()
        };
        assert!(crowded(false) > 10 && crowded(true) == 0, "{i}");
    }
    // A mask hides nothing that may be in the way; without a camera nobody knows what is.
    let Observation::Image { size, rgb, depth, intrinsics, .. } = step() else { unreachable!() };
    let wall = Some((0..size.pixels()).map(|i| i % 32 < 16).collect());
    let masked = Observation::Image { size, rgb: rgb.clone(), depth: depth.clone(), intrinsics, mask: wall };
    let unknown = Observation::Image { size, rgb, depth, intrinsics: None, mask: None };
    let all = |clearance| Options { top_k: 3000, per_pixel: Some(100), clearance, ..Options::default() };
    let hands = |observation, clearance| {
        let prediction = untimed(predictors[0].predict(observation, &all(clearance)).unwrap());
        prediction.primitives.into_iter().flat_map(|p| p.proposals).collect::<Vec<_>>()
    };
    assert!(hands(&masked, true).iter().all(|hand| in_palm(&hand.poses().next().unwrap()) < 2));
    assert!(hands(&masked, false).iter().any(|hand| in_palm(&hand.poses().next().unwrap()) > 1));
    assert_eq!(hands(&unknown, true), hands(&unknown, false));
    let kind = |observation| predictors[0].predict(observation, &all(true)).unwrap().input.kind;
    assert_eq!((kind(&masked).as_str(), kind(&unknown).as_str()), ("rgbd", "rgb"));
    let refused = predictors[1].predict(&unknown, &all(true)).unwrap_err().to_string();
    assert_eq!(refused, "intrinsics: expected those of the depth map, found none");
}

#[test]
fn holes_of_a_depth_map_come_last() {
    let Observation::Image { size, rgb, intrinsics, .. } = step() else { unreachable!() };
    // Seen on the left; a hole on the right, wider than a contact point is looked for.
    let depth = Some((0..size.pixels()).map(|i| if i % 32 < 12 { 2.0 } else { 0.0 }).collect());
    let observation = Observation::Image { size, rgb, depth, intrinsics, mask: None };
    let predictor = predictor(Modality::Rgb);
    let points = |region: Option<Vec<bool>>| {
        let options = Options { region, clearance: false, ..Options::default() };
        let prediction = predictor.predict(&observation, &options).unwrap();
        let proposals = prediction.primitives.into_iter().flat_map(|of| of.proposals);
        proposals.map(|p| p.point.is_some() && p.waypoints.len() > 1).collect::<Vec<bool>>()
    };
    assert!(points(None).len() > 20 && points(None).iter().all(|known| *known));
    let hole = points(Some((0..size.pixels()).map(|i| i % 32 > 20).collect()));
    assert!(hole.len() > 20 && hole.iter().all(|known| !known));
}
