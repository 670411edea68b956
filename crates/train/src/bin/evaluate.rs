//! Judges weights by what their proposals achieve in simulation.

mod shared;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::bail;
use clap::Parser;
use where2act_core::{Category, Seed, Split, program};
use where2act_infer::Options;
use where2act_sim::collect::{ObjectSet, categories_of};
use where2act_sim::render::Held;
use where2act_train::evaluate::EvaluateConfig;

use shared::Work;

#[global_allocator]
static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();

/// Judge weights: F-score on random trials, success rate of executed proposals, baselines. Ctrl-C ends it with the
/// report of the scenes judged by then.
#[derive(Parser)]
#[command(
    version,
    after_help = "Examples:
  evaluate --weights weights/cloud --split shapes --episodes 100 --out shapes.json
  evaluate --weights weights/cloud --split novel --out novel.json
  evaluate --weights weights/cloud --objects my-partnet-folder --out real.json"
)]
struct Args {
    /// Weights folder.
    #[arg(long)]
    weights: PathBuf,
    /// `procedural`, or a folder of objects (`<Category>/<id>/mobility.urdf`, or `<id>` alone), which take turns.
    #[arg(long, default_value = "procedural")]
    objects: String,
    /// Which generated objects: shapes that training has not seen, or categories it has not seen. Default: shapes.
    #[arg(long, value_parser = ["shapes", "novel"], conflicts_with = "categories")]
    split: Option<String>,
    /// Only these categories.
    #[arg(long, value_delimiter = ',')]
    categories: Vec<Category>,
    /// Scenes.
    #[arg(long, default_value_t = 100)]
    episodes: u64,
    /// Proposals executed for each scene and primitive: the best ones, and as many drawn from all.
    #[arg(long, default_value_t = 5)]
    proposals: usize,
    /// Random trials for each scene and primitive.
    #[arg(long, default_value_t = 16)]
    random: usize,
    /// Trials that know the joint, at most, before a primitive counts as impossible in a scene.
    #[arg(long, default_value_t = 200)]
    informed: usize,
    /// Random lights, shadows, materials, backgrounds and sensors in three of four scenes instead
    /// of the published look.
    #[arg(long)]
    randomise: bool,
    /// Also execute proposals whose hand has no room by the depth map.
    #[arg(long)]
    no_clearance: bool,
    /// Take proposals wherever the view has depth, without a mask: those where nothing moves fail. The background has no depth,
    /// and pictures are judged on the object alone too. Otherwise proposals are kept to the parts that move, as published.
    #[arg(long)]
    anywhere: bool,
    /// Roll cameras about their axis by so many degrees.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    roll: f32,
    /// Turn cameras beside the object by so many degrees, about their own y axis: the view is the part of a wider picture around
    /// the object.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    beside: f32,
    /// Tell the network which way is up, which a robot knows of its cameras.
    #[arg(long)]
    up: bool,
    /// Root of the randomness.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Report to write, JSON; a Markdown table of the same name lies beside it.
    #[arg(long)]
    out: PathBuf,
    #[command(flatten)]
    work: Work,
}

fn main() -> ExitCode {
    program::run("evaluate", "error", |args: Args| run(&args))
}

fn run(args: &Args) -> anyhow::Result<()> {
    let stop = args.work.begin()?;
    let config = EvaluateConfig {
        proposals: args.proposals,
        random: args.random,
        informed: args.informed,
        randomise: args.randomise,
        clearance: !args.no_clearance,
        anywhere: args.anywhere,
        held: Held { roll: args.roll, beside: args.beside },
        up: args.up,
        ..EvaluateConfig::new(objects(args)?, args.episodes, Seed(args.seed))
    };
    for (flag, found, most) in [("--roll", args.roll, 180.0), ("--beside", args.beside, 60.0)] {
        if !(-most..=most).contains(&found) {
            bail!("{flag}: expected degrees from {} to {most}, found {found}", -most);
        }
    }
    if config.scenes == 0 || config.informed == 0 {
        bail!("--episodes and --informed: expected at least 1");
    }
    if !(1..=Options::MAX_COUNT).contains(&config.proposals) {
        bail!("--proposals: expected a number from 1 to {}, found {}", Options::MAX_COUNT, config.proposals);
    }
    args.work.judge(&args.weights, &config, &stop, &args.out)
}

fn objects(args: &Args) -> anyhow::Result<ObjectSet> {
    if args.objects != "procedural" {
        if args.split.is_some() {
            bail!("--split: expected none with a folder of objects, all of which are judged");
        }
        return Ok(ObjectSet::folder(args.objects.as_ref(), &args.categories)?);
    }
    let split = if args.split.as_deref() == Some("novel") { Split::Novel } else { Split::Train };
    let categories = if args.categories.is_empty() { categories_of(split) } else { args.categories.clone() };
    Ok(ObjectSet::Procedural { categories, seeds: ObjectSet::TEST_SEEDS })
}
