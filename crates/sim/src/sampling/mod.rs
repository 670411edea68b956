//! Where and how to try something: the policies of data collection.

mod clear;
mod guided;
mod places;

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt};
use where2act_core::{GRIPPER, Grasp, GripperGeometry, Pixel, Primitive, Verdict};

use self::clear::Clear;
use self::places::Places;
use crate::object::JointKind;
use crate::render::View;
use crate::scene::SettledScene;

/// Guided candidates looked at before one that begins out of view is taken.
const TRIES_IN_VIEW: usize = 20;

/// Something to try at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Pixel of the view.
    pub pixel: Pixel,
    /// Index of the link seen there.
    pub link: usize,
    /// Contact point and hand rotation.
    pub grasp_in_world: Grasp,
    /// Outward normal at the contact point.
    pub normal_in_world: Vector3<f32>,
}

/// Chooses candidates on one view of a scene.
pub struct Sampler<'a> {
    scene: &'a SettledScene,
    view: &'a View,
    places: Places,
    clear: Clear,
}

/// How a point of a link moves with its joint.
#[derive(Clone, Copy, Debug)]
struct PointMotion {
    /// Unit velocity for a growing joint position.
    direction: Vector3<f32>,
    /// Whether the joint has room to grow, and to shrink.
    room: [bool; 2],
    kind: JointKind,
}

impl<'a> Sampler<'a> {
    /// `None` if the view shows no movable part.
    #[must_use]
    pub fn new(scene: &'a SettledScene, view: &'a View) -> Option<Self> {
        let places = Places::new(view)?;
        Some(Self { scene, view, places, clear: Clear::new(scene) })
    }

    /// The published exploration: a uniform pixel of the movable parts, an approach uniform in the hemisphere against
    /// the normal, any turn around it.
    #[must_use]
    pub fn random(&self, rng: &mut impl Rng) -> Candidate {
        let pixel = self.places.any(rng);
        let (point, normal, link) = self.surface(pixel);
        let direction = unit_vector(rng);
        let approach = if direction.dot(&normal) > 0.0 { -direction } else { direction };
        let grasp_in_world = Grasp::new(point, approach, unit_vector(rng));
        Candidate { pixel, link, grasp_in_world, normal_in_world: normal }
    }

    /// A promising candidate: at parts' edges and handles or anywhere, along or against what the joint still allows,
    /// checked for a free way and something to touch. Not all are checked, so that failures of all kinds occur too.
    #[must_use]
    pub fn guided(&self, primitive: Primitive, rng: &mut impl Rng) -> Candidate {
        guided::candidate(self, primitive, rng)
    }

    /// [`Self::guided`], of a hand that [begins in view](Self::begins_in_view) where such a one is found: what networks learn
    /// from. Those that push a shut drawer open from inside it would teach them that its front gives.
    #[must_use]
    pub fn guided_in_view(&self, primitive: Primitive, rng: &mut impl Rng) -> Candidate {
        let mut candidate = self.guided(primitive, rng);
        for _ in 1..TRIES_IN_VIEW {
            if self.begins_in_view(&candidate.grasp_in_world) {
                break;
            }
            candidate = self.guided(primitive, rng);
        }
        candidate
    }

    /// A candidate with a given orientation at a given pixel; `None` unless it shows a movable link.
    #[must_use]
    pub fn at(&self, pixel: Pixel, approach: Vector3<f32>, forward: Vector3<f32>) -> Option<Candidate> {
        self.view.link_at(pixel).filter(|&link| link > 0)?;
        let (point, normal, link) = self.surface(pixel);
        let grasp_in_world = Grasp::new(point, approach, forward);
        Some(Candidate { pixel, link, grasp_in_world, normal_in_world: normal })
    }

    /// Whether a hand begins where the camera sees that nothing is, by the middle of its palm and fingers. Behind what is
    /// seen it may be anywhere: in a shut drawer, or beyond a window.
    #[must_use]
    pub fn begins_in_view(&self, grasp: &Grasp) -> bool {
        let world_from_hand = grasp.hand_at(Primitive::START_DISTANCE);
        let hidden = |z: f32| {
            self.view.hides(&(world_from_hand * Point3::new(0.0, 0.0, z)), GripperGeometry::OUT_OF_VIEW)
        };
        !GRIPPER.along_axis().into_iter().any(hidden)
    }

    /// Point, normal and link at a pixel that shows something.
    fn surface(&self, pixel: Pixel) -> (Point3<f32>, Vector3<f32>, usize) {
        let point = self.view.point_in_world(pixel).unwrap_or_else(Point3::origin);
        let normal = self.view.normal_in_world(pixel).unwrap_or_else(Vector3::z);
        (point, normal, self.view.link_at(pixel).unwrap_or(0))
    }

    fn motion_of(&self, link: usize, point: &Point3<f32>) -> Option<PointMotion> {
        let joint = self.scene.object().links.get(link)?.joint.as_ref()?;
        let world_from_link = self.scene.world_from_links()[link];
        let axis = world_from_link * joint.axis.into_inner();
        let velocity = match joint.kind {
            JointKind::Prismatic => axis,
            JointKind::Revolute | JointKind::Continuous => {
                axis.cross(&(point.coords - world_from_link.translation.vector))
            }
        };
        let q = self.scene.q()[link - 1];
        let room =
            [joint.limits.1 - q, q - joint.limits.0].map(|room| Verdict::is_enough(room, joint.range()));
        Some(PointMotion { direction: velocity.try_normalize(1e-6)?, room, kind: joint.kind })
    }
}

/// Uniform on the unit sphere.
fn unit_vector(rng: &mut impl Rng) -> Vector3<f32> {
    loop {
        let v = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0f32));
        if (1e-3..1.0).contains(&v.norm_squared()) {
            return v.normalize();
        }
    }
}

#[cfg(test)]
mod tests;
