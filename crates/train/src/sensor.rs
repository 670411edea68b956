//! Scans as a depth camera would have taken them: noise along the line of sight, and holes.

use nalgebra::Point3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use where2act_core::Pixel;

/// Largest deviation of the noise, metres: what active stereo and time-of-flight cameras have at one to two metres, the
/// distance from which an object of one metre fills their picture.
const NOISE: f32 = 0.004;
/// Most holes of a scan, ...
const HOLES: usize = 6;
/// ... and their radii, in pixels of the stored depth map.
const HOLE_RADII: std::ops::Range<f32> = 2.0..16.0;
/// Largest share of single points that are missing too.
const DROPPED: f32 = 0.3;
/// A scan of which less than this share would be left keeps all its points: a small object may lie in one hole.
const LEFT: f32 = 0.25;

/// Takes the points of a rendered depth map, camera frame, as a sensor would have measured them.
pub(crate) fn measure(seen: &mut Vec<(Pixel, Point3<f32>)>, rng: &mut ChaCha8Rng) {
    if seen.is_empty() {
        return;
    }
    let deviation = rng.random_range(0.0..NOISE);
    let dropped = rng.random_range(0.0..DROPPED);
    let holes: Vec<(Pixel, f32)> = (0..rng.random_range(0..=HOLES))
        .map(|_| (seen[rng.random_range(0..seen.len())].0, rng.random_range(HOLE_RADII)))
        .collect();
    let inside = |pixel: &Pixel, (hole, radius): &(Pixel, f32)| {
        (pixel.u as f32 - hole.u as f32).hypot(pixel.v as f32 - hole.v as f32) < *radius
    };
    let kept: Vec<bool> = seen
        .iter()
        .map(|(pixel, _)| !holes.iter().any(|hole| inside(pixel, hole)) && rng.random::<f32>() >= dropped)
        .collect();
    if kept.iter().filter(|kept| **kept).count() as f32 >= LEFT * seen.len() as f32 {
        let mut kept = kept.into_iter();
        seen.retain(|_| kept.next().unwrap_or(false));
    }
    for (_, point) in seen {
        let noise: f32 = StandardNormal.sample(rng);
        let along = point.coords.normalize();
        *point += along * (deviation * noise);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_core::Seed;

    #[test]
    fn a_measured_wall_is_rough_and_has_gaps_but_stays_where_it_is() {
        let wall: Vec<_> = (0..200u32 * 200)
            .map(|i| {
                let (u, v) = (i % 200, i / 200);
                (Pixel { u, v }, Point3::new(u as f32 * 0.005 - 0.5, v as f32 * 0.005 - 0.5, 2.0))
            })
            .collect();
        let (mut rough, mut missing) = (0.0f32, 0);
        for seed in 0..20 {
            let mut seen = wall.clone();
            measure(&mut seen, &mut Seed(seed).rng());
            assert!(seen.len() > wall.len() / 2 && seen.is_sorted_by_key(|(p, _)| (p.v, p.u)));
            missing += wall.len() - seen.len();
            let n = seen.len() as f32;
            let mean = seen.iter().map(|(_, p)| p.z - 2.0).sum::<f32>() / n;
            let deviation = (seen.iter().map(|(_, p)| (p.z - 2.0).powi(2)).sum::<f32>() / n).sqrt();
            assert!(mean.abs() < 2e-4 && deviation < NOISE, "{mean} {deviation}");
            rough = rough.max(deviation);
        }
        assert!(rough > 0.5 * NOISE && missing > 20 * wall.len() / 20, "{rough} {missing}");
    }

    #[test]
    fn something_is_left_of_a_small_object() {
        for side in [1, 3, 10, 30] {
            let knob: Vec<_> = (0..side * side)
                .map(|i| (Pixel { u: i % side, v: i / side }, Point3::new(0.0, i as f32 * 1e-3, 4.0)))
                .collect();
            for seed in 0..200 {
                let mut seen = knob.clone();
                measure(&mut seen, &mut Seed(seed).rng());
                assert!(4 * seen.len() >= knob.len(), "{side}, {seed}: {}", seen.len());
            }
        }
    }
}
