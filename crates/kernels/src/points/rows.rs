//! Gathering features along neighbourhoods, and the gradients of that, on rows `[points, channels]`.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use crate::ShapeError;
use crate::isa::{Isa, per_isa};
use crate::norm_train::written;

/// Output values computed at a time.
const RUN: usize = 8192;

/// For each row of an output a few rows of an input, each with a weight: neighbours of a centre (one, weight 1), or the
/// three points that a fourth lies between.
#[derive(Clone, Debug, PartialEq)]
pub struct Selection {
    indices: Vec<u32>,
    weights: Option<Vec<f32>>,
    per_row: usize,
    inputs: usize,
}

impl Selection {
    /// `indices` holds `per_row` numbers below `inputs` for each output row, `weights` as many (all 1 if None).
    ///
    /// # Errors
    /// When it does not.
    pub fn new(
        indices: Vec<u32>,
        weights: Option<Vec<f32>>,
        per_row: usize,
        inputs: usize,
    ) -> Result<Self, ShapeError> {
        ShapeError::check(
            "indices beyond the last row",
            0,
            indices.iter().filter(|&&i| i as usize >= inputs).count(),
        )?;
        ShapeError::check("indices of the last row", 0, indices.len() % per_row.max(1))?;
        ShapeError::check("weights", indices.len(), weights.as_ref().map_or(indices.len(), Vec::len))?;
        Ok(Self { indices, weights, per_row: per_row.max(1), inputs })
    }

    /// Rows of the output.
    pub fn rows(&self) -> usize {
        self.indices.len() / self.per_row
    }

    /// Rows of the input.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// `base + the weighted sum of the selected rows`; `base` may be missing.
    ///
    /// # Errors
    /// When `features` is not `[inputs, channels]` or `base` not `[rows, channels]`.
    pub fn gather(
        &self,
        isa: Isa,
        channels: usize,
        features: &[f32],
        base: Option<&[f32]>,
    ) -> Result<Vec<f32>, ShapeError> {
        let len = self.rows() * channels;
        ShapeError::check("features", self.inputs * channels, features.len())?;
        ShapeError::check("base", len, base.map_or(len, <[f32]>::len))?;
        let rows = (RUN / channels.max(1)).max(1);
        Ok(written(len, |out| {
            out.par_chunks_mut((rows * channels).max(1)).enumerate().for_each(|(run, out)| {
                let first = run * rows;
                let base = base.map(|base| &base[first * channels..][..out.len()]);
                let entries = first * self.per_row..(first + out.len() / channels.max(1)) * self.per_row;
                let weights = self.weights.as_ref().map(|w| &w[entries.clone()]);
                gather_run(isa, channels, features, &self.indices[entries], weights, self.per_row, base, out);
            });
        }))
    }

    /// Gradient of [`Self::gather`] with respect to `features`: each input row gets the weighted gradients of the output
    /// rows it was selected for, summed in their order.
    ///
    /// # Errors
    /// When `dy` is not `[rows, channels]`.
    pub fn scatter(&self, isa: Isa, channels: usize, dy: &[f32]) -> Result<Vec<f32>, ShapeError> {
        ShapeError::check("gradients", self.rows() * channels, dy.len())?;
        // The entries of each input row, by counting.
        let mut ends = vec![0u32; self.inputs + 1];
        for &i in &self.indices {
            ends[i as usize + 1] += 1;
        }
        for i in 0..self.inputs {
            ends[i + 1] += ends[i];
        }
        let mut next = ends.clone();
        let mut entries = vec![0u32; self.indices.len()];
        for (entry, &i) in self.indices.iter().enumerate() {
            entries[next[i as usize] as usize] = entry as u32;
            next[i as usize] += 1;
        }
        let mut sums = vec![0.0; self.inputs * channels];
        sums.par_chunks_mut(channels.max(1)).enumerate().with_min_len(64).for_each(|(i, sum)| {
            let entries = &entries[ends[i] as usize..ends[i + 1] as usize];
            scatter_row(isa, dy, entries, self.weights.as_deref(), self.per_row, sum);
        });
        Ok(sums)
    }
}

/// `offsets * weight + the selected rows`: the first layer of a neighbourhood's MLP, whose input is each neighbour's
/// offset from its centre and its features; the features' product is computed once a point and selected here.
///
/// # Shapes
/// `offsets`: `[rows, 3]`, `weight`: `[3, channels]`, `features`: `[inputs, channels]` -> `[rows, channels]`
///
/// # Errors
/// When a slice does not have that shape, or the selection is not of one row each.
pub fn gather_around(
    isa: Isa,
    selection: &Selection,
    offsets: &[f32],
    weight: &[f32],
    features: &[f32],
) -> Result<Vec<f32>, ShapeError> {
    let channels = weight.len() / 3;
    ShapeError::check("offset weights", 3 * channels, weight.len())?;
    ShapeError::check("offsets", 3 * selection.rows(), offsets.len())?;
    ShapeError::check("features", selection.inputs * channels, features.len())?;
    ShapeError::check("selected rows each", 1, selection.per_row)?;
    let rows = (RUN / channels.max(1)).max(1);
    Ok(written(selection.rows() * channels, |out| {
        out.par_chunks_mut((rows * channels).max(1))
            .zip(offsets.par_chunks(3 * rows))
            .zip(selection.indices.par_chunks(rows))
            .for_each(|((out, offsets), indices)| around_run(isa, offsets, weight, features, indices, out));
    }))
}

/// Gradient of [`gather_around`] with respect to the weight `[3, channels]`: `offsets` transposed times `dy`.
///
/// # Errors
/// When the numbers of rows differ.
pub fn offset_gradient(
    isa: Isa,
    channels: usize,
    offsets: &[f32],
    dy: &[f32],
) -> Result<Vec<f32>, ShapeError> {
    ShapeError::check("offsets", offsets.len() / 3 * 3, offsets.len())?;
    ShapeError::check("gradients", offsets.len() / 3 * channels, dy.len())?;
    let rows = (RUN / channels.max(1)).max(1);
    let runs: Vec<Vec<f32>> = offsets
        .par_chunks(3 * rows)
        .zip(dy.par_chunks((rows * channels).max(1)))
        .map(|(offsets, dy)| {
            let mut sums = vec![0.0; 3 * channels];
            offset_run(isa, offsets, dy, &mut sums);
            sums
        })
        .collect();
    let sum = |i: usize| runs.iter().map(|run| f64::from(run[i])).sum::<f64>() as f32;
    Ok((0..3 * channels).map(sum).collect())
}

per_isa! {
    fn gather_run(
        channels: usize, features: &[f32], indices: &[u32], weights: Option<&[f32]>, per_row: usize,
        base: Option<&[f32]>, out: &mut [MaybeUninit<f32>],
    ) {
        let zeros = vec![0.0; channels];
        for (row, out) in out.chunks_exact_mut(channels).enumerate() {
            let out = match base {
                Some(base) => out.write_copy_of_slice(&base[row * channels..][..channels]),
                None => out.write_copy_of_slice(&zeros),
            };
            for entry in row * per_row..(row + 1) * per_row {
                let from = &features[indices[entry] as usize * channels..][..channels];
                let weight = weights.map_or(1.0, |w| w[entry]);
                for (out, from) in out.iter_mut().zip(from) {
                    *out += weight * from;
                }
            }
        }
    }
}

per_isa! {
    fn scatter_row(dy: &[f32], entries: &[u32], weights: Option<&[f32]>, per_row: usize, sum: &mut [f32]) {
        for &entry in entries {
            let from = &dy[entry as usize / per_row * sum.len()..][..sum.len()];
            let weight = weights.map_or(1.0, |w| w[entry as usize]);
            for (sum, from) in sum.iter_mut().zip(from) {
                *sum += weight * from;
            }
        }
    }
}
per_isa! {
    fn around_run(
        offsets: &[f32], weight: &[f32], features: &[f32], indices: &[u32], out: &mut [MaybeUninit<f32>],
    ) {
        let n = weight.len() / 3;
        let (x, yz) = weight.split_at(n);
        let (y, z) = yz.split_at(n);
        let (x, y, z) = (&x[..n], &y[..n], &z[..n]);
        for ((out, offset), &index) in out.chunks_exact_mut(n).zip(offsets.as_chunks::<3>().0).zip(indices) {
            let from = &features[index as usize * n..][..n];
            for c in 0..n {
                out[c].write(offset[0] * x[c] + offset[1] * y[c] + (offset[2] * z[c] + from[c]));
            }
        }
    }
}
per_isa! {
    fn offset_run(offsets: &[f32], dy: &[f32], sums: &mut [f32]) {
        let n = sums.len() / 3;
        let (x, yz) = sums.split_at_mut(n);
        let (y, z) = yz.split_at_mut(n);
        let (x, y, z) = (&mut x[..n], &mut y[..n], &mut z[..n]);
        for (offset, dy) in offsets.as_chunks::<3>().0.iter().zip(dy.chunks_exact(n)) {
            for c in 0..n {
                x[c] += offset[0] * dy[c];
                y[c] += offset[1] * dy[c];
                z[c] += offset[2] * dy[c];
            }
        }
    }
}
