//! `objects sheet`.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use image::{Rgb, RgbImage, imageops};
use rayon::prelude::*;
use where2act_core::Category;
use where2act_core::program::Progress;
use where2act_sim::object;

use crate::list::objects_in;
use crate::render::{Viewpoint, look_at, opened, save, show_pieces};

#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  objects sheet --out all.png
  objects sheet --out doors.png --categories Door,Safe --per-category 8 --open 0.5
  objects sheet --out mine.png data

The names of the objects are printed row by row, as they stand in the picture.")]
pub(crate) struct Args {
    /// Folders of objects, instead of generated ones.
    folders: Vec<PathBuf>,
    /// The picture, a .png file.
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
    /// Generated categories, one row each [default: all].
    #[arg(long, value_delimiter = ',', conflicts_with = "folders")]
    categories: Vec<String>,
    /// Objects in a row.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=32))]
    per_category: u32,
    /// Seed of the first object of every category.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Side of one picture, pixels.
    #[arg(long, value_name = "N", default_value_t = 240, value_parser = clap::value_parser!(u32).range(16..=1024))]
    size: u32,
    /// Every joint this far open, from 0 to 1: its limit, or half a turn if it has none.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.4)]
    open: f32,
    /// Draw the convex pieces that hands touch instead of what cameras see.
    #[arg(long)]
    pieces: bool,
    #[command(flatten)]
    view: Viewpoint,
}

/// White space between pictures, pixels.
const GAP: u32 = 4;

pub(crate) fn run(args: &Args, quiet: bool) -> Result<ExitCode> {
    if args.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
        bail!("--out {}: expected a .png file", args.out.display());
    }
    let specs = specs(args)?;
    let bar = Progress::new(quiet, specs.len() as u64, "{bar:30} {pos}/{len} objects, {eta} left");
    let pictures: Vec<Result<(String, RgbImage)>> = specs
        .par_iter()
        .map(|spec| {
            let mut object = object::open(spec)?;
            if args.pieces {
                show_pieces(&mut object);
            }
            let q = opened(&object, args.open)?;
            let picture = look_at(&object, &q, args.size as usize, args.view).to_image();
            bar.inc(1);
            Ok((object.name, picture))
        })
        .collect();
    bar.finish_and_clear();
    let pictures = pictures.into_iter().collect::<Result<Vec<_>>>()?;

    let columns = args.per_category.min(pictures.len() as u32);
    let rows = (pictures.len() as u32).div_ceil(columns);
    let cell = args.size + GAP;
    let mut sheet = RgbImage::from_pixel(columns * cell - GAP, rows * cell - GAP, Rgb([255; 3]));
    let mut names = String::new();
    for (row, line) in pictures.chunks(columns as usize).enumerate() {
        for (column, (_, picture)) in line.iter().enumerate() {
            let (x, y) = (column as u32 * cell, row as u32 * cell);
            imageops::replace(&mut sheet, picture, i64::from(x), i64::from(y));
        }
        let of_row: Vec<_> = line.iter().map(|(name, _)| name.as_str()).collect();
        names += &format!("row {}: {}\n", row + 1, of_row.join(", "));
    }
    save(&sheet, &args.out)?;
    std::io::stdout().write_all(names.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

fn specs(args: &Args) -> Result<Vec<String>> {
    let mut specs = Vec::new();
    for folder in &args.folders {
        specs.extend(objects_in(folder)?.into_iter().map(|p| p.to_string_lossy().into_owned()));
    }
    if args.folders.is_empty() {
        let named: Result<Vec<Category>, _> = args.categories.iter().map(|c| c.parse()).collect();
        let categories = if args.categories.is_empty() { Category::ALL.to_vec() } else { named? };
        let seeds = || (0..u64::from(args.per_category)).map(|i| args.seed.wrapping_add(i));
        specs.extend(categories.iter().flat_map(|c| seeds().map(move |s| format!("{c}:{s}"))));
    }
    Ok(specs)
}
