//! The paper's network for pictures: a ResNet-18 that looks, and a symmetric decoder that says it for every pixel.

mod decoder;
mod encoder;

use burn::module::Module;
use burn::nn::conv::Conv2d;
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::layers::conv;
#[cfg(all(test, feature = "train", feature = "import"))]
mod tests;

pub use decoder::{Decoder, UpBlock};
pub use encoder::{BasicBlock, Downsample, Encoder};

/// U-Net with a ResNet-18 encoder.
#[derive(Module, Debug)]
pub struct UNet {
    /// ResNet-18 without its classifier, under torchvision's names.
    pub encoder: Encoder,
    /// Five steps from 1/32 of the picture's size back to all of it.
    pub decoder: Decoder,
    /// 1x1 convolution to the features: weight `[features, channels, 1, 1]`.
    pub head: Conv2d,
}

impl UNet {
    /// A network with `channels` at its four levels, all weights zero.
    #[must_use]
    pub fn new(channels: [usize; 4], features: usize, device: &Device) -> Self {
        Self {
            encoder: Encoder::new(channels, device),
            decoder: Decoder::new(channels, device),
            head: conv([channels[0], features], 1, 1, true, device),
        }
    }

    /// Features of every pixel, row by row.
    ///
    /// # Shapes
    /// - `images`: `[b, 3, h, w]`, h and w multiples of 32
    /// - output: `[b, h * w, features]`
    #[must_use]
    pub fn forward(&self, images: Tensor<4>) -> Tensor<3> {
        let y = self.decode(images);
        let [b, c, h, w] = y.dims();
        let rows = y.reshape([b, c, h * w]).swap_dims(1, 2).reshape([b * h * w, c]);
        let features = self.project(rows);
        let [_, f] = features.dims();
        features.reshape([b, h * w, f])
    }

    /// Features at a few pixels only: what training needs, at a small part of the cost of [`Self::forward`].
    ///
    /// # Shapes
    /// - `images`: `[b, 3, h, w]`
    /// - `queries`: q pairs (picture, row-major pixel index)
    /// - output: `[q, features]`
    #[must_use]
    pub fn forward_at(&self, images: Tensor<4>, queries: &[(usize, usize)]) -> Tensor<2> {
        let y = self.decode(images);
        let [b, c, h, w] = y.dims();
        let device = y.device();
        let positions: Vec<i64> = queries
            .iter()
            .flat_map(|&(view, pixel)| {
                (0..c).map(move |channel| (((view * c + channel) * h * w) + pixel) as i64)
            })
            .collect();
        let positions = Tensor::<1, Int>::from_data(TensorData::new(positions, [queries.len() * c]), &device);
        self.project(y.reshape([b * c * h * w]).select(0, positions).reshape([queries.len(), c]))
    }

    /// The decoder's last activation, `[b, channels[0], h, w]`.
    fn decode(&self, images: Tensor<4>) -> Tensor<4> {
        let skips = self.encoder.forward(images.clone());
        self.decoder.forward(skips, images)
    }

    /// The 1x1 convolution on rows: `[rows, channels[0]]` -> `[rows, features]`.
    fn project(&self, rows: Tensor<2>) -> Tensor<2> {
        let weight = self.head.weight.val();
        let [features, channels, _, _] = weight.dims();
        let y = rows.matmul(weight.reshape([features, channels]).transpose());
        match &self.head.bias {
            Some(bias) => y + bias.val().reshape([1, features]),
            None => y,
        }
    }
}
