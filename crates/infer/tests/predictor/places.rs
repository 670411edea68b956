//! Where proposals are looked for: masks, regions, pixels, and how many.

use nalgebra::{Point3, Vector3};
use where2act_core::{Grasp, ImageSize, Intrinsics, Observation, Pixel, Primitive, Seed};
use where2act_infer::{Backend, Options, Output, Predictor};
use where2act_model::{Modality, ModelConfig, Network, Weights};

use crate::{ball, picture, predictor};

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
fn as_many_proposals_as_are_asked_for() {
    let options =
        Options { top_k: 60, primitives: vec![Primitive::Pushing], clearance: false, ..Options::default() };
    let prediction = predictor(Modality::Rgb).predict(&picture(300, 300), &options).unwrap();
    assert!(prediction.primitives[0].proposals.len() > 32, "{}", prediction.primitives[0].proposals.len());
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
