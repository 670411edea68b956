//! Gradients of a convolution, given the gradient `dy` of its output.

use rayon::prelude::*;

use super::micro::Accumulate;
use super::operands;
use super::planes::{Layout, Source, Tap};
use super::sweep::{Output, Pass, pack_weights, sweep};
use super::{CHANNELS, ConvShape, Part, check_parts};
use crate::parallel::with_scratch;
use crate::{Isa, ShapeError};

/// Positions of a portion for the input gradient.
const POSITIONS: usize = 1100;
/// Positions of a portion for the weight gradient.
const DOT_POSITIONS: usize = 1100;

/// Gradient of the input: `[batch, inputs, height, width]`.
///
/// # Errors
/// When a slice does not have the values that `shape` implies, or `shape` has no output.
pub fn input_gradient(
    isa: Isa,
    shape: &ConvShape,
    dy: &[f32],
    weight: &[f32],
) -> Result<Vec<f32>, ShapeError> {
    shape.check()?;
    ShapeError::check("output gradients", shape.output_len(), dy.len())?;
    ShapeError::check("weights", shape.weight_len(), weight.len())?;
    let (k, stride) = (shape.kernel, shape.stride);
    // Input row q * stride + a saw output row q + shift through tap `tap`, for one tap in `stride`.
    let shift = |a: usize, tap: usize| {
        let distance = (a + shape.padding) as isize - tap as isize;
        (distance.rem_euclid(stride as isize) == 0).then(|| distance.div_euclid(stride as isize))
    };
    let shifts: Vec<isize> = (0..stride).flat_map(|a| (0..k).filter_map(move |tap| shift(a, tap))).collect();
    let padding = shifts.iter().map(|s| s.unsigned_abs()).max().unwrap_or(0);
    let parts = [Part { planes: dy, channels: shape.outputs, doubled: false }];
    let source = Source {
        parts: &parts,
        channels: shape.outputs,
        height: shape.out_height(),
        width: shape.out_width(),
    };
    let out = [shape.height.div_ceil(stride), shape.width.div_ceil(stride)];
    let layout = Layout::new(shape.batch, &source, out, 1, padding, 2 * padding, POSITIONS);
    let mut passes = Vec::with_capacity(stride * stride);
    for phase in (0..stride).flat_map(|a| (0..stride).map(move |b| [a, b])) {
        let mut taps = Vec::new();
        let mut weights = Vec::new();
        for (y, x) in (0..k).flat_map(|y| (0..k).map(move |x| (y, x))) {
            if let (Some(row), Some(column)) = (shift(phase[0], y), shift(phase[1], x)) {
                let at = |shift: isize| shift.wrapping_add_unsigned(padding) as usize;
                taps.push(Tap { plane: [0, 0], row: at(row), column: at(column) });
                weights.push(y * k + x);
            }
        }
        let offsets = layout.offsets(operands::groups(isa, shape.outputs), &taps);
        let weights = pack_weights(isa, [shape.inputs, shape.outputs, taps.len()], |i, o, tap| {
            weight[(o * shape.inputs + i) * k * k + weights[tap]]
        });
        passes.push(Pass { offsets, weights, phase });
    }
    let output =
        Output { channels: shape.inputs, height: shape.height, width: shape.width, step: stride, bias: None };
    Ok(sweep(isa, shape.batch, &layout, &source, &passes, &output))
}

/// Gradient of the weight, `[outputs, inputs, kernel, kernel]`, for an input given in parts.
///
/// # Errors
/// When a slice does not have the values that `shape` implies, or `shape` has no output.
pub fn weight_gradient(
    isa: Isa,
    shape: &ConvShape,
    parts: &[Part<'_>],
    dy: &[f32],
) -> Result<Vec<f32>, ShapeError> {
    shape.check()?;
    check_parts(shape, parts)?;
    ShapeError::check("output gradients", shape.output_len(), dy.len())?;
    let source = shape.source(parts);
    let layout = shape.layout(&source, DOT_POSITIONS);
    let offsets = layout.offsets(shape.inputs, &shape.taps());
    let mut gradient = vec![0.0; shape.weight_len()];
    let per_block = CHANNELS * offsets.len();
    let blocks = shape.outputs.div_ceil(CHANNELS);
    let share = blocks.div_ceil(rayon::current_num_threads());
    let packed = layout.scratch_len(shape.inputs);
    gradient.par_chunks_mut(share * per_block).enumerate().for_each(|(thread, gradient)| {
        for portion in (0..layout.portions()).map(|i| layout.portion(i)) {
            let positions = layout.positions(portion).next_multiple_of(16 * isa.operands());
            with_scratch(packed + CHANNELS * positions, |scratch| {
                let (x, rows) = scratch.split_at_mut(packed);
                layout.fill(&source, portion, x);
                operands::pack_positions(isa, x);
                for (block, gradient) in gradient.chunks_mut(per_block).enumerate() {
                    rows.fill(0.0);
                    let first = (thread * share + block) * CHANNELS;
                    for (o, row) in (first..shape.outputs).zip(rows.chunks_exact_mut(positions)) {
                        for image in 0..portion.images {
                            let plane = (portion.first_image + image) * shape.outputs + o;
                            for y in 0..portion.rows {
                                let width = layout.out_width();
                                let from = (plane * shape.out_height() + portion.first_row + y) * width;
                                row[layout.position(image, y)..][..width]
                                    .copy_from_slice(&dy[from..from + width]);
                            }
                        }
                    }
                    operands::pack_positions(isa, rows);
                    Accumulate { x, offsets: &offsets, dy: rows, positions, gradient }.run_on(isa);
                }
            });
        }
    });
    Ok(gradient)
}

/// Gradient of nearest upsampling by two: the sum over every 2 x 2 pixels of some `channels` of a gradient
/// `[batch, all_channels, height, width]`, beginning with channel `first`.
///
/// # Errors
/// When the sizes do not fit, or a side is odd.
pub fn upsampling_gradient(
    gradient: &[f32],
    [batch, all_channels, height, width]: [usize; 4],
    first: usize,
    channels: usize,
) -> Result<Vec<f32>, ShapeError> {
    ShapeError::check("odd rows and columns to halve", 0, height % 2 + width % 2)?;
    ShapeError::check("values to halve", batch * all_channels * height * width, gradient.len())?;
    ShapeError::check("channels beyond the last", 0, (first + channels).saturating_sub(all_channels))?;
    let small = height * width / 4;
    let mut sums = vec![0.0; batch * channels * small];
    sums.par_chunks_mut(small.max(1)).enumerate().for_each(|(plane, sums)| {
        let from = (plane / channels * all_channels + first + plane % channels) * height * width;
        let rows = gradient[from..from + height * width].chunks_exact(2 * width);
        for (sums, rows) in sums.chunks_exact_mut(width / 2).zip(rows) {
            let (above, below) = rows.split_at(width);
            for (sum, (a, b)) in
                sums.iter_mut().zip(above.as_chunks::<2>().0.iter().zip(below.as_chunks::<2>().0))
            {
                *sum = (a[0] + a[1]) + (b[0] + b[1]);
            }
        }
    });
    Ok(sums)
}
