//! Furthest point sampling.
//!
//! The plain algorithm updates the distance of every point for every sample. Here the points are sorted into small
//! boxes first, and a box is touched only if the new sample is nearer to the box than the furthest of its points is to
//! the samples before. That bound is monotone in floating point too, so the result is the plain algorithm's, bit for bit.

use super::{LANES, lane_bits, point, squared_distances};
use crate::isa::{Isa, per_isa};

/// Registers of [`LANES`] points in a box. 64 points a box, 469 boxes for 30,000 points, balance the two
/// things done for a sample: updating the boxes around it and searching all boxes.
const DEPTH: usize = 2;
/// Points of one box.
const BOX: usize = DEPTH * LANES;

/// `m` points of the cloud `xyz`, each the one furthest from those before it; the first is `start`.
///
/// Of equally far points the lowest index wins. When every point has been taken (m > n, or duplicates) the lowest
/// index repeats. `start` beyond the end means the last point; an empty cloud gives an empty answer.
pub fn furthest_point_sampling(xyz: &[f32], m: usize, start: usize) -> Vec<u32> {
    furthest_point_sampling_with(Isa::best(), xyz, m, start)
}

/// [`furthest_point_sampling`] on a chosen instruction set.
pub fn furthest_point_sampling_with(isa: Isa, xyz: &[f32], m: usize, start: usize) -> Vec<u32> {
    let n = xyz.len() / 3;
    if n == 0 || m == 0 {
        return Vec::new();
    }
    let mut boxes = Boxes::new(&xyz[..3 * n]);
    let mut chosen = Vec::with_capacity(m);
    chosen.push(start.min(n - 1) as u32);
    while let (Some(&last), true) = (chosen.last(), chosen.len() < m) {
        chosen.push(add_sample(isa, &mut boxes, point(xyz, last as usize)));
    }
    chosen
}

/// The points in boxes, and what the search among boxes needs in blocks of columns. The last block is filled up with
/// boxes that are never touched nor chosen.
struct Boxes {
    members: Vec<Members>,
    blocks: Vec<Block>,
}

/// The points of a box: coordinates, squared distance to the nearest sample, index in the cloud.
struct Members {
    xyz: [[[f32; LANES]; 3]; DEPTH],
    distance: [[f32; LANES]; DEPTH],
    index: [[u32; LANES]; DEPTH],
}

/// Bounds of [`LANES`] boxes, and of each the point furthest from all samples: its squared distance and index.
struct Block {
    low: [[f32; LANES]; 3],
    high: [[f32; LANES]; 3],
    distance: [f32; LANES],
    index: [u32; LANES],
}

impl Boxes {
    fn new(xyz: &[f32]) -> Self {
        let cloud = xyz.as_chunks::<3>().0;
        let mut order: Vec<u32> = (0..cloud.len() as u32).collect();
        split(cloud, &mut order);
        let mut blocks = Vec::new();
        let mut members = Vec::new();
        for boxes in order.chunks(BOX * LANES) {
            let mut block = Block {
                low: [[f32::INFINITY; LANES]; 3],
                high: [[f32::NEG_INFINITY; LANES]; 3],
                distance: [f32::NEG_INFINITY; LANES],
                index: [u32::MAX; LANES],
            };
            for (lane, indices) in boxes.chunks(BOX).enumerate() {
                let (low, high) = bounds(cloud, indices);
                for axis in 0..3 {
                    block.low[axis][lane] = low[axis];
                    block.high[axis][lane] = high[axis];
                }
                let points = Members::new(cloud, indices);
                (block.distance[lane], block.index[lane]) =
                    furthest(points.distance.iter().zip(&points.index));
                members.push(points);
            }
            blocks.push(block);
        }
        Self { members, blocks }
    }
}

impl Members {
    fn new(cloud: &[[f32; 3]], indices: &[u32]) -> Self {
        let mut points = Self {
            xyz: [[[f32::NAN; LANES]; 3]; DEPTH],
            distance: [[f32::NEG_INFINITY; LANES]; DEPTH],
            index: [[u32::MAX; LANES]; DEPTH],
        };
        for (i, &index) in indices.iter().enumerate() {
            let (row, lane) = (i / LANES, i % LANES);
            let p = cloud[index as usize];
            for axis in 0..3 {
                points.xyz[row][axis][lane] = p[axis];
            }
            // Points that are not finite come after all others, and before the padding.
            points.distance[row][lane] = if p.iter().all(|v| v.is_finite()) { f32::INFINITY } else { -1.0 };
            points.index[row][lane] = index;
        }
        points
    }
}

/// Sorts indices so that every run of [`BOX`] is compact: halves along the longest side, as in a k-d tree.
fn split(cloud: &[[f32; 3]], order: &mut [u32]) {
    if order.len() <= BOX {
        return;
    }
    let (low, high) = bounds(cloud, order);
    let side = [0, 1, 2].map(|axis| high[axis] - low[axis]);
    let axis = (0..3).max_by(|&a, &b| side[a].total_cmp(&side[b])).unwrap_or(0);
    let middle = order.len().div_ceil(BOX) / 2 * BOX;
    order
        .select_nth_unstable_by(middle, |&a, &b| cloud[a as usize][axis].total_cmp(&cloud[b as usize][axis]));
    let (left, right) = order.split_at_mut(middle);
    split(cloud, left);
    split(cloud, right);
}

/// Bounding box of the finite ones of some points; of none, an inverted box that everything is infinitely far from.
fn bounds(cloud: &[[f32; 3]], indices: &[u32]) -> ([f32; 3], [f32; 3]) {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in indices.iter().map(|&i| cloud[i as usize]).filter(|p| p.iter().all(|v| v.is_finite())) {
        for axis in 0..3 {
            low[axis] = low[axis].min(p[axis]);
            high[axis] = high[axis].max(p[axis]);
        }
    }
    (low, high)
}

per_isa! {
    /// Takes a sample into account and returns the point that is now furthest.
    fn add_sample(boxes: &mut Boxes, sample: [f32; 3]) -> u32 {
        for (block, members) in boxes.blocks.iter_mut().zip(boxes.members.chunks_mut(LANES)) {
            let mut touched = touched(block, sample);
            while touched != 0 {
                let lane = touched.trailing_zeros() as usize;
                touched &= touched - 1;
                let points = &mut members[lane];
                for ([x, y, z], distance) in points.xyz.iter().zip(&mut points.distance) {
                    let new = squared_distances(sample, x, y, z);
                    for (old, new) in distance.iter_mut().zip(new) {
                        *old = if new < *old { new } else { *old };
                    }
                }
                (block.distance[lane], block.index[lane]) = furthest(points.distance.iter().zip(&points.index));
            }
        }
        furthest(boxes.blocks.iter().map(|block| (&block.distance, &block.index))).1
    }
}

/// One bit for each box that may hold a point nearer to the sample than to all samples before.
#[inline(always)]
fn touched(block: &Block, sample: [f32; 3]) -> u32 {
    let mut bound = [0.0; LANES];
    for axis in 0..3 {
        for l in 0..LANES {
            let gap = (block.low[axis][l] - sample[axis]).max(sample[axis] - block.high[axis][l]).max(0.0);
            bound[l] += gap * gap;
        }
    }
    lane_bits(|l| bound[l] < block.distance[l])
}

/// The greatest distance and its index, of equal ones the lowest.
#[inline(always)]
fn furthest<'a>(rows: impl Iterator<Item = (&'a [f32; LANES], &'a [u32; LANES])>) -> (f32, u32) {
    let (mut best, mut at) = ([f32::NEG_INFINITY; LANES], [u32::MAX; LANES]);
    for (distance, index) in rows {
        for l in 0..LANES {
            let better = (distance[l] > best[l]) | ((distance[l] == best[l]) & (index[l] < at[l]));
            best[l] = if better { distance[l] } else { best[l] };
            at[l] = if better { index[l] } else { at[l] };
        }
    }
    let mut half = LANES / 2;
    while half > 0 {
        for l in 0..half {
            let better = (best[l + half] > best[l]) | ((best[l + half] == best[l]) & (at[l + half] < at[l]));
            best[l] = if better { best[l + half] } else { best[l] };
            at[l] = if better { at[l + half] } else { at[l] };
        }
        half /= 2;
    }
    (best[0], at[0])
}
