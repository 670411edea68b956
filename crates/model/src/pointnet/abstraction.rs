//! A step down: neighbourhoods become points.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use super::hierarchy::Grouping;
use super::mlp::PointMlp;
use super::rows;

/// Shared MLP over the neighbours of each centre, then their maximum.
#[derive(Module, Debug)]
pub struct Abstraction {
    /// First layer `[3 + in, out]`: the neighbour's offset, then its features.
    pub mlp: PointMlp,
}

impl Abstraction {
    pub(crate) fn new(inputs: usize, sizes: &[usize], device: &Device) -> Self {
        Self { mlp: PointMlp::new(3 + inputs, sizes, device) }
    }

    /// # Shapes
    /// - `features`: `[b * n, in]`
    /// - output: `[b * centres, out]`
    pub(crate) fn forward(&self, features: &Tensor<2>, grouping: &Grouping, device: &Device) -> Tensor<2> {
        let [_, channels] = features.dims();
        let product = |weight: Tensor<2>| {
            let of_offset = weight.clone().slice(0..3);
            // A point is the neighbour of several centres: its product with the weight is computed once, then gathered.
            let of_features = features.clone().matmul(weight.slice(3..3 + channels));
            gathered(&of_features, of_offset, grouping, device)
        };
        self.mlp.forward_pooled(product, grouping.neighbours)
    }
}

/// For every neighbour its offset's product with the weight plus what its point has: `[n, c]`.
fn gathered(features: &Tensor<2>, weight: Tensor<2>, grouping: &Grouping, device: &Device) -> Tensor<2> {
    #[cfg(feature = "train")]
    if let Some(y) = crate::ops::group(features, &weight, &grouping.rows, &grouping.offsets) {
        return y;
    }
    let n = grouping.rows.len();
    let offsets = Tensor::<2>::from_data(TensorData::new(grouping.offsets.clone(), [n, 3]), device);
    offsets.matmul(weight) + features.clone().select(0, rows(grouping.rows.clone(), device))
}
