//! The six things a hand can try, and the motion of each.

use std::fmt;
use std::str::FromStr;

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::gripper::GRIPPER;
use crate::orientation::orthonormal_frame;

/// An action primitive of the paper. The discriminant is its number in shards.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[repr(u8)]
pub enum Primitive {
    /// Closed fingers press along the approach.
    Pushing = 0,
    /// Closed fingers touch, then slide along the hand's y axis.
    PushingUp = 1,
    /// Closed fingers touch, then slide along the hand's x axis.
    PushingLeft = 2,
    /// Open fingers approach, close, and go back.
    Pulling = 3,
    /// Open fingers approach, close, and move along the hand's y axis.
    PullingUp = 4,
    /// Open fingers approach, close, and move along the hand's x axis.
    PullingLeft = 5,
}

/// Whether the fingers touch each other or are 0.08 m apart (supplement, section C).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FingerState {
    /// Fingers touch.
    Closed,
    /// Fingers 0.08 m apart.
    Open,
}

impl FingerState {
    /// How far each finger is from where they meet, metres.
    #[must_use]
    pub const fn opening(self) -> f32 {
        match self {
            Self::Closed => 0.0,
            Self::Open => GRIPPER.finger_travel,
        }
    }
}

/// Where and how the hand goes: a contact point and the hand's axes, all in one frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grasp {
    /// Contact point on the surface, metres.
    pub point: Point3<f32>,
    /// Hand rotation `[x y z]`: forward, left, approach.
    pub rotation: Rotation3<f32>,
}

impl Grasp {
    /// From directions that need not be orthonormal: `approach` is kept, `forward` is made orthogonal to it.
    #[must_use]
    pub fn new(point: Point3<f32>, approach: Vector3<f32>, forward: Vector3<f32>) -> Self {
        Self { point, rotation: orthonormal_frame(approach, forward) }
    }

    /// The hand's z axis.
    #[must_use]
    pub fn approach(&self) -> Vector3<f32> {
        self.rotation.matrix().column(2).into()
    }

    /// The hand's x axis, the direction of the *-left primitives.
    #[must_use]
    pub fn forward(&self) -> Vector3<f32> {
        self.rotation.matrix().column(0).into()
    }

    /// The hand's y axis, the direction of the *-up primitives.
    #[must_use]
    pub fn left(&self) -> Vector3<f32> {
        self.rotation.matrix().column(1).into()
    }

    /// Hand pose with its origin `distance` metres behind the contact point.
    #[must_use]
    pub fn hand_at(&self, distance: f32) -> Isometry3<f32> {
        Isometry3::from_parts(
            Translation3::from(self.point - self.approach() * distance),
            UnitQuaternion::from_rotation_matrix(&self.rotation),
        )
    }

    /// The same grasp seen from another frame.
    #[must_use]
    pub fn transformed(&self, to_from_here: &Isometry3<f32>) -> Self {
        Self {
            point: to_from_here * self.point,
            rotation: to_from_here.rotation.to_rotation_matrix() * self.rotation,
        }
    }
}

/// One stage of a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stage {
    /// Drive the hand to a pose at even speed, in this many seconds.
    Move {
        /// Hand pose to reach, in the grasp's frame.
        hand: Isometry3<f32>,
        /// Duration.
        secs: f32,
    },
    /// Hold the pose for this many seconds.
    Wait {
        /// Duration.
        secs: f32,
    },
    /// Close the fingers and give them this many seconds.
    Close {
        /// Duration.
        secs: f32,
    },
}

/// The whole motion of a primitive.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Fingers before the first stage.
    pub fingers: FingerState,
    /// Hand pose before the first stage, in the grasp's frame.
    pub start: Isometry3<f32>,
    /// What follows.
    pub stages: Vec<Stage>,
}

impl Motion {
    /// The poses the hand visits, the start included.
    pub fn waypoints(&self) -> impl Iterator<Item = Isometry3<f32>> + '_ {
        let moves = self.stages.iter().filter_map(|stage| match stage {
            Stage::Move { hand, .. } => Some(*hand),
            Stage::Wait { .. } | Stage::Close { .. } => None,
        });
        std::iter::once(self.start).chain(moves)
    }
}

impl Primitive {
    /// All six, in the order of their numbers.
    pub const ALL: [Primitive; 6] = [
        Primitive::Pushing,
        Primitive::PushingUp,
        Primitive::PushingLeft,
        Primitive::Pulling,
        Primitive::PullingUp,
        Primitive::PullingLeft,
    ];
    /// Distance of the hand's origin from the contact point at the start, metres (published).
    pub const START_DISTANCE: f32 = 0.15;
    /// Duration of every stage: 2,000 steps at 500 Hz (published).
    pub const STAGE_SECS: f32 = 4.0;
    /// How far the sideways primitives move, metres (published).
    pub const SIDEWAYS: f32 = 0.05;

    /// Name on command lines and in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pushing => "pushing",
            Self::PushingUp => "pushing-up",
            Self::PushingLeft => "pushing-left",
            Self::Pulling => "pulling",
            Self::PullingUp => "pulling-up",
            Self::PullingLeft => "pulling-left",
        }
    }

    /// The primitive with this number in shards.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Whether it closes the hand around something.
    #[must_use]
    pub const fn is_pulling(self) -> bool {
        matches!(self, Self::Pulling | Self::PullingUp | Self::PullingLeft)
    }

    /// Distance of the hand's origin from the contact point at the end of the approach, metres (published).
    #[must_use]
    pub const fn contact_distance(self) -> f32 {
        match self {
            Self::PushingUp | Self::PushingLeft => 0.11,
            _ => 0.10,
        }
    }

    /// Fingers at the start.
    #[must_use]
    pub const fn fingers(self) -> FingerState {
        if self.is_pulling() { FingerState::Open } else { FingerState::Closed }
    }

    /// Where the touched point should go, as a unit vector in the grasp's frame: the approach for pushing, back
    /// for pulling, the hand's y for *-up and its x for *-left.
    #[must_use]
    pub fn intended_direction(self, grasp: &Grasp) -> Vector3<f32> {
        match self {
            Self::Pushing => grasp.approach(),
            Self::Pulling => -grasp.approach(),
            Self::PushingUp | Self::PullingUp => grasp.left(),
            Self::PushingLeft | Self::PullingLeft => grasp.forward(),
        }
    }

    /// The published motion for a grasp.
    #[must_use]
    pub fn motion(self, grasp: &Grasp) -> Motion {
        let secs = Self::STAGE_SECS;
        let start = grasp.hand_at(Self::START_DISTANCE);
        let contact = grasp.hand_at(self.contact_distance());
        let mut stages = vec![Stage::Move { hand: contact, secs }, Stage::Wait { secs }];
        if self.is_pulling() {
            stages.push(Stage::Close { secs });
        }
        let last = match self {
            Self::Pushing => None,
            Self::Pulling => Some(start),
            _ => {
                let sideways = self.intended_direction(grasp) * Self::SIDEWAYS;
                Some(Translation3::from(sideways) * contact)
            }
        };
        if let Some(hand) = last {
            stages.extend([Stage::Move { hand, secs }, Stage::Wait { secs }]);
        }
        Motion { fingers: self.fingers(), start, stages }
    }
}

impl fmt::Display for Primitive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is none of the six primitives.
#[derive(Debug, thiserror::Error)]
#[error("unknown primitive {0:?}, expected one of {names}", names = Primitive::ALL.map(Primitive::name).join(", "))]
pub struct UnknownPrimitive(String);

impl FromStr for Primitive {
    type Err = UnknownPrimitive;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL.into_iter().find(|p| p.name() == name).ok_or_else(|| UnknownPrimitive(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grasp() -> Grasp {
        Grasp::new(Point3::new(0.1, 0.2, 0.3), Vector3::x(), Vector3::z())
    }

    #[test]
    fn hand_axes_are_right_handed() {
        let g = grasp();
        assert!((g.approach().cross(&g.forward()) - g.left()).norm() < 1e-6);
        assert!((g.left() - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-6);
    }

    #[test]
    fn pulling_ends_where_it_started_and_left_moves_along_x() {
        let g = grasp();
        let poses: Vec<_> = Primitive::Pulling.motion(&g).waypoints().collect();
        assert_eq!(poses.len(), 3);
        assert_eq!(poses[0], poses[2]);
        assert!((poses[1].translation.vector - Vector3::new(0.0, 0.2, 0.3)).norm() < 1e-6);
        let poses: Vec<_> = Primitive::PushingLeft.motion(&g).waypoints().collect();
        let moved = poses[2].translation.vector - poses[1].translation.vector;
        assert!((moved - Vector3::z() * 0.05).norm() < 1e-6);
    }

    #[test]
    fn names_and_numbers_round_trip() {
        for p in Primitive::ALL {
            assert_eq!(p.name().parse::<Primitive>().unwrap(), p);
            assert_eq!(Primitive::from_number(p as u8), Some(p));
            assert_eq!(serde_json::to_string(&p).unwrap(), format!("{:?}", p.name()));
        }
        assert!(Primitive::from_number(6).is_none());
    }
}
