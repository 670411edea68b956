//! Sampling and neighbourhoods in point clouds.
//!
//! A cloud of n points is a slice of 3 n numbers, x y z after x y z; a remainder of one or two numbers is ignored.
//! No coordinates make these functions panic. Points with a coordinate that is not finite are neighbours of nothing and
//! are chosen only when nothing else is left, or first if told to.
//!
//! Squared distances are computed as `dx*dx + dy*dy + dz*dz` without fused multiply-add, in this order, so that every
//! instruction set gives the same bits.

mod boxes;
mod neighbours;
mod rows;
mod sampling;

pub use boxes::{Bounds, Frame, in_boxes, in_boxes_with};
pub use neighbours::{ball_query, ball_query_with, three_nearest, three_nearest_with};
pub use rows::{Selection, gather_around, offset_gradient};
pub use sampling::{furthest_point_sampling, furthest_point_sampling_with};

/// Points processed together: two AVX-512 registers, four of AVX2.
const LANES: usize = 32;

/// The coordinates of a cloud in three arrays, padded with NaN (which is near nothing) to a multiple of [`LANES`].
struct Columns {
    x: Vec<[f32; LANES]>,
    y: Vec<[f32; LANES]>,
    z: Vec<[f32; LANES]>,
}

impl Columns {
    fn new(xyz: &[f32]) -> Self {
        let blocks = (xyz.len() / 3).div_ceil(LANES);
        let nan = vec![[f32::NAN; LANES]; blocks];
        let mut columns = Self { x: nan.clone(), y: nan.clone(), z: nan };
        for (i, p) in xyz.as_chunks::<3>().0.iter().enumerate() {
            let (block, lane) = (i / LANES, i % LANES);
            columns.x[block][lane] = p[0];
            columns.y[block][lane] = p[1];
            columns.z[block][lane] = p[2];
        }
        columns
    }
}

/// Point `i` of a cloud.
fn point(xyz: &[f32], i: usize) -> [f32; 3] {
    [xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]]
}

/// Squared distances from one point to [`LANES`] others.
#[inline(always)]
fn squared_distances(p: [f32; 3], x: &[f32; LANES], y: &[f32; LANES], z: &[f32; LANES]) -> [f32; LANES] {
    let mut d = [0.0; LANES];
    for l in 0..LANES {
        let (dx, dy, dz) = (x[l] - p[0], y[l] - p[1], z[l] - p[2]);
        d[l] = dx * dx + dy * dy + dz * dz;
    }
    d
}

/// Bit l is set where `test` holds for lane l.
#[inline(always)]
fn lane_bits(test: impl Fn(usize) -> bool) -> u32 {
    let mut bytes = [0u8; LANES];
    for l in 0..LANES {
        bytes[l] = u8::from(test(l));
    }
    // Multiplying gathers the lowest bits of eight bytes in the highest byte; summing shifted lanes took three times as long.
    let gather =
        |eight: &[u8; 8]| (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u32;
    bytes.as_chunks::<8>().0.iter().enumerate().fold(0, |bits, (i, eight)| bits | gather(eight) << (8 * i))
}
