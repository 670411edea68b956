//! What a hand does to a settled scene.

mod batch;
mod controller;

use nalgebra::{Isometry3, Vector3};
use where2act_core::{Grasp, Invalid, Primitive, Verdict};

use crate::physics::{FirstContact, PUBLISHED_HZ, World};
use crate::scene::SettledScene;
pub use batch::{Agreement, Batch, BatchError, Outcome};
use controller::Controller;

/// How much of a trial is simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Mode {
    /// Every step at 500 Hz, as published.
    Faithful,
    /// 250 Hz; the way through free air is jumped over and waits end when nothing moves any more. The same outcome
    /// in all but one or two trials of a hundred, about three times as fast.
    #[default]
    Fast,
}

impl Mode {
    /// Steps per second.
    #[must_use]
    pub fn hz(self) -> f32 {
        match self {
            Self::Faithful => PUBLISHED_HZ,
            Self::Fast => PUBLISHED_HZ / 2.0,
        }
    }
}

/// What to try on a [`SettledScene`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attempt {
    /// What the hand does.
    pub primitive: Primitive,
    /// Index of the link it is meant for.
    pub link: usize,
    /// Where and how it touches, in the world frame.
    pub grasp_in_world: Grasp,
    /// Outward normal of the surface at the contact point, in the world frame; `None` = the approach is not checked.
    pub normal_in_world: Option<Vector3<f32>>,
}

/// A trial as it goes on, for pictures and measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct Moment {
    /// Steps since the start.
    pub step: usize,
    /// Poses of the object's links.
    pub world_from_links: Vec<Isometry3<f32>>,
    /// Pose of the hand.
    pub world_from_hand: Isometry3<f32>,
    /// Poses of the left and right finger.
    pub world_from_fingers: [Isometry3<f32>; 2],
}

/// Sees a trial at regular steps.
pub struct Observer<'a> {
    /// Steps between two looks; the first is at the start.
    pub every: usize,
    /// Called with what there is to see.
    pub look: &'a mut dyn FnMut(&Moment),
}

impl SettledScene {
    /// Tries a primitive on a link by the published procedure. `normal_in_world` is the surface's outward normal at
    /// the contact point, if the rule that the approach must come from the front is to be applied.
    ///
    /// # Panics
    /// If there is no such link.
    #[must_use]
    pub fn run(
        &self,
        primitive: Primitive,
        link: usize,
        grasp_in_world: &Grasp,
        normal_in_world: Option<Vector3<f32>>,
        mode: Mode,
    ) -> Verdict {
        self.attempt(
            &Attempt { primitive, link, grasp_in_world: *grasp_in_world, normal_in_world },
            mode,
            None,
        )
    }

    /// [`Self::run`] before the eyes of an observer.
    ///
    /// # Panics
    /// If there is no such link.
    #[must_use]
    pub fn attempt(&self, attempt: &Attempt, mode: Mode, observer: Option<Observer<'_>>) -> Verdict {
        let Attempt { primitive, link, grasp_in_world: grasp, normal_in_world } = attempt;
        let (primitive, link) = (*primitive, *link);
        let object = self.object();
        assert!(link < object.links.len(), "link {link} of {}", object.links.len());
        let q_start = link.checked_sub(1).map_or(0.0, |joint| self.q()[joint]);
        let range = object.links[link].joint.as_ref().map_or(0.0, crate::object::Joint::range);
        let judge = |invalid, q_end, motion| {
            Verdict::judge(primitive, grasp, invalid, (q_start, q_end), range, motion)
        };

        if normal_in_world.is_some_and(|normal| normal.dot(&grasp.approach()) > 0.0) {
            // Nothing is simulated, but who looks shall see what is refused.
            if observer.is_some() {
                Controller::new(self, mode, primitive.motion(grasp), observer).observe();
            }
            return judge(Some(Invalid::ApproachFromBehind), q_start, Vector3::zeros());
        }
        let mut controller = Controller::new(self, mode, primitive.motion(grasp), observer);
        let touched_in_link = controller.world.world_from_link(link).inverse() * grasp.point;
        let invalid = controller.follow(&mut Rules { primitive, link, touched: false }).err();
        let world = &controller.world;
        let motion = world.world_from_link(link) * touched_in_link - grasp.point;
        judge(invalid, world.q(link), motion)
    }
}

/// The published rules of validity, as the steps go by.
struct Rules {
    primitive: Primitive,
    link: usize,
    /// The hand has touched the object, and was allowed to.
    touched: bool,
}

impl Rules {
    /// Looks at the contacts of the last step; `first` is the first of all.
    fn check(&mut self, world: &World, first: bool) -> Result<(), Invalid> {
        if world.broke_down() {
            return Err(Invalid::Unstable);
        }
        if self.touched {
            return Ok(());
        }
        let Some(contact) = world.hand_contact(self.link) else { return Ok(()) };
        if first {
            return Err(Invalid::InitialContact);
        }
        self.touched = true;
        match contact {
            _ if self.primitive.is_pulling() => Ok(()),
            FirstContact::Target => Ok(()),
            FirstContact::Palm => Err(Invalid::HandFirst),
            FirstContact::OtherLink => Err(Invalid::OtherPartFirst),
        }
    }
}
