//! Scans to the points that PointNet++ sees, and back.

use std::collections::BTreeMap;

use nalgebra::Point3;
use rand::RngExt;
use rand::seq::index;
use rand_chacha::ChaCha8Rng;
use where2act_core::is_measured;
use where2act_kernels::points::{Bounds, Frame, furthest_point_sampling, in_boxes, three_nearest};

use super::PreprocessError;
use crate::config::ModelConfig;
use crate::heads::HAND_VIEWS;
use crate::pointnet::{Grouping, Hierarchy};

/// How metres become network units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CloudScale {
    /// A cloud whose size was seen in training keeps its metres; another is scaled to the nearest size that was.
    Trained,
    /// This many network units a metre. 1 in training.
    PerMetre(f32),
}

/// A scan as PointNet++ sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudInput {
    /// Points in network units around their centre, three numbers each: `[points * 3]`.
    pub xyz: Vec<f32>,
    /// The scan at full density: the points that were chosen from, in random order, network units.
    pub dense: Vec<f32>,
    /// Which of the given points each is. A scan with fewer points than the network wants repeats some.
    pub source: Vec<usize>,
    /// Middle of the scan in its own frame, metres.
    pub centre: Point3<f32>,
    /// Network units a metre.
    pub scale: f32,
}

/// The radius around the mean that holds this share of the points: some flying pixels do not change it.
const ROBUST_SHARE: f32 = 0.95;
impl CloudInput {
    /// Prepares points in the optical frame, metres. Points that were not [measured](is_measured) are skipped.
    ///
    /// # Errors
    /// [`PreprocessError::NoPoints`], [`PreprocessError::OnePlace`].
    pub fn new(
        points: &[Point3<f32>],
        scale: CloudScale,
        config: &ModelConfig,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self, PreprocessError> {
        let measured: Vec<usize> = (0..points.len()).filter(|i| is_measured(&points[*i])).collect();
        if measured.is_empty() {
            return Err(PreprocessError::NoPoints);
        }
        let most = config.preprocessing.scan_candidates.min(measured.len());
        // In random order: furthest point sampling starts at the first.
        let candidates: Vec<usize> =
            index::sample(rng, measured.len(), most).into_iter().map(|i| measured[i]).collect();
        let sum = candidates
            .iter()
            .fold([0.0f64; 3], |s, &i| [0, 1, 2].map(|axis| s[axis] + f64::from(points[i][axis])));
        let centre = Point3::from(sum.map(|x| (x / candidates.len() as f64) as f32));
        let radius = robust_radius(candidates.iter().map(|&i| (points[i] - centre).norm()).collect());
        if radius < 1e-6 {
            return Err(PreprocessError::OnePlace(candidates.len()));
        }
        let scale = match scale {
            CloudScale::PerMetre(scale) => scale,
            CloudScale::Trained => {
                let [low, high] = config.preprocessing.scan_radius;
                radius.clamp(low, high) / radius
            }
        };
        let in_network = |i: usize| ((points[i] - centre) * scale).into();
        let all: Vec<f32> = candidates.iter().flat_map(|&i| -> [f32; 3] { in_network(i) }).collect();
        let n = config.points;
        let chosen: Vec<usize> = if candidates.len() > n {
            furthest_point_sampling(&all, n, 0).into_iter().map(|i| i as usize).collect()
        } else {
            let again = (candidates.len()..n).map(|_| rng.random_range(0..candidates.len()));
            (0..candidates.len()).chain(again).collect()
        };
        Ok(Self {
            xyz: chosen.iter().flat_map(|&i| [all[3 * i], all[3 * i + 1], all[3 * i + 2]]).collect(),
            source: chosen.into_iter().map(|i| candidates[i]).collect(),
            dense: all,
            centre,
            scale,
        })
    }

    /// A point of the scan's frame, metres, in network units.
    #[must_use]
    pub fn network_from_metres(&self, point: &Point3<f32>) -> Point3<f32> {
        Point3::from((point - self.centre) * self.scale)
    }

    /// The inverse of [`Self::network_from_metres`].
    #[must_use]
    pub fn metres_from_network(&self, point: &Point3<f32>) -> Point3<f32> {
        self.centre + point.coords / self.scale
    }

    /// For each point of the scan's frame, metres, the nearest that the network sees: what queries are made of.
    #[must_use]
    pub fn nearest(&self, points: &[Point3<f32>]) -> Vec<usize> {
        let wanted: Vec<f32> =
            points.iter().flat_map(|p| <[f32; 3]>::from(self.network_from_metres(p))).collect();
        let (nearest, _) = three_nearest(&wanted, &self.xyz);
        nearest.into_iter().map(|[first, ..]| first as usize).collect()
    }

    /// Puts the nearest of the network's points at points of the scan's frame, metres, so that there are features right there,
    /// none of them twice: of those with the same nearest one the first has it. Which ones they were, with the index of the
    /// point where each is now. [`Self::source`] goes on to name what they were before.
    pub fn move_nearest_to(&mut self, points: &[Point3<f32>]) -> BTreeMap<usize, usize> {
        let mut moved = BTreeMap::new();
        for (i, row) in self.nearest(points).into_iter().enumerate() {
            moved.entry(row).or_insert(i);
        }
        for (&row, &i) in &moved {
            self.xyz.as_chunks_mut().0[row] = self.network_from_metres(&points[i]).into();
        }
        moved
    }

    /// Neighbourhoods of a batch for a network, with features wanted at `targets[i]` of input i: points in network
    /// units, three numbers each.
    #[must_use]
    pub fn hierarchy(inputs: &[Self], targets: &[Vec<f32>], config: &ModelConfig) -> Hierarchy {
        Self::surrounded(Hierarchy::with_targets(&Self::concatenated(inputs), targets), inputs, config)
    }

    /// Neighbourhoods for a network, with features wanted at every point.
    #[must_use]
    pub fn whole_hierarchy(&self, config: &ModelConfig) -> Hierarchy {
        Self::surrounded(Hierarchy::new(&self.xyz, 1), std::slice::from_ref(self), config)
    }

    fn surrounded(hierarchy: Hierarchy, inputs: &[Self], config: &ModelConfig) -> Hierarchy {
        if !config.surroundings {
            return hierarchy;
        }
        hierarchy.with_surroundings(&inputs.iter().map(|input| input.dense.as_slice()).collect::<Vec<_>>())
    }

    /// What hands would see of the scan at full density: for each of [`HAND_VIEWS`] and each hand the points around it,
    /// in the hand's frame, metres. Hands keep their size whatever the scale; `frames` are in network units, as
    /// [`crate::hand_frame`] makes them.
    #[must_use]
    pub fn hand_views(&self, frames: &[Frame]) -> Vec<Grouping> {
        let of_view = |view: &crate::heads::HandView| {
            let scaled = |corner: [f32; 3]| corner.map(|x| x * self.scale);
            let bounds = Bounds { min: scaled(view.bounds.min), max: scaled(view.bounds.max) };
            let mut offsets = in_boxes(&self.dense, frames, &bounds, view.points);
            offsets.iter_mut().for_each(|x| *x /= self.scale);
            Grouping { rows: Vec::new(), offsets, neighbours: view.points }
        };
        HAND_VIEWS.iter().map(of_view).collect()
    }

    /// Coordinates of a batch, one cloud after the other: what [`crate::Hierarchy::new`] takes.
    #[must_use]
    pub fn concatenated(inputs: &[Self]) -> Vec<f32> {
        inputs.iter().flat_map(|input| input.xyz.iter().copied()).collect()
    }

    /// The robust radius of this scan in network units: what training collects for
    /// [`crate::Preprocessing::scan_radius`].
    #[must_use]
    pub fn robust_radius(&self) -> f32 {
        robust_radius(
            self.dense.chunks_exact(3).map(|p| (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt()).collect(),
        )
    }
}

fn robust_radius(mut distances: Vec<f32>) -> f32 {
    let last = distances.len() - 1;
    let (_, radius, _) =
        distances.select_nth_unstable_by((ROBUST_SHARE * last as f32) as usize, f32::total_cmp);
    *radius
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Modality;
    use where2act_core::{Orientation6, Primitive, Seed};

    fn config(points: usize) -> ModelConfig {
        ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(points)
    }

    /// A square of `side` metres, 3 m away.
    fn square(side: f32, per_side: usize) -> Vec<Point3<f32>> {
        let at = |i: usize| side * (i as f32 / (per_side - 1) as f32 - 0.5);
        (0..per_side * per_side).map(|i| Point3::new(at(i % per_side) + 1.0, at(i / per_side), 3.0)).collect()
    }

    #[test]
    fn sizes_seen_in_training_keep_their_metres_and_others_are_brought_there() {
        let prepare = |side, scale| {
            CloudInput::new(&square(side, 60), scale, &config(500), &mut Seed(1).rng()).unwrap()
        };
        let usual = prepare(1.0, CloudScale::Trained);
        assert_eq!((usual.scale, usual.source.len(), usual.xyz.len()), (1.0, 500, 1500));
        let tiny = prepare(0.01, CloudScale::Trained);
        let huge = prepare(30.0, CloudScale::Trained);
        assert!((tiny.robust_radius() - 0.4).abs() < 0.02, "{}", tiny.robust_radius());
        assert!((huge.robust_radius() - 1.0).abs() < 0.05, "{}", huge.robust_radius());
        assert_eq!(prepare(0.01, CloudScale::PerMetre(2.0)).scale, 2.0);
        for (i, xyz) in huge.source.iter().zip(huge.xyz.chunks_exact(3)) {
            let back = huge.metres_from_network(&Point3::new(xyz[0], xyz[1], xyz[2]));
            assert!((back - square(30.0, 60)[*i]).norm() < 1e-4);
        }
    }

    #[test]
    fn a_hand_sees_the_same_wherever_it_is_and_however_the_scan_is_scaled() {
        // A step of 2 cm across a wall: points before it stand out towards the hand.
        let step = |x: f32| if x < 1.0 { 2.98 } else { 3.0 };
        let wall: Vec<_> = square(0.6, 90).iter().map(|p| Point3::new(p.x, p.y, step(p.x))).collect();
        let turn = nalgebra::Isometry3::new(
            nalgebra::Vector3::new(0.2, -0.1, 0.7),
            nalgebra::Vector3::new(0.3, 0.5, -0.2),
        );
        let turned: Vec<_> = wall.iter().map(|p| turn * p).collect();
        let contact = Point3::new(1.02, 0.0, 3.0);
        let (approach, forward) = (nalgebra::Vector3::z(), nalgebra::Vector3::x());
        let seen = |points: &[Point3<f32>], scale, contact: Point3<f32>, orientation| {
            let cloud =
                CloudInput::new(points, CloudScale::PerMetre(scale), &config(500), &mut Seed(1).rng())
                    .unwrap();
            let frame = crate::hand_frame(cloud.network_from_metres(&contact).into(), &orientation);
            let views = cloud.hand_views(&[frame]);
            assert_eq!(views.len(), HAND_VIEWS.len());
            for (view, of) in views.iter().zip(HAND_VIEWS) {
                assert_eq!(view.offsets.len(), 3 * of.points);
            }
            views[0].offsets.as_chunks::<3>().0.to_vec()
        };
        let straight = seen(&wall, 1.0, contact, Orientation6::new(approach, forward));
        assert!(straight.iter().any(|p| (p[2] + 0.02).abs() < 1e-4 && p[0] < -0.015));
        assert!(straight.iter().all(|p| (p[2] < -0.01) == (p[0] < -0.019)), "{straight:?}");
        let elsewhere = Orientation6::new(turn * approach, turn * forward);
        for other in [
            seen(&wall, 3.0, contact, Orientation6::new(approach, forward)),
            seen(&turned, 1.0, turn * contact, elsewhere),
        ] {
            for (a, b) in straight.iter().zip(&other) {
                assert!((0..3).all(|i| (a[i] - b[i]).abs() < 1e-4), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn few_points_repeat_and_bad_ones_are_left_out() {
        let mut points = square(1.0, 5);
        points.push(Point3::new(f32::NAN, 0.0, 1.0));
        points.push(Point3::new(f32::INFINITY, 0.0, 1.0));
        let input = CloudInput::new(&points, CloudScale::Trained, &config(100), &mut Seed(1).rng()).unwrap();
        assert_eq!(input.source.len(), 100);
        for i in 0..25 {
            assert!(input.source.contains(&i));
            assert_eq!(input.source[input.nearest(&points[i..=i])[0]], i);
        }
        assert!(input.source.iter().all(|i| *i < 25));
        // An organised cloud, most of which saw nothing: what it saw is all there is.
        let seen = &points[..25];
        let organised: Vec<_> = seen.iter().flat_map(|p| [*p, Point3::origin(), -Point3::origin()]).collect();
        let prepare =
            |points: &[_]| CloudInput::new(points, CloudScale::Trained, &config(100), &mut Seed(1).rng());
        let (seen, organised) = (prepare(seen).unwrap(), prepare(&organised).unwrap());
        assert_eq!(organised.source, seen.source.iter().map(|i| 3 * i).collect::<Vec<_>>());
        assert_eq!(CloudInput { source: seen.source.clone(), ..organised }, seen);
        assert_eq!(prepare(&[Point3::origin(); 9]), Err(PreprocessError::NoPoints));
        let none = CloudInput::new(&points[25..], CloudScale::Trained, &config(100), &mut Seed(1).rng());
        assert_eq!(none, Err(PreprocessError::NoPoints));
        let one = CloudInput::new(&points[..1], CloudScale::Trained, &config(100), &mut Seed(1).rng());
        assert_eq!(one, Err(PreprocessError::OnePlace(1)));
    }
}
