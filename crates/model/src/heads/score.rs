//! How likely an orientation is to succeed.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};

use super::SplitLinear;
use super::rotation::cross;
use crate::config::ModelConfig;
use crate::layers::{leaky, linear};

/// Numbers of a hand that an alignment weighs: its approach, forward and left axes.
pub(crate) const ALIGNED: usize = 9;

/// Feature and orientation -> one logit per primitive.
///
/// A hidden layer on the sum of what feature and orientation say is slow to learn how well a hand is aligned with what
/// the feature knows of the joint: that is a product of both. With alignments, the feature says which weights the
/// hand's axes have, and the hidden layer sees their weighted sums beside the orientation.
#[derive(Module, Debug)]
pub struct ScoreHead {
    /// Weight `[features, 9 * alignments]`: of each alignment the weights of approach, forward and left. `None` in the
    /// published network.
    pub align: Option<Linear>,
    /// Weight `[features + 6 + alignments, hidden]`.
    pub mlp1: SplitLinear,
    /// Weight `[hidden, primitives]`.
    pub mlp2: Linear,
}

impl ScoreHead {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        let (features, alignments) = (config.features, config.alignments);
        Self {
            align: (alignments > 0).then(|| linear(features, ALIGNED * alignments, true, device)),
            mlp1: SplitLinear::new(features, 6 + alignments, config.hidden, device),
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
        let hands = self.hands(features.clone(), orientations.unsqueeze_dim(1));
        self.forward_hands(features, hands)
    }

    /// [`Self::forward`] for what [`Self::hands`] made of the orientations.
    ///
    /// # Shapes
    /// - `features`: `[q, features]`
    /// - `hands`: `[q, 6 + alignments]`
    /// - output: `[q, primitives]`
    #[must_use]
    pub fn forward_hands(&self, features: Tensor<2>, hands: Tensor<2>) -> Tensor<2> {
        self.from_halves(self.feature_half(features) + self.hand_half(hands))
    }

    /// Logits of several hands at each place, whose feature enters the hidden layer once.
    ///
    /// # Shapes
    /// `[n, features]`, orthonormal axes `[n, each, 6]` -> `[n * each, primitives]`
    #[must_use]
    pub fn forward_each(&self, features: Tensor<2>, orientations: Tensor<3>) -> Tensor<2> {
        let [n, each, _] = orientations.dims();
        let hands = self.hand_half(self.hands(features.clone(), orientations));
        let [_, hidden] = hands.dims();
        let sum = self.feature_half(features).unsqueeze_dim::<3>(1) + hands.reshape([n, each, hidden]);
        self.from_halves(sum.reshape([n * each, hidden]))
    }

    /// What the hidden layer sees of hands: their orientations and how they are aligned.
    ///
    /// # Shapes
    /// `[n, features]`, orthonormal axes `[n, each, 6]` -> `[n * each, 6 + alignments]`
    #[must_use]
    pub fn hands(&self, features: Tensor<2>, orientations: Tensor<3>) -> Tensor<2> {
        let [n, each, _] = orientations.dims();
        let axes = orientations.reshape([n * each, 6]);
        let Some(align) = &self.align else { return axes };
        let left = cross(&axes.clone().narrow(1, 0, 3), &axes.clone().narrow(1, 3, 3));
        let all = Tensor::cat(vec![axes.clone(), left], 1).reshape([n, each, ALIGNED]);
        let weights = align.forward(features);
        let alignments = weights.dims()[1] / ALIGNED;
        let aligned = all.matmul(weights.reshape([n, alignments, ALIGNED]).transpose());
        Tensor::cat(vec![axes, aligned.reshape([n * each, alignments])], 1)
    }

    /// What the feature adds to the hidden layer: once per pixel, for any number of orientations.
    ///
    /// # Shapes
    /// `[n, features]` -> `[n, hidden]`
    #[must_use]
    pub fn feature_half(&self, features: Tensor<2>) -> Tensor<2> {
        self.mlp1.feature_half(features)
    }

    /// What hands add to the hidden layer.
    ///
    /// # Shapes
    /// `[n, 6 + alignments]`, of [`Self::hands`] -> `[n, hidden]`
    #[must_use]
    pub fn hand_half(&self, hands: Tensor<2>) -> Tensor<2> {
        self.mlp1.other_half(hands)
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
