//! Means of weights. Single steps of a run stray about what they all circle; their mean does not, and is the better network of
//! the two (Izmailov et al., 2018, "Averaging Weights Leads to Wider Optima and Better Generalization"). So is, on what is unlike
//! the data, the mean of a network and of what it has become by further training (Wortsman et al., 2022, "Robust Fine-Tuning
//! of Zero-Shot Models").

use std::collections::VecDeque;

use burn::module::{Module, ModuleMapper, ModuleVisitor, Param};
use burn::tensor::Tensor;
use where2act_model::{ModelConfig, Network};

use crate::start::difference;

/// Why networks have no mean.
#[derive(Debug, thiserror::Error)]
pub enum MeanError {
    /// There are none.
    #[error("expected networks, found none")]
    Empty,
    /// They differ in more than their weights, their names and how they are shown what they see.
    #[error("expected networks that differ in their weights alone, found {field} {first} and {second}")]
    Different {
        /// In what.
        field: String,
        /// What it is in one of them.
        first: String,
        /// What it is in the last.
        second: String,
    },
}

/// The mean of the weights and running statistics of some networks, number by number, described as the last of them is.
///
/// # Errors
/// [`MeanError`].
pub fn mean(networks: Vec<Network>) -> Result<Network, MeanError> {
    let last = networks.last().ok_or(MeanError::Empty)?.config().clone();
    let comparable = |network: &Network| ModelConfig {
        name: last.name.clone(),
        preprocessing: last.preprocessing.clone(),
        ..network.config().clone()
    };
    if let Some([field, first, second]) =
        networks.iter().find_map(|network| difference(&comparable(network), &last))
    {
        return Err(MeanError::Different { field, first, second });
    }
    let mut networks = networks.into_iter().rev();
    let mut mean = networks.next().ok_or(MeanError::Empty)?;
    for (count, network) in (2u32..).zip(networks) {
        mean = towards(mean, &network, 1.0 / f64::from(count));
    }
    Ok(mean)
}

/// Takes the mean a step towards the newest weights: `mean + share * (newest - mean)`, of running statistics as well. Both
/// without gradients.
#[must_use]
pub(crate) fn towards<M: Module>(mean: M, newest: &M, share: f64) -> M {
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
    use where2act_model::Modality;

    use crate::config::LossConfig;
    use crate::probes::Learner;
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

    #[test]
    fn a_mean_counts_every_network_alike_and_there_is_none_of_different_ones() {
        let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(64);
        let of = |config: &ModelConfig, seed| Network::new(config, Seed(seed), &Device::flex());
        let scores = |network: &Network| floats(network.heads.score.mlp1.linear.weight.val());
        let networks: Vec<Network> = (1..=3).map(|seed| of(&config, seed)).collect();
        let found = scores(&mean(networks.clone()).unwrap());
        for (i, found) in found.into_iter().enumerate() {
            let sum: f32 = networks.iter().map(|network| scores(network)[i]).sum();
            assert!((found - sum / 3.0).abs() < 1e-6);
        }
        let wider = ModelConfig { hidden: config.hidden + 1, ..config.clone() };
        let error = mean(vec![of(&config, 1), of(&wider, 1)]).expect_err("of two sizes").to_string();
        assert!(error.contains(&format!("hidden {} and {}", config.hidden, wider.hidden)), "{error}");
        assert!(matches!(mean(Vec::new()), Err(MeanError::Empty)));
    }
}
