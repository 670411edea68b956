//! Judging weights in simulation: proposals are executed and counted, beside baselines.
//!
//! For every scene and primitive the network's proposals are predicted from the view, at pixels of movable parts only
//! (as published) or anywhere, and executed: the best ones, and some of all of them. Beside it: random pixels and orientations;
//! random pixels with the approach along the normal; and trials that know the joint. A primitive that no trial with
//! that knowledge manages in a scene is not counted there, whoever tries it.

mod contestants;
mod fate;
mod report;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use where2act_core::{Category, Policy, Primitive, Seed, Trial};
use where2act_infer::{Options, Predictor};
use where2act_sim::collect::{CollectError, ObjectSet, Preparer, Recipe, ScenePrep};
use where2act_sim::object::ObjectError;
use where2act_sim::render::Held;
use where2act_sim::sampling::{Candidate, Sampler};

pub use contestants::Contestant;
pub(crate) use contestants::{Wanted, proposals};
pub use fate::Fate;
pub use report::{Judgement, Report, Row};

/// What to judge on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct EvaluateConfig {
    /// Objects to draw scenes from.
    pub objects: ObjectSet,
    /// Scenes.
    pub scenes: u64,
    /// Root of all randomness.
    pub seed: Seed,
    /// Proposals that are executed for each scene and primitive: the best one is top-1, the mean of this many best
    /// ones is top-k, that of as many drawn from all is sampled.
    pub proposals: usize,
    /// Random trials for each scene and primitive: a baseline, and what the score is judged on.
    pub random: usize,
    /// Trials that know the joint, at most, before a primitive counts as impossible in a scene.
    pub informed: usize,
    /// Whether random lights, materials, backgrounds and sensors replace the published look, in three of four scenes as in data.
    pub randomise: bool,
    /// Whether proposals are left out whose hand has no room by the depth map ([`Options::clearance`]).
    ///
    /// [`Options::clearance`]: where2act_infer::Options::clearance
    pub clearance: bool,
    /// Whether proposals may be wherever the view has depth, which the background has not, and fail where nothing moves;
    /// pictures then come without a mask. Otherwise they are kept to movable parts, as published.
    #[serde(default)]
    pub anywhere: bool,
    /// How cameras are held: straight at the object and upright, as published, if nothing is said.
    #[serde(default, skip_serializing_if = "Held::straight")]
    pub held: Held,
    /// Whether the network is told which way is up, as a robot can tell.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub up: bool,
}

impl EvaluateConfig {
    /// The usual numbers for some objects.
    #[must_use]
    pub fn new(objects: ObjectSet, scenes: u64, seed: Seed) -> Self {
        Self {
            objects,
            scenes,
            seed,
            proposals: 5,
            random: 16,
            informed: 200,
            randomise: false,
            clearance: true,
            anywhere: false,
            held: Held::default(),
            up: false,
        }
    }

    fn recipe(&self) -> Recipe {
        Recipe {
            seed: self.seed.child("evaluate", 0),
            objects: self.objects.clone(),
            trials: 0,
            wide: false,
            randomise: self.randomise,
            held: self.held,
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
    /// Someone asked to stop before there was anything to report.
    #[error("interrupted before the first scene was judged; nothing was written")]
    Interrupted,
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
    /// Whether one did whose hand began in view ([`Sampler::begins_in_view`]): what someone can do who stands where the camera
    /// stands and takes no chances behind what it sees.
    pub possible_in_view: bool,
    /// Trials of each contestant, in the order they were made.
    pub trials: Vec<(Contestant, Vec<bool>)>,
    /// What came of the network's best proposals, in the same order.
    pub fates: Vec<Fate>,
    /// (score, outcome) of the random trials.
    pub scored: Vec<(f32, bool)>,
}

/// What came of the number of a scene.
enum Outcome {
    /// The scene was judged.
    Judged(SceneResult),
    /// No scene could be made of this object, or of objects of this category.
    NoScene(String),
    /// This object cannot be loaded.
    Unloadable(String, ObjectError),
    /// Someone asked to stop before.
    Stopped,
}

/// Judges weights on the scenes of a configuration, several at a time: what they propose, and what they say of the hands of
/// random trials ([`Predictor::score`]). `progress` is called with the number of scenes done. After `stop` the report
/// is one of the scenes that were done by then.
///
/// # Errors
/// Any [`EvaluateError`].
pub fn evaluate(
    predictor: &Predictor,
    config: &EvaluateConfig,
    stop: &AtomicBool,
    progress: &(dyn Fn(u64) + Sync),
) -> Result<Report, EvaluateError> {
    let preparer = Preparer::new(config.recipe());
    let judge = Judge { predictor, config, stop };
    let done = AtomicU64::new(0);
    let one = |index: u64| -> Result<Outcome, EvaluateError> {
        if judge.stopped() {
            return Ok(Outcome::Stopped);
        }
        let name = || config.objects.turn(index).unwrap_or_default();
        let outcome = match preparer.prepare(index) {
            Ok(Some(prep)) => judge.scene(index, &prep)?,
            Ok(None) => Outcome::NoScene(name()),
            Err(CollectError::Object(error)) => Outcome::Unloadable(name(), error),
            Err(error) => return Err(error.into()),
        };
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        Ok(outcome)
    };
    let outcomes: Vec<Outcome> =
        (0..config.scenes).into_par_iter().map(one).collect::<Result<_, EvaluateError>>()?;
    let (mut scenes, mut without_scene, mut unloadable) = (Vec::new(), BTreeMap::new(), None);
    for outcome in outcomes {
        match outcome {
            Outcome::Judged(scene) => scenes.push(scene),
            Outcome::NoScene(name) => *without_scene.entry(name).or_insert(0) += 1,
            Outcome::Unloadable(name, error) => {
                tracing::warn!("{error}; its scene is left out");
                *without_scene.entry(name).or_insert(0) += 1;
                unloadable = Some(error);
            }
            Outcome::Stopped => {}
        }
    }
    if scenes.is_empty() {
        if judge.stopped() {
            return Err(EvaluateError::Interrupted);
        }
        if let Some(error) = unloadable {
            return Err(CollectError::Object(error).into());
        }
    }
    Ok(Report::new(predictor, config, &scenes, without_scene))
}

/// What every scene is judged with.
struct Judge<'a> {
    predictor: &'a Predictor,
    config: &'a EvaluateConfig,
    stop: &'a AtomicBool,
}

impl Judge<'_> {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn scene(&self, index: u64, prep: &ScenePrep) -> Result<Outcome, EvaluateError> {
        let Self { predictor, config, .. } = *self;
        let seed = prep.info.seed.child("evaluate", 0);
        let primitives = &predictor.config().primitives;
        let mut results: Vec<PrimitiveResult> = vec![PrimitiveResult::default(); primitives.len()];
        let judged = |primitives| {
            let (category, object) = (prep.info.category, prep.info.object.clone());
            Outcome::Judged(SceneResult { category, object, primitives })
        };
        let Some(sampler) = Sampler::new(&prep.settled, &prep.view) else { return Ok(judged(results)) };
        // All there are, one at each candidate, to draw from.
        let count = config.proposals.max(Options::default().candidates);
        let EvaluateConfig { clearance, anywhere, up, .. } = *config;
        let wanted = Wanted { count, clearance, anywhere, up };
        let proposals = proposals(predictor, prep, &sampler, wanted, seed)
            .map_err(|source| EvaluateError::Predict { scene: index, source })?;
        let mut random: Vec<Trial> = Vec::new();
        for ((&primitive, own), result) in primitives.iter().zip(&proposals).zip(&mut results) {
            if self.stopped() {
                return Ok(Outcome::Stopped);
            }
            random.extend(self.primitive(prep, &sampler, primitive, own, result));
        }
        let scores = contestants::scores(predictor, prep, &random, config, seed)
            .map_err(|source| EvaluateError::Predict { scene: index, source })?;
        for (trial, score) in random.iter().zip(scores) {
            let output = predictor.config().output_of(trial.primitive);
            if let Some(result) = output.and_then(|output| results.get_mut(output)) {
                result.scored.push((score, trial.verdict.success));
            }
        }
        Ok(judged(results))
    }

    /// Lets every contestant try a primitive; `own` are the network's proposals, best first, `None` where nothing
    /// moves. Returns the random trials.
    fn primitive(
        &self,
        prep: &ScenePrep,
        sampler: &Sampler<'_>,
        primitive: Primitive,
        own: &[Option<Candidate>],
        result: &mut PrimitiveResult,
    ) -> Vec<Trial> {
        let config = self.config;
        let seed = prep.info.seed.child("evaluate", 0).child("primitive", primitive as u64);
        let informed =
            contestants::informed(prep, sampler, primitive, [config.proposals, config.informed], seed);
        result.possible = informed.iter().any(|trial| trial.success);
        result.possible_in_view = informed.iter().any(|trial| trial.success && trial.in_view);
        // The first few only: trying until success would make the rate look worse than it is.
        let informed: Vec<bool> = informed.iter().take(config.proposals).map(|trial| trial.success).collect();
        let execute = |candidate: &Candidate| contestants::run(prep, primitive, Policy::Adaptive, candidate);
        let fate = |candidate: &Option<Candidate>| match candidate {
            Some(candidate) => Fate::of(&execute(candidate), &prep.info.freedoms),
            None => Fate::NothingMoves,
        };
        result.fates = own.par_iter().take(config.proposals).map(fate).collect();
        // Who proposes nothing has failed, as often as others try.
        let nothing = if own.is_empty() { config.proposals } else { 0 };
        result.fates.extend(std::iter::repeat_n(Fate::NoProposal, nothing));
        let best: Vec<bool> = result.fates.iter().map(|fate| *fate == Fate::Success).collect();
        let drawn = contestants::draw(own, config.proposals, seed.child("sampled", 0));
        let succeeds = |own: &Option<Candidate>| own.as_ref().is_some_and(|c| execute(c).verdict.success);
        let mut sampled: Vec<bool> = drawn.into_par_iter().map(succeeds).collect();
        sampled.extend(std::iter::repeat_n(false, nothing));
        let random = contestants::random(prep, sampler, primitive, config.random, seed);
        let along = contestants::along_normal(prep, sampler, primitive, config.random, seed);
        result.trials = vec![
            (Contestant::TopOne, best.iter().take(1).copied().collect()),
            (Contestant::TopK, best),
            (Contestant::Sampled, sampled),
            (Contestant::Random, random.iter().map(|t| t.verdict.success).collect()),
            (Contestant::AlongNormal, along),
            (Contestant::Informed, informed),
        ];
        random
    }
}

/// The primitives of a report, as its rows name them.
#[must_use]
pub fn names(primitives: &[Primitive]) -> Vec<String> {
    primitives.iter().map(ToString::to_string).collect()
}
