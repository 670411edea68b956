//! `objects check`.

use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::Result;
use rayon::prelude::*;
use where2act_core::program::Progress;
use where2act_sim::object::{self, Object, ObjectError};

use crate::list::objects_in;

#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  objects check data\n  objects check Faucet:1 cabinet.urdf\n\nExits with 1 if any object fails."
)]
pub(crate) struct Args {
    /// URDF files, folders of one or of many objects, or CATEGORY:SEED; with ~N at its end, variation N of one.
    #[arg(required = true, value_name = "DIR_OR_OBJECT")]
    objects: Vec<String>,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<ExitCode> {
    let mut specs = Vec::new();
    for spec in &args.objects {
        let path = Path::new(spec);
        if path.is_dir() && object::urdf_in(path).is_err() {
            specs.extend(objects_in(path)?.into_iter().map(|p| p.to_string_lossy().into_owned()));
        } else {
            specs.push(spec.clone());
        }
    }
    let bar = Progress::new(quiet, specs.len() as u64, "{bar:30} {pos}/{len} objects, {eta} left");
    let results: Vec<_> = specs
        .par_iter()
        .map(|spec| {
            let result = object::open(spec).map(|o| summary(&o));
            bar.inc(1);
            result
        })
        .collect();
    bar.finish_and_clear();

    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{:<28} {:<17} {:>5} {:>6} {:>9} {:>6}  result",
        "object", "category", "links", "joints", "triangles", "pieces"
    )?;
    let mut failed = false;
    for (spec, result) in specs.iter().zip(results) {
        match result {
            Ok(line) => writeln!(out, "{line}  ok")?,
            Err(error) => {
                failed = true;
                writeln!(out, "{}", failure(spec, &error))?;
            }
        }
    }
    Ok(ExitCode::from(u8::from(failed)))
}

fn summary(object: &Object) -> String {
    let category = object.category.map_or_else(|| "-".to_owned(), |c| c.to_string());
    let links: usize = object.links.iter().map(|l| 1 + l.welded.len()).sum();
    let pieces: usize = object.links.iter().map(|l| l.pieces.len()).sum();
    let joints = object.movable().len();
    format!(
        "{:<28} {category:<17} {links:>5} {joints:>6} {:>9} {pieces:>6}",
        object.name,
        object.triangle_count()
    )
}

fn failure(spec: &str, error: &ObjectError) -> String {
    format!("{spec:<28} error: {error}")
}
