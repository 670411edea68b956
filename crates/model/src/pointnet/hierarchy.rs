//! Who is near whom, at all four levels: the part of PointNet++ that needs no weights.

use rayon::prelude::*;
use where2act_kernels::points::{ball_query, furthest_point_sampling, three_nearest};

/// Sizes of a step down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Points that are kept.
    pub centres: usize,
    /// Neighbours are nearer than this, in network units.
    pub radius: f32,
    /// Neighbours of each.
    pub neighbours: usize,
}

const fn level(centres: usize, radius: f32) -> Level {
    Level { centres, radius, neighbours: 32 }
}

/// The four steps down (published).
pub const LEVELS: [Level; 4] = [level(1024, 0.1), level(256, 0.2), level(64, 0.4), level(16, 0.8)];

/// What [`Hierarchy::with_surroundings`] looks at around each point: where the fingers go, which are 2 cm wide and open
/// to 8 cm, and where the palm goes, which is 20 cm wide.
pub const SURROUNDINGS: [Level; 2] =
    [Level { centres: 0, radius: 0.08, neighbours: 48 }, Level { centres: 0, radius: 0.25, neighbours: 64 }];

/// Added to distances before they divide (published implementation).
const DISTANCE_EPSILON: f32 = 1e-8;

/// A step down: for each centre, which rows of the finer level surround it and where.
#[derive(Clone, Debug)]
pub struct Grouping {
    /// Rows of the finer level, all clouds of the batch counted through: `[centres * neighbours]`.
    pub rows: Vec<i64>,
    /// Position of each minus its centre: `[centres * neighbours * 3]`.
    pub offsets: Vec<f32>,
    /// Neighbours of each centre.
    pub neighbours: usize,
}

/// A step up: for each point of the finer level, the three nearest of the coarser one.
#[derive(Clone, Debug)]
pub struct Interpolation {
    /// Rows of the coarser level, all clouds of the batch counted through: `[points * 3]`.
    pub rows: Vec<i64>,
    /// How much each counts; three sum to one: `[points * 3]`.
    pub weights: Vec<f32>,
}

/// Neighbourhoods of a batch of clouds of equal size, and where features are wanted: at every point, or only at the
/// targets that training asks about.
#[derive(Clone, Debug, Default)]
pub struct Hierarchy {
    points: Vec<f32>,
    /// Where features are wanted; `None` = at all points.
    targets: Option<Vec<f32>>,
    /// First row of each cloud in the features.
    first_rows: Vec<usize>,
    groupings: Vec<Grouping>,
    interpolations: Vec<Interpolation>,
    /// Neighbours of each target in the full scan, for each of [`SURROUNDINGS`]; empty if nobody asked.
    surroundings: Vec<Grouping>,
}

impl Hierarchy {
    /// `points` holds `clouds` clouds one after the other, three numbers a point.
    #[must_use]
    pub fn new(points: &[f32], clouds: usize) -> Self {
        Self::with_levels(points, clouds, LEVELS)
    }

    /// [`Self::new`] with other steps down than the published ones.
    #[must_use]
    pub fn with_levels(points: &[f32], clouds: usize, levels: [Level; 4]) -> Self {
        Self::of_all(points, &vec![None; clouds], levels)
    }

    /// [`Self::new`], but features are wanted only at `targets[i]`, points near the surface of cloud i, three numbers
    /// each: the last and most expensive step up then costs as much as there are targets.
    #[must_use]
    pub fn with_targets(points: &[f32], targets: &[Vec<f32>]) -> Self {
        let wanted: Vec<_> = targets.iter().map(|t| Some(t.as_slice())).collect();
        Self::of_all(points, &wanted, LEVELS)
    }

    /// The same with what is around each target, or point, in the full scans: `scans[i]` holds the points of scan i in
    /// network units, three numbers each, in random order.
    ///
    /// # Panics
    /// If there are fewer scans than clouds.
    #[must_use]
    pub fn with_surroundings(mut self, scans: &[&[f32]]) -> Self {
        let targets = self.targets();
        let ends = self.first_rows.iter().skip(1).copied().chain([targets.len() / 3]);
        let ranges: Vec<_> = self.first_rows.iter().copied().zip(ends).collect();
        let of_one = |level: Level, i: usize| {
            let (start, end) = ranges[i];
            group(scans[i], &targets[3 * start..3 * end], level).offsets
        };
        let of_level = |level: Level| {
            let offsets: Vec<_> = (0..ranges.len()).into_par_iter().map(|i| of_one(level, i)).collect();
            Grouping { rows: Vec::new(), offsets: offsets.concat(), neighbours: level.neighbours }
        };
        self.surroundings = SURROUNDINGS.into_iter().map(of_level).collect();
        self
    }

    fn of_all(points: &[f32], targets: &[Option<&[f32]>], levels: [Level; 4]) -> Self {
        let per_cloud = (points.len() / targets.len().max(1)).max(1);
        let alone: Vec<_> = points
            .par_chunks(per_cloud)
            .zip(targets)
            .map(|(cloud, targets)| Self::of_one(cloud, *targets, levels))
            .collect();
        let mut alone = alone.into_iter();
        let mut all = alone.next().unwrap_or_default();
        for one in alone {
            all.append(one);
        }
        all
    }

    fn of_one(points: &[f32], targets: Option<&[f32]>, levels: [Level; 4]) -> Self {
        let mut groupings = Vec::with_capacity(levels.len());
        let mut interpolations = Vec::with_capacity(levels.len());
        let mut fine = points.to_vec();
        let mut wanted = targets.unwrap_or(points).to_vec();
        for level in levels {
            let chosen = furthest_point_sampling(&fine, level.centres, 0);
            let coarse: Vec<f32> = chosen.iter().flat_map(|&i| at(&fine, i)).collect();
            groupings.push(group(&fine, &coarse, level));
            interpolations.push(interpolate(&wanted, &coarse));
            wanted.clone_from(&coarse);
            fine = coarse;
        }
        let (points, targets) = (points.to_vec(), targets.map(<[f32]>::to_vec));
        Self { points, targets, first_rows: vec![0], groupings, interpolations, surroundings: Vec::new() }
    }

    /// Adds a cloud of the same size as those that are here already.
    fn append(&mut self, other: Self) {
        let count = self.clouds() as i64;
        self.first_rows.push(self.targets().len() / 3);
        if let (Some(here), Some(new)) = (&mut self.targets, other.targets) {
            here.extend(new);
        }
        let mut fine = (other.points.len() / 3) as i64;
        self.points.extend(other.points);
        for (level, (here, new)) in self.groupings.iter_mut().zip(other.groupings).enumerate() {
            let coarse = (new.rows.len() / new.neighbours.max(1)) as i64;
            let (fine_start, coarse_start) = (fine * count, coarse * count);
            here.rows.extend(new.rows.iter().map(|row| row + fine_start));
            here.offsets.extend(new.offsets);
            let (here, new) = (&mut self.interpolations[level], &other.interpolations[level]);
            here.rows.extend(new.rows.iter().map(|row| row + coarse_start));
            here.weights.extend(&new.weights);
            fine = coarse;
        }
    }

    /// Offsets of the full scan's points around each target for each of [`SURROUNDINGS`], without rows; empty if they
    /// were not asked for.
    #[must_use]
    pub fn surroundings(&self) -> &[Grouping] {
        &self.surroundings
    }

    /// Clouds in the batch.
    #[must_use]
    pub fn clouds(&self) -> usize {
        self.first_rows.len()
    }

    /// All points, three numbers each.
    #[must_use]
    pub fn points(&self) -> &[f32] {
        &self.points
    }

    /// Where features are wanted, three numbers each: the targets, or all points.
    #[must_use]
    pub fn targets(&self) -> &[f32] {
        self.targets.as_deref().unwrap_or(&self.points)
    }

    /// Row of a cloud's i-th target, or point, in the features.
    ///
    /// # Panics
    /// If there are fewer clouds.
    #[must_use]
    pub fn row(&self, cloud: usize, i: usize) -> usize {
        self.first_rows[cloud] + i
    }

    /// Steps down, the finest first.
    #[must_use]
    pub fn groupings(&self) -> &[Grouping] {
        &self.groupings
    }

    /// Steps up, the finest first.
    #[must_use]
    pub fn interpolations(&self) -> &[Interpolation] {
        &self.interpolations
    }
}

fn at(xyz: &[f32], i: u32) -> [f32; 3] {
    let i = 3 * i as usize;
    [xyz[i], xyz[i + 1], xyz[i + 2]]
}

fn group(fine: &[f32], coarse: &[f32], level: Level) -> Grouping {
    let found = ball_query(fine, coarse, level.radius, level.neighbours);
    let mut offsets = Vec::with_capacity(found.len() * 3);
    for (centre, near) in coarse.chunks_exact(3).zip(found.chunks_exact(level.neighbours)) {
        for &i in near {
            let p = at(fine, i);
            offsets.extend([p[0] - centre[0], p[1] - centre[1], p[2] - centre[2]]);
        }
    }
    Grouping { rows: found.into_iter().map(i64::from).collect(), offsets, neighbours: level.neighbours }
}

fn interpolate(fine: &[f32], coarse: &[f32]) -> Interpolation {
    let (indices, distances) = three_nearest(fine, coarse);
    let weights = distances.iter().flat_map(|d| {
        let inverse = d.map(|d| 1.0 / (d + DISTANCE_EPSILON));
        let sum: f32 = inverse.iter().sum();
        inverse.map(|w| w / sum)
    });
    Interpolation {
        weights: weights.collect(),
        rows: indices.iter().flatten().map(|&i| i64::from(i)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_get_what_the_same_points_get_in_a_whole_cloud() {
        let points: Vec<f32> = (0..2 * 2000 * 3).map(|i| ((i * 7919) % 1000) as f32 / 1000.0).collect();
        let whole = Hierarchy::new(&points, 2);
        let (first, second) = (points[30..60].to_vec(), points[6000 + 90..6000 + 96].to_vec());
        let some = Hierarchy::with_targets(&points, &[first, second]);
        assert_eq!((some.clouds(), some.targets().len()), (2, 36));
        for (cloud, target, point) in [(0, 0, 10), (0, 9, 19), (1, 0, 30), (1, 1, 31)] {
            let (a, b) = (some.row(cloud, target), whole.row(cloud, point));
            let of = |h: &Hierarchy, row: usize| {
                let near = &h.interpolations()[0];
                (near.rows[3 * row..3 * row + 3].to_vec(), near.weights[3 * row..3 * row + 3].to_vec())
            };
            assert_eq!(of(&some, a), of(&whole, b));
        }
        assert_eq!(some.interpolations()[1].rows, whole.interpolations()[1].rows);
    }

    #[test]
    fn surroundings_come_from_the_scan_of_the_targets_cloud() {
        let points: Vec<f32> = (0..2 * 500 * 3).map(|i| ((i * 7919) % 1000) as f32 / 1000.0).collect();
        let (first, second) = (points[30..60].to_vec(), points[1500..1506].to_vec());
        let hierarchy = Hierarchy::with_targets(&points, &[first, second]);
        // One point of each scan is 1 cm from every target of its cloud, in its own direction; the others are far.
        let near = |targets: &[f32], by: f32| -> Vec<f32> {
            targets.chunks_exact(3).flat_map(|p| [p[0] + by, p[1], p[2]]).chain([9.0, 9.0, 9.0]).collect()
        };
        let scans = [near(&points[30..60], 0.01), near(&points[1500..1506], -0.01)];
        let hierarchy = hierarchy.with_surroundings(&[&scans[0], &scans[1]]);
        for (found, level) in hierarchy.surroundings().iter().zip(SURROUNDINGS) {
            assert_eq!(found.offsets.len(), 12 * level.neighbours * 3);
            for (target, offsets) in found.offsets.chunks_exact(level.neighbours * 3).enumerate() {
                let by = if target < 10 { 0.01 } else { -0.01 };
                assert!(
                    offsets.chunks_exact(3).any(|o| (o[0] - by).abs() < 1e-5 && o[1] == 0.0),
                    "{offsets:?}"
                );
                assert!(offsets.iter().all(|x| x.abs() < level.radius));
            }
        }
    }
}
