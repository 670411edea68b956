//! What training alone asks: which ways each point can go. Thousands of trials say little about where a hinge is; the
//! scene knows it, and a backbone that can tell has learnt what all heads need.

use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::tensor::activation::leaky_relu;
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Point3, Vector3};
use where2act_core::Verdict;
use where2act_core::shard::Freedom;
use where2act_model::{ModelConfig, Network};

/// What a run trains: the network, and a head that stays behind when training is over.
#[derive(Module, Debug)]
pub struct Learner {
    /// What predicts.
    pub network: Network,
    /// Feature -> ways; `None` where the configuration does not ask for it.
    pub motion: Option<MotionHead>,
}

/// Feature -> the two [`Ways`] of its point, in either order.
#[derive(Module, Debug)]
pub struct MotionHead {
    /// Weight `[features, hidden]`.
    pub mlp1: Linear,
    /// Weight `[hidden, 6]`.
    pub mlp2: Linear,
}

/// The ways a point can go, forth and back, in the camera frame: of length 1, shorter where a turning part has little
/// leverage, and zero for a way that is blocked by the joint's limit. Both are zero where nothing moves.
pub type Ways = [Vector3<f32>; 2];

/// Distance from its axis at which a turning part has all the leverage it needs, metres.
const LEVERAGE: f32 = 0.1;

/// Slope of the hidden activation for negative numbers, as in the network's heads.
const LEAK: f64 = 0.01;

impl MotionHead {
    /// A head for the features of a network, with weights that wait to be drawn.
    #[must_use]
    pub fn new(config: &ModelConfig, device: &Device) -> Self {
        let linear = |inputs, outputs| {
            LinearConfig::new(inputs, outputs).with_initializer(Initializer::Zeros).init(device)
        };
        Self { mlp1: linear(config.features, config.hidden), mlp2: linear(config.hidden, 6) }
    }

    /// # Shapes
    /// `[q, features]` -> `[q, 2, 3]`
    #[must_use]
    pub fn forward(&self, features: Tensor<2>) -> Tensor<3> {
        let [q, _] = features.dims();
        self.mlp2.forward(leaky_relu(self.mlp1.forward(features), LEAK)).reshape([q, 2, 3])
    }
}

/// The ways of a point of a movable link.
pub(crate) fn ways(freedom: &Freedom, point: &Point3<f32>) -> Ways {
    let velocity = freedom.velocity(point);
    let way = if freedom.turns { velocity / velocity.norm().max(LEVERAGE) } else { velocity };
    let [down, up] = freedom.room.map(|room| if room > Verdict::MIN_JOINT_MOTION { 1.0 } else { 0.0 });
    [-way * down, way * up]
}

/// How much the ways that are thought differ from those that are: the mean squared difference, over many directions,
/// of how far one gets along each by the better way. The order of the ways does not matter to it.
///
/// # Shapes
/// `[q, 2, 3]`, `[q, 2, 3]` -> `[q]`
pub(crate) fn difference(thought: Tensor<3>, true_ways: Tensor<3>) -> Tensor<1> {
    let directions = directions();
    let [q, _, _] = thought.dims();
    let all = TensorData::new(directions.concat(), [directions.len(), 3]);
    let all = Tensor::<2>::from_data(all, &thought.device()).transpose();
    let reach =
        |ways: Tensor<3>| ways.reshape([2 * q, 3]).matmul(all.clone()).reshape([q, 2, directions.len()]);
    let furthest = |ways: Tensor<3>| reach(ways).max_dim(1).reshape([q, directions.len()]);
    (furthest(thought) - furthest(true_ways)).powi_scalar(2).mean_dim(1).reshape([q])
}

/// Towards the faces, edges and corners of a cube.
fn directions() -> Vec<[f32; 3]> {
    let step = |i: usize| (i % 3) as f32 - 1.0;
    let all = (0..27).map(|i| Vector3::new(step(i), step(i / 3), step(i / 9)));
    all.filter_map(|v| v.try_normalize(0.5)).map(Into::into).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_closed_door_opens_and_a_hinge_has_no_leverage() {
        let door =
            Freedom { turns: true, axis: Vector3::z_axis(), point: Point3::origin(), room: [0.0, 1.5] };
        let [shut, open] = ways(&door, &Point3::new(0.5, 0.0, 0.3));
        assert!(shut == Vector3::zeros() && (open - Vector3::y()).norm() < 1e-6);
        let [_, hinge] = ways(&door, &Point3::new(0.01, 0.0, 0.3));
        assert!((hinge - Vector3::y() * 0.1).norm() < 1e-6);
        let drawer = Freedom { turns: false, room: [0.2, 0.1], ..door };
        assert_eq!(ways(&drawer, &Point3::new(9.0, 9.0, 9.0)), [-Vector3::z(), Vector3::z()]);
    }

    #[test]
    fn the_order_of_the_ways_does_not_matter_but_each_way_does() {
        let tensor = |ways: [f32; 6]| Tensor::<1>::from_floats(ways, &Device::flex()).reshape([1, 2, 3]);
        let apart = |a, b| difference(tensor(a), tensor(b)).into_scalar::<f32>();
        let truth = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        assert!(apart([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], truth) < 1e-12);
        for wrong in [[0.0; 6], [0.0, 0.0, 1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]] {
            assert!(apart(wrong, truth) > 0.05, "{wrong:?}");
        }
        assert_eq!(directions().len(), 26);
    }
}
