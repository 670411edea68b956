//! Sizes, numbers and requests that nobody should make.

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use where2act_core::{
    Grasp, ImageSize, Intrinsics, Observation, Pixel, Prediction, Primitive, PrimitivePrediction, Seed,
};
use where2act_infer::{Error, Options, Output, draw_overlay};
use where2act_model::Modality;

use crate::{ball, picture, predictor};

#[test]
fn sizes_from_one_pixel_to_slivers() {
    let predictor = predictor(Modality::Rgb);
    for (width, height) in [(1, 1), (3000, 1), (1, 3000), (37, 1999)] {
        let observation = picture(width, height);
        let output = predictor.predict_dense(&observation, &Options::default()).unwrap();
        for of in &output.prediction.primitives {
            assert!(!of.proposals.is_empty());
            assert!(
                of.proposals.iter().all(|p| (p.pixel.u as usize) < width && (p.pixel.v as usize) < height)
            );
            let map = output.maps.dense(of.primitive);
            assert_eq!(map.len(), width * height);
            assert!(map.iter().all(|x| *x > 0.0 && *x <= of.actionability.max + 1e-6));
        }
    }
}

#[test]
fn scans_with_holes_in_their_numbers_keep_their_indices() {
    let predictor = predictor(Modality::Cloud);
    let mut points = ball(3000, 0.5, 2.0);
    for i in (0..3000).step_by(3) {
        points[i] = if i % 2 == 0 { Point3::new(f32::NAN, 0.0, f32::INFINITY) } else { Point3::origin() };
    }
    let observation = Observation::Cloud { points: points.clone() };
    let output = predictor.predict_dense(&observation, &Options::default()).unwrap();
    for p in output.prediction.primitives.iter().flat_map(|p| &p.proposals) {
        assert!((points[p.pixel.u as usize] - Point3::from(p.point.unwrap())).norm() < 1e-5);
    }
    let map = output.maps.dense(Primitive::Pushing);
    assert!((0..3000).all(|i| (map[i] == 0.0) == (i % 3 == 0)));
    assert_eq!(output.prediction.input.network_from_metres, 1.0);
    let nowhere = Options { pixel: Some(Pixel { u: 3, v: 0 }), ..Options::default() };
    assert!(predictor.predict(&observation, &nowhere).is_err());
}

#[test]
fn what_is_infinitely_far_away_is_not_seen() {
    // As renderers write what no surface covers; the object fills the left half.
    let size = ImageSize::square(64);
    let depth: Vec<f32> = (0..size.pixels()).map(|i| if i % 64 < 32 { 2.0 } else { 1e10 }).collect();
    let intrinsics = Some(Intrinsics::from_fov(size, 0.5));
    for (modality, rgb) in [(Modality::Cloud, None), (Modality::Rgb, Some(vec![[90; 3]; size.pixels()]))] {
        let predictor = predictor(modality);
        let observation =
            Observation::Image { size, rgb, depth: Some(depth.clone()), intrinsics, mask: None };
        let Output { prediction, maps } = predictor.predict_dense(&observation, &Options::default()).unwrap();
        for p in prediction.primitives.iter().flat_map(|of| &of.proposals) {
            assert!(p.pixel.u < 36 && p.point.unwrap()[2] == 2.0, "{:?}", p.point);
        }
        if modality == Modality::Cloud {
            assert!((0..64).all(|u| maps.at(Primitive::Pushing, u as f32, 9.0).is_some() == (u < 32)));
        }
        let background = Options { pixel: Some(Pixel { u: 60, v: 9 }), ..Options::default() };
        assert!(modality == Modality::Rgb || predictor.predict(&observation, &background).is_err());
    }
}

#[test]
fn what_is_of_no_use_is_refused_by_name() {
    let (rgb, cloud) = (predictor(Modality::Rgb), predictor(Modality::Cloud));
    let says = |result: Result<Prediction, Error>, words: &[&str]| {
        let message = result.unwrap_err().to_string();
        assert!(words.iter().all(|w| message.contains(w)), "{message} lacks one of {words:?}");
    };
    let options = Options::default();
    let points = |points| Observation::Cloud { points };
    let nan = Point3::new(f32::NAN, 0.0, 1.0);
    says(cloud.predict(&points(vec![]), &options), &["finite points", "none"]);
    says(cloud.predict(&points(vec![nan; 10]), &options), &["finite points", "none"]);
    says(cloud.predict(&points(vec![Point3::origin(); 10]), &options), &["finite points", "none"]);
    says(cloud.predict(&points(vec![Point3::new(0.0, 0.0, 1.0); 10]), &options), &["apart", "10"]);
    let behind = points(ball(100, 0.5, -2.0));
    says(cloud.predict(&behind, &options), &["optical frame", "100 of 100", "z <= 0"]);
    says(rgb.predict(&points(ball(100, 0.5, 2.0)), &options), &["scans", "pictures"]);
    let nowhere = Options { region: Some(vec![false; 100]), ..Options::default() };
    says(cloud.predict(&points(ball(100, 0.5, 2.0)), &nowhere), &["region", "points", "none"]);
    says(cloud.predict(&picture(8, 8), &options), &["pictures", "scans"]);
    says(rgb.predict(&picture(0, 8), &options), &["pixels"]);
    let elsewhere = Options { pixel: Some(Pixel { u: 8, v: 0 }), ..Options::default() };
    says(rgb.predict(&picture(8, 8), &elsewhere), &["pixel", "below 8", "8,0"]);
    let twice = Options { primitives: vec![Primitive::Pulling; 2], ..Options::default() };
    says(rgb.predict(&picture(8, 8), &twice), &["primitives", "each once", "pulling twice"]);
    let many = Options { samples: usize::MAX, ..Options::default() };
    says(rgb.predict(&picture(8, 8), &many), &["samples"]);
    let too_many = Options { samples: 10_000, candidates: 101, ..Options::default() };
    says(rgb.predict(&picture(8, 8), &too_many), &["samples", "1000000", "10000 x 101"]);

    let size = ImageSize::square(8);
    let intrinsics = Some(Intrinsics::from_fov(size, 0.6));
    let depth = |values: Vec<f32>, intrinsics| Observation::Image {
        size,
        rgb: None,
        depth: Some(values),
        intrinsics,
        mask: None,
    };
    says(cloud.predict(&depth(vec![0.0; 64], intrinsics), &options), &["finite points", "none"]);
    says(cloud.predict(&depth(vec![1.0; 63], intrinsics), &options), &["depth", "64", "63"]);
    says(cloud.predict(&depth(vec![1.0; 64], None), &options), &["intrinsics"]);
    let flat = Some(Intrinsics { fx: 0.0, fy: 1.0, cx: 0.0, cy: 0.0 });
    says(cloud.predict(&depth(vec![1.0; 64], flat), &options), &["intrinsics", "positive"]);
    let nothing = Observation::Image { size, rgb: None, depth: None, intrinsics, mask: None };
    says(cloud.predict(&nothing, &options), &["neither"]);
    // A size whose product is more than a number holds.
    let size = ImageSize { width: usize::MAX, height: 2 };
    let depth = Some(vec![1.0; 64]);
    let endless = Observation::Image { size, rgb: None, depth, intrinsics, mask: None };
    says(cloud.predict(&endless, &options), &["depth", &format!("= {} values", usize::MAX), "64"]);
}

#[test]
fn a_million_points() {
    let observation = Observation::Cloud { points: ball(1_000_000, 0.5, 2.0) };
    let prediction = predictor(Modality::Cloud).predict(&observation, &Options::default()).unwrap();
    assert_eq!(prediction.input.width, 1_000_000);
    // Whether fingers have room on both sides is luck with a network that has learnt nothing.
    let unlucky = |p: &PrimitivePrediction| p.proposals.is_empty() && p.primitive != Primitive::Pulling;
    assert!(!prediction.primitives.iter().any(unlucky));
}

/// A scan around its own origin has points beside the camera, whose projections have no bounds: what that overflows,
/// the overflow checks that CI runs this with would show.
#[test]
fn points_beside_the_camera_spoil_no_drawing() {
    let mut points = ball(3000, 0.5, 2.0);
    points.extend([Point3::new(1.0, 0.0, 1e-20), Point3::new(0.0, -1.0, 1e-20), Point3::new(1.0, 1.0, 0.0)]);
    let scan = Observation::Cloud { points };
    let predictor = predictor(Modality::Cloud);
    let Output { prediction, maps } = predictor.predict_dense(&scan, &Options::default()).unwrap();
    let overlay = draw_overlay(&maps, &prediction.primitives[0]);
    assert!(overlay.pixels().filter(|pixel| pixel.0 != [255; 3]).count() > 10_000);
}

/// Whatever hands and observations hold, hands have a score or none; CI runs this with overflow checks.
#[test]
fn odd_hands_on_odd_observations_have_a_score_or_none() {
    const ODD: [f32; 8] = [0.0, -0.0, f32::NAN, f32::INFINITY, f32::MAX, f32::MIN_POSITIVE, -2.0, 1e30];
    let (of_pictures, of_scans) = (predictor(Modality::Rgb), predictor(Modality::Cloud));
    let rng = &mut Seed(5).rng();
    let mut scored = 0;
    for round in 0..40 {
        let share = [0.0, 0.05, 0.5][round % 3];
        let mut number = |usual: f32| {
            if rng.random_bool(share) {
                ODD[rng.random_range(0..ODD.len())]
            } else {
                usual + rng.random_range(-0.01..0.01f32)
            }
        };
        let (width, height) = [(24, 18), (1, 1), (40, 1), (1, 40)][round % 4];
        let size = ImageSize { width, height };
        let depth = (round % 5 != 0).then(|| (0..size.pixels()).map(|_| number(2.0)).collect());
        let Observation::Image { rgb, .. } = picture(width, height) else { unreachable!() };
        let intrinsics = Some(Intrinsics::from_fov(size, 0.6));
        let scan = ball(600, 0.5, 2.0).iter().map(|p| p.map(&mut number)).collect();
        let hands: Vec<(Primitive, Grasp)> = (0..30)
            .map(|i| {
                let point = Point3::new(0.01 * i as f32, 0.0, 1.5 + 0.5 * (i % 2) as f32).map(&mut number);
                let hand = Grasp::new(point, Vector3::z().map(&mut number), Vector3::x().map(&mut number));
                (Primitive::ALL[i % 6], hand)
            })
            .collect();
        let views = [
            (&of_scans, Observation::Cloud { points: scan }),
            (&of_pictures, Observation::Image { size, rgb, depth, intrinsics, mask: None }),
        ];
        for (predictor, view) in views {
            if let Ok(scores) = predictor.score(&view, &hands, &Options::default()) {
                assert_eq!(scores.len(), hands.len());
                assert!(scores.iter().flatten().all(|score| (0.0..=1.0).contains(score)), "{scores:?}");
                scored += scores.iter().flatten().count();
            }
        }
    }
    assert!(scored > 100, "{scored}");
}
