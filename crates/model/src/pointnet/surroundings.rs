//! What is right around a point: the scan at full density, before it is thinned out for the hierarchy.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use super::hierarchy::{Grouping, SURROUNDINGS};
use super::mlp::PointMlp;

/// Sizes of the shared MLPs.
pub(crate) const SIZES: [usize; 3] = [32, 32, 64];
/// Numbers that describe the surroundings of a point.
pub(crate) const CHANNELS: usize = SURROUNDINGS.len() * SIZES[2];

/// For each of the [`SURROUNDINGS`] a shared MLP over the offsets of the scan's points around each point, then their
/// maximum. The hierarchy sees a scan at a spacing of centimetres, which blurs the gap behind a handle; this does not.
#[derive(Module, Debug)]
pub struct Surroundings {
    /// First layers `[3, out]`: the offset.
    pub mlps: Vec<PointMlp>,
}

impl Surroundings {
    pub(crate) fn new(device: &Device) -> Self {
        Self { mlps: SURROUNDINGS.iter().map(|_| PointMlp::new(3, &SIZES, device)).collect() }
    }

    /// Zeros where nobody looked: as far as the network can tell, such points are alone.
    ///
    /// # Shapes
    /// -> `[points, 128]`
    pub(crate) fn forward(&self, around: &[Grouping], points: usize, device: &Device) -> Tensor<2> {
        if around.is_empty() {
            return Tensor::zeros([points, CHANNELS], device);
        }
        let of_one = |(mlp, around): (&PointMlp, &Grouping)| {
            let n = around.offsets.len() / 3;
            let offsets = Tensor::<2>::from_data(TensorData::new(around.offsets.clone(), [n, 3]), device);
            mlp.forward_pooled(|weight| offsets.matmul(weight), around.neighbours)
        };
        Tensor::cat(self.mlps.iter().zip(around).map(of_one).collect(), 1)
    }
}
