//! A step up: points get the features of the coarser level around them.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use super::hierarchy::Interpolation;
use super::mlp::PointMlp;
use super::rows;

/// Interpolation of the three nearest coarser points, the finer level's own features beside it, shared MLP.
#[derive(Module, Debug)]
pub struct Propagation {
    /// First layer `[coarse + skip, out]`: the interpolated features, then the finer level's.
    pub mlp: PointMlp,
}

impl Propagation {
    pub(crate) fn new(coarse: usize, skip: usize, sizes: &[usize], device: &Device) -> Self {
        Self { mlp: PointMlp::new(coarse + skip, sizes, device) }
    }

    /// # Shapes
    /// - `coarse`: `[b * m, coarse]`
    /// - `skip`: `[b * n, skip]`
    /// - output: `[b * n, out]`
    pub(crate) fn forward(&self, coarse: Tensor<2>, skip: Tensor<2>, near: &Interpolation) -> Tensor<2> {
        let ([_, c], [_, s]) = (coarse.dims(), skip.dims());
        // Interpolation and the product with the weight commute; the coarser level has fewer rows to multiply.
        self.mlp.forward_with(|weight| {
            let of_coarse = weight.clone().slice(0..c);
            let of_skip = weight.slice(c..c + s);
            interpolated_onto(skip.matmul(of_skip), coarse.matmul(of_coarse), near)
        })
    }
}

/// `base` `[n, c]` plus the weighted sum of three rows of `coarse` `[m, c]` for each of its rows.
fn interpolated_onto(base: Tensor<2>, coarse: Tensor<2>, near: &Interpolation) -> Tensor<2> {
    #[cfg(feature = "train")]
    if let Some(y) = crate::ops::interpolate_onto(&base, &coarse, &near.rows, &near.weights) {
        return y;
    }
    let device = coarse.device();
    let [n, c] = base.dims();
    let weights = Tensor::<3>::from_data(TensorData::new(near.weights.clone(), [n, 3, 1]), &device);
    let three = coarse.select(0, rows(near.rows.clone(), &device)).reshape([n, 3, c]);
    base + (three * weights).sum_dim(1).reshape([n, c])
}
