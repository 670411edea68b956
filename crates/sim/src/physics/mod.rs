//! The object and the hand as a rapier world.
//!
//! rapier's maths is glam and its handles mean nothing outside; both stay inside this folder. What leaves it is
//! nalgebra, metres, radians and link indices.

mod clearance;
mod contacts;
mod convert;
mod hand;
mod shapes;
mod world;

pub(crate) use clearance::Clearance;
pub(crate) use contacts::FirstContact;
pub(crate) use hand::Hand;
pub use shapes::PieceError;
pub(crate) use shapes::Shapes;
pub(crate) use world::World;

/// Density of every piece of the object and of the hand, kg/m3 (SAPIEN's default, as published).
const DENSITY: f32 = 1000.0;
/// Static and dynamic friction coefficient of everything (supplement, section B).
const FRICTION: f32 = 4.0;
/// Restitution of everything (supplement, section B).
const RESTITUTION: f32 = 0.01;
/// Impulse of one step at 500 Hz above which bodies count as touching, N s. The published threshold is 1e-4 on the
/// square.
const TOUCH_IMPULSE: f32 = 0.01;
/// The step rate for which [`TOUCH_IMPULSE`] holds, per second.
pub(crate) const PUBLISHED_HZ: f32 = 500.0;

#[cfg(test)]
mod tests;
