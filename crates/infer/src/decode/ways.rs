//! What the ways a point can go add to the scores of hands there: see [`where2act_model::MotionHead`].

use where2act_kernels::{Isa, Mlp};
use where2act_model::{Heads, LinearLayer, ModelConfig, MotionHead, intended_axes};

use super::heads::{AXES, compiled, run};
use crate::Error;

/// The head for ways, compiled.
pub(super) struct Ways {
    /// Feature -> two ways.
    net: Mlp,
    weight: f32,
    /// Of each primitive, where its hands want points to go, in axes of the hand.
    intended: Vec<[f32; 3]>,
}

/// The two ways of a point.
pub(super) type TwoWays = [[f32; 3]; 2];

impl Ways {
    /// `None` if the network has none, or its scores do not heed them.
    pub(super) fn new(
        isa: Isa,
        heads: &Heads,
        config: &ModelConfig,
        last: Option<&LinearLayer>,
    ) -> Result<Option<Self>, Error> {
        let Some(head) = heads.heeded_ways() else { return Ok(None) };
        let net = compiled(isa, &LinearLayer::of(&head.linear).after(last))?;
        let intended = config.primitives.iter().copied().map(intended_axes).collect();
        Ok(Some(Self { net, weight: head.weight(), intended }))
    }

    /// The ways at each of some features.
    pub(super) fn at(&self, features: &[f32]) -> Result<Vec<TwoWays>, Error> {
        let numbers = run(&self.net, features, None)?;
        Ok(numbers.as_chunks().0.as_chunks().0.to_vec())
    }

    /// Adds to the logits of hands at one point, for one output of the heads. `axes` are those of the hands,
    /// `[AXES, n]`.
    pub(super) fn add(&self, ways: &TwoWays, output: usize, axes: &[f32], logits: &mut [f32]) {
        let Some(intended) = self.intended.get(output) else { return };
        let n = axes.len() / AXES;
        let reach = |way: &[f32; 3]| {
            let mut reach = vec![0.0; n];
            let weights = intended.iter().flat_map(|axis| way.iter().map(move |x| axis * x));
            // A primitive wants its points to go along one of the axes: the others weigh nothing.
            for (weight, row) in weights.zip(axes.chunks_exact(n.max(1))).filter(|(weight, _)| *weight != 0.0)
            {
                reach.iter_mut().zip(row).for_each(|(sum, x)| *sum += weight * x);
            }
            reach
        };
        let [forth, back] = ways.each_ref().map(reach);
        for (logit, (a, b)) in logits.iter_mut().zip(forth.into_iter().zip(back)) {
            *logit += self.weight * (a.max(b) - MotionHead::NEUTRAL);
        }
    }
}
