//! Batch-norm and ReLU of neighbours, then the greatest of each neighbourhood: `[groups * neighbours, channels]` to
//! `[groups, channels]`. What is not the greatest is never written, and its gradient is known to be zero.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::rows::{check, lines};
use super::{Affine, Gradients, Moments, written};
use crate::ShapeError;
use crate::isa::{Isa, per_isa};

/// Groups handled at a time.
const GROUPS: usize = 16;

/// The greatest of `max(x * scale + shift, 0)` over each group of `neighbours` rows, and which neighbour it was (the first,
/// of equal ones).
///
/// # Errors
/// When `x` is not whole groups, there are more than 256 neighbours, or a parameter is not one number per channel.
pub fn forward(
    isa: Isa,
    neighbours: usize,
    x: &[f32],
    affine: &Affine<'_>,
    moments: &Moments,
) -> Result<(Vec<f32>, Vec<u8>), ShapeError> {
    let channels = affine.gamma.len();
    check(channels, &[x], &[affine.beta, &moments.mean, &moments.variance])?;
    ShapeError::check("neighbours (1 is 1 to 256)", 1, usize::from((1..=256).contains(&neighbours)))?;
    let group = neighbours * channels;
    ShapeError::check("values of the last group", 0, x.len() % group)?;
    let (scale, shift) = lines(affine, moments);
    let mut which = vec![0; x.len() / neighbours];
    let greatest = written(x.len() / neighbours, |y| {
        y.par_chunks_mut(GROUPS * channels)
            .zip(which.par_chunks_mut(GROUPS * channels))
            .zip(x.par_chunks(GROUPS * group))
            .for_each(|((y, which), x)| pool(isa, x, &scale, &shift, y, which));
    });
    Ok((greatest, which))
}

/// Gradients for `dy`, given the input of [`forward`] and its second answer.
///
/// # Errors
/// As [`forward`].
pub fn backward(
    isa: Isa,
    neighbours: usize,
    dy: &[f32],
    which: &[u8],
    x: &[f32],
    affine: &Affine<'_>,
    moments: &Moments,
) -> Result<Gradients, ShapeError> {
    let channels = affine.gamma.len();
    check(channels, &[x], &[affine.beta, &moments.mean, &moments.variance])?;
    ShapeError::check("neighbours (1 is 1 to 256)", 1, usize::from((1..=256).contains(&neighbours)))?;
    ShapeError::check("gradients", x.len() / neighbours, dy.len())?;
    ShapeError::check("numbers of neighbours", dy.len(), which.len())?;
    ShapeError::check(
        "neighbour beyond the last",
        0,
        which.iter().filter(|&&w| usize::from(w) >= neighbours).count(),
    )?;
    let group = neighbours * channels;
    ShapeError::check("values of the last group", 0, x.len() % group)?;
    let (scale, shift) = lines(affine, moments);
    let picked = GROUPS * channels;
    let runs: Vec<(Vec<f32>, Vec<f32>)> = dy
        .par_chunks(picked)
        .zip(which.par_chunks(picked))
        .zip(x.par_chunks(GROUPS * group))
        .map(|((dy, which), x)| {
            let (mut total, mut product) = (vec![0.0; channels], vec![0.0; channels]);
            let groups =
                dy.chunks_exact(channels).zip(which.chunks_exact(channels)).zip(x.chunks_exact(group));
            for ((dy, which), x) in groups {
                for c in 0..channels {
                    let x = x[usize::from(which[c]) * channels + c];
                    let g = if x * scale[c] + shift[c] > 0.0 { dy[c] } else { 0.0 };
                    total[c] += g;
                    product[c] += g * (x - moments.mean[c]);
                }
            }
            (total, product)
        })
        .collect();
    let mut totals = vec![(0.0f64, 0.0f64); channels];
    for (total, product) in &runs {
        for (sums, (t, p)) in totals.iter_mut().zip(total.iter().zip(product)) {
            *sums = (sums.0 + f64::from(*t), sums.1 + f64::from(*p));
        }
    }
    let count = (x.len() / channels).max(1) as f32;
    let inverse: Vec<f32> = moments.variance.iter().map(|v| 1.0 / (v + affine.epsilon).sqrt()).collect();
    let beta: Vec<f32> = totals.iter().map(|t| t.0 as f32).collect();
    let gamma: Vec<f32> = totals.iter().zip(&inverse).map(|(t, inverse)| t.1 as f32 * inverse).collect();
    let falling: Vec<f32> = (0..channels).map(|c| scale[c] * inverse[c] * gamma[c] / count).collect();
    let level: Vec<f32> =
        (0..channels).map(|c| scale[c] * beta[c] / count - moments.mean[c] * falling[c]).collect();
    let input = written(x.len(), |out| {
        out.par_chunks_mut(GROUPS * group)
            .zip(x.par_chunks(GROUPS * group))
            .zip(dy.par_chunks(picked).zip(which.par_chunks(picked)))
            .for_each(|((out, x), (dy, which))| {
                spread(isa, x, &falling, &level, out);
                let groups = dy.chunks_exact(channels).zip(which.chunks_exact(channels));
                for ((out, x), (dy, which)) in
                    out.chunks_exact_mut(group).zip(x.chunks_exact(group)).zip(groups)
                {
                    for c in 0..channels {
                        let at = usize::from(which[c]) * channels + c;
                        if x[at] * scale[c] + shift[c] > 0.0 {
                            out[at].write(scale[c] * dy[c] - (x[at] * falling[c] + level[c]));
                        }
                    }
                }
            });
    });
    Ok(Gradients { input, gamma, beta })
}

per_isa! {
    fn pool(x: &[f32], scale: &[f32], shift: &[f32], y: &mut [MaybeUninit<f32>], which: &mut [u8]) {
        let n = scale.len();
        let shift = &shift[..n];
        let group = x.len() / (y.len() / n);
        let mut best = vec![0.0; n];
        let mut at = vec![0.0; n];
        for ((y, which), x) in y.chunks_exact_mut(n).zip(which.chunks_exact_mut(n)).zip(x.chunks_exact(group)) {
            best.fill(f32::NEG_INFINITY);
            for (k, x) in x.chunks_exact(n).enumerate() {
                let k = k as f32;
                for c in 0..n {
                    let value = x[c] * scale[c] + shift[c];
                    let better = value > best[c];
                    best[c] = if better { value } else { best[c] };
                    at[c] = if better { k } else if best[c] == f32::NEG_INFINITY { 0.0 } else { at[c] };
                }
            }
            for c in 0..n {
                y[c].write(best[c].max(0.0));
                which[c] = at[c] as u8;
            }
        }
    }
}
per_isa! {
    fn spread(x: &[f32], falling: &[f32], level: &[f32], out: &mut [MaybeUninit<f32>]) {
        let n = falling.len();
        let level = &level[..n];
        for (out, x) in out.chunks_exact_mut(n).zip(x.chunks_exact(n)) {
            for c in 0..n {
                out[c].write(-(x[c] * falling[c] + level[c]));
            }
        }
    }
}
