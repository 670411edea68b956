//! Who touches whom.

use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query::contact;
use rapier3d::prelude::{ColliderHandle, ContactPair};

use super::world::World;
use super::{Hand, PUBLISHED_HZ, TOUCH_IMPULSE};

/// Overlap of hand and object at the start that counts as touching, metres. Impulses of the first step would not do:
/// they also come from mere nearness.
const INITIAL_OVERLAP: f32 = 2e-4;

/// What a rapier body stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Body {
    /// A link of the object, by index.
    Link(usize),
    /// The hand without its fingers.
    Palm,
    /// The left or right finger.
    Finger,
}

impl Body {
    pub(super) fn to_user_data(self) -> u128 {
        match self {
            Self::Palm => 0,
            Self::Finger => 1,
            Self::Link(link) => 2 + link as u128,
        }
    }

    fn from_user_data(data: u128) -> Self {
        match data {
            0 => Self::Palm,
            1 => Self::Finger,
            link => Self::Link(link as usize - 2),
        }
    }
}

/// The first touch of hand and object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FirstContact {
    /// A finger on the target link, and nothing that a pushing hand must not do.
    Target,
    /// The palm on any link.
    Palm,
    /// A finger on another link.
    OtherLink,
}

impl World {
    /// Whether the hand overlaps the object now, before any step.
    pub(crate) fn overlaps(&self, hand: &Hand) -> bool {
        self.hand_colliders(hand).any(|h| {
            self.object_colliders().any(|o| {
                let (h, o) = (&self.rapier.colliders[h], &self.rapier.colliders[o]);
                let (hand_pose, object_pose) = (self.collider_pose(h), self.collider_pose(o));
                let near =
                    h.shape().compute_aabb(&hand_pose).intersects(&o.shape().compute_aabb(&object_pose));
                near && matches!(
                    contact(&hand_pose, h.shape(), &object_pose, o.shape(), 0.0),
                    Ok(Some(contact)) if contact.dist < -INITIAL_OVERLAP
                )
            })
        })
    }

    /// What the hand touched in the last step, worst first; `None` if nothing.
    pub(crate) fn hand_contact(&self, target: usize) -> Option<FirstContact> {
        let mut found = None;
        for pair in self.pressing_pairs() {
            let (a, b) = self.bodies_of(pair);
            let (part, link) = match (a, b) {
                (part @ (Body::Palm | Body::Finger), Body::Link(link))
                | (Body::Link(link), part @ (Body::Palm | Body::Finger)) => (part, link),
                _ => continue,
            };
            let contact = match part {
                Body::Palm => FirstContact::Palm,
                _ if link != target => FirstContact::OtherLink,
                _ => FirstContact::Target,
            };
            match contact {
                FirstContact::Palm => return Some(contact),
                FirstContact::OtherLink => found = Some(contact),
                FirstContact::Target => found = found.or(Some(contact)),
            }
        }
        found
    }

    /// Two links of the object that press on each other in the last step.
    pub(crate) fn colliding_links(&self) -> Option<(usize, usize)> {
        self.pressing_pairs().find_map(|pair| match self.bodies_of(pair) {
            (Body::Link(a), Body::Link(b)) => Some((a.min(b), a.max(b))),
            _ => None,
        })
    }

    /// Deepest overlap of hand and object in the last step, metres.
    #[cfg(test)]
    pub(crate) fn hand_penetration(&self) -> f32 {
        let of_hand = |pair: &&ContactPair| {
            let (a, b) = self.bodies_of(pair);
            !matches!((a, b), (Body::Link(_), Body::Link(_)))
        };
        let points = self.rapier.narrow_phase.contact_pairs().filter(of_hand);
        points
            .flat_map(ContactPair::solver_manifolds)
            .flat_map(|manifold| &manifold.points)
            .map(|point| -point.dist)
            .fold(0.0, f32::max)
    }

    /// Pairs with an impulse above the published threshold, scaled to this world's step.
    fn pressing_pairs(&self) -> impl Iterator<Item = &ContactPair> {
        let threshold = TOUCH_IMPULSE * self.dt() * PUBLISHED_HZ;
        self.rapier.narrow_phase.contact_pairs().filter(move |pair| {
            let mut points = pair.solver_manifolds().iter().flat_map(|manifold| &manifold.points);
            points.any(|point| point.data.impulse > threshold)
        })
    }

    fn bodies_of(&self, pair: &ContactPair) -> (Body, Body) {
        let body = |collider: ColliderHandle| {
            let parent = self.rapier.colliders[collider].parent().and_then(|b| self.rapier.bodies.get(b));
            Body::from_user_data(parent.map_or(2, |body| body.user_data))
        };
        (body(pair.collider1), body(pair.collider2))
    }
}
