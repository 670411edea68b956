//! `trial`: let a robot hand try something on an object.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::{ArgGroup, Parser};
use nalgebra::Vector3;
use where2act_core::{Pixel, Primitive, program};
use where2act_sim::{Mode, object};

mod batch;
mod gif;
mod hand;
mod one;

/// One interaction of a robot hand with an object, or a table of them.
///
/// Points and directions are in the world frame: metres, z up, objects face -x.
#[derive(Parser)]
#[command(
    version,
    max_term_width = 110,
    group = ArgGroup::new("contact").args(["pixel", "point", "batch"]).required(true),
    after_help = "\
Examples:
  trial Door:1 --primitive pushing --pixel 224,224 --joint link_1=0.5 --gif push.gif
  trial cabinet.urdf --primitive pulling --point 0.37,0.04,-0.25 \\
      --approach -1,0,0 --forward 0,1,0 --gif pull.gif
  trial cabinet.urdf --primitive pushing --point 0.32,0.3,0.3 --joint door_j=0.4 --json
  trial cabinet.urdf --batch trials.tsv --out outcomes.tsv

Columns of --batch, separated by tabs: primitive, target_link, px py pz (contact point), ax ay az (approach), \
fx fy fz (forward), and optionally q_<link> (start position of the joint that moves the link) and outcomes \
(valid, reason, q_start, q_end, success), which are compared. A contact point of a table has no normal: that a hand \
comes from behind the surface fails a single trial alone."
)]
struct Cli {
    /// A URDF file, its folder, or CATEGORY:SEED; with ~N at its end, variation N of it.
    object: String,
    /// pushing, pushing-up, pushing-left, pulling, pulling-up or pulling-left.
    #[arg(long, short, required_unless_present = "batch")]
    primitive: Option<Primitive>,
    /// Touch what is seen at this pixel of a 448x448 picture (see --azimuth, --elevation).
    #[arg(long, value_name = "U,V", value_parser = pixel)]
    pixel: Option<Pixel>,
    /// Touch the surface at this point.
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    point: Option<Vector3<f32>>,
    /// Direction in which the hand comes [default: against the surface's normal].
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    approach: Option<Vector3<f32>>,
    /// The hand's x axis; the fingers open at right angles to it [default: horizontal].
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true)]
    forward: Option<Vector3<f32>>,
    /// Start positions of all joints, radians or metres [default: closed].
    #[arg(long, value_name = "Q1,Q2,...", value_delimiter = ',', allow_hyphen_values = true)]
    q: Option<Vec<f32>>,
    /// Start position of one joint or link by name.
    #[arg(long, value_name = "NAME=VALUE", value_parser = named)]
    joint: Vec<(String, f32)>,
    /// The link that should move [default: the one that is touched].
    #[arg(long, value_name = "LINK")]
    target: Option<String>,
    /// Start from the given positions even if parts would move or collide there.
    #[arg(long)]
    no_settle: bool,
    /// Steps per second: 500 simulates every step, 250 leaves out those in which nothing happens.
    #[arg(long, default_value = "500", value_parser = mode, value_name = "500|250")]
    hz: Mode,
    /// Camera of --pixel, degrees around the object; 0 looks at its front.
    #[arg(long, value_parser = program::finite, value_name = "DEGREES", default_value_t = 35.0, allow_hyphen_values = true)]
    azimuth: f32,
    /// Camera of --pixel, degrees above the horizon.
    #[arg(long, value_parser = program::finite, value_name = "DEGREES", default_value_t = 30.0, allow_hyphen_values = true)]
    elevation: f32,
    /// Write a moving picture of object and hand.
    #[arg(long, value_name = "GIF", conflicts_with = "batch")]
    gif: Option<PathBuf>,
    /// Print the outcome as JSON.
    #[arg(long, conflicts_with = "batch")]
    json: bool,
    /// Run the trials of a table instead.
    #[arg(long, value_name = "TSV", conflicts_with_all = ["primitive", "approach", "forward", "target", "q", "joint"])]
    batch: Option<PathBuf>,
    /// Where the table goes with its outcomes [default: standard output].
    #[arg(long, value_name = "TSV", requires = "batch")]
    out: Option<PathBuf>,
    /// Threads to use [default: all cores].
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Only results and errors, no progress bars.
    #[arg(long)]
    quiet: bool,
}

fn main() -> ExitCode {
    program::run("trial", "error,where2act_sim=warn", |cli: Cli| run(&cli))
}

fn run(cli: &Cli) -> Result<()> {
    program::limit_threads(cli.jobs)?;
    let object = object::open(&cli.object)?;
    if object.movable().is_empty() {
        bail!("{}: expected a movable part, found none", cli.object);
    }
    match &cli.batch {
        Some(table) => batch::run(cli, table, object.into()),
        None => one::run(cli, object.into()),
    }
}

fn numbers<const N: usize>(text: &str) -> Result<[f32; N], String> {
    let parsed: Vec<f32> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    let finite = parsed.iter().all(|x| x.is_finite()) && text.split(',').count() == N;
    let found = <[f32; N]>::try_from(parsed).ok().filter(|_| finite);
    found.ok_or_else(|| format!("expected {N} finite numbers with commas between them"))
}

fn vector(text: &str) -> Result<Vector3<f32>, String> {
    numbers::<3>(text).map(Vector3::from)
}

fn pixel(text: &str) -> Result<Pixel, String> {
    let whole = |part: &str| part.trim().parse::<u32>().ok();
    let parts = text.split_once(',').and_then(|(u, v)| Some(Pixel { u: whole(u)?, v: whole(v)? }));
    parts.ok_or_else(|| "expected a column and a row, such as 224,240".to_owned())
}

fn named(text: &str) -> Result<(String, f32), String> {
    let parts = text.split_once('=').and_then(|(name, value)| Some((name.to_owned(), value.parse().ok()?)));
    parts
        .filter(|(_, value): &(String, f32)| value.is_finite())
        .ok_or_else(|| "expected NAME=VALUE".to_owned())
}

fn mode(text: &str) -> Result<Mode, String> {
    match text {
        "500" => Ok(Mode::Faithful),
        "250" => Ok(Mode::Fast),
        _ => Err("expected 500 or 250".to_owned()),
    }
}
