//! How actionable a pixel is.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use crate::config::ModelConfig;
use crate::layers::{leaky, linear};

/// Feature -> one logit per primitive; its sigmoid is the mean score to expect from good proposals there.
#[derive(Module, Debug)]
pub struct ActionabilityHead {
    /// Weight `[features, hidden]`.
    pub mlp1: Linear,
    /// Weight `[hidden, primitives]`.
    pub mlp2: Linear,
}

impl ActionabilityHead {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        let hidden = config.hidden_of_actionability();
        Self {
            mlp1: linear(config.features, hidden, true, device),
            mlp2: linear(hidden, config.primitives.len(), true, device),
        }
    }

    /// Logits.
    ///
    /// # Shapes
    /// `[q, features]` -> `[q, primitives]`
    #[must_use]
    pub fn forward(&self, features: Tensor<2>) -> Tensor<2> {
        self.mlp2.forward(leaky(self.mlp1.forward(features)))
    }
}
