//! Convolution for training, on planes of f32 as PyTorch and burn lay them out (`[batch, channels, height, width]`):
//! forward, gradient of the input, gradient of the weight.
//!
//! Rows are copied once, zero-padded, into a scratch that fits the second-level cache and is then one long row of
//! positions; a table of offsets, one for each (input channel, tap), turns any kernel size and stride into the same inner
//! loop over positions (`micro`), in bf16 after one more pass over the scratch (`operands`). Which thread does what never changes a sum: results are the same bits for any number.

mod backward;
mod forward;
mod micro;
mod operands;
mod planes;
mod sweep;

pub use backward::{input_gradient, upsampling_gradient, weight_gradient};
pub use forward::forward;

use crate::ShapeError;

/// Output channels computed together; with three vectors of positions they fill the registers of AVX-512.
const CHANNELS: usize = 8;

/// Sizes of a convolution with a square kernel, the same stride and padding on both axes, no dilation and no groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvShape {
    /// Images.
    pub batch: usize,
    /// Input channels.
    pub inputs: usize,
    /// Input rows.
    pub height: usize,
    /// Input columns.
    pub width: usize,
    /// Output channels.
    pub outputs: usize,
    /// Rows and columns of the kernel.
    pub kernel: usize,
    /// Step between windows.
    pub stride: usize,
    /// Zeros around the input.
    pub padding: usize,
}

impl ConvShape {
    /// Whether there is an output: no size is zero and the kernel fits the padded input.
    pub fn is_valid(&self) -> bool {
        let side = self.height.min(self.width);
        [self.batch, self.inputs, side, self.outputs, self.kernel, self.stride].iter().all(|&size| size > 0)
            && self.kernel <= side + 2 * self.padding
    }

    /// Output rows.
    pub fn out_height(&self) -> usize {
        (self.height + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// Output columns.
    pub fn out_width(&self) -> usize {
        (self.width + 2 * self.padding - self.kernel) / self.stride + 1
    }

    /// Values of the input.
    pub fn input_len(&self) -> usize {
        self.batch * self.inputs * self.height * self.width
    }

    /// Values of the output.
    pub fn output_len(&self) -> usize {
        self.batch * self.outputs * self.out_height() * self.out_width()
    }

    /// Values of the weight, `[outputs, inputs, kernel, kernel]`.
    pub fn weight_len(&self) -> usize {
        self.outputs * self.inputs * self.kernel * self.kernel
    }

    fn check(&self) -> Result<(), ShapeError> {
        ShapeError::check("convolution with an output (1 is yes)", 1, usize::from(self.is_valid()))
    }
}

/// A part of the input's channels. Several parts make an input without being copied together.
#[derive(Clone, Copy, Debug)]
pub struct Part<'a> {
    /// `[batch, channels, height, width]`, or half the height and width if `doubled`.
    pub planes: &'a [f32],
    /// Channels of this part.
    pub channels: usize,
    /// Every pixel stands for 2 x 2: nearest upsampling that is never written out. Needs even height and width.
    pub doubled: bool,
}

/// Checks that parts make up the input of a convolution.
fn check_parts(shape: &ConvShape, parts: &[Part<'_>]) -> Result<(), ShapeError> {
    ShapeError::check("input channels", shape.inputs, parts.iter().map(|part| part.channels).sum())?;
    for part in parts {
        let values = shape.batch * part.channels * shape.height * shape.width;
        if part.doubled {
            ShapeError::check("odd rows and columns to double", 0, shape.height % 2 + shape.width % 2)?;
            ShapeError::check("values to double", values / 4, part.planes.len())?;
        } else {
            ShapeError::check("input values", values, part.planes.len())?;
        }
    }
    Ok(())
}
