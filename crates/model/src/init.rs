//! First weights: a function of the seed and of each parameter's name, so that they are the same on every device.

use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Tensor, TensorData};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use where2act_core::Seed;

use crate::weights::names::Path;

/// Draws every weight: convolutions as torchvision's ResNet does (normal, variance 2 / fan-out), linear layers as
/// PyTorch does (uniform within 1 / sqrt(inputs)). Batch-norms stay as they are. The numbers depend on the seed and on
/// the parameters' names alone.
#[must_use]
pub fn draw_weights<M: Module>(module: M, seed: Seed) -> M {
    module.map(&mut Draw { seed, path: Path::default(), inputs: 0 })
}

struct Draw {
    seed: Seed,
    path: Path,
    /// Inputs of the linear layer whose weight came last: its bias comes next and has no shape to tell.
    inputs: usize,
}

impl ModuleMapper for Draw {
    fn enter_module(&mut self, name: &str, container: &str) {
        self.path.enter(name, container);
    }

    fn exit_module(&mut self, _: &str, _: &str) {
        self.path.leave();
    }

    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        if self.path.container() == "BatchNorm" {
            return param;
        }
        let shape = param.lazy_shape().to_vec();
        let count: usize = shape.iter().product();
        let mut rng = self.seed.child(&self.path.name(), 0).rng();
        let values: Vec<f32> = match D {
            4 => {
                self.inputs = shape[1..].iter().product();
                let fan_out = shape[0] * shape[2] * shape[3];
                let deviation = (2.0 / fan_out as f32).sqrt();
                (0..count).map(|_| deviation * normal(&mut rng)).collect()
            }
            _ => {
                if D == 2 {
                    self.inputs = shape[0];
                }
                let bound = 1.0 / (self.inputs.max(1) as f32).sqrt();
                (0..count).map(|_| rng.random_range(-bound..bound)).collect()
            }
        };
        param.map(|old| replace(&old, values))
    }
}

/// A tensor of the same shape, on the same device, tracked or not as before.
pub(crate) fn replace<const D: usize>(old: &Tensor<D>, values: Vec<f32>) -> Tensor<D> {
    let new = Tensor::from_data(TensorData::new(values, old.dims()), &old.device());
    #[cfg(feature = "train")]
    let new = new.set_require_grad(old.is_require_grad());
    new
}

/// A standard normal number (Box and Muller, 1958).
fn normal(rng: &mut ChaCha8Rng) -> f32 {
    let radius = (-2.0 * (1.0 - rng.random::<f32>()).max(f32::MIN_POSITIVE).ln()).sqrt();
    radius * (std::f32::consts::TAU * rng.random::<f32>()).cos()
}
