//! `objects`: look at articulated objects, check them, write generated ones for other simulators.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use where2act_core::program;

mod check;
mod export;
mod list;
mod render;
mod sheet;

/// Articulated objects: list, check, render and export them.
#[derive(Parser)]
#[command(
    version,
    max_term_width = 110,
    after_help = "\
Examples:
  objects list
  objects check Microwave:3 data/StorageFurniture/45746
  objects check data"
)]
struct Cli {
    /// Only results and errors, no progress bars.
    #[arg(long, global = true)]
    quiet: bool,
    /// Threads to use [default: all cores].
    #[arg(long, global = true, value_name = "N")]
    jobs: Option<usize>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The generated categories, or the objects in a folder.
    List(list::Args),
    /// Load objects and print a line for each: category, links, joints, triangles, convex pieces, ok or the error.
    Check(check::Args),
    /// Draw an object.
    Render(render::Args),
    /// Draw many objects into one picture.
    Sheet(sheet::Args),
    /// Write an object as URDF and OBJ for other simulators.
    Export(export::Args),
}

fn main() -> ExitCode {
    program::run("objects", "error,where2act_sim=warn", run)
}

fn run(cli: Cli) -> anyhow::Result<ExitCode> {
    program::limit_threads(cli.jobs)?;
    match cli.command {
        Command::List(args) => list::run(&args),
        Command::Check(args) => check::run(&args, cli.quiet),
        Command::Render(args) => render::run(&args),
        Command::Sheet(args) => sheet::run(&args, cli.quiet),
        Command::Export(args) => export::run(&args),
    }
}
