//! A whole training run: steps, epochs, validation, checkpoints, and an end that can be resumed.

mod error;
mod folder;
mod report;

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use burn::module::Module;
use burn::optim::GradientsParams;
use burn::tensor::Device;
use serde::Serialize;
use where2act_core::{Policy, Seed, Trial};
use where2act_model::{Modality, Precision, TrainingEngine, save_weights};

pub use error::TrainError;
pub(crate) use error::io;
pub use folder::{begins, files};
use folder::{forget_metrics_after, lock, prepare_folder};
pub use report::{EpochReport, Outcome, StageSecs, StepReport};
use report::{card, number, report};

use crate::adaptive;
use crate::batch::{Batch, Source};
use crate::checkpoint::{self, Progress, State};
use crate::config::{BatchConfig, ScheduleConfig, TrainConfig};
use crate::curves;
use crate::dataset::{Dataset, SceneId, spread};
use crate::mean::towards;
use crate::probes::Learner;
use crate::replay::Replay;
use crate::split::Part;
use crate::start::{first_trials, first_weights, optimiser, random_weights, with_scan_radius};
use crate::step::{Phase, forward};
use crate::teacher::Teacher;
use crate::validate::{Validation, score_scenes, shifted};

/// Trials that exploration adds to train scenes.
pub type NewTrials = Vec<(SceneId, Vec<Trial>)>;

/// Where training is told to stop, and tells how it goes.
pub struct Control<'a> {
    /// Set by Ctrl-C or SIGTERM: the step under way ends, a checkpoint is written, and the run returns. What ends an epoch is
    /// given up for that; it comes after the epoch's last step, which is done again.
    pub stop: &'a AtomicBool,
    /// Called after every step.
    pub on_step: &'a mut dyn FnMut(&StepReport),
    /// Called after every epoch; may return new trials for train scenes.
    pub on_epoch: &'a mut dyn FnMut(&EpochReport<'_>) -> NewTrials,
}

/// Losses beyond this mean that the run has left the road.
const EXPLODED: f32 = 1e6;
/// A checkpoint is written at least this often.
const CHECKPOINT_EVERY: Duration = Duration::from_secs(180);
/// Validation looks at so many scenes at most, the same ones every time. The threshold of the score is settled after the last
/// step by all of them: by the successes among random trials, of which forty trials a scene, 60 % of them guided, bring few.
const VALIDATION_SCENES: usize = 192;
/// Batches prepared ahead.
const AHEAD: usize = 2;

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
    let engine = config.schedule.precision.engine()?;
    if config.network.modality == Modality::Rgb {
        dataset.require_pictures(config.network.image_side)?;
    }
    let train_scenes: Arc<[SceneId]> = dataset.scenes(Part::Train)?.into();
    let validation_scenes = if config.phase(config.steps() - 1) == Phase::Look {
        dataset.scenes(Part::Validation)?
    } else {
        dataset.require_successes(&train_scenes, &config.network.primitives)?;
        dataset.tried_scenes(Part::Validation, &config.network.primitives)?
    };

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
        mean: (config.schedule.mean_steps > 0).then(|| learner.valid()),
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
        engine,
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
    engine: TrainingEngine,
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
            if !self.end_epoch(epoch)? {
                let mut outcome = self.outcome(false);
                outcome.progress.step -= 1;
                return Ok(outcome);
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

    fn is_stopped(&self) -> bool {
        self.control.stop.load(Ordering::Relaxed)
    }

    /// Runs steps up to `end` or until told to stop.
    fn steps_until(&mut self, end: usize) -> Result<(), TrainError> {
        let looks = self.config.schedule.look_steps;
        if self.state.progress.step < looks {
            self.steps_of_a_phase(end.min(looks), end)?;
        }
        if self.state.progress.step >= looks { self.steps_of_a_phase(end, end) } else { Ok(()) }
    }

    /// Runs steps up to `end`, in an epoch that ends at `epoch_end`, or until told to stop. Batches are prepared on another
    /// thread, in order.
    fn steps_of_a_phase(&mut self, end: usize, epoch_end: usize) -> Result<(), TrainError> {
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
                if self.is_stopped() {
                    break;
                }
                let began = Instant::now();
                let Ok(batch) = receive.recv() else { break };
                let batch = batch?;
                let reading = began.elapsed().as_secs_f64();
                self.step(step, &batch, reading)?;
                self.state.progress.secs += began.elapsed().as_secs_f64();
                // The end of an epoch saves only after validation and online sampling, which belong to it. Whoever stops those
                // goes on from the step before.
                let due = self.saved_at.elapsed() > CHECKPOINT_EVERY || step + 2 == epoch_end;
                if due && step + 1 < epoch_end {
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
        let learner = &self.state.learner;
        let losses = self.engine.scope(|| forward(learner, batch, phase, &self.config.loss, &mut rng));
        let total = losses.total(self.config);
        let loss = total.as_ref().map_or(0.0, number);
        secs.forward = lap();
        if !loss.is_finite() || loss > EXPLODED {
            return Err(self.diverged(step, loss));
        }
        let rate = self.config.rate(step);
        // Few views with few trials may have none left that is to be seen.
        if let Some(total) = total {
            let gradients = GradientsParams::from_grads(total.backward(), &self.state.learner);
            secs.backward = lap();
            let learner = self.state.learner.clone();
            self.state.learner = self.state.optimiser.step(rate, learner, gradients);
            self.state.mean = self.state.mean.take().map(|mean| self.mean_after(step, mean));
            secs.optimiser = lap();
        }
        self.state.progress.step = step + 1;
        let report = report(self.config, step + 1, loss, &losses, rate, secs);
        self.log(&report)?;
        (self.control.on_step)(&report);
        Ok(())
    }

    /// The mean of the weights after each of the last steps with all heads, the newest of all if this is none of them.
    fn mean_after(&self, step: usize, mean: Learner) -> Learner {
        let ScheduleConfig { look_steps, score_steps, mean_steps, .. } = self.config.schedule;
        let steps = (step + 1).saturating_sub(look_steps + score_steps).clamp(1, mean_steps);
        towards(mean, &self.state.learner.valid(), 1.0 / steps as f64)
    }

    /// Validates, keeps the weights, explores and saves; `false` if told to stop before that was done, and then nothing is
    /// saved.
    fn end_epoch(&mut self, epoch: usize) -> Result<bool, TrainError> {
        self.check_weights()?;
        let learner = self.state.mean.clone().unwrap_or_else(|| self.state.learner.valid());
        let network = learner.network.clone();
        let seed = self.config.root_seed();
        let phase = self.config.phase(self.state.progress.step - 1);
        let joint = phase == Phase::Joint;
        // Looking does not teach the score.
        let step = self.state.progress.step;
        let score = |most: usize| {
            let scenes: Vec<SceneId> = spread(&self.validation_scenes, most).copied().collect();
            score_scenes(&network, &self.dataset, &scenes, seed)
        };
        let scored = (phase != Phase::Look).then(|| score(VALIDATION_SCENES)).transpose()?;
        let judged = scored.as_ref().map(|scored| Validation::new(&network, scored));
        let ways = self.ways(&learner, seed)?;
        if self.is_stopped() {
            return Ok(false);
        }
        self.log(&serde_json::json!({ "step": step, "epoch": epoch, "validation": judged, "ways": ways }))?;
        let validation = judged.unwrap_or_default();
        // Proposals and actionability are learnt in the joint phase alone: weights of the phases before cannot be used.
        let is_best = joint && self.state.progress.best.is_none_or(|best| validation.figure > best);
        if is_best {
            self.state.progress.best = Some(validation.figure);
        }
        if joint {
            let last = step == self.config.steps();
            let scored = if last { score(usize::MAX)? } else { scored.unwrap_or_default() };
            let shifts = Validation::new(&network, &scored).shifts();
            let centred = network.clone().shift_scores(&shifts);
            let scored = shifted(&network, &scored, &shifts);
            let card = card(self.config, &self.state.progress, &Validation::new(&network, &scored));
            let save = |folder: &str| save_weights(&self.out.join(folder), &centred, &card, Precision::F16);
            save(files::LAST)?;
            if is_best {
                save(files::WEIGHTS)?;
            }
        } else if self.config.phase(self.config.steps() - 1) == Phase::Look {
            let card = card(self.config, &self.state.progress, &validation);
            save_weights(&self.out.join(files::LAST), &network, &card, Precision::F16)?;
        }
        let (validation, network) = (&validation, &network);
        let report = EpochReport { step, joint, epoch, validation, ways, is_best, network };
        let new = (self.control.on_epoch)(&report);
        if self.is_stopped() {
            return Ok(false);
        }
        if !new.is_empty() {
            let [own, random] =
                [Policy::Adaptive, Policy::Random].map(|policy| adaptive::count(&new, policy));
            self.log(&serde_json::json!({ "step": step, "online": { "own": own, "random": random } }))?;
        }
        for (scene, trials) in new {
            self.state.replay.add(scene, trials);
        }
        curves::draw(&self.out.join(files::METRICS), &self.out.join(files::CURVES))?;
        self.save()?;
        Ok(true)
    }

    /// How much the ways that points of validation scenes can go differ from those the features tell.
    fn ways(&self, learner: &Learner, seed: Seed) -> Result<Option<f32>, TrainError> {
        if learner.network.heads.motion.is_none() || self.config.loss.motion == 0.0 {
            return Ok(None);
        }
        let scenes: Vec<SceneId> = spread(&self.validation_scenes, VALIDATION_SCENES).copied().collect();
        let mut source = Source::new(self.dataset.clone(), &scenes, Arc::default(), self.config, Phase::Look);
        source.config =
            BatchConfig { mirrored: 0.0, rolled: 0.0, measured: 0.0, places_per_view: 64, ..source.config };
        let batches = scenes.len().div_ceil(source.config.views);
        let mut sum = 0.0;
        for step in 0..batches {
            let batch = source.batch(step)?;
            let losses = forward(learner, &batch, Phase::Look, &self.config.loss, &mut seed.rng());
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
