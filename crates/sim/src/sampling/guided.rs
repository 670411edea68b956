//! Guided candidates: what a person would try who knows how the joint moves.

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use where2act_core::{Grasp, Primitive};

use super::{Candidate, Sampler, unit_vector};
use crate::object::JointKind;

/// Share of the candidates that are taken without geometric checks.
const UNCHECKED: f64 = 0.1;
/// Candidates looked at before the last one is taken as it is.
const TRIES: usize = 200;

pub(super) fn candidate(sampler: &Sampler<'_>, primitive: Primitive, rng: &mut impl Rng) -> Candidate {
    let checked = !rng.random_bool(UNCHECKED);
    let mut last = None;
    for _ in 0..TRIES {
        let Some(candidate) = propose(sampler, primitive, rng) else { continue };
        if !checked || sampler.clear.allows(primitive, candidate.link, &candidate.grasp_in_world) {
            return candidate;
        }
        last = Some(candidate);
    }
    last.unwrap_or_else(|| sampler.random(rng))
}

/// A candidate that moves with the joint, unchecked; `None` if the surface does not suit the primitive.
fn propose(sampler: &Sampler<'_>, primitive: Primitive, rng: &mut impl Rng) -> Option<Candidate> {
    let special = rng.random_bool(if primitive == Primitive::Pushing { 0.3 } else { 0.75 });
    let pixel = sampler.places.of_some_link(special, rng);
    let (point, normal, link) = sampler.surface(pixel);
    let motion = sampler.motion_of(link, &point)?;
    let forwards = match motion.room {
        [true, false] => true,
        [false, true] => false,
        _ => rng.random_bool(0.5),
    };
    let wanted = if forwards { motion.direction } else { -motion.direction };
    // A sliding part must follow nearly all of the 1.2 cm that a push goes in; a turning one has more freedom.
    let spread = if motion.kind == JointKind::Prismatic { 0.3 } else { 0.5 };
    let noise = unit_vector(rng) * rng.random_range(0.0..spread);
    let (approach, forward) = match primitive {
        Primitive::Pushing => {
            let inwards = rng.random_range(0.0..0.7) * -normal;
            (wanted + inwards + noise, unit_vector(rng))
        }
        Primitive::Pulling => {
            let inwards = rng.random_range(0.0..0.7) * -normal;
            (-wanted + inwards + noise, unit_vector(rng))
        }
        _ => sideways(primitive, wanted + 0.5 * noise, normal, rng)?,
    };
    let approach = approach.try_normalize(1e-3)?;
    (approach.dot(&normal) < -0.05).then_some(())?;
    let grasp_in_world = Grasp::new(point, approach, forward);
    let along = primitive.intended_direction(&grasp_in_world).dot(&wanted);
    // Success needs a cosine above 0.5 after the turn of the part; pushing only needs to go in.
    let enough = match (primitive, motion.kind) {
        (Primitive::Pushing, JointKind::Revolute | JointKind::Continuous) => 0.3,
        _ => 0.7,
    };
    (along > enough).then_some(Candidate { pixel, link, grasp_in_world, normal_in_world: normal })
}

/// Approach and forward for a hand that moves along `wanted` across the surface.
fn sideways(
    primitive: Primitive,
    wanted: Vector3<f32>,
    normal: Vector3<f32>,
    rng: &mut impl Rng,
) -> Option<(Vector3<f32>, Vector3<f32>)> {
    let wanted = wanted.try_normalize(1e-3)?;
    let into = -normal + unit_vector(rng) * rng.random_range(0.0..1.0f32);
    let across = into - wanted * wanted.dot(&into);
    let across = across.try_normalize(0.05)?;
    // Leaning up to 40 degrees into the direction of motion lets the side of the fingers push.
    let lean = rng.random_range(-0.3..0.7f32);
    let approach = across * lean.cos() + wanted * lean.sin();
    let moving = wanted - approach * approach.dot(&wanted);
    Some(match primitive {
        Primitive::PushingUp | Primitive::PullingUp => (approach, moving.cross(&approach)),
        _ => (approach, moving),
    })
}
