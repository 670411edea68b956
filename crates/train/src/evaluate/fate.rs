//! What came of an executed proposal: where it failed says what the network has not understood.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use where2act_core::shard::Freedom;
use where2act_core::{Invalid, Trial, Verdict};

use crate::probes::ways;

/// What came of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Fate {
    /// It succeeded.
    Success,
    /// The hand came from behind the surface or touched the object before it moved.
    NoApproach,
    /// A pushing primitive whose hand touched first, or touched another part first.
    WrongTouch,
    /// The part gives in no direction within 60 degrees of the one intended: against its stop or across its joint.
    AgainstJoint,
    /// The joint gives that way, but the part moved too little or another way: the hand slipped, or never got hold.
    NoHold,
    /// It was not on a part that moves, and nobody tried it.
    NothingMoves,
    /// There was nothing to try.
    NoProposal,
    /// The simulation left the finite numbers.
    Unstable,
}

impl Fate {
    /// All of them, as tables list them.
    pub const ALL: [Fate; 8] = [
        Self::Success,
        Self::NoApproach,
        Self::WrongTouch,
        Self::AgainstJoint,
        Self::NoHold,
        Self::NothingMoves,
        Self::NoProposal,
        Self::Unstable,
    ];

    /// Name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::NoApproach => "no approach",
            Self::WrongTouch => "wrong touch",
            Self::AgainstJoint => "against the joint",
            Self::NoHold => "no hold",
            Self::NothingMoves => "nothing moves",
            Self::NoProposal => "no proposal",
            Self::Unstable => "unstable",
        }
    }

    /// Of a trial in a scene whose movable links have these freedoms, camera frame.
    pub(super) fn of(trial: &Trial, freedoms: &[Freedom]) -> Self {
        match trial.verdict {
            Verdict { success: true, .. } => Self::Success,
            Verdict { invalid: Some(Invalid::ApproachFromBehind | Invalid::InitialContact), .. } => {
                Self::NoApproach
            }
            Verdict { invalid: Some(Invalid::HandFirst | Invalid::OtherPartFirst), .. } => Self::WrongTouch,
            Verdict { invalid: Some(Invalid::Unstable), .. } => Self::Unstable,
            Verdict { invalid: None, .. } if gives_way(trial, freedoms) => Self::NoHold,
            Verdict { invalid: None, .. } => Self::AgainstJoint,
        }
    }
}

/// Whether the touched link can go where the trial wants it to.
fn gives_way(trial: &Trial, freedoms: &[Freedom]) -> bool {
    let grasp = &trial.grasp_in_camera;
    let Some(freedom) = usize::from(trial.link).checked_sub(1).and_then(|i| freedoms.get(i)) else {
        return false;
    };
    let intended = trial.primitive.intended_direction(grasp);
    let along = |way: &Vector3<f32>| {
        way.try_normalize(1e-6).is_some_and(|way| way.dot(&intended) > Verdict::MIN_DIRECTION_COSINE)
    };
    ways(freedom, &grasp.point).iter().any(along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;
    use where2act_core::{Grasp, Pixel, Policy, Primitive};

    fn trial(primitive: Primitive, link: u8, invalid: Option<Invalid>, success: bool) -> Trial {
        let grasp_in_camera = Grasp::new(Point3::new(0.3, 0.0, 1.0), Vector3::z(), Vector3::x());
        let verdict = Verdict { invalid, q_start: 0.0, q_end: 0.0, motion: Vector3::zeros(), success };
        let (policy, pixel) = (Policy::Adaptive, Pixel { u: 0, v: 0 });
        Trial { primitive, policy, pixel, link, grasp_in_camera, verdict }
    }

    #[test]
    fn failures_are_told_apart() {
        // A shut drawer that comes towards the camera, and a door with its hinge at the origin that opens away from it.
        let drawer = Freedom {
            turns: false,
            axis: Vector3::z_axis(),
            point: Point3::new(0.0, 0.0, 1.0),
            room: [0.3, 0.0],
        };
        let door = Freedom { turns: true, axis: -Vector3::y_axis(), room: [0.0, 1.0], ..drawer };
        let fate = |primitive, link, invalid, success| {
            Fate::of(&trial(primitive, link, invalid, success), &[drawer, door])
        };
        use Primitive::{Pulling, Pushing, PushingLeft};
        assert_eq!(fate(Pushing, 1, None, false), Fate::AgainstJoint);
        assert_eq!(fate(PushingLeft, 1, None, false), Fate::AgainstJoint);
        assert_eq!(fate(Pulling, 1, None, false), Fate::NoHold);
        assert_eq!(fate(Pushing, 2, None, false), Fate::NoHold);
        assert_eq!(fate(Pulling, 2, None, false), Fate::AgainstJoint);
        assert_eq!(fate(Pulling, 2, None, true), Fate::Success);
        assert_eq!(fate(Pulling, 1, Some(Invalid::InitialContact), false), Fate::NoApproach);
        assert_eq!(fate(Pushing, 2, Some(Invalid::HandFirst), false), Fate::WrongTouch);
        // The root and links that the scene does not know cannot give way.
        assert_eq!(fate(Pulling, 0, None, false), Fate::AgainstJoint);
        assert_eq!(fate(Pulling, 3, None, false), Fate::AgainstJoint);
    }

    #[test]
    fn every_reason_has_a_column() {
        for n in 1..=5 {
            let fate = Fate::of(&trial(Primitive::Pushing, 1, Invalid::from_number(n), false), &[]);
            assert!(Fate::ALL.contains(&fate) && fate != Fate::Success, "{n}");
        }
    }
}
