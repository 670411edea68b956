//! A second score for the few proposals that the first one likes, from the scan as the hand sees it.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor};
use where2act_core::Orientation6;
use where2act_kernels::points::{Bounds, Frame};

use super::SplitLinear;
use crate::config::ModelConfig;
use crate::layers::{leaky, linear};
use crate::pointnet::{Grouping, Sizes, Surroundings};

/// What a hand looks at: points of the scan in a box around the contact point, in the hand's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandView {
    /// The box around the contact point, metres; z is the approach.
    pub bounds: Bounds,
    /// Points of it.
    pub points: usize,
}

/// Where the fingers work, and where the whole hand goes. At the start its origin is 15 cm before the contact point and
/// the palm reaches 10 cm to each side along y; sideways it moves by 5 cm.
pub const HAND_VIEWS: [HandView; 2] = [
    HandView { bounds: Bounds { min: [-0.045, -0.07, -0.06], max: [0.045, 0.07, 0.04] }, points: 48 },
    HandView { bounds: Bounds { min: [-0.1, -0.16, -0.2], max: [0.1, 0.16, 0.08] }, points: 48 },
];

/// Feature, hand and what is around the hand -> one logit per primitive. Not in the published network.
///
/// Whether fingers fit behind a handle or the palm meets a frame is plain in the frame of the hand, and hard to tell from
/// a feature that has to serve all hands at once.
#[derive(Module, Debug)]
pub struct SecondLook {
    /// A description of each of the [`HAND_VIEWS`].
    pub views: Surroundings,
    /// Weight `[features + 6 + alignments + 2 * around, hidden]`.
    pub mlp1: SplitLinear,
    /// Weight `[hidden, primitives]`.
    pub mlp2: Linear,
}

impl SecondLook {
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Self {
        let views = Surroundings::new(HAND_VIEWS.len(), &Sizes::new(config.width).around, device);
        let others = 6 + config.alignments + views.channels();
        Self {
            views,
            mlp1: SplitLinear::new(config.features, others, config.hidden, device),
            mlp2: linear(config.hidden, config.primitives.len(), true, device),
        }
    }

    /// Logits.
    ///
    /// # Shapes
    /// - `features`: `[q, features]`
    /// - `hands`: `[q, 6 + alignments]`, of [`super::ScoreHead::hands`]
    /// - `around`: q neighbourhoods for each of [`HAND_VIEWS`], of [`crate::preprocess::CloudInput::hand_views`]
    /// - output: `[q, primitives]`
    #[must_use]
    pub fn forward(&self, features: Tensor<2>, hands: Tensor<2>, around: &[Grouping]) -> Tensor<2> {
        let [q, _] = features.dims();
        let seen = self.views.forward(around, q, &features.device());
        let hidden =
            self.mlp1.feature_half(features) + self.mlp1.other_half(Tensor::cat(vec![hands, seen], 1));
        self.mlp2.forward(leaky(hidden))
    }
}

/// The frame of a hand at a contact point. `orientation` is `[approach, forward]`, orthonormal.
#[must_use]
pub fn hand_frame(point: [f32; 3], orientation: &Orientation6) -> Frame {
    let (z, x) = (orientation.approach(), orientation.forward());
    Frame { origin: point, axes: [x, z.cross(&x), z].map(Into::into) }
}
