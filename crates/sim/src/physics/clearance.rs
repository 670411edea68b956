//! What a box in the hand's frame would touch, without a simulation.

use nalgebra::Isometry3;
use rapier3d::geometry::SharedShape;
use rapier3d::math::Pose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::query::intersection_test;

use super::{Shapes, convert, shapes};

/// The pieces of an object at rest, ready to be asked.
pub(crate) struct Clearance {
    pieces: Vec<Piece>,
}

struct Piece {
    link: usize,
    shape: SharedShape,
    pose: Pose,
    bounds: Aabb,
}

impl Clearance {
    pub(crate) fn new(shapes: &Shapes, world_from_links: &[Isometry3<f32>]) -> Self {
        let mut pieces = Vec::new();
        for (link, world_from_link) in world_from_links.iter().enumerate() {
            let world_from_link = convert::pose(world_from_link);
            for (shape, link_from_shape) in shapes.link(link) {
                let pose = world_from_link * *link_from_shape;
                pieces.push(Piece { link, bounds: shape.compute_aabb(&pose), shape: shape.clone(), pose });
            }
        }
        Self { pieces }
    }

    /// Whether a box given by its corners in a frame touches a link that `counts`.
    pub(crate) fn touches(
        &self,
        (min, max): ([f32; 3], [f32; 3]),
        world_from_frame: &Isometry3<f32>,
        counts: impl Fn(usize) -> bool,
    ) -> bool {
        let (cuboid, frame_from_box) = shapes::cuboid(min, max);
        let pose = convert::pose(world_from_frame) * frame_from_box;
        let bounds = cuboid.compute_aabb(&pose);
        self.pieces.iter().any(|piece| {
            counts(piece.link)
                && piece.bounds.intersects(&bounds)
                && intersection_test(&piece.pose, &*piece.shape, &pose, &*cuboid)
                    .is_ok_and(|found| found.intersecting)
        })
    }
}
