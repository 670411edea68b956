//! Online sampling: what the current network would do is tried, beside random trials. Taking the best of thousands of
//! proposals finds whatever the score is wrong about; this is where it learns that.

use std::sync::atomic::{AtomicBool, Ordering};

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
use crate::evaluate::{Wanted, proposals};
use crate::run::NewTrials;

/// Of so many best proposals of a primitive those to try are drawn; the best one always is among them.
const BEST: usize = 12;
/// A scene that shows other links at a larger share of its pixels than this is not the one of the data: files of its object
/// have changed. Other machines may round differently.
const OTHER_PIXELS: f32 = 0.01;

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
/// scene; once `stop` is set no other scene is begun. A scene that cannot be made again costs no other its trials.
///
/// # Errors
/// If the network cannot predict at all.
#[expect(clippy::too_many_arguments, reason = "each is another thing")]
pub fn explore(
    network: &Network,
    preparers: &[Preparer],
    dataset: &Dataset,
    scenes: &[SceneId],
    config: &AdaptiveConfig,
    seed: Seed,
    stop: &AtomicBool,
    progress: &(dyn Fn() + Sync),
) -> Result<Explored, ExploreError> {
    let weights = Weights { network: network.clone(), sha256: String::new() };
    let predictor = Predictor::from_weights(weights, Backend::default())?;
    let drawn = index::sample(&mut seed.rng(), scenes.len(), config.scenes.min(scenes.len())).into_vec();
    let one = |(i, scene): (usize, usize)| -> Result<(SceneId, Vec<Trial>), ExploreError> {
        let id = scenes[scene];
        let shard = &dataset.shards()[id.shard];
        let info = &shard.scenes()[id.scene];
        let preparer = &preparers[dataset.folder_of(id.shard)];
        // As those that were collected: another mode ends one or two trials in a hundred otherwise.
        let (prep, mode) = (preparer.restore(info)?, preparer.recipe().mode());
        let others = prep.view.link.iter().zip(shard.link(id.scene)).filter(|(made, seen)| made != seen);
        if others.count() as f32 > OTHER_PIXELS * prep.view.link.len() as f32 {
            return Err(CollectError::Foreign { scene: info.index, object: info.object.clone() }.into());
        }
        let turns = Turns::new(config, predictor.config().primitives.len(), i);
        let trials = explore_scene(&predictor, &prep, &turns, mode, seed.child("scene", i as u64))?;
        progress();
        Ok((id, trials))
    };
    let mut explored = Explored::default();
    let left = drawn.into_par_iter().enumerate().filter(|_| !stop.load(Ordering::Relaxed));
    for result in left.map(one).collect::<Vec<_>>() {
        match result {
            Ok(trials) => explored.trials.push(trials),
            Err(error) => explored.failed.push(error),
        }
    }
    Ok(explored)
}

/// Which primitives the trials of a scene are of, as outputs of the network.
struct Turns {
    random: Vec<usize>,
    own: Vec<usize>,
}

impl Turns {
    /// Primitives take turns over the trials of all scenes: began each scene with the first one, few trials a scene would
    /// always be of the same.
    fn new(config: &AdaptiveConfig, primitives: usize, scene: usize) -> Self {
        let own = (config.trials as f32 * config.own) as usize;
        let mut random: Vec<usize> = (0..config.trials).map(|n| (scene + n) % primitives).collect();
        let own = random.split_off(config.trials - own);
        Self { random, own }
    }
}

fn explore_scene(
    predictor: &Predictor,
    prep: &ScenePrep,
    turns: &Turns,
    mode: Mode,
    seed: Seed,
) -> Result<Vec<Trial>, ExploreError> {
    let Some(sampler) = Sampler::new(&prep.settled, &prep.view) else { return Ok(Vec::new()) };
    let primitives = &predictor.config().primitives;
    let mut chosen: Vec<(Primitive, Policy, Candidate)> = Vec::new();
    for (n, &output) in turns.random.iter().enumerate() {
        let mut rng = seed.child("random", n as u64).rng();
        chosen.push((primitives[output], Policy::Random, sampler.random(&mut rng)));
    }
    // Photos have no depth map, so the network for pictures has to learn by itself which hands have room.
    let clearance = predictor.config().modality == Modality::Cloud;
    let wanted = Wanted { count: BEST, clearance, anywhere: false, up: false };
    let all = proposals(predictor, prep, &sampler, wanted, seed)?;
    for (output, (own, &primitive)) in all.into_iter().zip(primitives).enumerate() {
        let mut own: Vec<Candidate> = own.into_iter().flatten().collect();
        let count = turns.own.iter().filter(|&&turn| turn == output).count();
        if let Some((_, rest)) = own.split_first_mut() {
            rest.shuffle(&mut seed.child("own", primitive as u64).rng());
        }
        chosen.extend(own.into_iter().take(count).map(|c| (primitive, Policy::Adaptive, c)));
    }
    let run = |(primitive, policy, candidate)| prep.run(primitive, policy, &candidate, mode);
    Ok(chosen.into_iter().map(run).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_primitive_gets_more_trials_than_another() {
        for (trials, primitives) in [(12, 6), (24, 6), (5, 3), (4, 1)] {
            let config = AdaptiveConfig { trials, own: 0.75, ..AdaptiveConfig::default() };
            let (mut random, mut own) = (vec![0; primitives], vec![0; primitives]);
            for scene in 0..primitives {
                let turns = Turns::new(&config, primitives, scene);
                turns.random.iter().for_each(|&output| random[output] += 1);
                turns.own.iter().for_each(|&output| own[output] += 1);
            }
            let wanted = (trials as f32 * 0.75) as usize;
            assert_eq!(own, vec![wanted; primitives]);
            assert_eq!(random, vec![trials - wanted; primitives]);
        }
    }
}
