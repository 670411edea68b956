//! What is right around a point: the scan at full density, before it is thinned out for the hierarchy.

use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};

use super::hierarchy::Grouping;
use super::mlp::PointMlp;

/// For each kind of neighbourhood a shared MLP over the scan's points in it, then their maximum. The hierarchy sees a scan
/// at a spacing of centimetres, which blurs the gap behind a handle; this does not.
#[derive(Module, Debug)]
pub struct Surroundings {
    /// One for each kind of neighbourhood; first layers `[3, out]`: where a point is in it.
    pub mlps: Vec<PointMlp>,
}

impl Surroundings {
    pub(crate) fn new(kinds: usize, sizes: &[usize; 3], device: &Device) -> Self {
        Self { mlps: (0..kinds).map(|_| PointMlp::new(3, sizes, device)).collect() }
    }

    /// Numbers that describe one place.
    pub(crate) fn channels(&self) -> usize {
        self.mlps.iter().map(PointMlp::outputs).sum()
    }

    /// Zeros where nobody looked: as far as the network can tell, such places are alone.
    ///
    /// # Shapes
    /// -> `[places, channels]`
    pub(crate) fn forward(&self, around: &[Grouping], places: usize, device: &Device) -> Tensor<2> {
        if around.is_empty() {
            return Tensor::zeros([places, self.channels()], device);
        }
        let of_one = |(mlp, around): (&PointMlp, &Grouping)| {
            let n = around.offsets.len() / 3;
            let offsets = Tensor::<2>::from_data(TensorData::new(around.offsets.clone(), [n, 3]), device);
            mlp.forward_pooled(|weight| offsets.matmul(weight), around.neighbours)
        };
        Tensor::cat(self.mlps.iter().zip(around).map(of_one).collect(), 1)
    }
}
