//! A whole training run: steps, epochs, validation, checkpoints, and an end that can be resumed.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor};
use serde::Serialize;
use where2act_core::{Policy, Primitive, Seed, Trial, write_whole};
use where2act_model::{Modality, Network, Precision, Summary, WeightsError, save_weights};

use crate::adaptive;
use crate::batch::{Batch, Source};
use crate::checkpoint::{self, CheckpointError, Progress, State};
use crate::config::{BatchConfig, ConfigError, TrainConfig};
use crate::curves::{self, CurvesError};
use crate::dataset::{DataError, Dataset, SceneId};
use crate::replay::Replay;
use crate::split::Part;
use crate::start::{first_trials, first_weights, manifests, optimiser, random_weights, with_scan_radius};
use crate::step::{Losses, Phase, forward};
use crate::teacher::Teacher;
use crate::validate::{Validation, validate};

/// Why a run stopped before its end.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The data cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A checkpoint cannot be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Weights cannot be written.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The picture of the curves cannot be drawn.
    #[error(transparent)]
    Curves(#[from] CurvesError),
    /// A file of a run cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the file system said.
        source: std::io::Error,
    },
    /// The run in this folder is another one.
    #[error("{}: this run has {what}; start another run with --out, or delete the folder", path.display())]
    OtherRun {
        /// The run's folder.
        path: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// Another program trains in this folder.
    #[error("{}: another program is training here; wait for it, or start another run with --out", path.display())]
    Busy {
        /// The run's folder.
        path: PathBuf,
    },
    /// The run whose trials are wanted had other data.
    #[error(
        "{}: expected a run on the same data, or its first folders, with its config.toml as it was, found another",
        path.display()
    )]
    OtherData {
        /// The run's folder.
        path: PathBuf,
    },
    /// The weights to start from are another network's.
    #[error("{}: these weights are of another network: {field} is {found}, expected {expected}", path.display())]
    OtherNetwork {
        /// The weights' folder.
        path: PathBuf,
        /// The first field of the network's description that differs.
        field: String,
        /// What it is in the weights' description.
        found: String,
        /// What the configuration makes of it.
        expected: String,
    },
    /// The teacher cannot teach this network.
    #[error(
        "{}: this network cannot teach: expected one for scans that knows the configuration's \
         primitives, found one for {modality:?} with {}",
        path.display(),
        primitives.iter().map(|p| p.name()).collect::<Vec<_>>().join(", ")
    )]
    OtherTeacher {
        /// The weights' folder.
        path: PathBuf,
        /// What it is for.
        modality: Modality,
        /// What it knows.
        primitives: Vec<Primitive>,
    },
    /// The loss is not a number any more, or far too large, or a weight is no number.
    #[error(
        "step {step}: the loss is {loss}; start another run with a smaller schedule.rate; last good checkpoint: {}",
        last_good.as_deref().unwrap_or(Path::new("none yet")).display()
    )]
    Diverged {
        /// At which step.
        step: usize,
        /// The loss; no number if a weight is none.
        loss: f32,
        /// The newest checkpoint, whose weights are numbers; `None` before the first.
        last_good: Option<PathBuf>,
    },
}

/// Trials that exploration adds to train scenes.
pub type NewTrials = Vec<(SceneId, Vec<Trial>)>;

/// Where training is told to stop, and tells how it goes.
pub struct Control<'a> {
    /// Set by Ctrl-C or SIGTERM: the step under way ends, a checkpoint is written, and the run returns.
    pub stop: &'a AtomicBool,
    /// Called after every step.
    pub on_step: &'a mut dyn FnMut(&StepReport),
    /// Called after every epoch; may return new trials for train scenes.
    pub on_epoch: &'a mut dyn FnMut(&EpochReport<'_>) -> NewTrials,
}

/// How a step went.
#[derive(Clone, Debug, Serialize)]
pub struct StepReport {
    /// Steps done.
    pub step: usize,
    /// Steps in all.
    pub steps: usize,
    /// Weighted sum of the losses.
    pub loss: f32,
    /// Cross-entropy of the score.
    pub score: Option<f32>,
    /// Cross-entropy of the score at second look.
    pub second: Option<f32>,
    /// Angle of the reconstruction, radians.
    pub geodesic: Option<f32>,
    /// Divergence of the code.
    pub kl: Option<f32>,
    /// Squared error of the actionability.
    pub actionability: Option<f32>,
    /// Difference of the ways that points can go.
    pub motion: Option<f32>,
    /// Squared error of the normals.
    pub normal: Option<f32>,
    /// Divergence of the score from what the teacher says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taught: Option<f32>,
    /// Learning rate.
    pub rate: f64,
    /// Seconds by stage.
    pub secs: StageSecs,
}

/// Seconds of one step by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct StageSecs {
    /// Waiting for the batch.
    pub reading: f64,
    /// Forward pass and losses.
    pub forward: f64,
    /// Gradients.
    pub backward: f64,
    /// The optimiser's step.
    pub optimiser: f64,
}

/// How an epoch ended.
#[derive(Debug)]
pub struct EpochReport<'a> {
    /// Steps done.
    pub step: usize,
    /// Whether all heads learn already.
    pub joint: bool,
    /// Number of this epoch, counted from 0.
    pub epoch: usize,
    /// Metrics on validation scenes.
    pub validation: &'a Validation,
    /// How much the ways that places of validation scenes can go differ from those the network tells, if it learns them.
    pub ways: Option<f32>,
    /// Whether these are the best weights so far.
    pub is_best: bool,
    /// The network as it stands, without gradients.
    pub network: &'a Network,
}

/// What a finished or interrupted run leaves.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Whether all steps were done.
    pub finished: bool,
    /// Folder of the newest weights, [`files::LAST`], if an epoch has ended that makes some.
    pub weights: Option<PathBuf>,
    /// Where the run stands.
    pub progress: Progress,
}

/// Losses beyond this mean that the run has left the road.
const EXPLODED: f32 = 1e6;
/// A checkpoint is written at least this often.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(180);
/// Validation looks at so many scenes at most. With 40 trials each, 60 % of them guided, these are some 500 random trials of
/// each primitive, from whose dozen or two successes the threshold of the score comes.
const VALIDATION_SCENES: usize = 192;
/// Batches prepared ahead.
const AHEAD: usize = 2;

/// Names of the files in a run's folder.
pub mod files {
    /// Locked while a program trains in the folder; empty.
    pub const LOCK: &str = ".lock";
    /// The configuration.
    pub const CONFIG: &str = "config.toml";
    /// One JSON line per step and epoch.
    pub const METRICS: &str = "metrics.jsonl";
    /// The picture of the curves.
    pub const CURVES: &str = "curves.png";
    /// Checkpoints.
    pub const CHECKPOINTS: &str = "checkpoints";
    /// The best weights by validation.
    pub const WEIGHTS: &str = "weights";
    /// The weights after the newest epoch: those to take. Validation knows trials that others proposed; what the network
    /// itself proposes goes on getting better when that does not (`weights/EXPERIMENTS.md`).
    pub const LAST: &str = "last";
}

/// Trains in `out` from the data in `dataset`; goes on from the newest checkpoint if there is one.
///
/// # Errors
/// Any [`TrainError`]. What was written before stays.
pub fn train<'a>(
    config: &'a TrainConfig,
    dataset: Arc<Dataset>,
    out: &'a Path,
    device: &Device,
    control: Control<'a>,
) -> Result<Outcome, TrainError> {
    config.validate()?;
    let train_scenes: Arc<[SceneId]> = dataset.scenes(Part::Train)?.into();
    let mut validation_scenes = if config.phase(config.steps() - 1) == Phase::Look {
        dataset.scenes(Part::Validation)?
    } else {
        dataset.require_successes(&train_scenes, &config.network.primitives)?;
        dataset.tried_scenes(Part::Validation)?
    };
    validation_scenes.truncate(VALIDATION_SCENES);

    // Held until the run ends, however it ends.
    let _lock = lock(out)?;
    let fingerprint = prepare_folder(config, &dataset, out)?;
    let model = with_scan_radius(config, &dataset, &train_scenes)?;
    let checkpoints = out.join(files::CHECKPOINTS);
    let newest = checkpoint::list(&checkpoints).map_err(|e| io(&checkpoints, e))?.pop();
    let learning = device.clone().autodiff();
    let learner = match &newest {
        // A checkpoint has all weights; those that the run began with may be gone.
        Some(_) => random_weights(config, &model, &learning),
        None => first_weights(config, &model, &learning)?,
    };
    let fresh = State {
        learner,
        optimiser: optimiser(config),
        replay: Replay::default(),
        progress: Progress { fingerprint: fingerprint.clone(), ..Progress::default() },
    };
    let mut state = match &newest {
        Some(path) => checkpoint::load(path, fresh)?,
        None => State { replay: first_trials(config, &dataset)?, ..fresh },
    };
    if state.progress.fingerprint != fingerprint {
        return Err(TrainError::OtherRun {
            path: out.to_owned(),
            what: "another configuration or other data",
        });
    }
    let teacher =
        config.teacher.as_ref().map(|teacher| Teacher::load(teacher, config, device)).transpose()?;
    let theirs = teacher.as_ref().map(|teacher| teacher.sha256().to_owned());
    if newest.is_some() && state.progress.teacher != theirs {
        return Err(TrainError::OtherRun { path: out.to_owned(), what: "a teacher with other weights" });
    }
    state.progress.teacher = theirs;
    forget_metrics_after(&out.join(files::METRICS), state.progress.step)?;
    let mut run = Run {
        config,
        teacher: teacher.map(Arc::new),
        dataset,
        train_scenes,
        validation_scenes,
        out,
        state,
        last_checkpoint: newest,
        saved_at: Instant::now(),
        control,
    };
    run.finish()
}

struct Run<'a> {
    config: &'a TrainConfig,
    teacher: Option<Arc<Teacher>>,
    dataset: Arc<Dataset>,
    train_scenes: Arc<[SceneId]>,
    validation_scenes: Vec<SceneId>,
    out: &'a Path,
    state: State,
    last_checkpoint: Option<PathBuf>,
    saved_at: Instant,
    control: Control<'a>,
}

impl Run<'_> {
    fn finish(&mut self) -> Result<Outcome, TrainError> {
        let steps = self.config.steps();
        while self.state.progress.step < steps {
            let epoch = self.state.progress.step / self.config.schedule.epoch_steps;
            let end = ((epoch + 1) * self.config.schedule.epoch_steps).min(steps);
            self.steps_until(end)?;
            if self.state.progress.step < end {
                self.save()?;
                return Ok(self.outcome(false));
            }
            self.end_epoch(epoch)?;
            if self.control.stop.load(Ordering::Relaxed) {
                return Ok(self.outcome(self.state.progress.step == steps));
            }
        }
        Ok(self.outcome(true))
    }

    fn outcome(&self, finished: bool) -> Outcome {
        let weights = self.out.join(files::LAST);
        Outcome {
            finished,
            weights: weights.is_dir().then_some(weights),
            progress: self.state.progress.clone(),
        }
    }

    /// Runs steps up to `end` or until told to stop.
    fn steps_until(&mut self, end: usize) -> Result<(), TrainError> {
        let looks = self.config.schedule.look_steps;
        self.steps_of_a_phase(end.min(looks))?;
        if self.state.progress.step >= looks { self.steps_of_a_phase(end) } else { Ok(()) }
    }

    /// Runs steps up to `end` or until told to stop. Batches are prepared on another thread, in order.
    fn steps_of_a_phase(&mut self, end: usize) -> Result<(), TrainError> {
        let replay = Arc::new(self.state.replay.clone());
        let phase = self.config.phase(self.state.progress.step);
        let mut source = Source::new(self.dataset.clone(), &self.train_scenes, replay, self.config, phase);
        source.teacher = self.teacher.clone().filter(|_| phase != Phase::Look);
        let first = self.state.progress.step;
        std::thread::scope(|scope| {
            let (send, receive) = sync_channel(AHEAD);
            scope.spawn(move || {
                for step in first..end {
                    // The receiver hangs up when training stops early.
                    if send.send(source.batch(step)).is_err() {
                        break;
                    }
                }
            });
            for step in first..end {
                if self.control.stop.load(Ordering::Relaxed) {
                    break;
                }
                let began = Instant::now();
                let Ok(batch) = receive.recv() else { break };
                let batch = batch?;
                let reading = began.elapsed().as_secs_f64();
                self.step(step, &batch, reading)?;
                self.state.progress.secs += began.elapsed().as_secs_f64();
                // The end of an epoch saves only after validation and online sampling, which belong to it.
                if self.saved_at.elapsed() > CHECKPOINT_EVERY && step + 1 < end {
                    self.save()?;
                }
            }
            Ok(())
        })
    }

    fn step(&mut self, step: usize, batch: &Batch, reading: f64) -> Result<(), TrainError> {
        let phase = self.config.phase(step);
        let mut rng = self.config.root_seed().child("noise", step as u64).rng();
        let mut secs = StageSecs { reading, ..StageSecs::default() };
        let mut watch = Instant::now();
        let mut lap = || std::mem::replace(&mut watch, Instant::now()).elapsed().as_secs_f64();
        let losses = forward(&self.state.learner, batch, phase, &self.config.loss, &mut rng);
        let total = losses.total(self.config);
        let loss = number(&total);
        secs.forward = lap();
        if !loss.is_finite() || loss > EXPLODED {
            return Err(self.diverged(step, loss));
        }
        let gradients = GradientsParams::from_grads(total.backward(), &self.state.learner);
        secs.backward = lap();
        let rate = self.config.rate(step);
        let learner = self.state.learner.clone();
        self.state.learner = self.state.optimiser.step(rate, learner, gradients);
        secs.optimiser = lap();
        self.state.progress.step = step + 1;
        let report = report(self.config, step + 1, loss, &losses, rate, secs);
        self.log(&report)?;
        (self.control.on_step)(&report);
        Ok(())
    }

    fn end_epoch(&mut self, epoch: usize) -> Result<(), TrainError> {
        self.check_weights()?;
        let network = self.state.learner.network.clone().valid();
        let seed = self.config.root_seed();
        let validation = validate(&network, &self.dataset, &self.validation_scenes, seed)?;
        let joint = self.config.phase(self.state.progress.step - 1) == Phase::Joint;
        let ways = self.ways(seed)?;
        // Proposals and actionability are learnt in the joint phase alone: weights of the first phase cannot be used.
        let is_best = joint && self.state.progress.best.is_none_or(|best| validation.figure > best);
        if is_best {
            self.state.progress.best = Some(validation.figure);
        }
        if joint {
            let card = card(self.config, &self.state.progress, &validation);
            let centred = network.clone().shift_scores(&validation.shifts());
            let save = |folder: &str| save_weights(&self.out.join(folder), &centred, &card, Precision::F16);
            save(files::LAST)?;
            if is_best {
                save(files::WEIGHTS)?;
            }
        } else if self.config.phase(self.config.steps() - 1) == Phase::Look {
            let card = card(self.config, &self.state.progress, &Validation::default());
            save_weights(&self.out.join(files::LAST), &network, &card, Precision::F16)?;
        }
        let step = self.state.progress.step;
        let line =
            serde_json::json!({ "step": step, "epoch": epoch, "validation": validation, "ways": ways });
        self.log(&line)?;
        let (validation, network) = (&validation, &network);
        let report = EpochReport { step, joint, epoch, validation, ways, is_best, network };
        let new = (self.control.on_epoch)(&report);
        if !new.is_empty() {
            let [own, random] =
                [Policy::Adaptive, Policy::Random].map(|policy| adaptive::count(&new, policy));
            self.log(&serde_json::json!({ "step": step, "online": { "own": own, "random": random } }))?;
        }
        for (scene, trials) in new {
            self.state.replay.add(scene, trials);
        }
        curves::draw(&self.out.join(files::METRICS), &self.out.join(files::CURVES))?;
        self.save()
    }

    /// How much the ways that points of validation scenes can go differ from those the features tell.
    fn ways(&self, seed: Seed) -> Result<Option<f32>, TrainError> {
        let learner = self.state.learner.clone().valid();
        if learner.network.heads.motion.is_none() || self.config.loss.motion == 0.0 {
            return Ok(None);
        }
        let mut source = Source::new(
            self.dataset.clone(),
            &self.validation_scenes,
            Arc::default(),
            self.config,
            Phase::Look,
        );
        source.config = BatchConfig { mirrored: 0.0, measured: 0.0, places_per_view: 64, ..source.config };
        let batches = self.validation_scenes.len().div_ceil(source.config.views);
        let mut sum = 0.0;
        for step in 0..batches {
            let batch = source.batch(step)?;
            let losses = forward(&learner, &batch, Phase::Look, &self.config.loss, &mut seed.rng());
            sum += losses.motion.as_ref().map_or(0.0, number);
        }
        Ok(Some(sum / batches as f32))
    }

    fn diverged(&self, step: usize, loss: f32) -> TrainError {
        TrainError::Diverged { step, loss, last_good: self.last_checkpoint.clone() }
    }

    /// The newest weights have not been through a loss yet.
    fn check_weights(&self) -> Result<(), TrainError> {
        let finite = checkpoint::is_finite(&self.state.learner);
        if finite { Ok(()) } else { Err(self.diverged(self.state.progress.step, f32::NAN)) }
    }

    fn save(&mut self) -> Result<(), TrainError> {
        self.check_weights()?;
        self.last_checkpoint = Some(checkpoint::save(&self.out.join(files::CHECKPOINTS), &self.state)?);
        self.saved_at = Instant::now();
        Ok(())
    }

    fn log(&self, line: &impl Serialize) -> Result<(), TrainError> {
        let path = self.out.join(files::METRICS);
        let append = || {
            let mut file = fs::OpenOptions::new().create(true).append(true).open(&path)?;
            let line = serde_json::to_string(line)?;
            writeln!(file, "{line}")
        };
        append().map_err(|e| io(&path, e))
    }
}

pub(crate) fn io(path: &Path, source: std::io::Error) -> TrainError {
    TrainError::Io { path: path.to_owned(), source }
}

fn number(loss: &Tensor<1>) -> f32 {
    loss.clone().into_data().convert::<f32>().as_slice::<f32>().map_or(f32::NAN, |s| s[0])
}

fn report(
    config: &TrainConfig,
    step: usize,
    loss: f32,
    losses: &Losses,
    rate: f64,
    secs: StageSecs,
) -> StepReport {
    let read = |loss: &Option<Tensor<1>>| loss.as_ref().map(number);
    StepReport {
        step,
        steps: config.steps(),
        loss,
        score: read(&losses.score),
        second: read(&losses.second),
        geodesic: read(&losses.geodesic),
        kl: read(&losses.kl),
        actionability: read(&losses.actionability),
        motion: read(&losses.motion),
        normal: read(&losses.normal),
        taught: read(&losses.taught),
        rate,
        secs,
    }
}

/// Keeps other programs out of the run's folder until the file is closed.
fn lock(out: &Path) -> Result<fs::File, TrainError> {
    let path = out.join(files::LOCK);
    let open = || {
        fs::create_dir_all(out)?;
        fs::OpenOptions::new().create(true).write(true).truncate(false).open(&path)
    };
    let file = open().map_err(|e| io(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(TrainError::Busy { path: out.to_owned() }),
        Err(fs::TryLockError::Error(error)) => Err(io(&path, error)),
    }
}

/// Creates the run's folder with its configuration, or checks that it holds the same one.
fn prepare_folder(config: &TrainConfig, dataset: &Dataset, out: &Path) -> Result<String, TrainError> {
    let text = toml::to_string(config).map_err(|e| io(out, std::io::Error::other(e)))?;
    let path = out.join(files::CONFIG);
    match fs::read_to_string(&path) {
        Ok(found) if found == text => {}
        // A run that never came to a checkpoint has nothing to lose.
        Ok(_) if checkpoint::list(&out.join(files::CHECKPOINTS)).is_ok_and(|all| all.is_empty()) => {
            write_whole(&path, |w| w.write_all(text.as_bytes())).map_err(|e| io(&path, e))?;
        }
        Ok(_) => return Err(TrainError::OtherRun { path: out.to_owned(), what: "another configuration" }),
        Err(_) => write_whole(&path, |w| w.write_all(text.as_bytes())).map_err(|e| io(&path, e))?,
    }
    Ok(checkpoint::fingerprint(&text, &manifests(dataset)?.concat()))
}

/// Drops lines of steps that will be done again.
fn forget_metrics_after(path: &Path, step: usize) -> Result<(), TrainError> {
    let Ok(text) = fs::read_to_string(path) else { return Ok(()) };
    let is_kept = |line: &&str| {
        serde_json::from_str::<serde_json::Value>(line)
            .is_ok_and(|value| value["step"].as_u64().is_some_and(|s| s as usize <= step))
    };
    let kept: String = text.lines().filter(is_kept).map(|line| format!("{line}\n")).collect();
    write_whole(path, |w| w.write_all(kept.as_bytes())).map_err(|e| io(path, e))
}

fn card(config: &TrainConfig, progress: &Progress, validation: &Validation) -> String {
    let mut text = format!(
        "# {}\n\nTrained for {} steps ({:.2} hours), seed {}, data and configuration {}.\n\n",
        config.name,
        progress.step,
        progress.secs / 3600.0,
        config.seed,
        &progress.fingerprint[..16]
    );
    text += &format!("Network: {} for each picture or scan.\n\n", Summary::new(&config.model()).total());
    text += "Validation (objects of the training categories that training has not seen, all policies):\n\n";
    text += "| primitive | trials | successes | average precision | F-score | best F-score |\n";
    text += "| --- | --- | --- | --- | --- | --- |\n";
    for (primitive, m) in config.network.primitives.iter().zip(&validation.all) {
        text += &format!(
            "| {primitive} | {} | {} | {:.3} | {:.3} | {:.3} |\n",
            m.trials, m.successes, m.average_precision, m.f_score, m.best_f_score
        );
    }
    text
}
