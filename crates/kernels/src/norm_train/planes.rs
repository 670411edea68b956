//! Pictures: `[batch, channels, pixels]`.

use std::mem::MaybeUninit;

use rayon::prelude::*;

use super::{Affine, Gradients, Moments, Tally, written};
use crate::ShapeError;
use crate::isa::{Isa, per_isa};
use crate::parallel::Shared;

/// Values that are summed in the first-level cache.
const RUN: usize = 2048;
/// Partial sums kept apart, so that the compiler can keep them in vectors.
const SUMS: usize = 64;

/// Sizes of a batch of planes.
pub type Sizes = [usize; 3];

fn check([batch, channels, pixels]: Sizes, slices: &[&[f32]], affine: &[&[f32]]) -> Result<(), ShapeError> {
    slices.iter().try_for_each(|s| ShapeError::check("values", batch * channels * pixels, s.len()))?;
    affine.iter().try_for_each(|s| ShapeError::check("channels", channels, s.len()))
}

/// Mean and variance of each channel.
///
/// # Errors
/// When `x` does not have as many values as the sizes say.
pub fn moments(isa: Isa, sizes: Sizes, x: &[f32]) -> Result<Moments, ShapeError> {
    check(sizes, &[x], &[])?;
    let [batch, channels, pixels] = sizes;
    let channel = |c: usize| {
        let planes = (0..batch).flat_map(|b| x[(b * channels + c) * pixels..][..pixels].chunks(RUN));
        planes.fold(Tally::default(), |all, run| {
            let mean = sum(isa, run) / run.len() as f32;
            let (offset, squares) = sum_centred(isa, run, mean);
            // The mean of a run is rounded; what is left of it corrects both moments.
            let count = run.len() as f64;
            let offset = f64::from(offset) / count;
            let squares = f64::from(squares) - offset * offset * count;
            all.join(Tally { count, mean: f64::from(mean) + offset, squares })
        })
    };
    let tallies: Vec<Tally> = (0..channels).into_par_iter().map(channel).collect();
    Ok(tallies.into_iter().collect())
}

/// `y = x * scale + shift`, `+ residual` if there is one, then `max(y, 0)` if `relu`.
///
/// # Errors
/// When a slice does not have as many values as the sizes say.
pub fn forward(
    isa: Isa,
    sizes: Sizes,
    x: &[f32],
    residual: Option<&[f32]>,
    affine: &Affine<'_>,
    moments: &Moments,
    relu: bool,
) -> Result<Vec<f32>, ShapeError> {
    check(
        sizes,
        &[x, residual.unwrap_or(x)],
        &[affine.gamma, affine.beta, &moments.mean, &moments.variance],
    )?;
    let [_, channels, pixels] = sizes;
    let floor = if relu { 0.0 } else { f32::NEG_INFINITY };
    Ok(written(x.len(), |y| {
        y.par_chunks_mut(pixels.max(1)).enumerate().for_each(|(plane, y)| {
            let (scale, shift) = affine.line(moments, plane % channels);
            let at = plane * pixels..(plane + 1) * pixels;
            match residual {
                Some(residual) => line_add(isa, &x[at.clone()], &residual[at], scale, shift, floor, y),
                None => line(isa, &x[at], scale, shift, floor, y),
            }
        });
    }))
}

/// What followed the batch-norm, with the result where it says which values passed.
#[derive(Clone, Copy, Debug)]
pub enum Followed<'a> {
    /// Nothing.
    Nothing,
    /// A ReLU.
    Relu(&'a [f32]),
    /// A residual was added, then a ReLU; the gradient of the residual is wanted.
    AddRelu(&'a [f32]),
}

/// Gradients for `dy`, and that of the residual if there is one.
///
/// # Errors
/// When a slice does not have as many values as the sizes say.
pub fn backward(
    isa: Isa,
    sizes: Sizes,
    dy: &[f32],
    x: &[f32],
    followed: Followed<'_>,
    affine: &Affine<'_>,
    moments: &Moments,
) -> Result<(Gradients, Option<Vec<f32>>), ShapeError> {
    let (output, residual) = match followed {
        Followed::Nothing => (None, false),
        Followed::Relu(output) => (Some(output), false),
        Followed::AddRelu(output) => (Some(output), true),
    };
    let parameters = [affine.gamma, affine.beta, &moments.mean, &moments.variance];
    check(sizes, &[dy, x, output.unwrap_or(x)], &parameters)?;
    let [batch, channels, pixels] = sizes;
    let mut masked = if residual { Vec::with_capacity(dy.len()) } else { Vec::new() };
    let to_residual = Shared(masked.as_mut_ptr());
    let mut input = Vec::with_capacity(dy.len());
    let to_input = Shared(input.as_mut_ptr());
    let count = (batch * pixels).max(1) as f32;
    let channel = |c: usize| {
        let planes = || (0..batch).map(|b| (b * channels + c) * pixels..(b * channels + c + 1) * pixels);
        let mean = moments.mean[c];
        let (mut sum, mut product) = (0.0f64, 0.0f64);
        for at in planes() {
            let runs = dy[at.clone()].chunks(RUN).zip(x[at.clone()].chunks(RUN));
            for (i, (dy, x)) in runs.enumerate() {
                let (s, p) = match output {
                    Some(y) => sums_masked(isa, dy, x, &y[at.start + i * RUN..][..dy.len()], mean),
                    None => sums(isa, dy, x, mean),
                };
                sum += f64::from(s);
                product += f64::from(p);
            }
        }
        let inverse = 1.0 / (moments.variance[c] + affine.epsilon).sqrt();
        let (sum, product) = (sum as f32, product as f32 * inverse);
        let (scale, slope) = (affine.gamma[c] * inverse, inverse * product / count);
        for at in planes() {
            // SAFETY: channel c of the image is this job's alone, and lies within the `dy.len()` values reserved.
            let out = unsafe { plane(to_input, at.start, pixels) };
            let (dy, x) = (&dy[at.clone()], &x[at.clone()]);
            match output {
                Some(y) if residual => {
                    // SAFETY: as above; with `residual` as many values were reserved.
                    let kept = unsafe { plane(to_residual, at.start, pixels) };
                    mask(isa, dy, &y[at], kept);
                    // SAFETY: `mask` has just written all of them.
                    let kept = unsafe { std::slice::from_raw_parts(kept.as_ptr().cast(), pixels) };
                    input_gradient(isa, kept, x, mean, scale, sum / count, slope, out);
                }
                Some(y) => input_gradient_masked(isa, dy, x, &y[at], mean, scale, sum / count, slope, out),
                None => input_gradient(isa, dy, x, mean, scale, sum / count, slope, out),
            }
        }
        (product, sum)
    };
    let (gamma, beta) = (0..channels).into_par_iter().map(channel).unzip();
    // SAFETY: the planes of all channels are all values, and each was written.
    unsafe {
        input.set_len(dy.len());
        masked.set_len(if residual { dy.len() } else { 0 });
    }
    Ok((Gradients { input, gamma, beta }, residual.then_some(masked)))
}

/// `pixels` values of a buffer, from value `start`.
///
/// # Safety
/// They lie within the buffer and nobody else uses them.
unsafe fn plane<'a>(buffer: Shared, start: usize, pixels: usize) -> &'a mut [MaybeUninit<f32>] {
    // SAFETY: the caller's promise; uninitialised memory is valid as MaybeUninit.
    unsafe { std::slice::from_raw_parts_mut(buffer.get().add(start).cast(), pixels) }
}

/// Sums two functions of the index over a slice, in [`SUMS`] partial sums each.
#[inline(always)]
fn two_sums(len: usize, f: impl Fn(usize) -> (f32, f32)) -> (f32, f32) {
    let (mut a, mut b) = ([0.0; SUMS], [0.0; SUMS]);
    let whole = len / SUMS * SUMS;
    for start in (0..whole).step_by(SUMS) {
        for l in 0..SUMS {
            let (u, v) = f(start + l);
            a[l] += u;
            b[l] += v;
        }
    }
    for i in whole..len {
        let (u, v) = f(i);
        a[i - whole] += u;
        b[i - whole] += v;
    }
    (a.iter().sum(), b.iter().sum())
}

per_isa! {
    fn sum(x: &[f32]) -> f32 {
        two_sums(x.len(), |i| (x[i], 0.0)).0
    }
}
per_isa! {
    fn sum_centred(x: &[f32], mean: f32) -> (f32, f32) {
        two_sums(x.len(), |i| (x[i] - mean, (x[i] - mean) * (x[i] - mean)))
    }
}
per_isa! {
    fn sums(dy: &[f32], x: &[f32], mean: f32) -> (f32, f32) {
        let x = &x[..dy.len()];
        two_sums(dy.len(), |i| (dy[i], dy[i] * (x[i] - mean)))
    }
}
per_isa! {
    fn sums_masked(dy: &[f32], x: &[f32], y: &[f32], mean: f32) -> (f32, f32) {
        let (x, y) = (&x[..dy.len()], &y[..dy.len()]);
        two_sums(dy.len(), |i| {
            let g = if y[i] > 0.0 { dy[i] } else { 0.0 };
            (g, g * (x[i] - mean))
        })
    }
}
per_isa! {
    fn line(x: &[f32], scale: f32, shift: f32, floor: f32, y: &mut [MaybeUninit<f32>]) {
        for (y, x) in y.iter_mut().zip(x) {
            y.write((x * scale + shift).max(floor));
        }
    }
}
per_isa! {
    fn line_add(x: &[f32], residual: &[f32], scale: f32, shift: f32, floor: f32, y: &mut [MaybeUninit<f32>]) {
        for ((y, x), residual) in y.iter_mut().zip(x).zip(residual) {
            y.write((x * scale + shift + residual).max(floor));
        }
    }
}
per_isa! {
    fn mask(dy: &[f32], y: &[f32], kept: &mut [MaybeUninit<f32>]) {
        for ((kept, dy), y) in kept.iter_mut().zip(dy).zip(y) {
            kept.write(if *y > 0.0 { *dy } else { 0.0 });
        }
    }
}
per_isa! {
    fn input_gradient(
        dy: &[f32], x: &[f32], mean: f32, scale: f32, average: f32, slope: f32, out: &mut [MaybeUninit<f32>],
    ) {
        for ((out, dy), x) in out.iter_mut().zip(dy).zip(x) {
            out.write(scale * (dy - average - (x - mean) * slope));
        }
    }
}
per_isa! {
    fn input_gradient_masked(
        dy: &[f32], x: &[f32], y: &[f32], mean: f32, scale: f32, average: f32, slope: f32,
        out: &mut [MaybeUninit<f32>],
    ) {
        for (((out, dy), x), y) in out.iter_mut().zip(dy).zip(x).zip(y) {
            let g = if *y > 0.0 { *dy } else { 0.0 };
            out.write(scale * (g - average - (x - mean) * slope));
        }
    }
}
