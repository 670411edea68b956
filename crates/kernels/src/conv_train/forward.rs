//! Convolution.

use super::operands;
use super::planes::{Layout, Source, Tap};
use super::sweep::{Output, Pass, pack_weights, sweep};
use super::{ConvShape, Part, check_parts};
use crate::{Isa, ShapeError};

/// Positions of a portion: with 64 channels about 300 KB of scratch.
const POSITIONS: usize = 1100;

impl ConvShape {
    /// The kernel's taps in the order of the weight.
    pub(super) fn taps(&self) -> Vec<Tap> {
        let s = self.stride;
        let tap = |y: usize, x: usize| Tap { plane: [y % s, x % s], row: y / s, column: x / s };
        (0..self.kernel).flat_map(|y| (0..self.kernel).map(move |x| tap(y, x))).collect()
    }

    /// The scratch for reading this convolution's input.
    pub(super) fn layout(&self, source: &Source<'_>, positions: usize) -> Layout {
        let out = [self.out_height(), self.out_width()];
        Layout::new(
            self.batch,
            source,
            out,
            self.stride,
            self.padding,
            (self.kernel - 1) / self.stride,
            positions,
        )
    }

    pub(super) fn source<'a>(&self, parts: &'a [Part<'a>]) -> Source<'a> {
        Source { parts, channels: self.inputs, height: self.height, width: self.width }
    }
}

/// The convolution of an input given in parts.
///
/// # Shapes
/// `weight`: `[outputs, inputs, kernel, kernel]`, inputs in the order of the parts; `bias`: `[outputs]`;
/// result: `[batch, outputs, out_height, out_width]`
///
/// # Errors
/// When a slice does not have the values that `shape` implies, or `shape` has no output.
pub fn forward(
    isa: Isa,
    shape: &ConvShape,
    parts: &[Part<'_>],
    weight: &[f32],
    bias: Option<&[f32]>,
) -> Result<Vec<f32>, ShapeError> {
    shape.check()?;
    check_parts(shape, parts)?;
    ShapeError::check("weights", shape.weight_len(), weight.len())?;
    ShapeError::check("biases", shape.outputs, bias.map_or(shape.outputs, <[f32]>::len))?;
    let source = shape.source(parts);
    let layout = shape.layout(&source, POSITIONS);
    let taps = shape.taps();
    let offsets = layout.offsets(operands::groups(isa, shape.inputs), &taps);
    let weights = pack_weights(isa, [shape.outputs, shape.inputs, taps.len()], |o, i, tap| {
        weight[(o * shape.inputs + i) * taps.len() + tap]
    });
    let pass = Pass { offsets, weights, phase: [0, 0] };
    let output = Output {
        channels: shape.outputs,
        height: shape.out_height(),
        width: shape.out_width(),
        step: 1,
        bias,
    };
    Ok(sweep(isa, shape.batch, &layout, &source, &[pass], &output))
}
