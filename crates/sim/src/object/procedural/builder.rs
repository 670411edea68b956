//! From bodies placed in one frame to an [`Object`] with link frames, materials and the size of its data set.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use where2act_core::Category;

use super::dice::Dice;
use super::finish::Finish;
use super::solid::{Solid, append};
use crate::object::{ConvexPiece, Joint, JointKind, Link, Mesh, Object, Visual, bounding_sphere};

/// Index of a material of the object being built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Mat(usize);

/// Index of a link of the object being built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LinkId(usize);

/// The link that does not move.
pub(super) const ROOT: LinkId = LinkId(0);

/// How a link moves. Lengths in the builder's frame, directions in the object's.
#[derive(Clone, Copy, Debug)]
pub(super) enum Motion {
    /// Turns around an axis through a point.
    Hinge { at: [f32; 3], axis: [f32; 3], limits: (f32, f32) },
    /// Turns without end.
    Spin { at: [f32; 3], axis: [f32; 3] },
    /// Slides.
    Slide { axis: [f32; 3], limits: (f32, f32) },
}

/// Bodies with their materials.
#[derive(Clone, Debug, Default)]
pub(super) struct Group(pub(super) Vec<(Mat, Solid)>);

impl Group {
    /// Adds a body.
    pub(super) fn add(&mut self, mat: Mat, solid: Solid) -> &mut Self {
        self.0.push((mat, solid));
        self
    }

    /// The same bodies elsewhere.
    pub(super) fn at(mut self, pose: &Isometry3<f32>) -> Self {
        self.0 = self.0.into_iter().map(|(mat, solid)| (mat, solid.at(pose))).collect();
        self
    }
}

struct Draft {
    label: &'static str,
    parent: usize,
    motion: Option<Motion>,
    meshes: BTreeMap<Mat, Mesh>,
    pieces: Vec<ConvexPiece>,
}

impl Draft {
    fn new(label: &'static str, parent: usize, motion: Option<Motion>) -> Self {
        Self { label, parent, motion, meshes: BTreeMap::new(), pieces: Vec::new() }
    }

    /// Where the link frame is at q = 0; slides use the object's origin.
    fn origin(&self) -> Point3<f32> {
        match self.motion {
            Some(Motion::Hinge { at, .. } | Motion::Spin { at, .. }) => Point3::from(at),
            _ => Point3::origin(),
        }
    }
}

/// An object under construction. Everything is placed in one frame (z up, front towards -x) with all parts at q = 0,
/// at about its final size; [`Builder::finish`] makes that exact.
pub(super) struct Builder {
    pub(super) dice: Dice,
    drafts: Vec<Draft>,
    finishes: Vec<Finish>,
}

impl Builder {
    pub(super) fn new(dice: Dice, root: &'static str) -> Self {
        Self { dice, drafts: vec![Draft::new(root, 0, None)], finishes: Vec::new() }
    }

    /// Registers a material.
    pub(super) fn mat(&mut self, finish: Finish) -> Mat {
        self.finishes.push(finish);
        Mat(self.finishes.len() - 1)
    }

    /// Draws a material and registers it.
    pub(super) fn draw(&mut self, finish: fn(&mut Dice) -> Finish) -> Mat {
        let finish = finish(&mut self.dice);
        self.mat(finish)
    }

    /// The finish of a material.
    pub(super) fn finish_of(&self, mat: Mat) -> Finish {
        self.finishes[mat.0].clone()
    }

    /// Adds a movable link.
    pub(super) fn link(&mut self, parent: LinkId, label: &'static str, motion: Motion) -> LinkId {
        self.drafts.push(Draft::new(label, parent.0, Some(motion)));
        LinkId(self.drafts.len() - 1)
    }

    /// Whether the object has a movable link yet.
    pub(super) fn moves(&self) -> bool {
        self.drafts.len() > 1
    }

    /// Puts a body on a link.
    pub(super) fn add(&mut self, link: LinkId, mat: Mat, mut solid: Solid) {
        let tile = self.finishes[mat.0].tile;
        let offset = self.dice.texture_offset();
        for uv in &mut solid.mesh.uvs {
            *uv = [uv[0] / tile + offset.x, uv[1] / tile + offset.y];
        }
        self.add_as_mapped(link, mat, solid);
    }

    /// Puts a body on a link whose texture coordinates already span its texture.
    pub(super) fn add_as_mapped(&mut self, link: LinkId, mat: Mat, solid: Solid) {
        let draft = &mut self.drafts[link.0];
        append(draft.meshes.entry(mat).or_default(), &solid.mesh);
        draft.pieces.extend(solid.pieces);
    }

    /// Puts bodies on a link.
    pub(super) fn put(&mut self, link: LinkId, group: Group) {
        for (mat, solid) in group.0 {
            self.add(link, mat, solid);
        }
    }

    /// Centres the object's bounding box, scales it into the unit sphere and moves every link into its own frame.
    pub(super) fn finish(self, name: String, category: Category) -> Object {
        let vertices = self.drafts.iter().flat_map(|d| d.meshes.values()).flat_map(|m| &m.positions);
        let (centre, radius) = bounding_sphere(vertices.copied());
        let scale = 1.0 / radius.max(1e-6);
        let place = |p: Point3<f32>| Point3::from((p - centre) * scale);
        let origins: Vec<Point3<f32>> = self
            .drafts
            .iter()
            .map(|d| match d.motion {
                Some(Motion::Slide { .. }) | None => Point3::origin(),
                _ => place(d.origin()),
            })
            .collect();
        let mut links = Vec::with_capacity(self.drafts.len());
        for (i, draft) in self.drafts.into_iter().enumerate() {
            let local = |p: &mut Point3<f32>| *p = place(*p) - origins[i].coords;
            let visuals = draft.meshes.into_iter().map(|(mat, mut mesh)| {
                mesh.positions.iter_mut().for_each(local);
                Visual { mesh: Arc::new(mesh), material: mat.0 }
            });
            let visuals = visuals.collect();
            let mut pieces = draft.pieces;
            pieces.iter_mut().flat_map(|piece| &mut piece.points).for_each(local);
            let joint = draft.motion.map(|motion| {
                let (kind, axis, limits) = match motion {
                    Motion::Hinge { axis, limits, .. } => (JointKind::Revolute, axis, limits),
                    Motion::Spin { axis, .. } => (JointKind::Continuous, axis, (-10.0, 10.0)),
                    Motion::Slide { axis, limits } => {
                        (JointKind::Prismatic, axis, (limits.0 * scale, limits.1 * scale))
                    }
                };
                let offset = origins[i] - origins[draft.parent];
                Joint {
                    name: format!("joint_{i}"),
                    parent: draft.parent,
                    kind,
                    parent_from_joint: Translation3::from(offset).into(),
                    axis: Unit::new_normalize(Vector3::from(axis)),
                    limits,
                }
            });
            let name = format!("link_{i}");
            links.push(Link {
                name,
                label: draft.label.to_owned(),
                welded: Vec::new(),
                joint,
                visuals,
                pieces,
            });
        }
        let materials = self.finishes.into_iter().map(|f| f.material).collect();
        Object { name, category: Some(category), links, materials }
    }
}

/// The frame of something on the front of an object, seen from there: x to the right (-y), y up (z), z towards the
/// viewer (-x).
pub(super) fn front(at: [f32; 3]) -> Isometry3<f32> {
    frame(at, -Vector3::y(), Vector3::z())
}

/// The frame of something on top of an object, seen from the front: x to the right (-y), y away from the viewer (x),
/// z up.
pub(super) fn top(at: [f32; 3]) -> Isometry3<f32> {
    frame(at, -Vector3::y(), Vector3::x())
}

/// The frame at a point with these x and y axes.
pub(super) fn frame(at: [f32; 3], x: Vector3<f32>, y: Vector3<f32>) -> Isometry3<f32> {
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, x.cross(&y)]));
    Isometry3::from_parts(
        Translation3::from(Vector3::from(at)),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// A turn around z in a part's own frame.
pub(super) fn turned(angle: f32) -> Isometry3<f32> {
    Isometry3::from_parts(
        Translation3::identity(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
    )
}

/// A shift in a part's own frame.
pub(super) fn shifted(by: [f32; 3]) -> Isometry3<f32> {
    Isometry3::translation(by[0], by[1], by[2])
}
