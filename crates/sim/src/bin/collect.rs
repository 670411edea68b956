//! `collect`: makes a data set of settled scenes, views and trials.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Parser;
use where2act_core::program::{self, Progress};
use where2act_core::shard::{DEPTH_SIDE, RGB_SIDE};
use where2act_core::{Category, Primitive, Seed};
use where2act_sim::collect::{Collected, Collector, ObjectSet, Part, Plan, Recipe, categories_of};

/// Collects scenes and interaction trials into shards.
///
/// A scene is one view of one settled object; its trials take turns over the primitives. The result depends on the
/// arguments alone: not on the number of threads, on interruptions, or on how work is split over machines.
#[derive(Parser)]
#[command(
    version,
    max_term_width = 110,
    after_help = "\
Examples:
  collect --scenes 200 --trials 48 --out data/train
  collect --scenes 200 --trials 48 --out data/train --resume
  collect --scenes 64 --trials 60 --guided 0 --object-seeds 1000000..1000100 --out data/test
  collect --objects data/partnet --categories Door,Safe --scenes 100 --trials 48 --out data/real
  collect --scenes 10000 --trials 48 --out data/big --shard 0/2     (and 1/2 on another machine)"
)]
struct Cli {
    /// `procedural`, or a folder with `<Category>/<id>/mobility.urdf` (or one other .urdf file), or `<id>` alone.
    #[arg(long, default_value = "procedural", value_name = "procedural|DIR")]
    objects: String,
    /// Categories to draw from [default: the ten training categories; for a folder, all in it].
    #[arg(long, value_delimiter = ',', value_name = "NAME,...")]
    categories: Vec<Category>,
    /// Seeds of the generated objects; disjoint ranges are disjoint objects [default: 0..1000].
    #[arg(long, value_name = "A..B", value_parser = seed_range)]
    object_seeds: Option<std::ops::Range<u64>>,
    /// Number of scenes.
    #[arg(long, value_name = "N")]
    scenes: u64,
    /// Trials in every scene.
    #[arg(long, value_name = "M", default_value_t = 48)]
    trials: usize,
    /// Primitives to try [default: all six].
    #[arg(long, value_delimiter = ',', value_name = "NAME,...")]
    primitives: Vec<Primitive>,
    /// Folder for shards and manifest.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Share of trials by the guided policy; the others are random, as published.
    #[arg(long, default_value_t = 0.5, value_name = "FRACTION", value_parser = fraction)]
    guided: f64,
    /// Cameras from a wide range of distances, heights and fields of view.
    #[arg(long)]
    wide: bool,
    /// Share of the scenes whose camera zooms in on the object, for networks for pictures.
    #[arg(long, default_value_t = 0.0, value_name = "FRACTION", value_parser = fraction)]
    close: f64,
    /// Random lights, shadows, materials, some of them wood, backgrounds and sensor noise, for networks that shall work on photos.
    #[arg(long)]
    randomise: bool,
    /// Share of the scenes whose object is stretched along its axes and perhaps lies on its side.
    #[arg(long, default_value_t = 0.0, value_name = "FRACTION", value_parser = fraction)]
    varied: f64,
    /// Side of the pictures that are kept, pixels; what is rendered has 448. Networks with a larger `network.image_side` than 224
    /// learn from larger ones.
    #[arg(long, default_value_t = RGB_SIDE, value_name = "224|448", value_parser = picture_side)]
    picture_side: usize,
    /// Simulate every step at 500 Hz: three times slower, the same outcome in nearly all trials.
    #[arg(long)]
    faithful: bool,
    /// Make only shards k with k % N == I.
    #[arg(long, default_value = "0/1", value_name = "I/N")]
    shard: Part,
    /// Scenes in a shard: what an interruption can cost.
    #[arg(long, default_value_t = 16, value_name = "N")]
    scenes_per_shard: u64,
    /// Go on with a data set that was begun with the same arguments.
    #[arg(long)]
    resume: bool,
    /// Root of all randomness.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// No progress bar and no table.
    #[arg(long)]
    quiet: bool,
}

/// Most scenes of a data set, and most trials in a scene, that may be asked for: far more than a disk and a memory hold.
const MOST_SCENES: u64 = 100_000_000;
const MOST_TRIALS: usize = 1_000_000;

fn seed_range(text: &str) -> Result<std::ops::Range<u64>, String> {
    let range = text.split_once("..").and_then(|(a, b)| Some(a.parse().ok()?..b.parse().ok()?));
    range.filter(|r| !r.is_empty()).ok_or_else(|| "expected A..B with A < B, such as 0..1000".to_owned())
}

fn fraction(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|f| (0.0..=1.0).contains(f));
    value.ok_or_else(|| "expected a number from 0 to 1".to_owned())
}

fn picture_side(text: &str) -> Result<usize, String> {
    let side = text.parse().ok().filter(|side| [RGB_SIDE, DEPTH_SIDE].contains(side));
    side.ok_or_else(|| format!("expected {RGB_SIDE} or {DEPTH_SIDE}"))
}

fn main() -> ExitCode {
    program::run("collect", "error,where2act_sim=warn", |cli: Cli| run(&cli))
}

fn run(cli: &Cli) -> anyhow::Result<()> {
    if cli.scenes == 0 {
        bail!("--scenes 0: expected at least one scene");
    }
    if cli.scenes > MOST_SCENES {
        bail!("--scenes {}: expected at most {MOST_SCENES}", cli.scenes);
    }
    if cli.trials > MOST_TRIALS {
        bail!("--trials {}: expected at most {MOST_TRIALS} in every scene", cli.trials);
    }
    if cli.scenes_per_shard == 0 {
        bail!("--scenes-per-shard 0: expected at least one scene");
    }
    program::limit_threads(cli.jobs)?;
    let plan = Plan {
        scenes: cli.scenes,
        scenes_per_shard: cli.scenes_per_shard,
        part: cli.shard,
        resume: cli.resume,
    };
    let collector = Collector::new(&cli.out, recipe(cli)?, plan)?;
    let stop = program::stop_flag()?;
    let template = "{bar:30} {pos}/{len} scenes, {msg}, {elapsed} gone, {eta} to go";
    let bar = Progress::new(cli.quiet, collector.scenes(), template);
    let start = Instant::now();
    let outcome = collector.run(&stop, &|scenes, state| {
        let rate = state.trials_made as f64 / start.elapsed().as_secs_f64().max(1e-3);
        let trials = state.tally.total().trials;
        let message = format!("{trials} trials ({rate:.0}/s), successes {}", state.tally.successes());
        bar.inc(scenes);
        bar.tell(|| format!("{} of {} scenes, {message}", bar.position(), collector.scenes()));
        bar.set_message(message);
    });
    bar.finish_and_clear();
    let collected = outcome?;
    if !cli.quiet {
        report(cli, collector.scenes(), &collected, start.elapsed());
    }
    Ok(())
}

fn recipe(cli: &Cli) -> anyhow::Result<Recipe> {
    let objects = if cli.objects == "procedural" {
        let categories = if cli.categories.is_empty() {
            categories_of(where2act_core::Split::Train)
        } else {
            cli.categories.clone()
        };
        let seeds = cli.object_seeds.clone().unwrap_or(ObjectSet::TRAINING_SEEDS);
        ObjectSet::Procedural { categories, seeds }
    } else {
        let folder = ObjectSet::folder(cli.objects.as_ref(), &cli.categories).context("--objects")?;
        if cli.object_seeds.is_some() {
            bail!("--object-seeds: expected none with a folder of objects");
        }
        folder
    };
    let primitives = if cli.primitives.is_empty() { Primitive::ALL.to_vec() } else { cli.primitives.clone() };
    Ok(Recipe {
        seed: Seed(cli.seed),
        objects,
        primitives,
        trials: cli.trials,
        guided: cli.guided,
        wide: cli.wide,
        close: cli.close,
        randomise: cli.randomise,
        varied: cli.varied,
        faithful: cli.faithful,
        picture_side: cli.picture_side,
        ..Recipe::default()
    })
}

fn report(cli: &Cli, wanted: u64, collected: &Collected, elapsed: Duration) {
    let Collected { shards_found, shards_made, scenes, trials_made, tally } = collected;
    let rate = *trials_made as f64 / elapsed.as_secs_f64().max(1e-3);
    // Whoever reads may have seen enough.
    let _ = writeln!(
        std::io::stdout(),
        "{tally}{scenes} of {wanted} scenes in {}; {shards_made} shards made, {shards_found} found; {trials_made} trials in {:.0} s, {rate:.1}/s",
        cli.out.display(),
        elapsed.as_secs_f64(),
    );
}
