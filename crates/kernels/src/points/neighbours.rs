//! Neighbourhoods by comparison with every point: for the few thousand points of a network's layer this is as fast
//! as a search structure, since a query ends as soon as it has enough neighbours.

use rayon::prelude::*;

use super::{Columns, LANES, lane_bits, point, squared_distances};
use crate::isa::{Isa, per_isa};

/// Queries given to a thread at a time.
const QUERIES: usize = 4 * LANES;

/// For each centre the first `nsample` points of `xyz`, in index order, at a distance below `radius`.
///
/// Fewer are filled up with the first. A centre without any gets its nearest point, repeated (0 if no distance is a
/// number). The answer holds `nsample` indices for each centre; it is empty if there are no points.
pub fn ball_query(xyz: &[f32], centres: &[f32], radius: f32, nsample: usize) -> Vec<u32> {
    ball_query_with(Isa::best(), xyz, centres, radius, nsample)
}

/// [`ball_query`] on a chosen instruction set.
pub fn ball_query_with(isa: Isa, xyz: &[f32], centres: &[f32], radius: f32, nsample: usize) -> Vec<u32> {
    if xyz.len() < 3 || nsample == 0 {
        return Vec::new();
    }
    let columns = Columns::new(xyz);
    let mut found = vec![0; centres.len() / 3 * nsample];
    found.par_chunks_mut(QUERIES * nsample).zip(centres.par_chunks(3 * QUERIES)).for_each(
        |(found, centres)| {
            query_balls(isa, &columns, centres, radius * radius, nsample, found);
        },
    );
    found
}

per_isa! {
    fn query_balls(columns: &Columns, centres: &[f32], limit: f32, nsample: usize, found: &mut [u32]) {
        for (i, found) in found.chunks_exact_mut(nsample).enumerate() {
            let centre = point(centres, i);
            let count = first_within(columns, centre, limit, found);
            let fill = if count > 0 { found[0] } else { nearest(columns, centre) };
            found[count..].fill(fill);
        }
    }
}

/// Writes the first points within the squared distance, as many as there is room for; returns how many.
#[inline(always)]
fn first_within(columns: &Columns, centre: [f32; 3], limit: f32, found: &mut [u32]) -> usize {
    let mut count = 0;
    for (block, ((x, y), z)) in columns.x.iter().zip(&columns.y).zip(&columns.z).enumerate() {
        let distance = squared_distances(centre, x, y, z);
        let mut within = lane_bits(|l| distance[l] < limit);
        while within != 0 {
            found[count] = (block * LANES) as u32 + within.trailing_zeros();
            count += 1;
            if count == found.len() {
                return count;
            }
            within &= within - 1;
        }
    }
    count
}

/// The nearest point, of equal ones the lowest; 0 if no distance is a number.
#[inline(always)]
fn nearest(columns: &Columns, centre: [f32; 3]) -> u32 {
    let (mut best, mut at) = (f32::INFINITY, 0);
    for (block, ((x, y), z)) in columns.x.iter().zip(&columns.y).zip(&columns.z).enumerate() {
        for (l, d) in squared_distances(centre, x, y, z).into_iter().enumerate() {
            if d < best {
                (best, at) = (d, (block * LANES + l) as u32);
            }
        }
    }
    at
}

/// For each point of `unknown` the three nearest of `known`: indices and distances, the nearest first, of equal ones the
/// lowest index first.
///
/// With fewer than three the last one repeats. If no distance is a number: index 0, distance infinite. Both answers are
/// empty if `known` is.
pub fn three_nearest(unknown: &[f32], known: &[f32]) -> (Vec<[u32; 3]>, Vec<[f32; 3]>) {
    three_nearest_with(Isa::best(), unknown, known)
}

/// [`three_nearest`] on a chosen instruction set.
pub fn three_nearest_with(isa: Isa, unknown: &[f32], known: &[f32]) -> (Vec<[u32; 3]>, Vec<[f32; 3]>) {
    if known.len() < 3 {
        return (Vec::new(), Vec::new());
    }
    let n = unknown.len() / 3;
    let queries = Columns::new(unknown);
    let known = known.as_chunks::<3>().0;
    let (mut indices, mut distances) = (vec![[0; 3]; n], vec![[0.0; 3]; n]);
    indices.par_chunks_mut(LANES).zip(distances.par_chunks_mut(LANES)).enumerate().with_min_len(4).for_each(
        |(block, (indices, distances))| {
            let (x, y, z) = (&queries.x[block], &queries.y[block], &queries.z[block]);
            three_nearest_block(isa, x, y, z, known, indices, distances);
        },
    );
    (indices, distances)
}

per_isa! {
    fn three_nearest_block(
        x: &[f32; LANES],
        y: &[f32; LANES],
        z: &[f32; LANES],
        known: &[[f32; 3]],
        indices: &mut [[u32; 3]],
        distances: &mut [[f32; 3]],
    ) {
        let (mut best, mut at) = ([[f32::INFINITY; LANES]; 3], [[0; LANES]; 3]);
        for (k, &p) in known.iter().enumerate() {
            let d = squared_distances(p, x, y, z);
            for l in 0..LANES {
                let (first, second, third) = (d[l] < best[0][l], d[l] < best[1][l], d[l] < best[2][l]);
                best[2][l] = if second { best[1][l] } else if third { d[l] } else { best[2][l] };
                at[2][l] = if second { at[1][l] } else if third { k as u32 } else { at[2][l] };
                best[1][l] = if first { best[0][l] } else if second { d[l] } else { best[1][l] };
                at[1][l] = if first { at[0][l] } else if second { k as u32 } else { at[1][l] };
                best[0][l] = if first { d[l] } else { best[0][l] };
                at[0][l] = if first { k as u32 } else { at[0][l] };
            }
        }
        for (l, (indices, distances)) in indices.iter_mut().zip(distances).enumerate() {
            *indices = [at[0][l], at[1][l], at[2][l]];
            *distances = [best[0][l].sqrt(), best[1][l].sqrt(), best[2][l].sqrt()];
            for i in 1..3 {
                if distances[i] == f32::INFINITY {
                    (indices[i], distances[i]) = (indices[i - 1], distances[i - 1]);
                }
            }
        }
    }
}
