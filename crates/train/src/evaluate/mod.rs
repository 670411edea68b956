//! Judging weights in simulation: proposals are executed and counted, beside baselines.
//!
//! For every scene and primitive the network's proposals are predicted from the view, at pixels of movable parts only
//! (as published), and executed. Beside it: random pixels and orientations; random pixels with the approach along the
//! normal; and trials that know the joint. A primitive that no trial with that knowledge manages in a scene is not
//! counted there, whoever tries it.

mod contestants;
mod report;

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use where2act_core::{Category, Policy, Primitive, Seed, Trial};
use where2act_infer::Predictor;
use where2act_model::Network;
use where2act_sim::collect::{CollectError, ObjectSet, Preparer, Recipe, ScenePrep};
use where2act_sim::sampling::Sampler;

pub use contestants::Contestant;
pub(crate) use contestants::proposals;
pub use report::{Judgement, Report, Row};

use crate::validate::score_record;

/// What to judge on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluateConfig {
    /// Objects to draw scenes from.
    pub objects: ObjectSet,
    /// Scenes.
    pub scenes: u64,
    /// Root of all randomness.
    pub seed: Seed,
    /// Proposals that are executed for each scene and primitive: the best one is top-1, their mean is top-k.
    pub proposals: usize,
    /// Random trials for each scene and primitive: a baseline, and what the score is judged on.
    pub random: usize,
    /// Trials that know the joint, at most, before a primitive counts as impossible in a scene.
    pub informed: usize,
    /// Whether the published look is replaced by random lights, materials, backgrounds and sensors.
    pub randomise: bool,
}

impl EvaluateConfig {
    /// The usual numbers for some objects.
    #[must_use]
    pub fn new(objects: ObjectSet, scenes: u64, seed: Seed) -> Self {
        Self { objects, scenes, seed, proposals: 5, random: 16, informed: 200, randomise: false }
    }

    fn recipe(&self) -> Recipe {
        Recipe {
            seed: self.seed.child("evaluate", 0),
            objects: self.objects.clone(),
            trials: 0,
            wide: false,
            randomise: self.randomise,
            ..Recipe::default()
        }
    }
}

/// Why judging stopped.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// A scene cannot be made.
    #[error(transparent)]
    Scene(#[from] CollectError),
    /// The network cannot look at a view.
    #[error("scene {scene}: {source}")]
    Predict {
        /// Number of the scene.
        scene: u64,
        /// Why.
        source: where2act_infer::Error,
    },
    /// A view cannot be prepared for the network.
    #[error("scene {scene}: {source}")]
    View {
        /// Number of the scene.
        scene: u64,
        /// Why.
        source: where2act_model::preprocess::PreprocessError,
    },
    /// Someone asked to stop.
    #[error("interrupted after {0} scenes; nothing was written")]
    Interrupted(u64),
}

/// What happened in one scene.
#[derive(Clone, Debug)]
pub struct SceneResult {
    /// Category of its object.
    pub category: Option<Category>,
    /// Name of its object.
    pub object: String,
    /// One entry per primitive of the network.
    pub primitives: Vec<PrimitiveResult>,
}

/// What happened with one primitive in one scene.
#[derive(Clone, Debug, Default)]
pub struct PrimitiveResult {
    /// Whether a trial that knows the joint succeeded.
    pub possible: bool,
    /// Trials of each contestant, in the order they were made.
    pub trials: Vec<(Contestant, Vec<bool>)>,
    /// (score, outcome) of the random trials.
    pub scored: Vec<(f32, bool)>,
}

/// Judges weights on all scenes of a configuration. `predictor` proposes and `network`, the same weights, scores the
/// random trials. `progress` is called with the number of scenes done.
///
/// # Errors
/// Any [`EvaluateError`].
pub fn evaluate(
    predictor: &Predictor,
    network: &Network,
    config: &EvaluateConfig,
    stop: &AtomicBool,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Report, EvaluateError> {
    let preparer = Preparer::new(config.recipe());
    let mut scenes = Vec::new();
    for index in 0..config.scenes {
        if stop.load(Ordering::Relaxed) {
            return Err(EvaluateError::Interrupted(index));
        }
        if let Some(prep) = preparer.prepare(index)? {
            scenes.push(judge_scene(predictor, network, config, index, &prep)?);
        }
        progress(index + 1);
    }
    Ok(Report::new(predictor, config, &scenes))
}

fn judge_scene(
    predictor: &Predictor,
    network: &Network,
    config: &EvaluateConfig,
    index: u64,
    prep: &ScenePrep,
) -> Result<SceneResult, EvaluateError> {
    let seed = prep.info.seed.child("evaluate", 0);
    let primitives = &predictor.config().primitives;
    let mut results: Vec<PrimitiveResult> = vec![PrimitiveResult::default(); primitives.len()];
    let Some(sampler) = Sampler::new(&prep.settled, &prep.view) else {
        return Ok(SceneResult {
            category: prep.info.category,
            object: prep.info.object.clone(),
            primitives: results,
        });
    };
    let proposals = proposals(predictor, prep, &sampler, config.proposals, seed)
        .map_err(|source| EvaluateError::Predict { scene: index, source })?;
    let mut random_trials: Vec<Trial> = Vec::new();
    for (p, &primitive) in primitives.iter().enumerate() {
        let seed = seed.child("primitive", primitive as u64);
        let informed = contestants::informed(prep, &sampler, primitive, config.informed, seed);
        let result = &mut results[p];
        result.possible = informed.contains(&true);
        // The first few only: trying until success would make the rate look worse than it is.
        let informed: Vec<bool> = informed.into_iter().take(config.proposals).collect();
        let best: Vec<bool> = proposals[p]
            .par_iter()
            .map(|candidate| contestants::run(prep, primitive, Policy::Adaptive, candidate).verdict.success)
            .collect();
        let random = contestants::random(prep, &sampler, primitive, config.random, seed);
        let along = contestants::along_normal(prep, &sampler, primitive, config.random, seed);
        result.trials = vec![
            (Contestant::TopOne, best.first().copied().into_iter().collect()),
            (Contestant::TopK, best),
            (Contestant::Random, random.iter().map(|t| t.verdict.success).collect()),
            (Contestant::AlongNormal, along),
            (Contestant::Informed, informed),
        ];
        random_trials.extend(random);
    }
    let record = prep.record(random_trials);
    let scored = score_record(network, &record, &mut seed.child("score", 0).rng())
        .map_err(|source| EvaluateError::View { scene: index, source })?;
    for (trial, score) in scored {
        if let Some(p) = predictor.config().output_of(trial.primitive) {
            results[p].scored.push((score, trial.verdict.success));
        }
    }
    Ok(SceneResult { category: prep.info.category, object: prep.info.object.clone(), primitives: results })
}

/// The primitives of a report, as its rows name them.
#[must_use]
pub fn names(primitives: &[Primitive]) -> Vec<String> {
    primitives.iter().map(ToString::to_string).collect()
}
