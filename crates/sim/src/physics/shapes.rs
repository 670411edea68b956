//! Collision shapes, built once per object and shared by all its worlds.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use rapier3d::geometry::{ColliderBuilder, SharedShape};
use rapier3d::math::{Pose, Vector};
use rapier3d::parry::shape::ConvexPolyhedron;
use rapier3d::parry::transformation::try_convex_hull;
use where2act_core::GRIPPER;

use super::{DENSITY, FRICTION, RESTITUTION, convert};
use crate::object::{ConvexPiece, Object};

/// Extent given to flat pieces along the directions they lack, metres. Thinner hulls tunnel and have no inertia.
const MIN_THICKNESS: f32 = 0.002;

/// A collision piece that no body can be made of.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("collision piece {piece} of link {link:?} in {object}: {why}")]
pub struct PieceError {
    /// Name of the object.
    pub object: String,
    /// Name of the link.
    pub link: String,
    /// Index of the piece in its link.
    pub piece: usize,
    /// What is wrong with it.
    pub why: &'static str,
}

/// The shapes of an object's links, in link frames.
pub(crate) struct Shapes {
    links: Vec<Vec<(SharedShape, Pose)>>,
}

impl Shapes {
    pub(crate) fn new(object: &Object) -> Result<Self, PieceError> {
        let links = object.links.iter().map(|link| {
            let shape = |(piece, source): (usize, &ConvexPiece)| {
                hull(&source.points).map_err(|why| PieceError {
                    object: object.name.clone(),
                    link: link.name.clone(),
                    piece,
                    why,
                })
            };
            link.pieces.iter().enumerate().map(shape).collect()
        });
        Ok(Self { links: links.collect::<Result<_, _>>()? })
    }

    /// Whether a point of the link frame lies inside one of the link's shapes.
    pub(crate) fn contain(&self, link: usize, point_in_link: &Point3<f32>) -> bool {
        let point = convert::point(point_in_link);
        self.links[link].iter().any(|(shape, pose)| shape.contains_point(pose, point))
    }

    /// Shapes of a link with their poses in the link frame.
    pub(super) fn link(&self, link: usize) -> &[(SharedShape, Pose)] {
        &self.links[link]
    }
}

/// A collider with the materials of the published trials.
pub(super) fn collider(shape: SharedShape, link_from_shape: Pose) -> ColliderBuilder {
    ColliderBuilder::new(shape)
        .position(link_from_shape)
        .density(DENSITY)
        .friction(FRICTION)
        .restitution(RESTITUTION)
}

/// An axis-aligned box in its body's frame.
pub(super) fn cuboid(min: [f32; 3], max: [f32; 3]) -> (SharedShape, Pose) {
    let (min, max) = (Vector::from(min), Vector::from(max));
    let half = 0.5 * (max - min);
    (SharedShape::cuboid(half.x, half.y, half.z), Pose::from_translation(0.5 * (min + max)))
}

/// The hand's box in the hand frame.
pub(super) fn hand_shape() -> (SharedShape, Pose) {
    cuboid(GRIPPER.hand_min, GRIPPER.hand_max)
}

/// The left (`side` = 1) or right (-1) finger in its own frame. The right one is the left one turned by half a turn
/// about z.
pub(super) fn finger_shape(side: f32) -> (SharedShape, Pose) {
    let corners = GRIPPER.finger_corners().map(|[x, y, z]| Vector::new(side * x, side * y, z));
    let hull = SharedShape::convex_hull(&corners).expect("the finger is a solid");
    (hull, Pose::IDENTITY)
}

/// The convex hull of a piece; pieces that are flat or thin in some direction are thickened along it.
fn hull(points: &[Point3<f32>]) -> Result<(SharedShape, Pose), &'static str> {
    if points.is_empty() {
        return Err("it has no points");
    }
    if !points.iter().all(|p| p.coords.iter().all(|x| x.is_finite())) {
        return Err("a coordinate is not finite");
    }
    if let Some(half) = axis_aligned_box(points) {
        let centre = 0.5 * (points[0].coords + points[points.len() - 1].coords);
        let shape = SharedShape::cuboid(half.x, half.y, half.z);
        return Ok((shape, Pose::from_translation(convert::vector(&centre))));
    }
    let (centre, axes, extents) = principal_box(points);
    let thin = extents.min() < MIN_THICKNESS;
    let cloud: Vec<Vector> = if thin {
        let missing = extents.map(|e| 0.5 * (MIN_THICKNESS - e).max(0.0));
        let shifts = (0..8).map(|i| {
            let sign = |axis: usize| if i >> axis & 1 == 0 { -missing[axis] } else { missing[axis] };
            axes * Vector3::new(sign(0), sign(1), sign(2))
        });
        let mut shifts: Vec<_> = shifts.collect();
        shifts.dedup_by(|a, b| a == b);
        points.iter().flat_map(|p| shifts.iter().map(move |s| convert::point(&(p + s)))).collect()
    } else {
        points.iter().map(convert::point).collect()
    };
    let polyhedron = try_convex_hull(&cloud)
        .ok()
        .and_then(|(vertices, triangles)| ConvexPolyhedron::from_convex_mesh(vertices, &triangles));
    if let Some(polyhedron) = polyhedron {
        return Ok((SharedShape::new(polyhedron), Pose::IDENTITY));
    }
    // Hulls that even so defeat the algorithm become their principal box.
    let half = extents.map(|e| 0.5 * e.max(MIN_THICKNESS));
    let frame = nalgebra::Isometry3::from_parts(
        centre.into(),
        nalgebra::UnitQuaternion::from_rotation_matrix(&nalgebra::Rotation3::from_matrix_unchecked(axes)),
    );
    Ok((SharedShape::cuboid(half.x, half.y, half.z), convert::pose(&frame)))
}

/// Half extents if the points are the eight corners of a box along the axes, in the order of
/// [`ConvexPiece::cuboid`]: boxes are faster and more exact to collide than general hulls.
fn axis_aligned_box(points: &[Point3<f32>]) -> Option<Vector3<f32>> {
    let [min, .., max] = points else { return None };
    let half = 0.5 * (max - min);
    (points == ConvexPiece::cuboid(*min, *max).points && half.min() >= 0.5 * MIN_THICKNESS).then_some(half)
}

/// Centre, right-handed axes and extents of a box around the points along their principal directions.
fn principal_box(points: &[Point3<f32>]) -> (Vector3<f32>, Matrix3<f32>, Vector3<f32>) {
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f32>>() / points.len() as f32;
    let covariance: Matrix3<f32> =
        points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
    let mut axes = SymmetricEigen::new(covariance).eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(0).neg_mut();
    }
    let mut low = Vector3::repeat(f32::INFINITY);
    let mut high = -low;
    for p in points {
        let local = axes.transpose() * (p.coords - mean);
        low = low.inf(&local);
        high = high.sup(&local);
    }
    (mean + axes * (0.5 * (low + high)), axes, high - low)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn extents(points: &[[f32; 3]]) -> Vector {
        let points: Vec<Point3<f32>> = points.iter().map(|p| Point3::from(*p)).collect();
        let (shape, pose) = hull(&points).unwrap();
        let aabb = shape.compute_aabb(&pose);
        assert!(shape.mass_properties(DENSITY).mass() > 0.0);
        aabb.extents()
    }

    #[test]
    fn flat_thin_and_tiny_pieces_become_bodies() {
        let square = [[0.0, 0.0, 0.5], [0.3, 0.0, 0.5], [0.3, 0.2, 0.5], [0.0, 0.2, 0.5]];
        let e = extents(&square);
        assert!((e - Vector::new(0.3, 0.2, MIN_THICKNESS)).length() < 1e-4, "{e}");
        let e = extents(&[[0.0; 3], [0.1, 0.0, 0.0], [0.4, 0.0, 0.0]]);
        assert!((e - Vector::new(0.4, MIN_THICKNESS, MIN_THICKNESS)).length() < 1e-3, "{e}");
        let e = extents(&[[0.2; 3]; 5]);
        assert!(e.min_element() > 0.0 && e.max_element() < 2.0 * MIN_THICKNESS, "{e}");
        let disc: Vec<[f32; 3]> =
            (0..40).map(|i| i as f32 * 0.157).map(|a| [a.cos(), a.sin(), 0.0]).collect();
        let e = extents(&disc);
        assert!((e.z - MIN_THICKNESS).abs() < 1e-4 && e.x < 2.01, "a disc stays a disc: {e}");
    }

    #[test]
    fn boxes_are_recognised_and_nonsense_is_refused() {
        let piece = ConvexPiece::cuboid(Point3::new(0.1, 0.2, 0.3), Point3::new(0.4, 0.6, 0.8));
        let (shape, pose) = hull(&piece.points).unwrap();
        assert!(shape.as_cuboid().is_some());
        assert!((pose.translation - Vector::new(0.25, 0.4, 0.55)).length() < 1e-6);
        assert!(hull(&[]).is_err());
        assert!(hull(&[Point3::new(f32::NAN, 0.0, 0.0)]).is_err());
    }
}
