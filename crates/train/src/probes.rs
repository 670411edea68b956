//! What scenes know without trials: which ways each point can go, and which way a surface faces. Thousands of trials say little
//! about where a hinge is; the scene knows it, and a backbone that can tell has learnt what all heads need.

use burn::module::Module;
use burn::nn::{Initializer, Linear, LinearConfig};
use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Point3, Vector3};
use where2act_core::shard::Freedom;
use where2act_core::{ImageSize, Pixel, Seed, Verdict};
use where2act_model::{ModelConfig, Network, draw_weights};

use crate::config::LossConfig;

/// What a run trains: the network, and a probe that stays behind when training is over.
#[derive(Module, Debug)]
pub struct Learner {
    /// What predicts.
    pub network: Network,
    /// Feature -> normal of its surface, camera frame; `None` where the configuration does not ask for it.
    pub normal: Option<Probe>,
}

/// A question to the features that has nothing to do with hands.
#[derive(Module, Debug)]
pub struct Probe {
    /// Weight `[features, 3]`.
    pub linear: Linear,
}

/// The ways a point can go, forth and back, in the camera frame: of length 1, shorter where a turning part has little
/// leverage, and zero for a way that is blocked by the joint's limit. Both are zero where nothing moves.
pub type Ways = [Vector3<f32>; 2];

/// Distance from its axis at which a turning part has all the leverage it needs, metres.
const LEVERAGE: f32 = 0.1;

impl Learner {
    /// A network and the probe that a configuration asks for, with weights that depend on the seed alone.
    #[must_use]
    pub fn new(network: Network, loss: &LossConfig, seed: Seed) -> Self {
        let (config, device) = (network.config().clone(), network.device());
        let draw = || draw_weights(Probe::new(&config, &device), seed.child("normal", 0));
        Self { normal: (loss.normal > 0.0).then(draw), network }
    }
}

impl Probe {
    /// A probe for the features of a network, with weights that wait to be drawn.
    fn new(config: &ModelConfig, device: &Device) -> Self {
        let linear = LinearConfig::new(config.features, 3).with_initializer(Initializer::Zeros);
        Self { linear: linear.init(device) }
    }

    /// # Shapes
    /// `[q, features]` -> `[q, 3]`
    #[must_use]
    pub fn forward(&self, features: Tensor<2>) -> Tensor<2> {
        self.linear.forward(features)
    }
}

/// The ways of a point of a movable link.
pub(crate) fn ways(freedom: &Freedom, point: &Point3<f32>) -> Ways {
    let velocity = freedom.velocity(point);
    let way = if freedom.turns { velocity / velocity.norm().max(LEVERAGE) } else { velocity };
    let range = freedom.room.iter().sum();
    let [down, up] = freedom.room.map(|room| if Verdict::is_enough(room, range) { 1.0 } else { 0.0 });
    [-way * down, way * up]
}

/// Pixels to each side whose points span a surface.
const SPAN: u32 = 2;
/// Farthest that these points may be from the surface's own, as a share of its depth: beyond it is another surface.
const SAME_SURFACE: f32 = 0.02;

/// Normal of the surface seen at a pixel of a depth map, towards the camera; `None` at its edges.
/// `point` is what is seen at a pixel, camera frame.
pub(crate) fn normal(
    pixel: Pixel,
    size: ImageSize,
    point: impl Fn(Pixel) -> Option<Point3<f32>>,
) -> Option<Vector3<f32>> {
    let Pixel { u, v } = pixel;
    let inside = u >= SPAN && v >= SPAN && (u + SPAN) < size.width as u32 && (v + SPAN) < size.height as u32;
    let here = inside.then(|| point(pixel))??;
    let near =
        |u: u32, v: u32| point(Pixel { u, v }).filter(|p| (p.z - here.z).abs() < SAME_SURFACE * here.z);
    let (left, right, up, down) =
        (near(u - SPAN, v)?, near(u + SPAN, v)?, near(u, v - SPAN)?, near(u, v + SPAN)?);
    // x right, y down, z forward: down x right looks back at the camera.
    (down - up).cross(&(right - left)).try_normalize(1e-12)
}

/// How much the ways that are thought differ from those that are: the mean squared difference, over many directions,
/// of how far one gets along each by the better way. The order of the ways does not matter to it.
///
/// # Shapes
/// `[q, 6]`, `[q, 6]` -> `[q]`
pub(crate) fn difference(thought: Tensor<2>, true_ways: Tensor<2>) -> Tensor<1> {
    let directions = directions();
    let [q, _] = thought.dims();
    let all = TensorData::new(directions.concat(), [directions.len(), 3]);
    let all = Tensor::<2>::from_data(all, &thought.device()).transpose();
    let reach =
        |ways: Tensor<2>| ways.reshape([2 * q, 3]).matmul(all.clone()).reshape([q, 2, directions.len()]);
    let furthest = |ways: Tensor<2>| reach(ways).max_dim(1).reshape([q, directions.len()]);
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
        let button = Freedom { room: [0.002, 0.006], ..drawer };
        assert_eq!(ways(&button, &Point3::origin()), [Vector3::zeros(), Vector3::z()]);
    }

    #[test]
    fn a_slanted_board_faces_the_camera_and_an_edge_has_no_normal() {
        let size = ImageSize::square(20);
        // A plane z = 2 + x / 2, with a step at u = 15.
        let point = |p: Pixel| {
            let x = (p.u as f32 - 10.0) * 0.01;
            (p.v < 18)
                .then(|| Point3::new(x, p.v as f32 * 0.01, 2.0 + 0.5 * x + if p.u < 15 { 0.0 } else { 1.0 }))
        };
        let at = |u, v| normal(Pixel { u, v }, size, point);
        assert!((at(5, 9).unwrap() - Vector3::new(0.5, 0.0, -1.0).normalize()).norm() < 1e-3);
        assert!([at(1, 9), at(19, 9), at(14, 9), at(5, 17), at(5, 19)].iter().all(Option::is_none));
    }

    #[test]
    fn the_order_of_the_ways_does_not_matter_but_each_way_does() {
        let tensor = |ways: [f32; 6]| Tensor::<1>::from_floats(ways, &Device::flex()).reshape([1, 6]);
        let apart = |a, b| difference(tensor(a), tensor(b)).into_scalar::<f32>();
        let truth = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        assert!(apart([0.0, 0.0, 0.0, 0.0, 0.0, 1.0], truth) < 1e-12);
        for wrong in [[0.0; 6], [0.0, 0.0, 1.0, 0.0, 0.0, -1.0], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]] {
            assert!(apart(wrong, truth) > 0.05, "{wrong:?}");
        }
        assert_eq!(directions().len(), 26);
    }
}
