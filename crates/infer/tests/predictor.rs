//! The library with small random networks: what holds for any weights.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rand::RngExt;
use where2act_core::{
    GRIPPER, Grasp, ImageSize, Intrinsics, Observation, Pixel, Prediction, Primitive, PrimitivePrediction,
    Seed, Timing,
};
use where2act_infer::{Backend, Error, Options, Output, Predictor, draw_overlay};
use where2act_kernels::Isa;
use where2act_model::{Modality, ModelConfig, Network, Weights};

fn predictor_on(modality: Modality, backend: Backend) -> Predictor {
    let config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(1024);
    let network = Network::new(&config, Seed(7), &burn::tensor::Device::flex());
    Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, backend).unwrap()
}

fn predictor(modality: Modality) -> Predictor {
    predictor_on(modality, Backend::Fast)
}

fn picture(width: usize, height: usize) -> Observation {
    let rgb = (0..width * height)
        .map(|i| [(i % 251) as u8, (i / width.max(1)) as u8, (i % 13) as u8 * 19])
        .collect();
    let size = ImageSize { width, height };
    Observation::Image { size, rgb: Some(rgb), depth: None, intrinsics: None, mask: None }
}

/// A sphere of radius `r` at distance `z`, as far as it is seen.
fn ball(n: usize, r: f32, z: f32) -> Vec<Point3<f32>> {
    (0..n)
        .map(|i| {
            let (a, h) = (i as f32 * 2.399_963, (i as f32 + 0.5) / n as f32);
            let s = (1.0 - h * h).sqrt();
            Point3::new(r * s * a.cos(), r * s * a.sin(), z - r * h)
        })
        .collect()
}

fn untimed(mut prediction: Prediction) -> Prediction {
    prediction.timing = Timing::default();
    prediction
}

#[test]
fn eight_threads_share_one_predictor_and_agree() {
    fn shareable<T: Send + Sync>(_: &T) {}
    for (modality, observation) in [
        (Modality::Rgb, picture(200, 150)),
        (Modality::Cloud, Observation::Cloud { points: ball(5000, 0.5, 2.0) }),
    ] {
        let predictor = predictor(modality);
        shareable(&predictor);
        let options = Options::default();
        let expected = untimed(predictor.predict(&observation, &options).unwrap());
        let answers: Vec<Prediction> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..8)
                .map(|_| scope.spawn(|| untimed(predictor.predict(&observation, &options).unwrap())))
                .collect();
            threads.into_iter().map(|t| t.join().unwrap()).collect()
        });
        assert!(answers.iter().all(|a| *a == expected));
        let batch =
            predictor.predict_batch(&[observation.clone(), picture(0, 0), observation.clone()], &options);
        assert_eq!(untimed(batch[0].as_ref().unwrap().clone()), expected);
        assert!(batch[1].is_err());
        assert_eq!(untimed(batch[2].as_ref().unwrap().clone()), expected);
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(
                untimed(pool.install(|| predictor.predict(&observation, &options)).unwrap()),
                expected
            );
        }
    }
}

/// Threads that ask different things must not see each other's buffers.
#[test]
fn eight_threads_with_different_inputs_get_their_own_answers() {
    for modality in [Modality::Rgb, Modality::Cloud] {
        let predictor = predictor(modality);
        let observations: Vec<Observation> = (0..8)
            .map(|i| match modality {
                Modality::Rgb => picture(100 + 31 * i, 230 - 17 * i),
                Modality::Cloud => {
                    Observation::Cloud { points: ball(1500 + 700 * i, 0.3 + 0.05 * i as f32, 2.0) }
                }
            })
            .collect();
        let options = |i: usize| Options { seed: Seed(i as u64), ..Options::default() };
        let answer = |i: usize| untimed(predictor.predict(&observations[i], &options(i)).unwrap());
        let expected: Vec<Prediction> = (0..8).map(answer).collect();
        assert!((1..8).all(|i| expected[i].primitives != expected[0].primitives));
        std::thread::scope(|scope| {
            for i in 0..8 {
                let (answer, expected) = (&answer, &expected);
                // Every thread begins with another input, so that the threads never go in step.
                scope.spawn(move || {
                    for j in (0..8).map(|j| (i + j) % 8) {
                        assert!(answer(j) == expected[j], "thread {i}, input {j}");
                    }
                });
            }
        });
    }
}

#[test]
fn the_engine_and_burn_agree() {
    let observation = picture(200, 150);
    let maps = |backend| {
        let predictor = predictor_on(Modality::Rgb, backend);
        predictor.predict_dense(&observation, &Options::default()).unwrap().maps.dense(Primitive::Pulling)
    };
    let (fast, burn) = (maps(Backend::Fast), maps(Backend::Flex));
    let apart = |other: &[f32]| {
        assert_eq!(fast.len(), other.len());
        let apart = fast.iter().zip(other).map(|(a, b)| (a - b).abs());
        // `max` alone would pass over what is no number.
        apart.fold(0.0f32, |most, d| if d.is_nan() { f32::INFINITY } else { most.max(d) })
    };
    assert!(apart(&burn) < 1e-4, "{}", apart(&burn));
    if Isa::bf16().is_some() {
        let near = apart(&maps(Backend::Bf16));
        assert!(near > 1e-5 && near < 2e-2, "{near}");
    }
}

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
fn a_mask_keeps_candidates_and_heat_on_the_object() {
    let mut observation = picture(100, 80);
    let on = |i: usize| (40..60).contains(&(i % 100)) && i / 100 < 40;
    if let Observation::Image { mask, .. } = &mut observation {
        *mask = Some((0..8000).map(on).collect());
    }
    let output = predictor(Modality::Rgb);
    let output = output.predict_dense(&observation, &Options::default()).unwrap();
    for p in output.prediction.primitives.iter().flat_map(|p| &p.proposals) {
        assert!(on(p.pixel.v as usize * 100 + p.pixel.u as usize));
    }
    let map = output.maps.dense(Primitive::Pulling);
    assert!((0..8000).all(|i| (map[i] > 0.0) == on(i)));
}

/// A network that looks closely sees of a masked picture what it sees of the picture cut out, and says so in the picture's pixels.
#[test]
fn a_close_look_at_a_mask_is_a_look_at_what_was_cut_out() {
    let mut config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(0.125);
    config.preprocessing.close_up = Some(1.5);
    let network = Network::new(&config, Seed(7), &burn::tensor::Device::flex());
    let predictor =
        Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, Backend::Fast).unwrap();
    let Observation::Image { size, rgb: Some(rgb), .. } = picture(200, 150) else { unreachable!() };
    // A part of the picture with its own part of the mask, seen by the same camera.
    let view = |[left, top, right, bottom]: [usize; 4], on: &dyn Fn(usize, usize) -> bool| {
        let part = ImageSize { width: right - left, height: bottom - top };
        let at = |i: usize| (left + i % part.width, top + i / part.width);
        let (cx, cy) = (100.0 - left as f32, 75.0 - top as f32);
        Observation::Image {
            size: part,
            rgb: Some((0..part.pixels()).map(at).map(|(u, v)| rgb[v * size.width + u]).collect()),
            depth: Some(vec![2.0; part.pixels()]),
            intrinsics: Some(Intrinsics { fx: 300.0, fy: 300.0, cx, cy }),
            mask: Some((0..part.pixels()).map(at).map(|(u, v)| on(u, v)).collect()),
        }
    };
    let options = Options { clearance: false, ..Options::default() };
    for (object, window) in [
        ([100, 50, 140, 74], [90, 32, 150, 92]),
        // At the right edge, in a corner, and wider than high: what is shown of the squares is no square.
        ([180, 60, 200, 100], [160, 50, 200, 110]),
        ([0, 0, 40, 21], [0, 0, 50, 41]),
        ([20, 100, 160, 140], [0, 15, 195, 150]),
        ([70, 71, 74, 75], [69, 70, 75, 76]),
    ] {
        let [left, top, right, bottom] = object;
        let on = move |u: usize, v: usize| (left..right).contains(&u) && (top..bottom).contains(&v);
        let (large, small) = (view([0, 0, 200, 150], &on), view(window, &on));
        let [close, cut_out] = [&large, &small].map(|seen| predictor.predict_dense(seen, &options).unwrap());
        let moved = |pixel: Pixel| Pixel { u: pixel.u + window[0] as u32, v: pixel.v + window[1] as u32 };
        for (found, expected) in close.prediction.primitives.iter().zip(&cut_out.prediction.primitives) {
            assert!(!found.proposals.is_empty());
            assert_eq!(found.actionability, expected.actionability, "{object:?}");
            assert_eq!(found.proposals.len(), expected.proposals.len());
            for (found, expected) in found.proposals.iter().zip(&expected.proposals) {
                assert_eq!(found.pixel, moved(expected.pixel));
                assert_eq!((found.score, found.rotation), (expected.score, expected.rotation));
            }
        }
        for (u, v) in [(left, top), ((left + right) / 2, (top + bottom) / 2), (right - 1, bottom - 1)] {
            let at = |output: &Output<'_>, u: usize, v: usize| {
                output.maps.at(Primitive::Pulling, u as f32 + 0.25, v as f32 + 0.75).unwrap()
            };
            let (found, expected) = (at(&close, u, v), at(&cut_out, u - window[0], v - window[1]));
            assert!((found - expected).abs() < 1e-5, "{object:?}: {found} {expected}");
        }
        // What is asked about is found there too: a pixel, and a hand of the caller's own.
        let pixel = cut_out.prediction.primitives[0].proposals[0].pixel;
        let ask = |seen, pixel| {
            let options = Options { pixel: Some(pixel), ..options.clone() };
            predictor.predict(seen, &options).unwrap().primitives.swap_remove(0)
        };
        let (found, expected) = (ask(&large, moved(pixel)), ask(&small, pixel));
        assert_eq!(found.actionability, expected.actionability);
        assert_eq!(found.proposals[0].rotation, expected.proposals[0].rotation);
        let hand = Grasp {
            point: Point3::from(close.prediction.primitives[0].proposals[0].point.unwrap()),
            rotation: nalgebra::Rotation3::from_axis_angle(&Vector3::y_axis(), 0.3),
        };
        let score =
            |seen| predictor.score(seen, &[(Primitive::Pushing, hand)], &options).unwrap()[0].unwrap();
        let (found, expected) = (score(&large), score(&small));
        assert!((found - expected).abs() < 1e-4, "{object:?}: {found} {expected}");
    }
}

#[test]
fn what_is_smaller_than_a_pixel_of_the_network_is_found() {
    // A pixel of the network is some four wide and high here.
    let on = |pixels: &[usize]| (0..900 * 700).map(|i| pixels.contains(&i)).collect::<Vec<_>>();
    let predictor = predictor(Modality::Rgb);
    let seen = |mask: Option<Vec<bool>>, region: Option<Vec<bool>>| {
        let mut observation = picture(900, 700);
        if let Observation::Image { mask: of, .. } = &mut observation {
            *of = mask;
        }
        let options = Options { region, ..Options::default() };
        let prediction = predictor.predict(&observation, &options).map_err(|e| e.to_string())?;
        assert!(prediction.primitives.iter().all(|of| of.actionability.max > 0.0));
        let proposals = prediction.primitives.into_iter().flat_map(|of| of.proposals);
        Ok(proposals.map(|p| (p.pixel.u, p.pixel.v)).collect::<Vec<_>>())
    };
    let corner = || Some(on(&[900 * 699 + 899]));
    assert_eq!(seen(None, corner()), Ok(vec![(899, 699); 6]));
    assert_eq!(seen(corner(), None), Ok(vec![(899, 699); 6]));
    // Both ends of a picture, and nothing between.
    let mut ends = seen(None, Some(on(&[0, 900 * 699 + 899]))).unwrap();
    ends.sort_unstable();
    assert_eq!(ends, [[(0, 0); 6], [(899, 699); 6]].concat());
    let none = |what: &str| Err(format!("{what}: expected pixels or points of the object, found none"));
    assert_eq!(seen(Some(on(&[])), None), none("mask"));
    assert_eq!(seen(Some(on(&[])), corner()), none("mask"));
    assert_eq!(seen(None, Some(on(&[]))), none("region"));
    assert_eq!(seen(corner(), Some(on(&[0]))), none("region"));
}

/// A wall with a step of 15 cm towards the camera on its right side.
fn step() -> Observation {
    let size = ImageSize::square(32);
    let depth = (0..size.pixels()).map(|i| if i % 32 < 16 { 2.0 } else { 1.85 }).collect();
    let rgb = Some(vec![[200, 180, 160]; size.pixels()]);
    let intrinsics = Some(Intrinsics::from_fov(size, 0.4));
    Observation::Image { size, rgb, depth: Some(depth), intrinsics, mask: None }
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

#[test]
fn the_very_point_that_was_asked_for_answers() {
    let predictor = predictor(Modality::Cloud);
    let points = ball(6000, 0.5, 2.0);
    let observation = Observation::Cloud { points: points.clone() };
    // A network of 1,024 points sees one of six of these: most neighbours share their nearest one.
    let mut scores: Vec<f32> = (0..12u32)
        .map(|i| {
            let pixel = Pixel { u: 2000 + i, v: 0 };
            let primitives = vec![Primitive::Pushing];
            let options = Options { pixel: Some(pixel), primitives, clearance: false, ..Options::default() };
            let prediction = predictor.predict(&observation, &options).unwrap();
            let best = &prediction.primitives[0].proposals[0];
            assert_eq!(best.point, Some(points[pixel.u as usize].into()));
            best.actionability
        })
        .collect();
    scores.sort_by(f32::total_cmp);
    scores.dedup();
    assert_eq!(scores.len(), 12);
}

#[test]
fn a_region_between_the_network_s_points_is_found() {
    // As above: five of six of the scan's points are none of the network's.
    let predictor = predictor(Modality::Cloud);
    let points = ball(6000, 0.5, 2.0);
    let scan = Observation::Cloud { points: points.clone() };
    let size = ImageSize::square(96);
    let depth = Some((0..size.pixels()).map(|i| 2.0 + (i % 96) as f32 * 1e-3).collect());
    let camera = Intrinsics::from_fov(size, 0.5);
    let map = Observation::Image { size, rgb: None, depth, intrinsics: Some(camera), mask: None };
    // What is so near one of the points: a handful.
    let around = |i: usize| points.iter().map(|p| (p - points[i]).norm() < 0.02).collect::<Vec<bool>>();
    for i in (3000..5000).step_by(250) {
        let inside = around(i);
        let options = Options { region: Some(inside.clone()), clearance: false, ..Options::default() };
        let prediction = predictor.predict(&scan, &options).unwrap();
        let proposals: Vec<_> = prediction.primitives.iter().flat_map(|of| &of.proposals).collect();
        assert!(proposals.len() > 2 && proposals.iter().all(|p| inside[p.pixel.u as usize]), "{i}");
    }
    for (observation, length) in [(&scan, points.len()), (&map, size.pixels())] {
        for first in 3000..3008 {
            let region = Some((0..length).map(|i| (first..first + 3).contains(&i)).collect());
            let options = Options { region, clearance: false, ..Options::default() };
            let prediction = predictor.predict(observation, &options).unwrap();
            // All of a random network's hands may come out of the surface.
            let proposals: Vec<_> = prediction.primitives.iter().flat_map(|of| &of.proposals).collect();
            assert!(proposals.len() > 2, "{first}: {}", proposals.len());
            for best in proposals {
                let at = best.pixel.v as usize * 96 + best.pixel.u as usize;
                assert!((first..first + 3).contains(&at), "{first}: {at}");
                let there = match observation {
                    Observation::Cloud { points } => points[at],
                    Observation::Image { .. } => {
                        camera.pixel_to_point(best.pixel, 2.0 + best.pixel.u as f32 * 1e-3)
                    }
                };
                assert!((Point3::from(best.point.unwrap()) - there).norm() < 1e-5);
            }
        }
    }
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
fn as_many_proposals_as_are_asked_for() {
    let options =
        Options { top_k: 60, primitives: vec![Primitive::Pushing], clearance: false, ..Options::default() };
    let prediction = predictor(Modality::Rgb).predict(&picture(300, 300), &options).unwrap();
    assert!(prediction.primitives[0].proposals.len() > 32, "{}", prediction.primitives[0].proposals.len());
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

/// What is built in is what lies in `weights/`, and it answers as if it had been loaded from there.
#[cfg(feature = "bundled-weights")]
#[test]
fn bundled_weights_are_those_of_the_workspace() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights");
    for (name, modality, observation) in [
        ("rgb", Modality::Rgb, picture(200, 150)),
        ("cloud", Modality::Cloud, Observation::Cloud { points: ball(5000, 0.5, 2.0) }),
    ] {
        let bundled = Predictor::bundled(modality, Backend::default()).unwrap();
        let loaded = Predictor::load(&folder.join(name)).unwrap();
        assert_eq!(bundled.model(), loaded.model());
        let answer = |p: &Predictor| untimed(p.predict(&observation, &Options::default()).unwrap());
        assert_eq!(answer(&bundled), answer(&loaded));
    }
}

#[test]
fn the_best_at_each_place_is_the_first_of_several() {
    let observation = picture(200, 150);
    for seed in 0..3 {
        let with = |per_pixel, top_k| {
            let options =
                Options { per_pixel: Some(per_pixel), top_k, seed: Seed(seed), ..Options::default() };
            predictor(Modality::Rgb).predict(&observation, &options).unwrap().primitives
        };
        for (one, several) in with(1, 32).into_iter().zip(with(3, 96)) {
            let mut seen = Vec::new();
            let firsts = several.proposals.iter().filter(|p| {
                let first = !seen.contains(&p.pixel);
                seen.push(p.pixel);
                first
            });
            let found: Vec<_> = one.proposals.iter().map(|p| (p.pixel, p.score, p.approach)).collect();
            assert!(found.len() > 10);
            assert_eq!(found, firsts.map(|p| (p.pixel, p.score, p.approach)).collect::<Vec<_>>());
        }
    }
}
