//! From an object to a scene that stands still.

use std::f32::consts::PI;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use rand::{Rng, RngExt};

use crate::object::{JointKind, Object};
use crate::physics::{Clearance, PUBLISHED_HZ, PieceError, Shapes, World};

/// Steps a scene is given to come to rest (published).
const MAX_STEPS: usize = 20_000;
/// Steps over which motion is looked at. A lid of 100 kg trembles on its limit by more than [`STILL_MOTION`] from one
/// step to the next without going anywhere; what counts is where it is after a while.
const WINDOW: usize = 100;
/// Motion of a joint per step that counts as none (published), radians or metres; taken as the mean of a window.
const STILL_MOTION: f32 = 1e-6;
/// Steps in a row without motion that count as rest. The published 5,000 decide the same: what is slower than
/// [`STILL_MOTION`] for 2 s is not speeding up.
const STILL_STEPS: usize = 1_000;

/// How far outside its limits a given position may be: numbers in files are rounded.
const LIMIT_SLACK: f32 = 1e-3;

/// An object with its parts at chosen positions.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The object.
    pub object: Arc<Object>,
    /// Joint positions, one per movable link, radians or metres.
    pub q: Vec<f32>,
}

/// Joint positions that an object cannot have.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadPositions {
    /// Not one per movable link.
    #[error("expected {expected} joint positions, one per movable link, found {found}")]
    Count {
        /// Movable links.
        expected: usize,
        /// Positions.
        found: usize,
    },
    /// Outside a joint's limits, or not a number.
    #[error("joint {joint}: expected a position from {} to {}, found {found}", limits.0, limits.1)]
    OutsideLimits {
        /// Name of the joint.
        joint: String,
        /// Its limits, radians or metres.
        limits: (f32, f32),
        /// The position.
        found: f32,
    },
}

/// Why a scene cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsettled {
    /// The object has a piece that no body can be made of.
    #[error(transparent)]
    Piece(#[from] PieceError),
    /// Two parts press on each other where they stand. The published procedure drops such scenes.
    #[error("parts {0:?} and {1:?} collide where they stand, expected parts free of each other")]
    PartsCollide(String, String),
    /// Something still moves after the time that settling may take.
    #[error("still moving after {} s, expected rest", MAX_STEPS as f32 / PUBLISHED_HZ)]
    NeverStill,
    /// The simulation left the finite numbers.
    #[error("the simulation of the object left the finite numbers")]
    Unstable,
}

impl Scene {
    /// An object with its parts at given positions.
    ///
    /// # Errors
    /// If there is not one position per movable link, inside its joint's limits.
    pub fn new(object: Arc<Object>, q: Vec<f32>) -> Result<Self, BadPositions> {
        if q.len() != object.movable().len() {
            return Err(BadPositions::Count { expected: object.movable().len(), found: q.len() });
        }
        for (link, &found) in object.movable().zip(&q) {
            let joint = object.joint(link);
            let (low, high) = joint.limits;
            if !(low - LIMIT_SLACK..=high + LIMIT_SLACK).contains(&found) {
                return Err(BadPositions::OutsideLimits {
                    joint: joint.name.clone(),
                    limits: joint.limits,
                    found,
                });
            }
        }
        Ok(Self { object, q })
    }

    /// Start poses as published: all parts closed in half of the scenes; else every part closed with probability 1/2
    /// and otherwise uniform in its range. Endless turns are wrapped into (-pi, pi].
    #[must_use]
    pub fn sample(object: Arc<Object>, rng: &mut impl Rng) -> Self {
        let mut q = object.closed();
        if rng.random_bool(0.5) {
            for link in object.movable() {
                let joint = object.joint(link);
                if rng.random_bool(0.5) {
                    let (low, high) = joint.limits;
                    let position = low + (high - low) * rng.random::<f32>();
                    q[link - 1] = match joint.kind {
                        JointKind::Continuous => wrapped(position),
                        JointKind::Revolute | JointKind::Prismatic => position,
                    };
                }
            }
        }
        Self { object, q }
    }

    /// Lets gravity act until nothing has moved for 2 s, at most 40 s.
    ///
    /// # Errors
    /// [`Unsettled`] says why the scene is of no use.
    pub fn settle(self) -> Result<SettledScene, Unsettled> {
        let shapes = Shapes::new(&self.object)?;
        let mut world = World::new(&self.object, &shapes, &self.q, PUBLISHED_HZ);
        let mut q = self.q;
        let (mut still, mut stuck) = (0, 0);
        for _ in 0..MAX_STEPS / WINDOW {
            for _ in 0..WINDOW {
                world.step();
            }
            let now = world.all_q();
            // Rapier puts bodies that are nowhere back where they were, but not joints, and says so in that step alone.
            if world.broke_down() || !now.iter().all(|q| q.is_finite()) {
                return Err(Unsettled::Unstable);
            }
            let motion = q.iter().zip(&now).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            q = now;
            let rests = motion < STILL_MOTION * WINDOW as f32;
            let collides = world.colliding_links().is_some();
            still = if rests && !collides { still + WINDOW } else { 0 };
            stuck = if rests && collides { stuck + WINDOW } else { 0 };
            if still >= STILL_STEPS {
                return Ok(SettledScene { object: self.object, q, shapes: Arc::new(shapes) });
            }
            if stuck >= STILL_STEPS {
                break;
            }
        }
        Err(match world.colliding_links() {
            Some((a, b)) => {
                let name = |link: usize| self.object.links[link].name.clone();
                Unsettled::PartsCollide(name(a), name(b))
            }
            None => Unsettled::NeverStill,
        })
    }

    /// Takes the scene as it is. For scenes known to stand still, and for a closer look at those that do not.
    ///
    /// # Errors
    /// [`Unsettled::Piece`].
    pub fn assume_settled(self) -> Result<SettledScene, Unsettled> {
        let shapes = Arc::new(Shapes::new(&self.object)?);
        Ok(SettledScene { object: self.object, q: self.q, shapes })
    }
}

/// An angle wrapped into (-pi, pi].
fn wrapped(angle: f32) -> f32 {
    let turned = angle.rem_euclid(2.0 * PI);
    if turned > PI { turned - 2.0 * PI } else { turned }
}

/// A scene at rest, ready for any number of trials. Cheap to clone; shared between threads.
#[derive(Clone)]
pub struct SettledScene {
    object: Arc<Object>,
    q: Vec<f32>,
    shapes: Arc<Shapes>,
}

impl SettledScene {
    /// The object.
    #[must_use]
    pub fn object(&self) -> &Arc<Object> {
        &self.object
    }

    /// Joint positions at rest, one per movable link, radians or metres.
    #[must_use]
    pub fn q(&self) -> &[f32] {
        &self.q
    }

    /// Poses of all links at rest.
    #[must_use]
    pub fn world_from_links(&self) -> Vec<Isometry3<f32>> {
        self.object.world_from_links(&self.q)
    }

    /// Whether a point of a link's frame lies inside one of its collision pieces.
    pub(crate) fn piece_contains(&self, link: usize, point_in_link: &Point3<f32>) -> bool {
        self.shapes.contain(link, point_in_link)
    }

    /// What a box would touch in this scene.
    pub(crate) fn clearance(&self) -> Clearance {
        Clearance::new(&self.shapes, &self.world_from_links())
    }

    /// A fresh world with the object at rest.
    pub(crate) fn world(&self, hz: f32) -> World {
        World::new(&self.object, &self.shapes, &self.q, hz)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::{ConvexPiece, Joint, Link};
    use nalgebra::Vector3;
    use where2act_core::Seed;

    /// A lid that turns about y and a tray beside it that slides towards it, on a base without pieces.
    fn object(slide: f32) -> Arc<Object> {
        let joint = |kind, axis, limits| Joint {
            name: format!("{kind:?}"),
            parent: 0,
            kind,
            parent_from_joint: Isometry3::identity(),
            axis,
            limits,
        };
        let link = |name: &str, joint, pieces| Link {
            name: name.into(),
            label: name.into(),
            welded: Vec::new(),
            joint,
            visuals: Vec::new(),
            pieces,
        };
        let lid = ConvexPiece::cuboid(Point3::new(0.0, 0.0, 0.0), Point3::new(0.3, 0.3, 0.02));
        let tray = ConvexPiece::cuboid(Point3::new(0.4 - slide, 0.0, -0.1), Point3::new(0.7, 0.3, 0.1));
        let links = vec![
            link("base", None, Vec::new()),
            link("lid", Some(joint(JointKind::Revolute, -Vector3::y_axis(), (0.0, 1.5))), vec![lid]),
            link("tray", Some(joint(JointKind::Prismatic, Vector3::y_axis(), (0.0, 0.2))), vec![tray]),
            link("knob", Some(joint(JointKind::Continuous, Vector3::z_axis(), (-10.0, 10.0))), Vec::new()),
        ];
        Arc::new(Object { name: "test".into(), category: None, links, materials: Vec::new() })
    }

    #[test]
    fn open_lids_fall_shut_and_the_rest_stays() {
        let scene = Scene::new(object(0.0), vec![0.5, 0.1, 0.0]).unwrap().settle().unwrap();
        assert!(scene.q()[0].abs() < 1e-3 && (scene.q()[1] - 0.1).abs() < 1e-6, "{:?}", scene.q());
    }

    #[test]
    fn parts_that_press_on_each_other_are_refused() {
        // The lid falls onto the tray and stays there.
        let refused = Scene::new(object(0.2), vec![0.9, 0.0, 0.0]).unwrap().settle().err().unwrap();
        assert_eq!(refused, Unsettled::PartsCollide("lid".into(), "tray".into()));
    }

    #[test]
    fn positions_are_checked() {
        assert!(matches!(
            Scene::new(object(0.0), vec![0.0]),
            Err(BadPositions::Count { expected: 3, found: 1 })
        ));
        for bad in [1.6, -0.1, f32::NAN] {
            let refused = Scene::new(object(0.0), vec![bad, 0.0, 0.0]).unwrap_err().to_string();
            assert!(refused.contains("Revolute") && refused.contains("1.5"), "{refused}");
        }
    }

    #[test]
    fn half_of_the_starts_are_closed_and_the_rest_spread_over_the_ranges() {
        let object = object(0.0);
        let mut rng = Seed(4).rng();
        let starts: Vec<Vec<f32>> =
            (0..4000).map(|_| Scene::sample(Arc::clone(&object), &mut rng).q).collect();
        let share = |is: &dyn Fn(&Vec<f32>) -> bool| starts.iter().filter(|q| is(q)).count() as f32 / 4000.0;
        // All closed: 1/2 + 1/2 * 1/8.
        assert!((share(&|q| q.iter().all(|x| *x == 0.0)) - 0.5625).abs() < 0.03);
        assert!((share(&|q| q[0] > 0.75) - 0.125).abs() < 0.02);
        assert!(starts.iter().all(|q| (0.0..=1.5).contains(&q[0]) && (0.0..=0.2).contains(&q[1])));
        assert!(starts.iter().all(|q| q[2] > -PI - 1e-5 && q[2] <= PI + 1e-5));
        assert!((share(&|q| q[2] > 0.0) - 0.125).abs() < 0.02);
    }
}
