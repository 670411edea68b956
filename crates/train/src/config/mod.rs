//! One validated description of a training run: a TOML file, with command-line flags over it.

mod checks;
mod layers;

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use where2act_core::shard::RGB_SIDE;
use where2act_core::{Primitive, Seed};
use where2act_kernels::Isa;
use where2act_model::{EngineError, Modality, ModelConfig, TrainingEngine};

pub use checks::ConfigError;

use crate::step::Phase;

/// Everything that decides the result of a training run. Saved beside the checkpoints; resuming with another one is
/// refused.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainConfig {
    /// Name of the run and of its weights.
    pub name: String,
    /// Everything random derives from it.
    #[serde(default)]
    pub seed: u64,
    /// Weights to start from instead of random ones: the folder of a network of the same shape, e.g. `weights/cloud`.
    /// It may lack a second look and the head for ways, and its actionability may be of another size; these start at random.
    /// Its backbone may be narrower: see `Network::with_tensors_of`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from: Option<PathBuf>,
    /// Folders of earlier runs on the same data or the first folders of it, of either modality, whose newest online trials, as
    /// many as `adaptive.buffer` holds, this run begins with; those of the last one are the newest. Give it a seed that none
    /// of them had: with the same one it repeats that run's random trials.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub replay: Vec<PathBuf>,
    /// A ResNet-18 under torchvision's names, safetensors or PyTorch's own format, to start the encoder of a network for
    /// pictures from instead of random weights; everything else starts at random. Of width 1, as ResNet-18 is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub encoder: Option<PathBuf>,
    /// The network.
    pub network: NetworkConfig,
    /// What one step sees.
    #[serde(default)]
    pub batch: BatchConfig,
    /// How long, and how fast the rate falls.
    pub schedule: ScheduleConfig,
    /// Weights of the losses.
    #[serde(default)]
    pub loss: LossConfig,
    /// A trained network for scans that says how likely hands are to succeed, for a network for pictures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teacher: Option<TeacherConfig>,
    /// New trials where the network is confident.
    #[serde(default)]
    pub adaptive: AdaptiveConfig,
    /// What to collect if there is no data.
    #[serde(default)]
    pub collect: CollectConfig,
}

/// The network to train.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkConfig {
    /// Pictures or scans.
    pub modality: Modality,
    /// One output of each head for every one of these.
    #[serde(default = "all_primitives")]
    pub primitives: Vec<Primitive>,
    /// Width of the backbone; 1 is the paper's.
    #[serde(default = "one")]
    pub width: f32,
    /// Hidden units of each head; the paper's is 128.
    #[serde(default = "published_hidden")]
    pub hidden: usize,
    /// Hidden units of the actionability alone, which runs at every pixel, if not as many as in the other heads.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actionability_hidden: Option<usize>,
    /// Numbers of the proposals' random code; the paper's is 10.
    #[serde(default = "published_latent")]
    pub latent: usize,
    /// Points of a scan; the paper's is 10,000.
    #[serde(default = "published_points")]
    pub points: usize,
    /// Random foreground points that furthest point sampling chooses from; the paper's is 30,000. No more than `points`
    /// means plain random sampling, which is faster and follows the scanner's own density.
    #[serde(default = "published_candidates")]
    pub candidates: usize,
    /// Whether every point of a scan is also described by what is right around it among the candidates. Not in the
    /// paper.
    #[serde(default)]
    pub surroundings: bool,
    /// Directions that the score head predicts at each pixel or point, to see how well a hand is aligned with them. The
    /// paper has none.
    #[serde(default)]
    pub alignments: usize,
    /// Whether the best proposals for a scan are scored once more, from the scan as the hand would see it. Not in the paper.
    #[serde(default)]
    pub second_look: bool,
    /// Side of the square picture that the network sees, pixels, a multiple of 32; the paper's is 224. Larger ones are learnt
    /// from data of `collect --picture-side 448`, and cost as much more as they have more pixels.
    #[serde(default = "published_image_side", skip_serializing_if = "is_published_image_side")]
    pub image_side: usize,
    /// If a picture comes with a mask, the network is shown the square around it, larger than the mask's larger extent by this
    /// factor, where it is asked for proposals. Training and validation show pictures as they were collected, whole; those of
    /// `collect --close` are such squares, 1.05 to 1.79 times as large as the object. The paper's network sees whole pictures.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub close_up: Option<f32>,
    /// How much it matters to a score whether the joint gives where the hand wants to go, in logits, if the features are
    /// asked for the ways of points at all; 0 asks without consequence. The paper has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ways: Option<f32>,
}

/// What one step sees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BatchConfig {
    /// Views of a step.
    pub views: usize,
    /// Trials of a view at most; successes and failures of each primitive half and half as far as they last.
    pub trials_per_view: usize,
    /// Share of the trials that get a free negative: the same with the approach flipped, which cannot succeed. The paper's: 1.
    pub flipped: f32,
    /// Share of the trials that get another: the same orientation at a random place of a part that does not move or, in
    /// pictures, of the background, a third of them right beside an outline. 0 leaves such places out altogether, as the paper
    /// does.
    pub fixed: f32,
    /// Share of the views that are shown mirrored.
    pub mirrored: f32,
    /// Share of the views whose camera is not upright: rolled about its axis by up to 20 degrees. A picture is turned about its
    /// middle; what comes into it repeats its border, and what leaves it is not asked about.
    pub rolled: f32,
    /// Whether hands that push or pull are turned half round about their approach at random, which changes nothing.
    pub half_turns: bool,
    /// Further places of a view at which only actionability is learnt, and what the scene knows. Of those on parts that move,
    /// half are drawn by pixel and half by part.
    pub places_per_view: usize,
    /// Places of a view in the steps that only look.
    pub looks_per_view: usize,
    /// Share of the scans that are seen as through a depth camera, with noise and holes. The paper's are rendered.
    pub measured: f32,
}

/// How long, and how fast the rate falls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduleConfig {
    /// Steps in which the backbone alone learns, from what the scene knows without any trial: which ways points can go and
    /// where surfaces face. The paper has none.
    #[serde(default)]
    pub look_steps: usize,
    /// Steps in which backbone and score head learn alone.
    pub score_steps: usize,
    /// Steps in which all heads learn.
    pub joint_steps: usize,
    /// Steps of one epoch: after each one comes validation, a checkpoint and, if enabled, adaptive sampling.
    pub epoch_steps: usize,
    /// Steps with all heads whose weights are averaged, the last ones most: what is validated, saved and explored with is the
    /// running mean `mean + (newest - mean) / mean_steps`, of fewer steps before there are so many. 0 = the newest weights (the
    /// paper).
    #[serde(default, skip_serializing_if = "no_steps")]
    pub mean_steps: usize,
    /// What turns gradients into steps: Adam unless said otherwise. Steps of both are about as large, so `rate` may stay.
    #[serde(default, skip_serializing_if = "Optimiser::is_adam")]
    pub optimiser: Optimiser,
    /// What the convolutions of a network for pictures multiply in: f32 unless said otherwise.
    #[serde(default, skip_serializing_if = "Arithmetic::is_f32")]
    pub precision: Arithmetic,
    /// Learning rate at the start.
    #[serde(default = "published_rate")]
    pub rate: f64,
    /// Learning rate of the steps with trials, after those that only look, before it falls; `rate` unless said otherwise. A
    /// high one spoils what the looks have taught.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trial_rate: Option<f64>,
    /// Decay of the weights towards zero.
    #[serde(default = "published_weight_decay")]
    pub weight_decay: f32,
    /// How the rate falls.
    #[serde(default)]
    pub decay: Decay,
}

/// How the learning rate falls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "lowercase")]
pub enum Decay {
    /// Multiplied by `factor` every `steps` steps, counted from the first step of all. The paper's: 0.9 every 5,000.
    Step {
        /// Steps between two falls.
        steps: usize,
        /// Multiplied with the rate.
        factor: f64,
    },
    /// Half a cosine from the full rate to a hundredth at the last step, and another one before it from the first look
    /// to the last.
    Cosine,
}

/// Weights of the losses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Binary cross-entropy of the score.
    pub score: f32,
    /// Angle between a proposal and the successful orientation it should reconstruct.
    pub geodesic: f32,
    /// Divergence of the proposal's code from the normal distribution.
    pub kl: f32,
    /// Squared error of the actionability. Where nothing moves there is none to learn but zero.
    pub actionability: f32,
    /// Proposals whose scores make the actionability's target.
    pub proposals: usize,
    /// How many of the best of them are averaged; 0 = all (the paper), 5 = the follow-up's rule.
    pub best: usize,
    /// Difference of the ways that points can go from those the network's features tell. 0 = not asked (the paper).
    pub motion: f32,
    /// Squared error of the surface's normal that the network's features tell. 0 = not asked (the paper).
    pub normal: f32,
}

fn no_steps(steps: &usize) -> bool {
    *steps == 0
}

fn is_zero(number: &f32) -> bool {
    *number == 0.0
}

/// Who teaches a network for pictures, and how much.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TeacherConfig {
    /// Folder of the weights of a network for scans that knows the same primitives, e.g. `weights/cloud`.
    pub weights: PathBuf,
    /// Places of a view that it talks about in the steps with trials, at most: a third of them at most those of trials, the
    /// others places on parts that move, of which `batch.places_per_view` offers half as many as its number, or all of them if
    /// `batch.fixed` is 0. Default: 64.
    #[serde(default = "taught_places")]
    pub places: usize,
    /// Weight of the loss: divergence of the score from what the teacher says. Default: 1, the weight of what trials say.
    #[serde(default = "one")]
    pub weight: f32,
}

impl TeacherConfig {
    /// Everything but the folder as it is by default.
    #[must_use]
    pub fn new(weights: PathBuf) -> Self {
        Self { weights, places: taught_places(), weight: one() }
    }
}

fn taught_places() -> usize {
    64
}

/// New trials where the network is confident, between epochs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AdaptiveConfig {
    /// Whether to do it.
    pub enabled: bool,
    /// Train scenes that get new trials after each epoch of the joint phase.
    pub scenes: usize,
    /// New trials on each of them.
    pub trials: usize,
    /// Share of them that are the network's own best proposals; the others are random. The paper's: a half.
    pub own: f32,
    /// Trials of the replay buffer; older ones are forgotten first. The paper's: 10,000.
    pub buffer: usize,
    /// Share of a step's views that show scenes of the last eight rounds. They show where the network is wrong now, and would
    /// hardly come once among all scenes before it is another.
    #[serde(skip_serializing_if = "is_zero")]
    pub newest: f32,
}

/// What to collect if there is no data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CollectConfig {
    /// Further scenes without trials, for the steps that only look.
    pub looks: u64,
    /// Generated objects of each category that these scenes draw from, where trials draw from a thousand.
    pub look_objects: u64,
    /// Scenes.
    pub scenes: u64,
    /// Trials on each.
    pub trials: usize,
    /// Share of guided trials; the paper has none.
    pub guided: f32,
    /// Random lights, shadows, materials, backgrounds and cameras.
    pub randomise: bool,
    /// Share of the scenes, with trials and without, whose camera zooms in on the object, for `network.close_up`.
    #[serde(skip_serializing_if = "is_zero")]
    pub close: f32,
}

impl Default for BatchConfig {
    fn default() -> Self {
        Self {
            views: 8,
            trials_per_view: 48,
            flipped: 0.25,
            fixed: 0.0,
            mirrored: 0.0,
            rolled: 0.0,
            half_turns: false,
            places_per_view: 16,
            looks_per_view: 128,
            measured: 0.0,
        }
    }
}

/// What turns gradients into steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optimiser {
    /// Adam for all parameters (the paper).
    #[default]
    Adam,
    /// Muon (Jordan et al., 2024) for the weights of the backbone's layers, with steps about as large as Adam's; Adam for
    /// the rest.
    Muon,
}

impl Optimiser {
    fn is_adam(&self) -> bool {
        *self == Self::Adam
    }
}

/// What convolutions multiply in while they learn; all else is f32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Arithmetic {
    /// What weights are kept in, too.
    #[default]
    F32,
    /// Operands rounded to 8 bits, sums in f32. Needs AVX-512 with bf16; on AMD's Zen 5 a step is sooner done.
    Bf16,
}

impl Arithmetic {
    fn is_f32(&self) -> bool {
        *self == Self::F32
    }

    /// What computes the steps.
    ///
    /// # Errors
    /// [`EngineError::NoBf16`].
    pub fn engine(self) -> Result<TrainingEngine, EngineError> {
        match self {
            Self::F32 => Ok(TrainingEngine::Fast),
            Self::Bf16 => Isa::bf16().map(|_| TrainingEngine::Bf16).ok_or(EngineError::NoBf16),
        }
    }
}

impl Default for Decay {
    fn default() -> Self {
        Self::Step { steps: 5000, factor: 0.9 }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self {
            score: 1.0,
            geodesic: 5.0,
            kl: 0.02,
            actionability: 100.0,
            proposals: 100,
            best: 0,
            motion: 0.0,
            normal: 0.0,
        }
    }
}

impl Default for AdaptiveConfig {
    fn default() -> Self {
        Self { enabled: false, scenes: 64, trials: 24, own: 0.5, buffer: 10_000, newest: 0.0 }
    }
}

impl Default for CollectConfig {
    fn default() -> Self {
        Self {
            looks: 0,
            look_objects: 1000,
            scenes: 160,
            trials: 48,
            guided: 0.6,
            randomise: false,
            close: 0.0,
        }
    }
}

fn all_primitives() -> Vec<Primitive> {
    Primitive::ALL.to_vec()
}
fn one() -> f32 {
    1.0
}
fn published_hidden() -> usize {
    128
}
fn published_latent() -> usize {
    10
}
fn published_points() -> usize {
    10_000
}
fn published_candidates() -> usize {
    30_000
}
fn published_image_side() -> usize {
    RGB_SIDE
}
fn is_published_image_side(side: &usize) -> bool {
    *side == RGB_SIDE
}
fn published_rate() -> f64 {
    1e-3
}
fn published_weight_decay() -> f32 {
    1e-5
}

impl TrainConfig {
    /// Reads and checks a TOML file. If it names a `base`, a file beside it, what it says goes over what that one says, field
    /// by field.
    ///
    /// # Errors
    /// Any [`ConfigError`].
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        let config: Self =
            layers::read(path)?.try_into().map_err(|error| ConfigError::syntax(path, &error))?;
        config.validate()?;
        Ok(config)
    }

    /// All steps.
    #[must_use]
    pub fn steps(&self) -> usize {
        let ScheduleConfig { look_steps, score_steps, joint_steps, .. } = self.schedule;
        look_steps + score_steps + joint_steps
    }

    /// What is learnt in a step.
    #[must_use]
    pub fn phase(&self, step: usize) -> Phase {
        let ScheduleConfig { look_steps, score_steps, .. } = self.schedule;
        match step {
            _ if step < look_steps => Phase::Look,
            _ if step < look_steps + score_steps => Phase::Score,
            _ => Phase::Joint,
        }
    }

    /// The root of the run's randomness.
    #[must_use]
    pub fn root_seed(&self) -> Seed {
        Seed(self.seed)
    }

    /// The network's own description.
    #[must_use]
    pub fn model(&self) -> ModelConfig {
        let n = &self.network;
        let mut model = ModelConfig::new(n.modality, &n.primitives).with_points(n.points);
        model.width = n.width;
        model.name.clone_from(&self.name);
        model.hidden = n.hidden;
        model.actionability_hidden = n.actionability_hidden;
        model.latent = n.latent;
        model.alignments = n.alignments;
        model.surroundings = n.surroundings && n.modality == Modality::Cloud;
        model.second_look = n.second_look && n.modality == Modality::Cloud;
        model.ways = n.ways;
        model.preprocessing.scan_candidates = n.candidates;
        model.preprocessing.image_side = n.image_side;
        model.preprocessing.close_up = n.close_up.filter(|_| n.modality == Modality::Rgb);
        model
    }

    /// Learning rate of a step.
    #[must_use]
    pub fn rate(&self, step: usize) -> f64 {
        let schedule = &self.schedule;
        let looks = schedule.look_steps;
        let rate = if step < looks { schedule.rate } else { schedule.trial_rate.unwrap_or(schedule.rate) };
        match schedule.decay {
            Decay::Step { steps, factor } => rate * factor.powi((step / steps.max(1)) as i32),
            Decay::Cosine => {
                let (first, end) = if step < looks { (0, looks) } else { (looks, self.steps()) };
                let done = (step - first) as f64 / (end - first).max(1) as f64;
                let share = 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
                rate * (0.01 + 0.99 * share)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn minimal() -> String {
        "name = 'test'\n[network]\nmodality = 'cloud'\n[schedule]\nscore_steps = 10\njoint_steps = 30\nepoch_steps = 5\n"
            .to_owned()
    }

    pub(super) fn load(text: &str) -> Result<TrainConfig, ConfigError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.toml");
        std::fs::write(&path, text).unwrap();
        TrainConfig::load(&path)
    }

    #[test]
    fn defaults_are_the_published_numbers() {
        let config = load(&minimal()).unwrap();
        assert_eq!(config.network.points, 10_000);
        assert!((config.rate(0) - 1e-3).abs() < 1e-12 && (config.rate(5000) - 9e-4).abs() < 1e-12);
        assert_eq!(toml::from_str::<TrainConfig>(&toml::to_string(&config).unwrap()).unwrap(), config);
    }

    #[test]
    fn steps_with_trials_may_have_a_rate_of_their_own() {
        let schedule =
            "[loss]\nnormal = 1.0\n[schedule]\nlook_steps = 20\ntrial_rate = 1e-4\ndecay = 'cosine'";
        let text = minimal().replace("[schedule]", schedule);
        let config = load(&text).unwrap();
        let near = |step, rate: f64| (config.rate(step) / rate - 1.0).abs() < 1e-9;
        assert!(near(0, 1e-3) && near(10, 0.505e-3) && near(20, 1e-4) && near(40, 0.505e-4));
    }

    #[test]
    fn the_configurations_of_the_repository_are_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs");
        let mut names = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap() {
            names.push(TrainConfig::load(&entry.unwrap().path()).unwrap().name);
        }
        names.sort();
        assert_eq!(
            names,
            [
                "paper-pushing",
                "quick-cloud",
                "where2act-cloud",
                "where2act-cloud",
                "where2act-cloud",
                "where2act-cloud",
                "where2act-rgb",
                "where2act-rgb-close"
            ]
        );
    }
}
