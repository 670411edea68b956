//! What is said about a pixel or point: how actionable it is, how to act there, and how likely that works.
//!
//! Every head has one hidden layer and one output per primitive of the configuration. Orientations are six numbers,
//! `[approach, forward]`, everywhere.

mod actionability;
mod motion;
mod proposal;
mod rotation;
mod score;
mod second_look;
#[cfg(all(test, feature = "train"))]
mod tests;

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Int, Tensor, TensorData};

use crate::config::ModelConfig;
use crate::layers::linear;
use crate::pointnet::Grouping;
pub use actionability::ActionabilityHead;
pub use motion::{MotionHead, intended_axes};
pub use proposal::{Code, ProposalDecoder, ProposalEncoder, ProposalHead};
pub use rotation::{rotation_matrix, to_axes};
pub(crate) use score::ALIGNED;
pub use score::ScoreHead;
pub use second_look::{HAND_VIEWS, HandView, SecondLook, hand_frame};

/// The heads.
#[derive(Module, Debug)]
pub struct Heads {
    /// Feature -> how actionable.
    pub actionability: ActionabilityHead,
    /// Feature and orientation -> how likely to succeed.
    pub score: ScoreHead,
    /// Feature and random code -> orientation.
    pub proposal: ProposalHead,
    /// How likely the best of them really are to succeed; `None` in the published network.
    pub second_look: Option<SecondLook>,
    /// Which ways a point can go; `None` in the published network.
    pub motion: Option<MotionHead>,
}

impl Heads {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        Self {
            actionability: ActionabilityHead::new(config, device),
            score: ScoreHead::new(config, device),
            proposal: ProposalHead::new(config, device),
            second_look: config.looks_twice().then(|| SecondLook::new(config, device)),
            motion: MotionHead::new(config, device),
        }
    }

    /// The head for ways, if scores heed it.
    #[must_use]
    pub fn heeded_ways(&self) -> Option<&MotionHead> {
        self.motion.as_ref().filter(|head| head.weight() != 0.0)
    }

    /// Logits of a hand at each of some points, by the last score that there is, with what the ways of the points add.
    ///
    /// # Shapes
    /// features `[n, features]`, orthonormal axes `[n, 6]`, what the hands see of a scan if there is a second look, of
    /// [`crate::preprocess::CloudInput::hand_views`] -> `[n, primitives]`
    #[must_use]
    pub fn logits(&self, features: Tensor<2>, orientations: Tensor<2>, hand_views: &[Grouping]) -> Tensor<2> {
        let axes = orientations.unsqueeze_dim(1);
        let hands = self.score.hands(features.clone(), axes.clone());
        let logits = match &self.second_look {
            Some(look) => look.forward(features.clone(), hands, hand_views),
            None => self.score.forward_hands(features.clone(), hands),
        };
        self.with_ways(logits, features, axes)
    }

    /// Logits of a score, first or second, with what the ways of their points add to them.
    ///
    /// # Shapes
    /// logits `[n * each, primitives]`, features `[n, features]`, orthonormal axes `[n, each, 6]` ->
    /// `[n * each, primitives]`
    #[must_use]
    pub fn with_ways(&self, logits: Tensor<2>, features: Tensor<2>, orientations: Tensor<3>) -> Tensor<2> {
        match self.heeded_ways() {
            Some(motion) => logits + motion.gain(features, orientations),
            None => logits,
        }
    }
}

/// Which output of a head concerns each query: the position of its primitive in the configuration's list.
#[derive(Clone, Debug)]
pub struct Choice {
    rows: Tensor<1, Int>,
    outputs: usize,
}

impl Choice {
    /// `positions[i]` is the output that query i asks for, each below `outputs`.
    #[must_use]
    pub fn new(positions: &[usize], outputs: usize, device: &Device) -> Self {
        let rows = positions.iter().enumerate().map(|(i, p)| (i * outputs + (*p).min(outputs - 1)) as i64);
        let rows = TensorData::new(rows.collect::<Vec<_>>(), [positions.len()]);
        Self { rows: Tensor::from_data(rows, device), outputs }
    }

    /// # Shapes
    /// `[q, outputs]` -> `[q]`
    #[must_use]
    pub fn pick(&self, all: Tensor<2>) -> Tensor<1> {
        let [q, outputs] = all.dims();
        debug_assert_eq!(outputs, self.outputs);
        all.reshape([q * outputs]).select(0, self.rows.clone())
    }

    /// # Shapes
    /// `[q, outputs, n]` -> `[q, n]`
    #[must_use]
    pub fn pick_rows(&self, all: Tensor<3>) -> Tensor<2> {
        let [q, outputs, n] = all.dims();
        debug_assert_eq!(outputs, self.outputs);
        all.reshape([q * outputs, n]).select(0, self.rows.clone())
    }
}

/// The first layer of a head whose input is a feature and something else, split so that the feature's half can be
/// computed once for many of the others.
#[derive(Module, Debug)]
pub struct SplitLinear {
    /// Weight `[features + other, hidden]`, bias `[hidden]`.
    pub linear: Linear,
    /// How many of the inputs are the feature.
    pub features: usize,
}

impl SplitLinear {
    pub(crate) fn new(features: usize, other: usize, hidden: usize, device: &Device) -> Self {
        Self { linear: linear(features + other, hidden, true, device), features }
    }

    /// # Shapes
    /// `[n, features]` -> `[n, hidden]`, bias included
    #[must_use]
    pub fn feature_half(&self, features: Tensor<2>) -> Tensor<2> {
        let half = features.matmul(self.linear.weight.val().slice(0..self.features));
        match &self.linear.bias {
            Some(bias) => half + bias.val().unsqueeze(),
            None => half,
        }
    }

    /// # Shapes
    /// `[n, other]` -> `[n, hidden]`
    #[must_use]
    pub fn other_half(&self, other: Tensor<2>) -> Tensor<2> {
        let weight = self.linear.weight.val();
        let [inputs, _] = weight.dims();
        other.matmul(weight.slice(self.features..inputs))
    }
}
