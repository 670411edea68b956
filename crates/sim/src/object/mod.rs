//! Articulated objects: one type, whatever they come from.

mod cache;
mod convex;
mod error;
mod export;
mod hull;
mod load;
mod mesh;
mod normals;
mod open;
mod partnet;
pub mod procedural;
mod shapes;
mod sides;
mod soup;
mod urdf;
mod varied;

pub use error::ObjectError;
pub use export::export;
pub use open::{open, open_with_cache, unvaried, urdf_in};
pub use partnet::category_of;

use std::ops::Range;
use std::sync::Arc;

use image::RgbImage;
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use where2act_core::Category;

/// An articulated object in its own frame, which is the world frame of its scenes: z up, front towards -x, inside a
/// sphere of about 1 m around the origin.
///
/// Links that fixed joints weld together are merged when an object is loaded, so every link but the first has
/// exactly one movable joint: `q[i - 1]` is the position of link `i`.
#[derive(Clone, Debug)]
pub struct Object {
    /// Unique name: `StorageFurniture/45746` for a folder, `Microwave:17` for a generated one, `Microwave:17~3` for
    /// its variation 3.
    pub name: String,
    /// PartNet-Mobility category, if known.
    pub category: Option<Category>,
    /// The root, fixed in the world, then every movable link after its parent.
    pub links: Vec<Link>,
    /// What visuals refer to.
    pub materials: Vec<Material>,
}

/// A rigid part.
#[derive(Clone, Debug)]
pub struct Link {
    /// URDF name.
    pub name: String,
    /// What people call it ("drawer", "door"), if known; the URDF name otherwise.
    pub label: String,
    /// URDF names of the links that fixed joints weld to this one.
    pub welded: Vec<String>,
    /// How it moves; `None` for the root alone.
    pub joint: Option<Joint>,
    /// What cameras see, in the link frame.
    pub visuals: Vec<Visual>,
    /// What hands touch, in the link frame.
    pub pieces: Vec<ConvexPiece>,
}

/// A movable joint with one degree of freedom.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// URDF name.
    pub name: String,
    /// Index of the parent link, smaller than the child's.
    pub parent: usize,
    /// Turning or sliding.
    pub kind: JointKind,
    /// Pose of the link frame in the parent's link frame at q = 0.
    pub parent_from_joint: Isometry3<f32>,
    /// Axis in the link frame.
    pub axis: Unit<Vector3<f32>>,
    /// Lower and upper limit, radians or metres. Continuous joints have +-10 (as the published trials clip them).
    pub limits: (f32, f32),
}

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// Turns within limits, radians.
    Revolute,
    /// Turns without limits, radians.
    Continuous,
    /// Slides within limits, metres.
    Prismatic,
}

impl Joint {
    /// Width of the limits.
    #[must_use]
    pub fn range(&self) -> f32 {
        self.limits.1 - self.limits.0
    }

    /// Pose of the link in its parent's frame at position `q`.
    #[must_use]
    pub fn parent_from_link(&self, q: f32) -> Isometry3<f32> {
        self.parent_from_joint
            * match self.kind {
                JointKind::Prismatic => Translation3::from(self.axis.into_inner() * q).into(),
                JointKind::Revolute | JointKind::Continuous => Isometry3::from_parts(
                    Translation3::identity(),
                    UnitQuaternion::from_axis_angle(&self.axis, q),
                ),
            }
    }
}

/// A coloured mesh on a link.
#[derive(Clone, Debug)]
pub struct Visual {
    /// Triangles in the link frame.
    pub mesh: Arc<Mesh>,
    /// Index into [`Object::materials`].
    pub material: usize,
}

/// Triangles with a normal and a texture coordinate for every vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices, metres.
    pub positions: Vec<Point3<f32>>,
    /// Unit normals, one per vertex.
    pub normals: Vec<Vector3<f32>>,
    /// Texture coordinates, one per vertex, v upwards as in OBJ; (0, 0) where the source has none.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex indices. Both sides are visible: PartNet-Mobility's winding is not reliable.
    pub triangles: Vec<[u32; 3]>,
}

/// How a surface looks.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Diffuse colour, sRGB in [0, 1]; multiplied with the texture.
    pub colour: [f32; 3],
    /// Texture, if any; repeats.
    pub texture: Option<Arc<RgbImage>>,
    /// Strength of the highlight in [0, 1].
    pub specular: f32,
    /// Phong exponent of the highlight.
    pub shininess: f32,
    /// 1 = solid. Glass is drawn as a tint over what lies behind it in RGB, but is solid for depth and touch.
    pub opacity: f32,
}

/// A convex body, as the corners of its hull in the link frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexPiece {
    /// Corners of the hull, metres; at least four, not coplanar.
    pub points: Vec<Point3<f32>>,
}

impl ConvexPiece {
    /// An axis-aligned box.
    #[must_use]
    pub fn cuboid(min: Point3<f32>, max: Point3<f32>) -> Self {
        let corner = |i: usize| {
            let pick = |axis: usize| if i >> axis & 1 == 0 { min[axis] } else { max[axis] };
            Point3::new(pick(0), pick(1), pick(2))
        };
        Self { points: (0..8).map(corner).collect() }
    }
}

/// The middle of the points' bounding box and the radius of the sphere around it that holds them; the origin and 0 without
/// points.
fn bounding_sphere(points: impl Iterator<Item = Point3<f32>> + Clone) -> (Point3<f32>, f32) {
    let infinity = Point3::from(Vector3::repeat(f32::INFINITY));
    let (min, max) = points.clone().fold((infinity, -infinity), |(min, max), p| (min.inf(&p), max.sup(&p)));
    if min > max {
        return (Point3::origin(), 0.0);
    }
    let centre = nalgebra::center(&min, &max);
    (centre, points.map(|p| (p - centre).norm()).fold(0.0, f32::max))
}

impl Object {
    /// Indices of the movable links.
    #[must_use]
    pub fn movable(&self) -> Range<usize> {
        1..self.links.len()
    }

    /// The joint of a movable link.
    ///
    /// # Panics
    /// For the root or an index out of range.
    #[must_use]
    pub fn joint(&self, link: usize) -> &Joint {
        self.links[link].joint.as_ref().expect("every link but the root has a joint")
    }

    /// Index of the link with this URDF name, or of the link that this one is welded to, or of the only one with this label.
    #[must_use]
    pub fn find_link(&self, name: &str) -> Option<usize> {
        let named = |l: &Link| l.name == name || l.welded.iter().any(|w| w == name);
        let labelled = || {
            let mut links = (0..self.links.len()).filter(|i| self.links[*i].label == name);
            links.next().filter(|_| links.next().is_none())
        };
        self.links.iter().position(named).or_else(labelled)
    }

    /// Poses of all links in the world at joint positions `q`, one per movable link.
    ///
    /// # Panics
    /// If `q` has another length.
    #[must_use]
    pub fn world_from_links(&self, q: &[f32]) -> Vec<Isometry3<f32>> {
        assert_eq!(q.len() + 1, self.links.len(), "one joint position per movable link");
        let mut poses = vec![Isometry3::identity(); self.links.len()];
        for link in self.movable() {
            let joint = self.joint(link);
            poses[link] = poses[joint.parent] * joint.parent_from_link(q[link - 1]);
        }
        poses
    }

    /// Number of visible triangles.
    #[must_use]
    pub fn triangle_count(&self) -> usize {
        self.links.iter().flat_map(|l| &l.visuals).map(|v| v.mesh.triangles.len()).sum()
    }

    /// Joint positions with every part closed: each joint at the limit nearest to zero, or zero.
    #[must_use]
    pub fn closed(&self) -> Vec<f32> {
        self.movable().map(|l| 0.0f32.clamp(self.joint(l).limits.0, self.joint(l).limits.1)).collect()
    }
}
