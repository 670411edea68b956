//! Which ways a point can go, and what that says about a hand there.

use burn::module::Module;
use burn::nn::Linear;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Point3, Rotation3};
use where2act_core::{Grasp, Primitive};

use super::rotation::cross;
use crate::config::ModelConfig;
use crate::layers::linear;

/// Numbers that the two ways of a point are: two vectors.
const WAYS: usize = 6;

/// Feature -> the two ways its point can go, camera frame: of length 1, shorter where a turning part has little leverage,
/// zero where it is blocked. Not in the published network.
///
/// It learns from what scenes know, not from trials, and so from many more objects than the scores do. The best score of
/// thousands is often one that is wrong; whether the joint gives where the hand wants to go is an opinion from another source,
/// and is added to it (`weights/EXPERIMENTS.md` has what that is worth). The answer is linear in the feature, as the score's alignments are, so that it
/// stands in the features as these need it.
#[derive(Module, Debug)]
pub struct MotionHead {
    /// Weight `[features, 6]`.
    pub linear: Linear,
    /// [`ModelConfig::ways`].
    #[module(skip)]
    weight: f32,
    /// Of each primitive, [`intended_axes`].
    #[module(skip)]
    intended: Vec<[f32; 3]>,
}

/// The weights of a hand's approach, forward and left axes whose sum is where the primitive wants the point to go.
#[must_use]
pub fn intended_axes(primitive: Primitive) -> [f32; 3] {
    let hand = Grasp { point: Point3::origin(), rotation: Rotation3::identity() };
    let direction = primitive.intended_direction(&hand);
    [hand.approach(), hand.forward(), hand.left()].map(|axis| axis.dot(&direction))
}

impl MotionHead {
    /// How far the better way must reach for a score to stay as it is: half of a free way.
    pub const NEUTRAL: f32 = 0.5;

    /// `None` if the network has none.
    pub(crate) fn new(config: &ModelConfig, device: &Device) -> Option<Self> {
        let linear = linear(config.features, WAYS, true, device);
        let intended: Vec<_> = config.primitives.iter().copied().map(intended_axes).collect();
        config.ways.map(|weight| Self { linear, weight, intended })
    }

    /// # Shapes
    /// `[q, features]` -> `[q, 6]`
    #[must_use]
    pub fn ways(&self, features: Tensor<2>) -> Tensor<2> {
        self.linear.forward(features)
    }

    /// What is added to the logits of hands: nothing if the better way reaches half as far in the intended direction as a
    /// free one, half the weight if it reaches all the way.
    ///
    /// # Shapes
    /// features `[n, features]`, orthonormal axes `[n, each, 6]` -> `[n * each, primitives]`
    #[must_use]
    pub fn gain(&self, features: Tensor<2>, orientations: Tensor<3>) -> Tensor<2> {
        let [n, each, _] = orientations.dims();
        let device = features.device();
        let primitives = self.intended.len();
        let axes = orientations.reshape([n * each, 6]);
        let left = cross(&axes.clone().narrow(1, 0, 3), &axes.clone().narrow(1, 3, 3));
        // `[n * each, axis, xyz]`, then `[n * each, primitive, xyz]`.
        let axes = Tensor::cat(vec![axes, left], 1).reshape([n * each, 3, 3]);
        let intended =
            Tensor::<2>::from_data(TensorData::new(self.intended.concat(), [primitives, 3]), &device);
        let across = axes.swap_dims(1, 2).reshape([n * each * 3, 3]).matmul(intended.transpose());
        let wanted =
            across.reshape([n * each, 3, primitives]).swap_dims(1, 2).reshape([n, each * primitives, 3]);
        let ways = self.ways(features).reshape([n, 2, 3]);
        let reach = wanted.matmul(ways.transpose()).max_dim(2).reshape([n * each, primitives]);
        (reach - Self::NEUTRAL) * self.weight
    }

    /// Weight of the ways in a score, [`ModelConfig::ways`].
    #[must_use]
    pub const fn weight(&self) -> f32 {
        self.weight
    }
}
