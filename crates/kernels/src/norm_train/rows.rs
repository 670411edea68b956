//! Points: `[rows, channels]`, with a ReLU always.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::{Affine, Gradients, Moments, Tally, written};
use crate::ShapeError;
use crate::isa::{Isa, per_isa};

/// Values that are summed in the first-level cache.
const RUN: usize = 4096;

pub(super) fn check(channels: usize, slices: &[&[f32]], affine: &[&[f32]]) -> Result<usize, ShapeError> {
    ShapeError::check("rows of all channels (1 is yes)", 1, usize::from(channels > 0))?;
    let len = slices.first().map_or(0, |s| s.len());
    ShapeError::check("values of the last row", 0, len % channels)?;
    slices.iter().try_for_each(|s| ShapeError::check("values", len, s.len()))?;
    affine.iter().try_for_each(|s| ShapeError::check("channels", channels, s.len()))?;
    Ok((RUN / channels).max(1) * channels)
}

/// Mean and variance of each channel.
///
/// # Errors
/// When `x` is not whole rows.
pub fn moments(isa: Isa, channels: usize, x: &[f32]) -> Result<Moments, ShapeError> {
    let run = check(channels, &[x], &[])?;
    let runs: Vec<_> = x
        .par_chunks(run)
        .with_min_len(8)
        .map(|run| {
            let count = run.len() / channels;
            let (mut mean, mut offset, mut squares) =
                (vec![0.0; channels], vec![0.0; channels], vec![0.0; channels]);
            sum(isa, run, &mut mean);
            mean.iter_mut().for_each(|m| *m /= count as f32);
            sum_centred(isa, run, &mean, &mut offset, &mut squares);
            (count as f64, mean, offset, squares)
        })
        .collect();
    let channel = |c: usize| {
        runs.iter().fold(Tally::default(), |all, (count, mean, offset, squares)| {
            // The mean of a run is rounded; what is left of it corrects both moments.
            let offset = f64::from(offset[c]) / count;
            let squares = f64::from(squares[c]) - offset * offset * count;
            all.join(Tally { count: *count, mean: f64::from(mean[c]) + offset, squares })
        })
    };
    Ok((0..channels).map(channel).collect())
}

/// `max(x * scale + shift, 0)`.
///
/// # Errors
/// When `x` is not whole rows, or a parameter not one number per channel.
pub fn forward(isa: Isa, x: &[f32], affine: &Affine<'_>, moments: &Moments) -> Result<Vec<f32>, ShapeError> {
    let channels = affine.gamma.len();
    let run = check(channels, &[x], &[affine.beta, &moments.mean, &moments.variance])?;
    let (scale, shift) = lines(affine, moments);
    Ok(written(x.len(), |y| {
        y.par_chunks_mut(run)
            .zip(x.par_chunks(run))
            .with_min_len(8)
            .for_each(|(y, x)| line(isa, x, &scale, &shift, y));
    }))
}

/// Gradients for `dy`, given the input of [`forward`].
///
/// # Errors
/// As [`forward`].
pub fn backward(
    isa: Isa,
    dy: &[f32],
    x: &[f32],
    affine: &Affine<'_>,
    moments: &Moments,
) -> Result<Gradients, ShapeError> {
    let channels = affine.gamma.len();
    let run = check(channels, &[dy, x], &[affine.beta, &moments.mean, &moments.variance])?;
    let (scale, shift) = lines(affine, moments);
    let runs: Vec<(Vec<f32>, Vec<f32>)> = dy
        .par_chunks(run)
        .zip(x.par_chunks(run))
        .with_min_len(8)
        .map(|(dy, x)| {
            let (mut total, mut product) = (vec![0.0; channels], vec![0.0; channels]);
            sums(isa, dy, x, &scale, &shift, &moments.mean, &mut total, &mut product);
            (total, product)
        })
        .collect();
    let total = |runs: &mut dyn Iterator<Item = f32>| runs.map(f64::from).sum::<f64>() as f32;
    let count = (x.len() / channels).max(1) as f32;
    let inverse: Vec<f32> = moments.variance.iter().map(|v| 1.0 / (v + affine.epsilon).sqrt()).collect();
    let beta: Vec<f32> = (0..channels).map(|c| total(&mut runs.iter().map(|run| run.0[c]))).collect();
    let gamma: Vec<f32> =
        (0..channels).map(|c| total(&mut runs.iter().map(|run| run.1[c])) * inverse[c]).collect();
    // scale (g - average - (x - mean) slope) as scale g - (x falling + level)
    let falling: Vec<f32> = (0..channels).map(|c| scale[c] * inverse[c] * gamma[c] / count).collect();
    let level: Vec<f32> =
        (0..channels).map(|c| scale[c] * beta[c] / count - moments.mean[c] * falling[c]).collect();
    let input = written(dy.len(), |out| {
        let runs = out.par_chunks_mut(run).zip(dy.par_chunks(run)).zip(x.par_chunks(run));
        runs.with_min_len(8)
            .for_each(|((out, dy), x)| input_gradient(isa, dy, x, &scale, &shift, &falling, &level, out));
    });
    Ok(Gradients { input, gamma, beta })
}

pub(super) fn lines(affine: &Affine<'_>, moments: &Moments) -> (Vec<f32>, Vec<f32>) {
    (0..affine.gamma.len()).map(|c| affine.line(moments, c)).unzip()
}

per_isa! {
    fn sum(x: &[f32], total: &mut [f32]) {
        for row in x.chunks_exact(total.len()) {
            for (total, x) in total.iter_mut().zip(row) {
                *total += x;
            }
        }
    }
}
per_isa! {
    fn sum_centred(x: &[f32], mean: &[f32], offset: &mut [f32], squares: &mut [f32]) {
        let n = mean.len();
        let (offset, squares) = (&mut offset[..n], &mut squares[..n]);
        for row in x.chunks_exact(n) {
            for c in 0..n {
                let apart = row[c] - mean[c];
                offset[c] += apart;
                squares[c] += apart * apart;
            }
        }
    }
}
per_isa! {
    fn line(x: &[f32], scale: &[f32], shift: &[f32], y: &mut [MaybeUninit<f32>]) {
        let n = scale.len();
        let shift = &shift[..n];
        for (y, x) in y.chunks_exact_mut(n).zip(x.chunks_exact(n)) {
            for c in 0..n {
                y[c].write((x[c] * scale[c] + shift[c]).max(0.0));
            }
        }
    }
}
per_isa! {
    fn sums(
        dy: &[f32], x: &[f32], scale: &[f32], shift: &[f32], mean: &[f32], total: &mut [f32], product: &mut [f32],
    ) {
        let n = scale.len();
        let (shift, mean, total, product) = (&shift[..n], &mean[..n], &mut total[..n], &mut product[..n]);
        for (dy, x) in dy.chunks_exact(n).zip(x.chunks_exact(n)) {
            for c in 0..n {
                let g = if x[c] * scale[c] + shift[c] > 0.0 { dy[c] } else { 0.0 };
                total[c] += g;
                product[c] += g * (x[c] - mean[c]);
            }
        }
    }
}
per_isa! {
    fn input_gradient(
        dy: &[f32], x: &[f32], scale: &[f32], shift: &[f32], falling: &[f32], level: &[f32],
        out: &mut [MaybeUninit<f32>],
    ) {
        let n = scale.len();
        let (shift, falling, level) = (&shift[..n], &falling[..n], &level[..n]);
        for ((out, dy), x) in out.chunks_exact_mut(n).zip(dy.chunks_exact(n)).zip(x.chunks_exact(n)) {
            for c in 0..n {
                let g = if x[c] * scale[c] + shift[c] > 0.0 { dy[c] } else { 0.0 };
                out[c].write(scale[c] * g - (x[c] * falling[c] + level[c]));
            }
        }
    }
}
