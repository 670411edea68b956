//! Who tries: the network, and the baselines it is compared with.

use nalgebra::Vector3;
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use where2act_core::{Grasp, Observation, Policy, Primitive, Proposal, Seed, Trial};
use where2act_infer::{Error, Options, Predictor};
use where2act_sim::Mode;
use where2act_sim::collect::ScenePrep;
use where2act_sim::sampling::{Candidate, Sampler};

use super::EvaluateConfig;

/// Who tries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Contestant {
    /// The network's best proposal; a failure where it has none.
    TopOne,
    /// The network's best few proposals, each at a pixel of its own.
    TopK,
    /// Some of all the network's proposals, drawn at random: what to expect of one that is not the best.
    Sampled,
    /// Uniform pixel of the movable parts, uniform orientation in the hemisphere against the normal.
    Random,
    /// Uniform pixel of the movable parts, approach against the normal, any turn around it.
    AlongNormal,
    /// The guided sampling policy, which knows the geometry and the joint: what is to be had.
    Informed,
}

impl Contestant {
    /// All of them, as tables list them.
    pub const ALL: [Contestant; 6] =
        [Self::TopOne, Self::TopK, Self::Sampled, Self::Random, Self::AlongNormal, Self::Informed];

    /// Name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::TopOne => "top-1",
            Self::TopK => "top-k",
            Self::Sampled => "sampled",
            Self::Random => "random",
            Self::AlongNormal => "along normal",
            Self::Informed => "knows the joint",
        }
    }
}

/// Runs one candidate in the fast mode.
pub(super) fn run(prep: &ScenePrep, primitive: Primitive, policy: Policy, candidate: &Candidate) -> Trial {
    prep.run(primitive, policy, candidate, Mode::Fast)
}

/// Which of its proposals a network is asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wanted {
    /// So many of the best.
    pub(crate) count: usize,
    /// Only hands that have room.
    pub(crate) clearance: bool,
    /// Anywhere in the view, which comes without a mask, and not only at pixels of movable parts.
    pub(crate) anywhere: bool,
    /// As a network that is told which way is up.
    pub(crate) up: bool,
}

/// The network's best proposals, best first, for each of its primitives. There may be fewer, or none, because hands have
/// no room; what it proposes where nothing moves is `None`.
pub(crate) fn proposals(
    predictor: &Predictor,
    prep: &ScenePrep,
    sampler: &Sampler<'_>,
    Wanted { count, clearance, anywhere, up }: Wanted,
    seed: Seed,
) -> Result<Vec<Vec<Option<Candidate>>>, Error> {
    let movable = || prep.view.link.iter().map(|&link| link > 1).collect();
    let options = Options {
        top_k: count,
        clearance,
        up: up.then(|| up_in_camera(prep)),
        seed,
        region: (!anywhere).then(movable),
        network_from_metres: Some(1.0),
        ..Options::default()
    };
    let observation = observation(prep, anywhere);
    let prediction = predictor.predict(&observation, &options)?;
    let in_world = |direction: [f32; 3]| prep.view.camera.world_from_camera * Vector3::from(direction);
    let candidate = |p: &Proposal| sampler.at(p.pixel, in_world(p.approach), in_world(p.forward));
    let of_primitives = prediction.primitives.iter();
    Ok(of_primitives.map(|of| of.proposals.iter().map(candidate).collect()).collect())
}

fn up_in_camera(prep: &ScenePrep) -> Vector3<f32> {
    prep.view.camera.camera_from_world() * Vector3::z()
}

/// What the network sees: without a mask if it is not told what is the object.
fn observation(prep: &ScenePrep, anywhere: bool) -> Observation {
    let mut observation = prep.view.observation();
    if anywhere && let Observation::Image { mask, .. } = &mut observation {
        *mask = None;
    }
    observation
}

/// What the network says of trials that others made; no chance where it sees no surface.
pub(super) fn scores(
    predictor: &Predictor,
    prep: &ScenePrep,
    trials: &[Trial],
    config: &EvaluateConfig,
    seed: Seed,
) -> Result<Vec<f32>, Error> {
    let up = config.up.then(|| up_in_camera(prep));
    let seed = seed.child("score", 0);
    let options = Options { up, seed, network_from_metres: Some(1.0), ..Options::default() };
    let hands: Vec<(Primitive, Grasp)> = trials.iter().map(|t| (t.primitive, t.grasp_in_camera)).collect();
    let scores = predictor.score(&observation(prep, config.anywhere), &hands, &options)?;
    Ok(scores.into_iter().map(|score| score.unwrap_or(0.0)).collect())
}

/// Some of these at random, none of them twice.
pub(super) fn draw<T>(all: &[T], count: usize, seed: Seed) -> Vec<&T> {
    let mut left: Vec<&T> = all.iter().collect();
    let mut rng = seed.rng();
    let mut drawn = Vec::new();
    while drawn.len() < count && !left.is_empty() {
        drawn.push(left.swap_remove(rng.random_range(0..left.len())));
    }
    drawn
}

pub(super) fn random(
    prep: &ScenePrep,
    sampler: &Sampler<'_>,
    primitive: Primitive,
    count: usize,
    seed: Seed,
) -> Vec<Trial> {
    let one = |n: usize| {
        let candidate = sampler.random(&mut seed.child("random", n as u64).rng());
        run(prep, primitive, Policy::Random, &candidate)
    };
    (0..count).into_par_iter().map(one).collect()
}

pub(super) fn along_normal(
    prep: &ScenePrep,
    sampler: &Sampler<'_>,
    primitive: Primitive,
    count: usize,
    seed: Seed,
) -> Vec<bool> {
    let one = |n: usize| {
        let random = sampler.random(&mut seed.child("normal", n as u64).rng());
        let forward = random.grasp_in_world.forward();
        let candidate = sampler.at(random.pixel, -random.normal_in_world, forward).unwrap_or(random);
        run(prep, primitive, Policy::Random, &candidate).verdict.success
    };
    (0..count).into_par_iter().map(one).collect()
}

/// What came of a trial that knows the joint.
#[derive(Clone, Copy)]
pub(super) struct Informed {
    pub(super) success: bool,
    /// Whether the hand began where the camera sees that nothing is.
    pub(super) in_view: bool,
}

/// Trials that know the joint: `least`, and then handfuls, `most` in all, until one that begins in view succeeds.
pub(super) fn informed(
    prep: &ScenePrep,
    sampler: &Sampler<'_>,
    primitive: Primitive,
    [least, most]: [usize; 2],
    seed: Seed,
) -> Vec<Informed> {
    const AT_ONCE: usize = 8;
    let one = |n: usize| {
        let candidate = sampler.guided(primitive, &mut seed.child("informed", n as u64).rng());
        let success = run(prep, primitive, Policy::Guided, &candidate).verdict.success;
        Informed { success, in_view: sampler.begins_in_view(&candidate.grasp_in_world) }
    };
    let mut outcomes: Vec<Informed> = Vec::new();
    while outcomes.len() < least.min(most)
        || outcomes.len() < most && !outcomes.iter().any(|of| of.success && of.in_view)
    {
        let next = outcomes.len()..(outcomes.len() + AT_ONCE).min(most);
        outcomes.extend(next.into_par_iter().map(one).collect::<Vec<_>>());
    }
    outcomes
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_infer::Backend;
    use where2act_model::{Modality, ModelConfig, Network, Weights};
    use where2act_sim::collect::{Preparer, Recipe};

    #[test]
    fn a_part_of_one_pixel_has_proposals_too() {
        let primitives = [Primitive::Pushing, Primitive::Pulling];
        let config = ModelConfig::new(Modality::Cloud, &primitives).with_points(256);
        let network = Network::new(&config, Seed(1), &burn::tensor::Device::flex());
        let weights = Weights { network, sha256: String::new() };
        let predictor = Predictor::from_weights(weights, Backend::Fast).unwrap();
        let mut prep = Preparer::new(Recipe::default()).prepare(0).unwrap().unwrap();
        let found = |prep: &ScenePrep| {
            let sampler = Sampler::new(&prep.settled, &prep.view).unwrap();
            let wanted = |anywhere| {
                let wanted = Wanted { count: 5, clearance: false, anywhere, up: false };
                let found = proposals(&predictor, prep, &sampler, wanted, Seed(1)).unwrap();
                found.into_iter().flatten().collect::<Vec<_>>()
            };
            let [on_parts, anywhere] = [false, true].map(wanted);
            // One entry per proposal, those where nothing moves included.
            assert!(anywhere.len() == 10 && on_parts.iter().all(Option::is_some));
            (on_parts.len(), anywhere.iter().flatten().count())
        };
        let (on_parts, anywhere) = found(&prep);
        assert!(on_parts == 10 && anywhere > 0);
        // All but one pixel of the parts that move, and not one at their edge, become the part that does not.
        let mut moves: Vec<_> = prep.view.link.iter_mut().filter(|link| **link > 1).collect();
        moves.remove(moves.len() / 2);
        moves.into_iter().for_each(|link| *link = 1);
        assert_eq!(found(&prep), (2, 0));
    }
}
