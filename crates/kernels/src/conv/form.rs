//! The ways to compute a convolution, and what each makes of a picture.

use crate::winograd::{F23, F32, F43, Winograd};

/// How a convolution is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Any square kernel: the window of each output pixel is gathered, then multiplied.
    Direct {
        /// Side of the kernel.
        size: usize,
        /// Step between output pixels.
        stride: usize,
        /// Zeros around the input.
        pad: usize,
    },
    /// 3x3, stride 1, padding 1 by F(2x2, 3x3).
    Winograd2,
    /// 3x3, stride 1, padding 1 by F(4x4, 3x3).
    Winograd4,
    /// Nearest 2x upsampling, then 3x3 with padding 1, as four direct 2x2 convolutions on the small picture,
    /// one for each parity of output pixels.
    UpDirect,
    /// The same with one F(3x3, 2x2) whose output channels are those of all four.
    UpWinograd,
}

/// What a convolution reads: channels of one map of the same size as the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// So many channels.
    Plain(usize),
    /// So many channels of a picture of twice the size, given as four times as many channels of a quarter of
    /// the pixels: channel 4 c + 2 (y mod 2) + x mod 2 ([`Form::UpWinograd`] only). They are not upsampled.
    Split(usize),
}

impl Source {
    /// Channels of the weights.
    pub fn channels(self) -> usize {
        match self {
            Self::Plain(c) | Self::Split(c) => c,
        }
    }
    /// Channels of the map.
    pub(super) fn stored(self) -> usize {
        match self {
            Self::Plain(c) => c,
            Self::Split(c) => 4 * c,
        }
    }
}

impl Form {
    /// Side of the kernel in the weights.
    pub fn kernel(self) -> usize {
        if let Self::Direct { size, .. } = self { size } else { 3 }
    }

    /// Height and width of the result.
    pub fn output_size(self, (height, width): (usize, usize)) -> (usize, usize) {
        match self {
            Self::Direct { size, stride, pad } => {
                let side = |n: usize| (n + 2 * pad).checked_sub(size).map_or(0, |n| n / stride + 1);
                (side(height), side(width))
            }
            Self::Winograd2 | Self::Winograd4 => (height, width),
            Self::UpDirect | Self::UpWinograd => (2 * height, 2 * width),
        }
    }

    /// Rows and columns of tiles, each of which is a row of the matrix product.
    pub(super) fn grid(self, (height, width): (usize, usize)) -> (usize, usize) {
        match self {
            Self::Direct { .. } => self.output_size((height, width)),
            Self::Winograd2 => (height.div_ceil(F23::M), width.div_ceil(F23::M)),
            Self::Winograd4 => (height.div_ceil(F43::M), width.div_ceil(F43::M)),
            Self::UpDirect => (height, width),
            // One more row and column than pixels: the odd parities start one pixel earlier.
            Self::UpWinograd => ((height + 1).div_ceil(F32::M), (width + 1).div_ceil(F32::M)),
        }
    }

    /// Pixels gathered for each row of a product (one where the planes hold a transform of them).
    pub(super) fn taps(self) -> usize {
        match self {
            Self::Direct { size, .. } => size * size,
            Self::UpDirect => 4,
            _ => 1,
        }
    }

    /// Output pixels of a tile along each axis, per phase.
    pub(super) fn tile(self) -> usize {
        match self {
            Self::Direct { .. } | Self::UpDirect => 1,
            Self::Winograd2 => F23::M,
            Self::Winograd4 => F43::M,
            Self::UpWinograd => F32::M,
        }
    }
}

/// Of the two rows that an output row of parity `parity` sees on the small picture, the one under row `k` of
/// the 3x3 kernel.
pub(super) fn tap_of(parity: usize, k: usize) -> usize {
    if parity == 0 { k.div_ceil(2) } else { k / 2 }
}
