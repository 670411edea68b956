//! `objects list`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use where2act_core::{Category, Split};
use where2act_sim::object::{ObjectError, urdf_in};

#[derive(clap::Args)]
pub(crate) struct Args {
    /// A folder of objects, searched to any depth; without it, the generated categories.
    folder: Option<PathBuf>,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    let mut out = std::io::stdout().lock();
    let lines: Vec<String> = match &args.folder {
        Some(folder) => objects_in(folder)?.iter().map(|p| p.display().to_string()).collect(),
        None => Category::ALL.into_iter().map(line).collect(),
    };
    for line in lines {
        writeln!(out, "{line}")?;
    }
    Ok(ExitCode::SUCCESS)
}

fn line(category: Category) -> String {
    let split = match category.split() {
        Split::Train => "train",
        Split::Novel => "novel",
    };
    format!("{category:<17} {split:<6} {}", moving_parts(category))
}

/// What moves on the objects of a category.
fn moving_parts(category: Category) -> &'static str {
    match category {
        Category::Box => "flaps and lids that turn",
        Category::Door => "doors that turn in a frame, their handles",
        Category::Faucet => "levers, knobs and spouts that turn",
        Category::Kettle => "a lid that lifts or turns, a handle",
        Category::Microwave => "a door that turns, knobs and buttons",
        Category::Refrigerator => "one or more doors that turn",
        Category::StorageFurniture => "drawers that slide, doors that turn",
        Category::Switch => "rockers, levers and knobs that turn, buttons that slide",
        Category::TrashCan => "a lid that turns or lifts, a pedal, wheels",
        Category::Window => "sashes that turn or slide in a frame",
        Category::Bucket => "a handle that turns",
        Category::KitchenPot => "a lid that lifts, handles",
        Category::Safe => "a door that turns, a knob or wheel on it",
        Category::Table => "drawers that slide, doors that turn",
        Category::WashingMachine => "a door or lid that turns, knobs and buttons",
    }
}

/// Folders below `folder`, itself included, that hold one object each, in the order of their names; with them those that
/// hold several URDF files and do not say which one counts, which cannot be loaded. A folder inside an object's
/// folder is not looked at.
pub(crate) fn objects_in(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        bail!("{}: expected a folder of objects, found none", folder.display());
    }
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        match urdf_in(&next) {
            Ok(_) => {
                found.push(next);
                continue;
            }
            Err(ObjectError::AmbiguousFolder { found: 1.., .. }) => found.push(next.clone()),
            Err(_) => {}
        }
        let entries = std::fs::read_dir(&next).with_context(|| next.display().to_string())?;
        // Links are not followed, so that a loop of them has an end.
        let folders = entries.filter_map(Result::ok).filter(|e| e.file_type().is_ok_and(|t| t.is_dir()));
        open.extend(folders.map(|e| e.path()));
    }
    found.sort();
    if found.is_empty() {
        bail!("{}: expected folders with a URDF file each, found none", folder.display());
    }
    Ok(found)
}
