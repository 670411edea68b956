//! `objects export`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use where2act_sim::object;

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  objects export Microwave:3 --out microwave\n  objects check microwave")]
pub(crate) struct Args {
    /// CATEGORY:SEED, a URDF file, or its folder; with ~N at its end, variation N of it.
    object: String,
    /// A new or empty folder for mobility.urdf, OBJ meshes, materials and textures.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    object::export(&object::open(&args.object)?, &args.out)?;
    Ok(ExitCode::SUCCESS)
}
