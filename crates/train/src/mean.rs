//! The running mean of the weights along a run. Single steps stray about what they all circle; their mean does not, and
//! is the better network of the two (Izmailov et al., 2018, "Averaging Weights Leads to Wider Optima and Better
//! Generalization").

use std::collections::VecDeque;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::Tensor;

use crate::probes::Learner;

/// Takes the mean a step towards the newest weights: `mean + share * (newest - mean)`, of running statistics as well. Both
/// without gradients.
#[must_use]
pub(crate) fn towards(mean: Learner, newest: &Learner, share: f64) -> Learner {
    let mut weights = Weights::default();
    newest.visit(&mut weights);
    mean.map(&mut Towards { newest: weights.0, share })
}

/// All weights and running statistics, flat, in the order in which a module shows them.
#[derive(Default)]
struct Weights(VecDeque<Tensor<1>>);

impl ModuleVisitor for Weights {
    fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
        let weights = param.val();
        let count = weights.shape().num_elements();
        self.0.push_back(weights.reshape([count]));
    }
}

struct Towards {
    newest: VecDeque<Tensor<1>>,
    share: f64,
}

impl ModuleMapper for Towards {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        let Some(newest) = self.newest.pop_front() else { return param };
        param.map(|mean| {
            let newest = newest.reshape(mean.dims());
            mean.clone() + (newest - mean) * self.share
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use where2act_core::{Primitive, Seed};
    use where2act_model::{Modality, ModelConfig, Network};

    use crate::config::LossConfig;
    use crate::step::floats;

    #[test]
    fn every_weight_and_running_statistic_goes_the_same_share_of_its_way() {
        let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(64);
        let loss = LossConfig { normal: 1.0, ..LossConfig::default() };
        let learner =
            |seed| Learner::new(Network::new(&config, Seed(seed), &Device::flex()), &loss, Seed(seed));
        let flat = |learner: &Learner| {
            let mut weights = Weights::default();
            learner.visit(&mut weights);
            weights.0.into_iter().flat_map(floats).collect::<Vec<f32>>()
        };
        struct Plus(f64);
        impl ModuleMapper for Plus {
            fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
                param.map(|weights| weights + self.0)
            }
        }
        let (first, second) = (learner(1), learner(2).map(&mut Plus(0.5)));
        let (a, b) = (flat(&first), flat(&second));
        let mean = flat(&towards(first, &second, 0.25));
        assert!(a.len() == mean.len() && a.len() > config.features);
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() > 1e-9));
        for ((a, b), mean) in a.iter().zip(&b).zip(&mean) {
            assert!((mean - (0.75 * a + 0.25 * b)).abs() < 1e-6, "{a} {b} {mean}");
        }
        assert_eq!(flat(&second), b);
    }
}
