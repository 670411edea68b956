//! Averages weights.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, bail};
use burn::tensor::Device;
use clap::Parser;
use where2act_core::program;
use where2act_model::{Precision, Weights, save_weights};
use where2act_train::mean;

/// The mean of the weights of networks that have come from one another, number by number. It costs nothing more to run than one
/// of them, and often does better on what is unlike the data.
#[derive(Parser)]
#[command(
    version,
    after_help = "Example:
  mean runs/first/last runs/second/last --out runs/both"
)]
struct Args {
    /// Weights folders, of networks that differ in their weights alone.
    #[arg(required = true, num_args = 2..)]
    weights: Vec<PathBuf>,
    /// Weights folder to write. What the last network's says of its preprocessing goes there.
    #[arg(long)]
    out: PathBuf,
}

fn main() -> ExitCode {
    program::run("mean", "error", |args: Args| run(&args))
}

fn run(args: &Args) -> anyhow::Result<()> {
    let device = Device::flex();
    let loaded: Result<Vec<Weights>, _> =
        args.weights.iter().map(|folder| Weights::load(folder, &device)).collect();
    let loaded = loaded?;
    let name = loaded.last().map_or("", |last| &last.network.config().name);
    let mut card =
        format!("# {name}\n\nThe mean, number by number, of the weights whose SHA-256 begins with");
    for Weights { sha256, .. } in &loaded {
        card += &format!(" {}", sha256.get(..12).unwrap_or(sha256));
    }
    card += ".\n";
    let mean = mean(loaded.into_iter().map(|weights| weights.network).collect())?;
    if args.out.exists() {
        bail!("--out {}: expected a new folder, found one", args.out.display());
    }
    let sha256 = save_weights(&args.out, &mean, &card, Precision::F16)
        .with_context(|| format!("--out {}", args.out.display()))?;
    println!("weights: {} ({})", args.out.display(), sha256.get(..12).unwrap_or(&sha256));
    Ok(())
}
