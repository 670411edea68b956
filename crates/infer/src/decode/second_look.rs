//! The second score of the few proposals that the first one likes: see [`where2act_model::SecondLook`].

use where2act_core::Orientation6;
use where2act_kernels::{Activation, Isa, Mlp};
use where2act_model::preprocess::CloudInput;
use where2act_model::{Heads, LinearLayer, ModelConfig, SurroundingsEngine, hand_frame};

use super::heads::{AXES, LEAK, compiled, failed, run};
use super::ways::Ways;
use super::{Scored, sigmoid};
use crate::Error;

/// Hands at each candidate that are looked at again. They are some angle apart, so four are most of what differs.
pub(crate) const LOOKS: usize = 4;

/// The second look, compiled.
pub(crate) struct SecondLook {
    /// Numbers per row of the feature matrix.
    features: usize,
    /// Feature -> weights of the hand's axes, alignment by alignment.
    align: Option<Mlp>,
    around: SurroundingsEngine,
    /// (feature, axes, alignments, surroundings) -> a logit per primitive.
    net: Mlp,
    /// What the ways of the points add to it.
    ways: Option<Ways>,
}

impl SecondLook {
    /// `None` if the network has none.
    pub(super) fn new(
        isa: Isa,
        heads: &Heads,
        config: &ModelConfig,
        last: Option<&LinearLayer>,
    ) -> Result<Option<Self>, Error> {
        let Some(look) = &heads.second_look else { return Ok(None) };
        let first = LinearLayer::of(&look.mlp1.linear).after(last);
        let second = LinearLayer::of(&look.mlp2);
        let layers = [first.followed_by(Activation::Leaky(LEAK)), second.followed_by(Activation::Identity)];
        let align =
            heads.score.align.as_ref().map(|align| compiled(isa, &LinearLayer::of(align).after(last)));
        Ok(Some(Self {
            features: last.map_or(look.mlp1.features, LinearLayer::inputs),
            align: align.transpose()?,
            around: SurroundingsEngine::new(isa, &look.views).map_err(failed)?,
            net: Mlp::new(isa, first.inputs(), &layers).map_err(failed)?,
            ways: Ways::new(isa, heads, config, last)?,
        }))
    }

    /// The same hands with their second scores, for one output of the heads. `rows` are the candidates' rows of the
    /// feature matrix and of the cloud's points.
    pub(crate) fn score(
        &self,
        features: &[f32],
        cloud: &CloudInput,
        rows: &[u32],
        hands: Vec<Scored>,
        output: usize,
    ) -> Result<Vec<Scored>, Error> {
        let n = self.features;
        let row = |hand: &Scored| rows.get(hand.candidate).map_or(0, |&row| row as usize);
        let own = hands.iter().filter_map(|hand| features.get(row(hand) * n..(row(hand) + 1) * n));
        let own: Vec<f32> = own.flatten().copied().collect();
        let orientations: Vec<_> = hands.iter().map(|h| Orientation6::from_rotation(&h.rotation)).collect();
        let weights =
            self.align.as_ref().map(|align| run(align, &own, None)).transpose()?.unwrap_or_default();
        let alignments = weights.len() / hands.len().max(1);
        let points = cloud.xyz.as_chunks().0;
        let mut seen = Vec::new();
        let mut frames = Vec::with_capacity(hands.len());
        for (i, (hand, orientation)) in hands.iter().zip(&orientations).enumerate() {
            let point = points.get(row(hand)).copied().unwrap_or_default();
            let frame = hand_frame(point, orientation);
            let [_, left, _] = frame.axes;
            let axes = orientation.0.into_iter().chain(left);
            seen.extend(own.get(i * n..(i + 1) * n).unwrap_or_default());
            seen.extend(orientation.0);
            let weights = weights.get(i * alignments..(i + 1) * alignments).unwrap_or_default();
            let aligned = |weights: &[f32]| weights.iter().zip(axes.clone()).map(|(w, a)| w * a).sum::<f32>();
            seen.extend(weights.chunks_exact(AXES).map(aligned));
            frames.push(frame);
        }
        let width = seen.len() / hands.len().max(1);
        let rows = self.around.describe(&seen, width, &cloud.hand_views(&frames)).map_err(failed)?;
        let logits = run(&self.net, &rows, None)?;
        let mut of_output: Vec<f32> = logits.into_iter().skip(output).step_by(self.net.outputs()).collect();
        if let Some(head) = &self.ways {
            for ((ways, frame), logit) in head.at(&own)?.iter().zip(&frames).zip(&mut of_output) {
                let [forward, left, approach] = frame.axes;
                head.add(ways, output, &[approach, forward, left].concat(), std::slice::from_mut(logit));
            }
        }
        Ok(hands
            .into_iter()
            .zip(of_output)
            .map(|(hand, logit)| Scored { score: sigmoid(logit), ..hand })
            .collect())
    }
}
