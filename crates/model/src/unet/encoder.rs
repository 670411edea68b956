//! ResNet-18 (He et al., 2016) without its classifier.

use burn::module::Module;
use burn::nn::BatchNorm;
use burn::nn::conv::Conv2d;
use burn::tensor::module::max_pool2d;
use burn::tensor::ops::MaxPoolOptions;
use burn::tensor::{Device, Tensor};

use crate::layers::{After, conv, conv_norm, norm};

/// Two 3x3 convolutions and a way around them.
#[derive(Module, Debug)]
pub struct BasicBlock {
    /// `[out, in, 3, 3]`, may have stride 2.
    pub conv1: Conv2d,
    /// After the first convolution.
    pub bn1: BatchNorm,
    /// `[out, out, 3, 3]`.
    pub conv2: Conv2d,
    /// After the second convolution.
    pub bn2: BatchNorm,
    /// On the way around, where size or channels change.
    pub downsample: Option<Downsample>,
}

/// 1x1 convolution that fits the way around to the block's output.
#[derive(Module, Debug)]
pub struct Downsample {
    /// `[out, in, 1, 1]`.
    pub conv: Conv2d,
    /// After it.
    pub bn: BatchNorm,
}

impl BasicBlock {
    fn new([input, output]: [usize; 2], stride: usize, device: &Device) -> Self {
        Self {
            conv1: conv([input, output], 3, stride, false, device),
            bn1: norm(output, device),
            conv2: conv([output, output], 3, 1, false, device),
            bn2: norm(output, device),
            downsample: (stride != 1 || input != output).then(|| Downsample {
                conv: conv([input, output], 1, stride, false, device),
                bn: norm(output, device),
            }),
        }
    }

    /// # Shapes
    /// `[b, in, h, w]` -> `[b, out, h / stride, w / stride]`
    fn forward(&self, x: Tensor<4>) -> Tensor<4> {
        let around = match &self.downsample {
            Some(d) => conv_norm(&d.conv, &d.bn, x.clone(), After::Identity),
            None => x.clone(),
        };
        let y = conv_norm(&self.conv1, &self.bn1, x, After::Relu);
        conv_norm(&self.conv2, &self.bn2, y, After::AddRelu(around))
    }
}

/// The encoder, under torchvision's parameter names.
#[derive(Module, Debug)]
pub struct Encoder {
    /// `[channels[0], 3, 7, 7]`, stride 2.
    pub conv1: Conv2d,
    /// After it.
    pub bn1: BatchNorm,
    /// 1/4 of the size.
    pub layer1: Vec<BasicBlock>,
    /// 1/8 of the size.
    pub layer2: Vec<BasicBlock>,
    /// 1/16 of the size.
    pub layer3: Vec<BasicBlock>,
    /// 1/32 of the size.
    pub layer4: Vec<BasicBlock>,
}

impl Encoder {
    pub(crate) fn new(c: [usize; 4], device: &Device) -> Self {
        let layer = |input, output, stride| {
            vec![
                BasicBlock::new([input, output], stride, device),
                BasicBlock::new([output, output], 1, device),
            ]
        };
        Self {
            conv1: conv([3, c[0]], 7, 2, false, device),
            bn1: norm(c[0], device),
            layer1: layer(c[0], c[0], 1),
            layer2: layer(c[0], c[1], 2),
            layer3: layer(c[1], c[2], 2),
            layer4: layer(c[2], c[3], 2),
        }
    }

    /// Activations at 1/2, 1/4, 1/8, 1/16 and 1/32 of the size.
    ///
    /// # Shapes
    /// `[b, 3, h, w]` -> five times `[b, c, h / 2^i, w / 2^i]`
    #[must_use]
    pub fn forward(&self, images: Tensor<4>) -> [Tensor<4>; 5] {
        let run = |layer: &[BasicBlock], x: Tensor<4>| layer.iter().fold(x, |x, block| block.forward(x));
        let x0 = conv_norm(&self.conv1, &self.bn1, images, After::Relu);
        let pool = MaxPoolOptions::new([3, 3]).with_stride([2, 2]).with_padding([1, 1]);
        let x1 = run(&self.layer1, max_pool2d(x0.clone(), pool));
        let x2 = run(&self.layer2, x1.clone());
        let x3 = run(&self.layer3, x2.clone());
        let x4 = run(&self.layer4, x3.clone());
        [x0, x1, x2, x3, x4]
    }
}
