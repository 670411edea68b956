//! Predictions to files and to the terminal.

use std::io::{self, Write};
use std::path::Path;

use anyhow::{Context, Result};
use image::{ImageFormat, RgbImage};
use where2act_core::{Observation, Prediction, Primitive, write_whole};
use where2act_infer::write::{write_coloured_ply, write_npy_grid, write_npy_row};
use where2act_infer::{Output, draw_overlay, draw_sheet, heat_colour, heat_end};

/// While it is there, the rest of what is beside it may be half of a prediction, which the next one removes.
const UNFINISHED: &str = ".unfinished-prediction";

/// Writes `prediction.json`, a map and an overlay per primitive, and the contact sheet; for scans also a coloured ply
/// per primitive. What an earlier prediction left goes first, and the JSON comes last: where it is, everything is.
pub(crate) fn write(
    folder: &Path,
    observation: &Observation,
    output: &mut Output<'_>,
    no_pictures: bool,
) -> Result<()> {
    let Output { prediction, maps } = output;
    forget(folder)?;
    for of in &mut prediction.primitives {
        let name = of.primitive.name();
        let map = format!("map_{name}.npy");
        let path = folder.join(&map);
        match observation {
            Observation::Image { size, .. } => save(&path, |to| {
                write_npy_grid(to, (size.height, size.width), |v, row| maps.row(of.primitive, v, row))
            })?,
            Observation::Cloud { points } => {
                let values = maps.dense(of.primitive);
                save(&path, |to| write_npy_row(to, &values))?;
                let end = heat_end(of.actionability.max);
                let path = folder.join(format!("cloud_{name}.ply"));
                save(&path, |to| write_coloured_ply(to, points, &values, |v| heat_colour(v / end)))?;
            }
        }
        of.actionability.map = Some(map);
        if !no_pictures {
            save_png(&folder.join(format!("overlay_{name}.png")), &draw_overlay(maps, of))?;
        }
    }
    if !no_pictures {
        save_png(&folder.join("sheet.png"), &draw_sheet(maps, prediction))?;
    }
    let json = serde_json::to_vec_pretty(prediction).context("prediction.json")?;
    save(&folder.join("prediction.json"), |to| to.write_all(&json))?;
    remove(&folder.join(UNFINISHED))
}

/// Removes an earlier prediction, its JSON first, or what there is of one; where neither was, nothing: other files may have such
/// names too.
fn forget(folder: &Path) -> Result<()> {
    let ours = std::fs::read(folder.join("prediction.json"))
        .is_ok_and(|json| serde_json::from_slice::<Prediction>(&json).is_ok());
    let unfinished = folder.join(UNFINISHED);
    let ours = ours || unfinished.exists();
    save(&unfinished, |_| Ok(()))?;
    if !ours {
        return Ok(());
    }
    let of_one = Primitive::ALL.map(|primitive| {
        let name = primitive.name();
        [format!("map_{name}.npy"), format!("overlay_{name}.png"), format!("cloud_{name}.ply")]
    });
    let all = ["prediction.json".to_owned(), "sheet.png".to_owned()]
        .into_iter()
        .chain(of_one.into_iter().flatten());
    all.map(|name| folder.join(name)).try_for_each(|path| remove(&path))
}

/// Removes a file, if it is there.
fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error)
            if error.kind() != io::ErrorKind::NotFound && error.kind() != io::ErrorKind::NotADirectory =>
        {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}

fn save(
    path: &Path,
    write: impl FnOnce(&mut io::BufWriter<&mut std::fs::File>) -> io::Result<()>,
) -> Result<()> {
    write_whole(path, write).with_context(|| path.display().to_string())
}

fn save_png(path: &Path, picture: &RgbImage) -> Result<()> {
    let mut bytes = io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png).with_context(|| path.display().to_string())?;
    save(path, |to| to.write_all(bytes.get_ref()))
}

/// The best proposal of every primitive, a line each.
pub(crate) fn table(
    to: &mut impl Write,
    input: &Path,
    prediction: &Prediction,
    folder: Option<&Path>,
) -> io::Result<()> {
    let (i, t) = (&prediction.input, &prediction.timing);
    let at = if i.kind == "cloud" { "point" } else { "pixel" };
    writeln!(to, "{} ({}, {} x {}): {:.0} ms", input.display(), i.kind, i.width, i.height, t.total)?;
    writeln!(to, "  primitive     actionable max/mean   best  at {at:<8} approach              point [m]")?;
    for of in &prediction.primitives {
        let a = &of.actionability;
        write!(to, "  {:<13} {:>10.3} / {:<7.3}", of.primitive.name(), a.max, a.mean)?;
        match of.proposals.first() {
            None => writeln!(to, "     -  no proposal")?,
            Some(p) => {
                let pixel = if i.kind == "cloud" {
                    p.pixel.u.to_string()
                } else {
                    format!("{},{}", p.pixel.u, p.pixel.v)
                };
                let vector = |v: [f32; 3]| v.map(|x| format!("{x:>6.2}")).join(" ");
                let point = p.point.map_or("-".to_owned(), vector);
                writeln!(to, " {:>6.3}  {pixel:<11} {}  {point}", p.score, vector(p.approach))?;
            }
        }
    }
    match folder {
        Some(folder) => writeln!(to, "  -> {}", folder.display()),
        None => Ok(()),
    }
}
