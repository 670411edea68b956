//! Trains a network: from shards, or from nothing at all.

mod shared;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use burn::tensor::Device;
use clap::Parser;
use clap::builder::PossibleValuesParser;
use indicatif::HumanDuration;
use where2act_core::program::{self, Progress};
use where2act_core::shard::{DEPTH_SIDE, RGB_SIDE};
use where2act_core::{Policy, Primitive, Seed};
use where2act_model::{Modality, Summary};
use where2act_sim::collect::{CollectError, Collector, ObjectSet, Plan, Preparer, Recipe};
use where2act_train::adaptive::Explored;
use where2act_train::evaluate::EvaluateConfig;
use where2act_train::run::{Control, EpochReport, NewTrials, StepReport, TrainError, begins, files, train};
use where2act_train::teacher::Teacher;
use where2act_train::{
    Arithmetic, CollectConfig, Dataset, Folder, TeacherConfig, TrainConfig, adaptive, checkpoint,
    first_weights,
};

use shared::Work;

/// Large buffers are kept for the next step instead of being returned to the system: half of a step's time.
#[global_allocator]
static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();

/// Train a network on interaction trials.
#[derive(Parser)]
#[command(
    version,
    after_help = "Examples:
  train                                             collect a small set, train for minutes, evaluate
  train --config configs/standard.toml --data data/cloud --out runs/cloud
  train --config configs/standard.toml --data data/cloud --out runs/cloud --resume
  train --data data/cloud --modality rgb --steps 2000 --out runs/quick-rgb
  train --config configs/standard.toml --from weights/cloud --looks 0 \\
      --data data/mine --out runs/mine
  RUST_LOG=info train 2> train.log                  without a terminal: a line a minute
  train --modality rgb --encoder resnet18.pth --data data/rgb --out runs/rgb"
)]
struct Args {
    /// TOML file that describes the run.
    #[arg(long, default_value = "configs/quick.toml")]
    config: PathBuf,
    /// Folder of shards, as `collect` writes it; may be given several times, and then all are one data set. Default:
    /// data/NAME, and data/NAME-looks where the configuration wants scenes without trials, collected first if not there.
    #[arg(long)]
    data: Vec<PathBuf>,
    /// Folder of the run: checkpoints, metrics, curves, weights. Default: runs/NAME.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Go on from the newest checkpoint in the run's folder.
    #[arg(long)]
    resume: bool,
    /// Skip damaged shards instead of stopping.
    #[arg(long)]
    skip_damaged: bool,
    /// Another seed than the configuration's.
    #[arg(long)]
    seed: Option<u64>,
    /// Weights to start from instead of random ones, e.g. weights/cloud, to go on with objects of your own. They may be of a
    /// narrower network (network.width), whose knowledge this one then begins with.
    #[arg(long)]
    from: Option<PathBuf>,
    /// Folder of an earlier run on the same data, or its first folders, of either modality, to begin with the trials that it
    /// made between epochs; may be given several times, the newest trials last. Give this run another seed: with one of
    /// theirs it repeats random trials.
    #[arg(long, value_name = "RUN")]
    replay: Vec<PathBuf>,
    /// ResNet-18 under torchvision's names (.pth or .safetensors) to start the encoder from: pictures, width 1.
    #[arg(long, value_name = "FILE", conflicts_with = "from")]
    encoder: Option<PathBuf>,
    /// Weights of a network for scans that says how likely hands are to succeed, e.g. weights/cloud, to learn from beside
    /// trials: for pictures.
    #[arg(long, value_name = "WEIGHTS")]
    teacher: Option<PathBuf>,
    /// Other numbers of steps with trials than the configuration's: all of them, a quarter for the score alone.
    #[arg(long)]
    steps: Option<usize>,
    /// Another number of steps that only look at scenes, before those with trials. 0 where --from has looked already.
    #[arg(long)]
    looks: Option<usize>,
    /// Pictures or scans, instead of what the configuration says.
    #[arg(long, value_parser = ["rgb", "cloud"])]
    modality: Option<String>,
    /// Primitive to learn, instead of those of the configuration; several times for several.
    #[arg(long = "primitive", value_name = "P")]
    primitives: Vec<Primitive>,
    /// No online sampling.
    #[arg(long)]
    no_adaptive: bool,
    /// What the convolutions of a network for pictures multiply in, instead of what the configuration says. bf16 needs AVX-512
    /// with bf16.
    #[arg(long, value_parser = ["f32", "bf16"])]
    precision: Option<String>,
    /// Scenes of the evaluation at the end; 0 = none.
    #[arg(long, default_value_t = 40)]
    episodes: u64,
    /// Backend of burn. ndarray needs a build with `--features ndarray`.
    #[arg(long, default_value = "flex", value_parser = PossibleValuesParser::new(DEVICES))]
    device: String,
    #[command(flatten)]
    work: Work,
}

/// burn's backends that this build has.
const DEVICES: &[&str] = if cfg!(feature = "ndarray") { &["flex", "ndarray"] } else { &["flex"] };

/// The device of one of [`DEVICES`].
#[cfg_attr(feature = "ndarray", expect(deprecated, reason = "asked for by name; burn 0.23 drops it"))]
fn device(name: &str) -> Device {
    match name {
        #[cfg(feature = "ndarray")]
        "ndarray" => Device::ndarray(),
        _ => Device::flex(),
    }
}

fn main() -> ExitCode {
    program::run("train", "error,where2act_sim=warn", |args: Args| run(&args))
}

fn run(args: &Args) -> anyhow::Result<()> {
    let stop = args.work.begin()?;
    let config = configure(args)?;
    let out = args.out.clone().unwrap_or_else(|| Path::new("runs").join(&config.name));
    let holds = |name: &str| out.join(name).exists();
    if !args.resume && [files::CHECKPOINTS, files::LAST, files::WEIGHTS].into_iter().any(holds) {
        bail!("{}: holds a run already, expected an empty folder (or --resume to go on)", out.display());
    }
    // Collecting takes minutes: what cannot be made or read is found out first.
    std::fs::create_dir_all(&out).with_context(|| format!("--out {}", out.display()))?;
    let mut data = args.data.clone();
    if data.is_empty() {
        // A checkpoint has all that a run began with.
        if begins(&out)? {
            check_start(&config)?;
        }
        data = collect(&config, &args.work, &stop)?;
    }
    let dataset = Arc::new(Dataset::open_all(&data, args.skip_damaged)?);
    for damage in &dataset.skipped {
        eprintln!("skipped: {damage}");
    }
    for Folder { path, manifest, shards } in dataset.folders() {
        if (shards.len() as u64) < manifest.shards() {
            eprintln!("{}: {} of its {} shards are there", path.display(), shards.len(), manifest.shards());
        }
    }
    if !args.work.quiet {
        eprintln!("{}", Summary::new(&config.model()));
    }
    let device = device(&args.device);
    let bar = args.work.progress(config.steps() as u64, "training");
    let preparers = preparers(&dataset);
    if let (true, Err(error)) = (config.adaptive.enabled, &preparers) {
        tracing::error!("there will be no online sampling: {error:#}");
    }
    let mut share = Stages::default();
    let mut on_step = |report: &StepReport| {
        share.add(report);
        bar.set_position(report.step as u64);
        bar.set_message(show(report));
        bar.tell(|| {
            let left = share.per_step() * (report.steps - report.step) as f64;
            let left = HumanDuration(Duration::from_secs_f64(left));
            format!("step {} of {}, {left} left: {}", report.step, report.steps, show(report))
        });
    };
    let mut on_epoch = |report: &EpochReport<'_>| {
        bar.say(&show_epoch(report));
        explore(&config, report, preparers.as_deref().ok(), &dataset, &stop, &bar)
    };
    let control = Control { stop: &stop, on_step: &mut on_step, on_epoch: &mut on_epoch };
    let outcome = train(&config, Arc::clone(&dataset), &out, &device, control)?;
    bar.finish_and_clear();
    eprintln!("{}", share.show());
    if !outcome.finished {
        let done = outcome.progress.step;
        bail!("stopped after {done} of {} steps; go on with the same command and --resume", config.steps());
    }
    let Some(weights) = outcome.weights else {
        bail!(
            "{}: no weights, because the run has no step with all heads (schedule.joint_steps)",
            out.display()
        )
    };
    if args.episodes > 0 && config.schedule.joint_steps > 0 {
        judge(&config, &weights, args, &out, &stop)?;
    }
    println!("weights: {}", weights.display());
    if out.join(files::WEIGHTS).is_dir() {
        println!("         {} (best by validation)", out.join(files::WEIGHTS).display());
    }
    println!("curves:  {}", out.join(files::CURVES).display());
    let input = if config.network.modality == Modality::Rgb {
        "examples/cabinet.png"
    } else {
        "examples/cabinet.ply"
    };
    println!("next:    cargo run --bin predict {input} --weights {}", weights.display());
    Ok(())
}

/// The file, with the flags over it.
fn configure(args: &Args) -> anyhow::Result<TrainConfig> {
    let mut config = TrainConfig::load(&args.config)?;
    if let Some(seed) = args.seed {
        config.seed = seed;
    }
    if let Some(from) = &args.from {
        config.from = Some(from.clone());
    }
    if !args.replay.is_empty() {
        config.replay.clone_from(&args.replay);
    }
    if let Some(encoder) = &args.encoder {
        config.encoder = Some(encoder.clone());
    }
    if let Some(weights) = &args.teacher {
        let named = || TeacherConfig::new(weights.clone());
        config.teacher.get_or_insert_with(named).weights.clone_from(weights);
    }
    if let Some(steps) = args.steps {
        config.schedule.score_steps = steps / 4;
        config.schedule.joint_steps = steps - steps / 4;
    }
    if let Some(looks) = args.looks {
        config.schedule.look_steps = looks;
    }
    match args.modality.as_deref() {
        Some("rgb") => config.network.modality = Modality::Rgb,
        Some(_) => config.network.modality = Modality::Cloud,
        None => {}
    }
    if !args.primitives.is_empty() {
        config.network.primitives.clone_from(&args.primitives);
    }
    match args.precision.as_deref() {
        Some("bf16") => config.schedule.precision = Arithmetic::Bf16,
        Some(_) => config.schedule.precision = Arithmetic::F32,
        None => {}
    }
    if args.no_adaptive {
        config.adaptive.enabled = false;
    }
    config.validate()?;
    Ok(config)
}

/// Reads what the run shall start from.
fn check_start(config: &TrainConfig) -> anyhow::Result<()> {
    config.schedule.precision.engine().map_err(TrainError::from)?;
    let flag = if config.encoder.is_some() { "--encoder" } else { "--from" };
    first_weights(config, &config.model(), &Device::flex()).context(flag)?;
    if let Some(teacher) = &config.teacher {
        Teacher::load(teacher, config, &Device::flex()).context("--teacher")?;
    }
    for run in &config.replay {
        if checkpoint::list(&run.join(files::CHECKPOINTS))?.is_empty() {
            bail!("--replay {}: no checkpoints, expected the folder of a run", run.display());
        }
    }
    Ok(())
}

/// Collects what the configuration asks for, or the rest of it: the folders.
fn collect(config: &TrainConfig, work: &Work, stop: &AtomicBool) -> anyhow::Result<Vec<PathBuf>> {
    let CollectConfig { looks, look_objects, scenes, trials, guided, randomise, close } = config.collect;
    let looks = if config.schedule.look_steps > 0 { looks } else { 0 };
    let mut folders = Vec::new();
    let kinds = [("", scenes, trials, ObjectSet::TRAINING_SEEDS), ("-looks", looks, 0, 0..look_objects)];
    for (number, (suffix, scenes, trials, seeds)) in kinds.into_iter().enumerate() {
        if scenes == 0 {
            continue;
        }
        let seed = config.root_seed().child("collect", number as u64);
        let recipe = Recipe {
            seed,
            objects: ObjectSet::training_of(seeds),
            trials,
            guided: f64::from(guided),
            randomise,
            wide: randomise,
            close: f64::from(close),
            picture_side: if config.network.image_side > RGB_SIDE { DEPTH_SIDE } else { RGB_SIDE },
            ..Recipe::default()
        };
        let plan = Plan { resume: true, ..Plan::new(scenes) };
        let folder = Path::new("data").join(format!("{}{suffix}", config.name));
        let hint = "data of another run; use it with --data, or give the configuration another name";
        let collector = Collector::new(&folder, recipe, plan).map_err(|error| match error {
            CollectError::OtherRecipe { .. } => anyhow::Error::new(error).context(hint),
            other => other.into(),
        })?;
        let bar = work.progress(collector.scenes(), "collecting");
        collector.run(stop, &|scenes, collected| {
            let message = format!("successes: {}", collected.tally.successes());
            bar.inc(scenes);
            bar.tell(|| format!("{} of {} scenes, {message}", bar.position(), collector.scenes()));
            bar.set_message(message);
        })?;
        bar.finish_and_clear();
        folders.push(folder);
    }
    Ok(folders)
}

/// What makes the scenes of each folder again.
fn preparers(dataset: &Dataset) -> anyhow::Result<Vec<Preparer>> {
    let of_folder = |folder: &Folder| {
        let recipe = serde_json::from_value(folder.manifest.recipe.clone());
        Ok(Preparer::new(recipe.with_context(|| format!("{}: its recipe", folder.path.display()))?))
    };
    dataset.folders().iter().map(of_folder).collect()
}

/// New trials between epochs of the joint phase.
fn explore(
    config: &TrainConfig,
    report: &EpochReport<'_>,
    preparers: Option<&[Preparer]>,
    dataset: &Dataset,
    stop: &AtomicBool,
    bar: &Progress,
) -> NewTrials {
    let (Some(preparers), true, true) = (preparers, config.adaptive.enabled, report.joint) else {
        return Vec::new();
    };
    let Ok(scenes) = dataset.scenes(where2act_train::Part::Train) else { return Vec::new() };
    let seed = config.root_seed().child("adaptive", report.epoch as u64);
    let done = AtomicUsize::new(0);
    let count = config.adaptive.scenes.min(scenes.len());
    let progress = || {
        let message = format!("exploring scene {}/{count}", 1 + done.fetch_add(1, Ordering::Relaxed));
        bar.tell(|| message.clone());
        bar.set_message(message);
    };
    match adaptive::explore(
        report.network,
        preparers,
        dataset,
        &scenes,
        &config.adaptive,
        seed,
        stop,
        &progress,
    ) {
        Ok(Explored { trials, failed }) => {
            if let Some(first) = failed.first() {
                tracing::error!(
                    "online sampling: {} of {count} scenes gave no trials: {first}",
                    failed.len()
                );
            }
            let show = |policy| {
                let (trials, successes) = adaptive::count(&trials, policy);
                format!("{:.0} % of {trials}", 100.0 * successes as f64 / trials.max(1) as f64)
            };
            let (own, random) = (show(Policy::Adaptive), show(Policy::Random));
            bar.say(&format!("online sampling: {own} own proposals and {random} random trials succeed"));
            trials
        }
        Err(error) => {
            tracing::error!("no new trials: {error}");
            Vec::new()
        }
    }
}

fn judge(
    config: &TrainConfig,
    weights: &Path,
    args: &Args,
    out: &Path,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let objects = ObjectSet::Procedural {
        categories: where2act_sim::collect::categories_of(where2act_core::Split::Train),
        seeds: ObjectSet::TEST_SEEDS,
    };
    let judged =
        EvaluateConfig { informed: 60, ..EvaluateConfig::new(objects, args.episodes, Seed(config.seed)) };
    args.work.judge(weights, &judged, stop, &out.join("evaluation.json"))
}

fn show(report: &StepReport) -> String {
    let mut text = format!("loss {:.3}", report.loss);
    for (name, value) in [
        ("score", report.score),
        ("second", report.second),
        ("angle", report.geodesic),
        ("kl", report.kl),
        ("actionability", report.actionability),
        ("motion", report.motion),
        ("normal", report.normal),
        ("taught", report.taught),
    ] {
        if let Some(value) = value {
            text += &format!(", {name} {value:.3}");
        }
    }
    text
}

/// What validation found: of the score only where there are trials, of the ways only if they are learnt.
fn show_epoch(report: &EpochReport<'_>) -> String {
    let trials: u64 = report.validation.all.iter().map(|metrics| metrics.trials).sum();
    let best = if report.is_best { ", best so far" } else { "" };
    let figure =
        (trials > 0).then(|| format!("mean average precision {:.3}{best}", report.validation.figure));
    let ways = report.ways.map(|ways| format!("ways differ by {ways:.4}"));
    let found: Vec<String> = figure.into_iter().chain(ways).collect();
    if found.is_empty() {
        return format!("step {}", report.step);
    }
    format!("step {}: validation {}", report.step, found.join(", "))
}

/// Seconds by stage, summed.
#[derive(Default)]
struct Stages {
    steps: usize,
    secs: [f64; 4],
}

impl Stages {
    fn add(&mut self, report: &StepReport) {
        let s = report.secs;
        self.steps += 1;
        for (sum, new) in self.secs.iter_mut().zip([s.reading, s.forward, s.backward, s.optimiser]) {
            *sum += new;
        }
    }

    /// Seconds of a step.
    fn per_step(&self) -> f64 {
        self.secs.iter().sum::<f64>() / self.steps.max(1) as f64
    }

    fn show(&self) -> String {
        let total: f64 = self.secs.iter().sum();
        let [reading, forward, backward, optimiser] = self.secs.map(|s| 100.0 * s / total.max(1e-9));
        let step = self.per_step();
        format!(
            "{step:.2} s a step: reading {reading:.1} %, forward {forward:.1} %, backward {backward:.1} %, \
             optimiser {optimiser:.1} %"
        )
    }
}
