//! Layers that treat every point alike: one matrix product over all rows of a batch.

use burn::module::Module;
use burn::nn::{BatchNorm, Linear};
use burn::tensor::activation::relu;
use burn::tensor::{Device, Tensor};

use crate::layers::{folded, linear, norm, rows_norm_relu, trains};

/// Linear without bias, batch-norm over rows, ReLU.
#[derive(Module, Debug)]
pub struct MlpLayer {
    /// Weight `[in, out]`.
    pub linear: Linear,
    /// Over the rows.
    pub norm: BatchNorm,
}

impl MlpLayer {
    pub(crate) fn new(inputs: usize, outputs: usize, device: &Device) -> Self {
        Self { linear: linear(inputs, outputs, false, device), norm: norm(outputs, device) }
    }

    /// # Shapes
    /// `[rows, in]` -> `[rows, out]`
    #[must_use]
    pub fn forward(&self, x: Tensor<2>) -> Tensor<2> {
        self.forward_with(|weight| x.matmul(weight))
    }

    /// [`Self::forward_with`], then the greatest of every `neighbours` rows.
    fn forward_pooled(&self, product: impl FnOnce(Tensor<2>) -> Tensor<2>, neighbours: usize) -> Tensor<2> {
        #[cfg(feature = "train")]
        if trains(&self.norm, &self.linear.weight.val()) {
            return train_pooled(&self.norm, product(self.linear.weight.val()), neighbours);
        }
        pooled(self.forward_with(product), neighbours)
    }

    /// The layer for an input that is not there as a matrix: `product` multiplies it by the weight `[in, out]`.
    pub(crate) fn forward_with(&self, product: impl FnOnce(Tensor<2>) -> Tensor<2>) -> Tensor<2> {
        let weight = self.linear.weight.val();
        if trains(&self.norm, &weight) {
            rows_norm_relu(&self.norm, product(weight))
        } else {
            let (scale, shift) = folded(&self.norm);
            relu(product(weight * scale.unsqueeze()) + shift.unsqueeze())
        }
    }
}

/// The greatest of every `neighbours` rows.
fn pooled(x: Tensor<2>, neighbours: usize) -> Tensor<2> {
    let [n, c] = x.dims();
    x.reshape([n / neighbours, neighbours, c]).max_dim(1).reshape([n / neighbours, c])
}

/// Batch-norm with the batch's statistics, ReLU, and the greatest of every `neighbours` rows.
#[cfg(feature = "train")]
fn train_pooled(norm: &BatchNorm, x: Tensor<2>, neighbours: usize) -> Tensor<2> {
    crate::ops::norm_relu_pool(norm, &x, neighbours)
        .unwrap_or_else(|| pooled(rows_norm_relu(norm, x), neighbours))
}

/// Several of them.
#[derive(Module, Debug)]
pub struct PointMlp {
    /// In order.
    pub layers: Vec<MlpLayer>,
}

impl PointMlp {
    pub(crate) fn new(inputs: usize, sizes: &[usize], device: &Device) -> Self {
        let before = std::iter::once(&inputs).chain(sizes);
        Self { layers: before.zip(sizes).map(|(i, o)| MlpLayer::new(*i, *o, device)).collect() }
    }

    /// Numbers that come out of the last layer.
    pub(crate) fn outputs(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.linear.weight.dims()[1])
    }

    /// All layers, the first as [`MlpLayer::forward_with`].
    pub(crate) fn forward_with(&self, product: impl FnOnce(Tensor<2>) -> Tensor<2>) -> Tensor<2> {
        let first = self.layers[0].forward_with(product);
        self.layers[1..].iter().fold(first, |x, layer| layer.forward(x))
    }

    /// All layers (at least two), the first as [`MlpLayer::forward_with`], then the greatest of every `neighbours` rows.
    ///
    /// # Shapes
    /// -> `[n / neighbours, out]`
    pub(crate) fn forward_pooled(
        &self,
        product: impl FnOnce(Tensor<2>) -> Tensor<2>,
        neighbours: usize,
    ) -> Tensor<2> {
        let last = self.layers.len() - 1;
        let first = self.layers[0].forward_with(product);
        let x = self.layers[1..last].iter().fold(first, |x, layer| layer.forward(x));
        self.layers[last].forward_pooled(|weight| x.matmul(weight), neighbours)
    }
}
