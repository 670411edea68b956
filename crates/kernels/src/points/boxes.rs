//! What is inside boxes that stand anywhere: the surroundings of a hand, in its own frame.

use rayon::prelude::*;

use super::{Columns, LANES, lane_bits, squared_distances};
use crate::isa::{Isa, per_isa};

/// Origins given to a thread at a time, at least.
const GROUPS: usize = 4;

/// A place to look from: `rows` turn an offset from `origin` into coordinates along the frame's x, y and z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Its origin, in the frame of the points.
    pub origin: [f32; 3],
    /// Its axes x, y and z, orthonormal, in the frame of the points.
    pub axes: [[f32; 3]; 3],
}

/// A box along the axes of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lower corner.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
}

/// For each frame the first `count` points of `xyz`, in index order, that are inside `bounds` of it, as coordinates in
/// the frame: `[frames, count, 3]`.
///
/// Fewer are filled up with the first; a box without any gets its frame's origin, `count` times. Frames that share an origin,
/// as hands at one place do, are cheaper together.
pub fn in_boxes(xyz: &[f32], frames: &[Frame], bounds: &Bounds, count: usize) -> Vec<f32> {
    in_boxes_with(Isa::best(), xyz, frames, bounds, count)
}

/// [`in_boxes`] on a chosen instruction set.
pub fn in_boxes_with(isa: Isa, xyz: &[f32], frames: &[Frame], bounds: &Bounds, count: usize) -> Vec<f32> {
    let each = 3 * count;
    let mut found = vec![0.0; frames.len() * each];
    if count == 0 {
        return found;
    }
    let columns = Columns::new(xyz);
    let place = |i: &usize| frames[*i].origin.map(f32::to_bits);
    let mut order: Vec<usize> = (0..frames.len()).collect();
    order.sort_by_key(place);
    let groups: Vec<&[usize]> = order.chunk_by(|a, b| place(a) == place(b)).collect();
    let of_group = |group: &&[usize]| {
        let frames: Vec<Frame> = group.iter().map(|i| frames[*i]).collect();
        let mut found = vec![0.0; frames.len() * each];
        fill_boxes(isa, &columns, &frames, bounds, &mut found);
        found
    };
    let boxes: Vec<Vec<f32>> = groups.par_iter().with_min_len(GROUPS).map(of_group).collect();
    for (group, boxes) in groups.iter().zip(&boxes) {
        for (i, inside) in group.iter().zip(boxes.chunks_exact(each)) {
            found[i * each..(i + 1) * each].copy_from_slice(inside);
        }
    }
    found
}

per_isa! {
    /// All frames have the same origin: what is too far from it for any box is left out once.
    fn fill_boxes(columns: &Columns, frames: &[Frame], bounds: &Bounds, found: &mut [f32]) {
        let each = found.len() / frames.len().max(1);
        let Some(Frame { origin, .. }) = frames.first() else { return };
        let near = near(columns, *origin, bounds.reach());
        for (frame, found) in frames.iter().zip(found.chunks_exact_mut(each)) {
            let filled = first_inside(&near, frame, bounds, found);
            if filled > 0 {
                let (first, rest) = found.split_at_mut(3 * filled);
                rest.chunks_exact_mut(3).for_each(|point| point.copy_from_slice(&first[..3]));
            }
        }
    }
}

impl Bounds {
    /// Distance from the origin beyond which nothing is inside, however axes and coordinates were rounded.
    fn reach(&self) -> f32 {
        let furthest = [0, 1, 2].map(|i| self.min[i].abs().max(self.max[i].abs()));
        1.001 * furthest.iter().map(|x| x * x).sum::<f32>().sqrt()
    }
}

/// The points within `reach` of a place, in index order.
#[inline(always)]
fn near(columns: &Columns, place: [f32; 3], reach: f32) -> Columns {
    let mut xyz = Vec::new();
    for ((x, y), z) in columns.x.iter().zip(&columns.y).zip(&columns.z) {
        let squared = squared_distances(place, x, y, z);
        let mut within = lane_bits(|l| squared[l] <= reach * reach);
        while within != 0 {
            let l = within.trailing_zeros() as usize;
            xyz.extend([x[l], y[l], z[l]]);
            within &= within - 1;
        }
    }
    Columns::new(&xyz)
}

/// Writes the first points inside the box, as many as there is room for; returns how many.
#[inline(always)]
fn first_inside(columns: &Columns, frame: &Frame, bounds: &Bounds, found: &mut [f32]) -> usize {
    let (room, mut count) = (found.len() / 3, 0);
    for ((x, y), z) in columns.x.iter().zip(&columns.y).zip(&columns.z) {
        let seen = frame.axes.map(|axis| along(frame.origin, axis, x, y, z));
        let between = |i: usize, l: usize| (seen[i][l] > bounds.min[i]) & (seen[i][l] < bounds.max[i]);
        // Without branches, so that all lanes are compared at once.
        let mut within = lane_bits(|l| between(0, l) & between(1, l) & between(2, l));
        while within != 0 {
            let l = within.trailing_zeros() as usize;
            found[3 * count..3 * count + 3].copy_from_slice(&seen.map(|axis| axis[l]));
            count += 1;
            if count == room {
                return count;
            }
            within &= within - 1;
        }
    }
    count
}

/// Coordinates of [`LANES`] points along one axis of a frame.
#[inline(always)]
fn along(
    origin: [f32; 3],
    axis: [f32; 3],
    x: &[f32; LANES],
    y: &[f32; LANES],
    z: &[f32; LANES],
) -> [f32; LANES] {
    let mut coordinate = [0.0; LANES];
    for l in 0..LANES {
        let (dx, dy, dz) = (x[l] - origin[0], y[l] - origin[1], z[l] - origin[2]);
        coordinate[l] = dx * axis[0] + dy * axis[1] + dz * axis[2];
    }
    coordinate
}
