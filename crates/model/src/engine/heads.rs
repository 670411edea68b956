//! The heads as MLPs over rows.

use where2act_kernels::{Activation, Isa, Mlp, ShapeError};

use super::fold::{Plain, mlp};
use crate::heads::{Heads, SplitLinear};
use crate::layers::LEAK;

/// The heads compiled for one instruction set.
///
/// Score and proposal see a feature beside something else. The feature's half of the hidden layer is computed once
/// per pixel; the other MLP takes the something else and looks that half up:
/// `Lookup { table: halves, rows: pixel of each row, weights: None, each: 1 }`.
#[derive(Clone)]
pub struct EngineHeads {
    /// Feature -> logits, one per primitive.
    pub actionability: Mlp,
    /// Feature -> half of the score's hidden layer.
    pub score_feature: Mlp,
    /// Orientation (6) and the half -> logits, one per primitive.
    pub score: Mlp,
    /// Feature -> half of the proposal's hidden layer.
    pub proposal_feature: Mlp,
    /// Code z and the half -> six raw numbers per primitive.
    pub proposal: Mlp,
}

impl EngineHeads {
    pub(super) fn new(isa: Isa, heads: &Heads) -> Result<Self, ShapeError> {
        let leaky = Activation::Leaky(LEAK as f32);
        let split = |first: &SplitLinear, second: &burn::nn::Linear| {
            let (feature, other) = Plain::linear(&first.linear, leaky).split(first.features);
            let (feature, other) = (feature.padded(), other.padded());
            let hidden = other.bias.len();
            let inputs = other.weights.len() / hidden.max(1);
            let last = Plain::linear(second, Activation::Identity).with_inputs(hidden);
            Ok((mlp(isa, first.features, &[feature])?, mlp(isa, inputs, &[other, last])?))
        };
        let act = &heads.actionability;
        let [features, _] = act.mlp1.weight.dims();
        let layers = [Plain::linear(&act.mlp1, leaky), Plain::linear(&act.mlp2, Activation::Identity)];
        let (score_feature, score) = split(&heads.score.mlp1, &heads.score.mlp2)?;
        let (proposal_feature, proposal) = split(&heads.proposal.decoder.mlp1, &heads.proposal.decoder.mlp2)?;
        Ok(Self {
            actionability: mlp(isa, features, &layers)?,
            score_feature,
            score,
            proposal_feature,
            proposal,
        })
    }
}
