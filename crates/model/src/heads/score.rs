//! How likely an orientation is to succeed.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use super::SplitLinear;
use crate::config::ModelConfig;
use crate::layers::{leaky, linear};

/// Feature and orientation -> one logit per primitive.
#[derive(Module, Debug)]
pub struct ScoreHead {
    /// Weight `[features + 6, hidden]`.
    pub mlp1: SplitLinear,
    /// Weight `[hidden, primitives]`.
    pub mlp2: Linear,
}

impl ScoreHead {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        Self {
            mlp1: SplitLinear::new(config.features, 6, config.hidden, device),
            mlp2: linear(config.hidden, config.primitives.len(), true, device),
        }
    }

    /// Logits.
    ///
    /// # Shapes
    /// - `features`: `[q, features]`
    /// - `orientations`: `[q, 6]`, orthonormal axes `[approach, forward]`
    /// - output: `[q, primitives]`
    #[must_use]
    pub fn forward(&self, features: Tensor<2>, orientations: Tensor<2>) -> Tensor<2> {
        self.from_halves(self.feature_half(features) + self.orientation_half(orientations))
    }

    /// What the feature adds to the hidden layer: once per pixel, for any number of orientations.
    ///
    /// # Shapes
    /// `[n, features]` -> `[n, hidden]`
    #[must_use]
    pub fn feature_half(&self, features: Tensor<2>) -> Tensor<2> {
        self.mlp1.feature_half(features)
    }

    /// What the orientation adds to the hidden layer.
    ///
    /// # Shapes
    /// `[n, 6]` -> `[n, hidden]`
    #[must_use]
    pub fn orientation_half(&self, orientations: Tensor<2>) -> Tensor<2> {
        self.mlp1.other_half(orientations)
    }

    /// Logits from the sum of both halves, broadcast as the caller likes.
    ///
    /// # Shapes
    /// `[.., hidden]` -> `[.., primitives]`
    #[must_use]
    pub fn from_halves<const D: usize>(&self, sum: Tensor<D>) -> Tensor<D> {
        self.mlp2.forward(leaky(sum))
    }
}
