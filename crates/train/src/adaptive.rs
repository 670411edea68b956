//! Online sampling: what the current network would do is tried, beside random trials. Taking the best of thousands of
//! proposals finds whatever the score is wrong about; this is where it learns that.

use rand::seq::{SliceRandom, index};
use rayon::prelude::*;
use where2act_core::{Policy, Primitive, Seed, Trial};
use where2act_infer::{Backend, Error, Predictor};
use where2act_model::{Modality, Network, Weights};
use where2act_sim::Mode;
use where2act_sim::collect::{CollectError, Preparer, ScenePrep};
use where2act_sim::sampling::{Candidate, Sampler};

use crate::config::AdaptiveConfig;
use crate::dataset::{Dataset, SceneId};
use crate::evaluate::proposals;
use crate::run::NewTrials;

/// Of so many best proposals of a primitive those to try are drawn; the best one always is among them.
const BEST: usize = 12;

/// Why there are no new trials.
#[derive(Debug, thiserror::Error)]
pub enum ExploreError {
    /// A scene cannot be made again.
    #[error(transparent)]
    Scene(#[from] CollectError),
    /// The network cannot predict.
    #[error("online sampling: {0}")]
    Predict(#[from] Error),
}

/// What online sampling brings.
#[derive(Debug, Default)]
pub struct Explored {
    /// The new trials.
    pub trials: NewTrials,
    /// Why other scenes gave none.
    pub failed: Vec<ExploreError>,
}

/// (trials, successes) of a policy among new trials.
#[must_use]
pub fn count(trials: &NewTrials, policy: Policy) -> (usize, usize) {
    let of = trials.iter().flat_map(|(_, trials)| trials).filter(|t| t.policy == policy);
    of.fold((0, 0), |(n, successes), t| (n + 1, successes + usize::from(t.verdict.success)))
}

/// New trials on randomly drawn scenes of `scenes`: on each of them some are the network's own best proposals and the
/// others random, primitives taking turns. Each folder of the data has its own preparer. `progress` is called after every
/// scene. A scene that cannot be made again costs no other its trials.
///
/// # Errors
/// If the network cannot predict at all.
pub fn explore(
    network: &Network,
    preparers: &[Preparer],
    dataset: &Dataset,
    scenes: &[SceneId],
    config: &AdaptiveConfig,
    seed: Seed,
    progress: &(dyn Fn() + Sync),
) -> Result<Explored, ExploreError> {
    let weights = Weights { network: network.clone(), sha256: String::new() };
    let predictor = Predictor::from_weights(weights, Backend::default())?;
    let drawn = index::sample(&mut seed.rng(), scenes.len(), config.scenes.min(scenes.len())).into_vec();
    let one = |(i, scene): (usize, usize)| -> Result<(SceneId, Vec<Trial>), ExploreError> {
        let id = scenes[scene];
        let info = &dataset.shards()[id.shard].scenes()[id.scene];
        let prep = preparers[dataset.folder_of(id.shard)].restore(info)?;
        let trials = explore_scene(&predictor, &prep, config, seed.child("scene", i as u64))?;
        progress();
        Ok((id, trials))
    };
    let mut explored = Explored::default();
    for result in drawn.into_par_iter().enumerate().map(one).collect::<Vec<_>>() {
        match result {
            Ok(trials) => explored.trials.push(trials),
            Err(error) => explored.failed.push(error),
        }
    }
    Ok(explored)
}

fn explore_scene(
    predictor: &Predictor,
    prep: &ScenePrep,
    config: &AdaptiveConfig,
    seed: Seed,
) -> Result<Vec<Trial>, ExploreError> {
    let Some(sampler) = Sampler::new(&prep.settled, &prep.view) else { return Ok(Vec::new()) };
    let primitives = &predictor.config().primitives;
    let mut chosen: Vec<(Primitive, Policy, Candidate)> = Vec::new();
    let own_trials = (config.trials as f32 * config.own) as usize;
    for n in 0..config.trials - own_trials {
        let primitive = primitives[n % primitives.len()];
        let mut rng = seed.child("random", n as u64).rng();
        chosen.push((primitive, Policy::Random, sampler.random(&mut rng)));
    }
    // Photos have no depth map, so the network for pictures has to learn by itself which hands have room.
    let clearance = predictor.config().modality == Modality::Cloud;
    let all = proposals(predictor, prep, &sampler, BEST, clearance, seed)?;
    for (p, (mut own, &primitive)) in all.into_iter().zip(primitives).enumerate() {
        // The turns of this primitive among these trials.
        let count = (own_trials + primitives.len() - 1 - p) / primitives.len();
        if let Some((_, rest)) = own.split_first_mut() {
            rest.shuffle(&mut seed.child("own", primitive as u64).rng());
        }
        chosen.extend(own.into_iter().take(count).map(|c| (primitive, Policy::Adaptive, c)));
    }
    let run = |(primitive, policy, candidate)| prep.run(primitive, policy, &candidate, Mode::Fast);
    Ok(chosen.into_iter().map(run).collect())
}
