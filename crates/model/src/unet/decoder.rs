//! The way back up: nearest upsampling, the encoder's activation of that size beside it, two convolutions.

use burn::module::Module;
use burn::nn::BatchNorm;
use burn::nn::conv::Conv2d;
use burn::tensor::{Device, Tensor};

use crate::layers::{After, conv, conv_norm, norm, up_conv_norm};

/// One step up.
#[derive(Module, Debug)]
pub struct UpBlock {
    /// `[out, in + skip, 3, 3]`: upsampled channels first, then the skip's.
    pub conv1: Conv2d,
    /// After the first convolution.
    pub bn1: BatchNorm,
    /// `[out, out, 3, 3]`.
    pub conv2: Conv2d,
    /// After the second convolution.
    pub bn2: BatchNorm,
}

impl UpBlock {
    fn new([input, skip, output]: [usize; 3], device: &Device) -> Self {
        Self {
            conv1: conv([input + skip, output], 3, 1, false, device),
            bn1: norm(output, device),
            conv2: conv([output, output], 3, 1, false, device),
            bn2: norm(output, device),
        }
    }

    /// # Shapes
    /// `[b, in, h, w]` and `[b, skip, 2h, 2w]` -> `[b, out, 2h, 2w]`
    fn forward(&self, x: Tensor<4>, skip: Tensor<4>) -> Tensor<4> {
        let y = up_conv_norm(&self.conv1, &self.bn1, x, skip);
        conv_norm(&self.conv2, &self.bn2, y, After::Relu)
    }
}

/// The decoder.
#[derive(Module, Debug)]
pub struct Decoder {
    /// From 1/32 to 1/16, 1/8, 1/4, 1/2 and the full size; the last one has the picture itself as its skip.
    pub blocks: Vec<UpBlock>,
}

impl Decoder {
    pub(crate) fn new(c: [usize; 4], device: &Device) -> Self {
        let shapes =
            [[c[3], c[2], c[2]], [c[2], c[1], c[1]], [c[1], c[0], c[0]], [c[0], c[0], c[0]], [c[0], 3, c[0]]];
        Self { blocks: shapes.map(|shape| UpBlock::new(shape, device)).into() }
    }

    /// # Shapes
    /// the encoder's five activations and `images` `[b, 3, h, w]` -> `[b, channels[0], h, w]`
    pub(crate) fn forward(&self, [x0, x1, x2, x3, x4]: [Tensor<4>; 5], images: Tensor<4>) -> Tensor<4> {
        self.blocks.iter().zip([x3, x2, x1, x0, images]).fold(x4, |y, (block, skip)| block.forward(y, skip))
    }
}
