//! Which orientations to try: a conditional variational auto-encoder (Sohn et al., 2015).

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use super::{Choice, SplitLinear};
use crate::config::ModelConfig;
use crate::layers::{leaky, linear};

/// A normal distribution over the code z, independent in each number.
#[derive(Clone, Debug)]
pub struct Code {
    /// `[q, latent]`.
    pub mean: Tensor<2>,
    /// Logarithm of the variance, `[q, latent]`.
    pub log_variance: Tensor<2>,
}

impl Code {
    /// A sample that the gradient passes through. `normal` holds standard normal numbers, `[q, latent]`.
    #[must_use]
    pub fn sample(&self, normal: Tensor<2>) -> Tensor<2> {
        self.mean.clone() + normal * self.log_variance.clone().mul_scalar(0.5).exp()
    }
}

/// Decoder for prediction, encoder for training.
#[derive(Module, Debug)]
pub struct ProposalHead {
    /// (feature, z) -> orientation.
    pub decoder: ProposalDecoder,
    /// (feature, orientation) -> distribution of z.
    pub encoder: ProposalEncoder,
}

/// (feature, z) -> one orientation per primitive: six numbers that [`super::to_axes`] makes orthonormal.
#[derive(Module, Debug)]
pub struct ProposalDecoder {
    /// Weight `[features + latent, hidden]`.
    pub mlp1: SplitLinear,
    /// Weight `[hidden, primitives * 6]`.
    pub mlp2: Linear,
}

/// (feature, orientation) -> distribution of z, one per primitive.
#[derive(Module, Debug)]
pub struct ProposalEncoder {
    /// Weight `[features + 6, hidden]`.
    pub mlp1: SplitLinear,
    /// Weight `[hidden, primitives * latent]`.
    pub mean: Linear,
    /// Weight `[hidden, primitives * latent]`.
    pub log_variance: Linear,
}

impl ProposalHead {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        let (outputs, hidden, latent) = (config.primitives.len(), config.hidden, config.latent);
        Self {
            decoder: ProposalDecoder {
                mlp1: SplitLinear::new(config.features, latent, hidden, device),
                mlp2: linear(hidden, outputs * 6, true, device),
            },
            encoder: ProposalEncoder {
                mlp1: SplitLinear::new(config.features, 6, hidden, device),
                mean: linear(hidden, outputs * latent, true, device),
                log_variance: linear(hidden, outputs * latent, true, device),
            },
        }
    }

    /// The code's distribution for the primitive each query is about.
    ///
    /// # Shapes
    /// - `features`: `[q, features]`
    /// - `orientations`: `[q, 6]`
    #[must_use]
    pub fn encode(&self, features: Tensor<2>, orientations: Tensor<2>, choice: &Choice) -> Code {
        let mlp1 = &self.encoder.mlp1;
        let hidden = leaky(mlp1.feature_half(features) + mlp1.other_half(orientations));
        let pick = |all: Tensor<2>| {
            let [q, n] = all.dims();
            choice.pick_rows(all.reshape([q, choice.outputs, n / choice.outputs]))
        };
        let mean = pick(self.encoder.mean.forward(hidden.clone()));
        Code { mean, log_variance: pick(self.encoder.log_variance.forward(hidden)) }
    }

    /// Raw orientations for every primitive; [`super::to_axes`] makes them orthonormal.
    ///
    /// # Shapes
    /// - `features`: `[q, features]`
    /// - `z`: `[q, latent]`, standard normal in prediction
    /// - output: `[q, primitives, 6]`
    #[must_use]
    pub fn decode(&self, features: Tensor<2>, z: Tensor<2>) -> Tensor<3> {
        let flat = self.decode_from_halves(self.feature_half(features) + self.code_half(z));
        let [q, n] = flat.dims();
        flat.reshape([q, n / 6, 6])
    }

    /// What the feature adds to the decoder's hidden layer: once per pixel, for any number of codes.
    ///
    /// # Shapes
    /// `[n, features]` -> `[n, hidden]`
    #[must_use]
    pub fn feature_half(&self, features: Tensor<2>) -> Tensor<2> {
        self.decoder.mlp1.feature_half(features)
    }

    /// What the code adds to the decoder's hidden layer.
    ///
    /// # Shapes
    /// `[n, latent]` -> `[n, hidden]`
    #[must_use]
    pub fn code_half(&self, z: Tensor<2>) -> Tensor<2> {
        self.decoder.mlp1.other_half(z)
    }

    /// Raw orientations from the sum of both halves, broadcast as the caller likes.
    ///
    /// # Shapes
    /// `[.., hidden]` -> `[.., primitives * 6]`
    #[must_use]
    pub fn decode_from_halves<const D: usize>(&self, sum: Tensor<D>) -> Tensor<D> {
        self.decoder.mlp2.forward(leaky(sum))
    }
}
