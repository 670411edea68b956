//! `objects export`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use where2act_core::Category;
use where2act_sim::object;

#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  objects export Microwave --seed 3 --out microwave\n  objects check microwave"
)]
pub(crate) struct Args {
    /// One of the 15 categories, see `objects list`.
    category: String,
    /// Which object of the category.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// A new or empty folder for mobility.urdf, OBJ meshes, materials and textures.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let category: Category = args.category.parse()?;
    let object = object::open(&format!("{category}:{}", args.seed))?;
    object::export(&object, &args.out)?;
    Ok(ExitCode::SUCCESS)
}
