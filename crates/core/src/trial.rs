//! One interaction and what came of it.

use std::fmt;

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::{Grasp, Pixel, Primitive};

/// How a trial's pixel and orientation were chosen. The discriminant is its number in shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum Policy {
    /// Uniform pixel on the movable parts, uniform orientation in the hemisphere against the normal (published).
    Random = 0,
    /// Near edges and handles, along or against what the joint allows.
    Guided = 1,
    /// Where the current network is confident (published online sampling).
    Adaptive = 2,
}

impl Policy {
    /// The policy with this number in shards.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        [Self::Random, Self::Guided, Self::Adaptive].get(usize::from(number)).copied()
    }
}

/// Why a trial counts as a failure without looking at the motion. The discriminant is its number in shards; 0 is
/// kept for valid trials.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Invalid {
    /// The approach comes from behind the surface.
    ApproachFromBehind = 1,
    /// The hand touches the object before it moves.
    InitialContact = 2,
    /// A pushing primitive whose hand, not a finger, touched first.
    HandFirst = 3,
    /// A pushing primitive that touched another part first.
    OtherPartFirst = 4,
    /// The simulation left the finite numbers.
    Unstable = 5,
}

impl Invalid {
    /// The reason with this number in shards; `None` for 0 (valid) and unknown numbers.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        [
            Self::ApproachFromBehind,
            Self::InitialContact,
            Self::HandFirst,
            Self::OtherPartFirst,
            Self::Unstable,
        ]
        .into_iter()
        .find(|reason| *reason as u8 == number)
    }
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::ApproachFromBehind => "approach-from-behind",
            Self::InitialContact => "initial-contact",
            Self::HandFirst => "hand-first",
            Self::OtherPartFirst => "other-part-first",
            Self::Unstable => "unstable",
        })
    }
}

/// What came of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Why the trial is invalid; `None` if it is valid.
    pub invalid: Option<Invalid>,
    /// The target joint's position before, radians or metres.
    pub q_start: f32,
    /// The target joint's position after.
    pub q_end: f32,
    /// How the touched point moved in the world, metres.
    pub motion: Vector3<f32>,
    /// Whether the part moved enough, in the intended direction, in a valid trial.
    pub success: bool,
}

impl Verdict {
    /// Joint motion that always counts as success: 0.01 rad or m (published).
    pub const MIN_JOINT_MOTION: f32 = 0.01;
    /// Share of the joint's range that counts as success for short joints (published).
    pub const MIN_RANGE_SHARE: f32 = 0.5;
    /// Cosine between intended and actual motion above which the direction counts as right (published).
    pub const MIN_DIRECTION_COSINE: f32 = 0.5;

    /// Whether a joint that turned or slid by so much has moved. `range` is the width of its limits.
    #[must_use]
    pub fn is_enough(moved: f32, range: f32) -> bool {
        moved > Self::MIN_JOINT_MOTION || moved / range.max(1e-8) > Self::MIN_RANGE_SHARE
    }

    /// Judges a trial by the published rule. `range` is the width of the joint's limits.
    #[must_use]
    pub fn judge(
        primitive: Primitive,
        grasp_in_world: &Grasp,
        invalid: Option<Invalid>,
        (q_start, q_end): (f32, f32),
        range: f32,
        motion: Vector3<f32>,
    ) -> Self {
        let turned = (q_end - q_start).abs();
        let direction = motion.try_normalize(1e-9).unwrap_or_else(Vector3::zeros);
        let intended = primitive == Primitive::Pushing
            || primitive.intended_direction(grasp_in_world).dot(&direction) > Self::MIN_DIRECTION_COSINE;
        let success = invalid.is_none() && Self::is_enough(turned, range) && intended && turned.is_finite();
        Self { invalid, q_start, q_end, motion, success }
    }
}

/// A trial as training sees it: in the camera frame, tied to a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// What was tried.
    pub primitive: Primitive,
    /// How it was chosen.
    pub policy: Policy,
    /// Pixel of the observation whose surface point was touched.
    pub pixel: Pixel,
    /// Index of the touched link in its object.
    pub link: u8,
    /// Contact point and hand rotation in the camera frame.
    pub grasp_in_camera: Grasp,
    /// What came of it; the motion is in the camera frame.
    pub verdict: Verdict,
}

impl Trial {
    /// A trial executed in the world, seen from a camera.
    #[must_use]
    pub fn seen_from(
        camera_from_world: &Isometry3<f32>,
        (primitive, policy): (Primitive, Policy),
        (pixel, link): (Pixel, u8),
        grasp_in_world: &Grasp,
        verdict_in_world: &Verdict,
    ) -> Self {
        let motion = camera_from_world.rotation * verdict_in_world.motion;
        Self {
            primitive,
            policy,
            pixel,
            link,
            grasp_in_camera: grasp_in_world.transformed(camera_from_world),
            verdict: Verdict { motion, ..*verdict_in_world },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn direction_matters_for_all_but_pushing_and_short_joints_count_by_share() {
        let grasp = Grasp::new(Point3::origin(), Vector3::x(), Vector3::z());
        let judge = |p, dq, range, m| Verdict::judge(p, &grasp, None, (0.0, dq), range, m).success;
        assert!(judge(Primitive::Pushing, 0.02, 1.0, -Vector3::x()));
        assert!(judge(Primitive::Pulling, 0.02, 1.0, -Vector3::x()));
        assert!(!judge(Primitive::Pulling, 0.02, 1.0, Vector3::x()));
        assert!(judge(Primitive::PullingLeft, 0.02, 1.0, Vector3::z() * 0.01));
        assert!(!judge(Primitive::PullingUp, 0.02, 1.0, Vector3::z() * 0.01));
        assert!(!judge(Primitive::Pushing, 0.009, 1.0, Vector3::x()));
        assert!(judge(Primitive::Pushing, 0.009, 0.016, Vector3::x()));
        assert!(!judge(Primitive::Pushing, f32::NAN, 1.0, Vector3::x()));
    }

    #[test]
    fn numbers_round_trip() {
        for n in 1..=5 {
            assert_eq!(Invalid::from_number(n).unwrap() as u8, n);
        }
        assert!(Invalid::from_number(0).is_none());
        assert_eq!(Policy::from_number(2), Some(Policy::Adaptive));
    }
}
