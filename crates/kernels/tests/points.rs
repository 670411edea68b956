//! Sampling and neighbourhoods against the plain loops they stand for, on every instruction set.

use proptest::prelude::*;
use where2act_kernels::Isa;
use where2act_kernels::points::{
    Bounds, Frame, Selection, ball_query_with, furthest_point_sampling_with, gather_around, in_boxes_with,
    offset_gradient, three_nearest_with,
};

fn squared_distance(a: &[f32], b: &[f32]) -> f32 {
    let (dx, dy, dz) = (a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    dx * dx + dy * dy + dz * dz
}

fn naive_sampling(xyz: &[f32], m: usize, start: usize) -> Vec<u32> {
    let points: Vec<_> = xyz.chunks_exact(3).collect();
    if points.is_empty() {
        return Vec::new();
    }
    let finite = |p: &[f32]| p.iter().all(|v| v.is_finite());
    let mut distance: Vec<f32> =
        points.iter().map(|p| if finite(p) { f32::INFINITY } else { -1.0 }).collect();
    let mut next = start.min(points.len() - 1);
    (0..m)
        .map(|_| {
            let sample = next;
            for (d, p) in distance.iter_mut().zip(&points) {
                let new = squared_distance(p, points[sample]);
                *d = if new < *d { new } else { *d };
            }
            next = 0;
            for i in 1..points.len() {
                if distance[i] > distance[next] {
                    next = i;
                }
            }
            sample as u32
        })
        .collect()
}

fn naive_ball(xyz: &[f32], centres: &[f32], radius: f32, nsample: usize) -> Vec<u32> {
    let mut all = Vec::new();
    for centre in centres.chunks_exact(3) {
        let d: Vec<_> = xyz.chunks_exact(3).map(|p| squared_distance(p, centre)).collect();
        let mut found: Vec<u32> =
            (0..d.len()).filter(|&i| d[i] < radius * radius).map(|i| i as u32).take(nsample).collect();
        if found.is_empty() {
            let nearest = (0..d.len()).fold(0, |best, i| {
                if d[i] < d[best] || (d[best].is_nan() && !d[i].is_nan()) { i } else { best }
            });
            found.push(if d[nearest] < f32::INFINITY { nearest as u32 } else { 0 });
        }
        let first = found[0];
        found.resize(nsample, first);
        all.extend(found);
    }
    all
}

fn naive_three(unknown: &[f32], known: &[f32]) -> (Vec<[u32; 3]>, Vec<[f32; 3]>) {
    unknown
        .chunks_exact(3)
        .map(|u| {
            let mut near: Vec<(f32, u32)> = known
                .chunks_exact(3)
                .enumerate()
                .map(|(i, k)| (squared_distance(u, k), i as u32))
                .filter(|(d, _)| *d < f32::INFINITY)
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let last = near.get(..3.min(near.len())).and_then(|n| n.last()).copied();
            near.resize(near.len().max(3), last.unwrap_or((f32::INFINITY, 0)));
            ([near[0].1, near[1].1, near[2].1], [near[0].0.sqrt(), near[1].0.sqrt(), near[2].0.sqrt()])
        })
        .unzip()
}

fn naive_boxes(xyz: &[f32], frames: &[Frame], bounds: &Bounds, count: usize) -> Vec<f32> {
    let seen_from = |frame: &Frame| {
        let seen = xyz.chunks_exact(3).map(|p| {
            let [dx, dy, dz] = [0, 1, 2].map(|i| p[i] - frame.origin[i]);
            frame.axes.map(|axis| dx * axis[0] + dy * axis[1] + dz * axis[2])
        });
        let is_inside = |p: &[f32; 3]| (0..3).all(|i| p[i] > bounds.min[i] && p[i] < bounds.max[i]);
        let mut inside: Vec<[f32; 3]> = seen.filter(is_inside).take(count).collect();
        let first = inside.first().copied().unwrap_or_default();
        inside.resize(count, first);
        inside.concat()
    };
    frames.iter().flat_map(seen_from).collect()
}

fn frame() -> impl Strategy<Value = Frame> {
    (prop::array::uniform3(-1.0f32..1.0), 0.0f32..7.0, 0.0f32..7.0).prop_map(|(origin, a, b)| {
        let ((s, c), (t, d)) = (a.sin_cos(), b.sin_cos());
        Frame { origin, axes: [[c, s, 0.0], [-s * d, c * d, t], [s * t, -c * t, d]] }
    })
}

/// Coordinates on a coarse grid (many exact ties and duplicates), anywhere, or not a number.
fn coordinate() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => (-4i8..4).prop_map(|v| f32::from(v) * 0.25),
        8 => -1.0f32..1.0,
        1 => prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(3e38), Just(-0.0)],
    ]
}

fn cloud(max: usize) -> impl Strategy<Value = Vec<f32>> {
    prop_oneof![
        prop::collection::vec(-1.0f32..1.0, 0..3 * max),
        prop::collection::vec((-4i8..4).prop_map(|v| f32::from(v) * 0.25), 0..3 * max),
        prop::collection::vec(coordinate(), 0..3 * max),
    ]
}

/// Whether sums of so many terms within [-1, 1] are the expected ones but for an ulp at every addition.
fn close(isa: Isa, found: &[f32], expected: &[f64], terms: usize) -> Result<(), TestCaseError> {
    prop_assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
    let ulps = f64::from(f32::EPSILON) * terms as f64 * scale;
    for (a, b) in found.iter().zip(expected) {
        prop_assert!((f64::from(*a) - b).abs() <= ulps, "{}: {a}, expected {b}", isa.name());
    }
    Ok(())
}

proptest! {
    #[test]
    fn gathering_and_its_gradients_equal_the_plain_loops(
        inputs in 1usize..30, rows in 1usize..300, channels in 1usize..70, per_row in 1usize..4, seed in 0usize..1000,
    ) {
        let values = |len: usize, k: usize| -> Vec<f32> {
            (0..len).map(|i| ((i * k + seed) as f32 * 0.37).sin()).collect()
        };
        let indices: Vec<u32> = (0..rows * per_row).map(|i| ((i * 7 + seed * i) % inputs) as u32).collect();
        let weights = values(rows * per_row, 3);
        let (features, base) = (values(inputs * channels, 1), values(rows * channels, 2));
        let (dy, offsets, of_offset) =
            (values(rows * channels, 5), values(3 * rows, 7), values(3 * channels, 11));
        let mut gathered: Vec<f64> = base.iter().map(|v| f64::from(*v)).collect();
        let mut scattered = vec![0.0; features.len()];
        let mut around = vec![0.0; rows * channels];
        let mut of_weight = vec![0.0; 3 * channels];
        for (row, c) in (0..rows).flat_map(|row| (0..channels).map(move |c| (row, c))) {
            let at = row * channels + c;
            for entry in row * per_row..(row + 1) * per_row {
                let from = indices[entry] as usize * channels + c;
                gathered[at] += f64::from(weights[entry]) * f64::from(features[from]);
                scattered[from] += f64::from(weights[entry]) * f64::from(dy[at]);
            }
            // Around a centre there is one neighbour a row.
            around[at] = f64::from(features[indices[row] as usize * channels + c]);
            for axis in 0..3 {
                let offset = f64::from(offsets[3 * row + axis]);
                around[at] += offset * f64::from(of_offset[axis * channels + c]);
                of_weight[axis * channels + c] += offset * f64::from(dy[at]);
            }
        }
        let fails = |error| TestCaseError::fail(format!("{error}"));
        let one = Selection::new(indices[..rows].to_vec(), None, 1, inputs).map_err(fails)?;
        let several = Selection::new(indices, Some(weights), per_row, inputs).map_err(fails)?;
        for isa in Isa::available() {
            close(isa, &several.gather(isa, channels, &features, Some(&base)).map_err(fails)?, &gathered, 1 + per_row)?;
            close(isa, &several.scatter(isa, channels, &dy).map_err(fails)?, &scattered, rows * per_row)?;
            close(isa, &gather_around(isa, &one, &offsets, &of_offset, &features).map_err(fails)?, &around, 4)?;
            close(isa, &offset_gradient(isa, channels, &offsets, &dy).map_err(fails)?, &of_weight, rows)?;
        }
    }

    #[test]
    fn sampling_equals_the_plain_loop(xyz in cloud(400), m in 0usize..500, start in 0usize..450) {
        let expected = naive_sampling(&xyz, m, start);
        for isa in Isa::available() {
            prop_assert_eq!(&furthest_point_sampling_with(isa, &xyz, m, start), &expected, "{}", isa.name());
        }
    }

    #[test]
    fn ball_query_equals_the_plain_loop(
        xyz in cloud(300), centres in cloud(40), radius in 0.0f32..0.8, nsample in 0usize..40,
    ) {
        let expected = if xyz.len() < 3 { Vec::new() } else { naive_ball(&xyz, &centres, radius, nsample) };
        let expected = if nsample == 0 { Vec::new() } else { expected };
        for isa in Isa::available() {
            prop_assert_eq!(&ball_query_with(isa, &xyz, &centres, radius, nsample), &expected, "{}", isa.name());
        }
    }

    #[test]
    fn what_is_in_boxes_equals_the_plain_loop(
        xyz in cloud(300), mut frames in prop::collection::vec(frame(), 0..40), places in 1usize..40,
        min in prop::array::uniform3(-0.6f32..0.1), size in prop::array::uniform3(0.0f32..1.0), count in 0usize..40,
    ) {
        // Several frames at a place, in any order.
        for i in places..frames.len() {
            frames[i].origin = frames[i % places].origin;
        }
        let bounds = Bounds { min, max: [0, 1, 2].map(|i| min[i] + size[i]) };
        let expected = naive_boxes(&xyz, &frames, &bounds, count);
        for isa in Isa::available() {
            prop_assert_eq!(&in_boxes_with(isa, &xyz, &frames, &bounds, count), &expected, "{}", isa.name());
        }
    }

    #[test]
    fn three_nearest_equals_the_plain_loop(unknown in cloud(100), known in cloud(60)) {
        let expected = if known.len() < 3 { Default::default() } else { naive_three(&unknown, &known) };
        for isa in Isa::available() {
            let (indices, distances) = three_nearest_with(isa, &unknown, &known);
            prop_assert_eq!(&indices, &expected.0, "{}", isa.name());
            prop_assert_eq!(&distances, &expected.1, "{}", isa.name());
        }
    }
}

#[test]
fn a_large_cloud_equals_the_plain_loop() {
    // A sphere-like shell: more boxes than one block holds, and the real use.
    let xyz: Vec<f32> = (0..6000)
        .flat_map(|i| {
            let (a, b) = (i as f32 * 2.399, i as f32 / 3000.0 - 1.0);
            let r = (1.0 - b * b).sqrt();
            [r * a.cos(), r * a.sin(), b]
        })
        .collect();
    let expected = naive_sampling(&xyz, 2000, 7);
    for isa in Isa::available() {
        assert_eq!(furthest_point_sampling_with(isa, &xyz, 2000, 7), expected, "{}", isa.name());
    }
}
