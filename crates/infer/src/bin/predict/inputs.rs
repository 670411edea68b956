//! Files to observations.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use where2act_core::{ImageSize, Intrinsics, Observation, is_measured, is_measured_depth};
use where2act_infer::read::{FileKind, file_kind, read_depth, read_mask, read_picture, read_scan};
use where2act_model::Modality;

use crate::args::Args;

/// Half of what a depth map shows is further than this, metres, only if its numbers are no metres.
const FARTHEST: f32 = 60.0;
/// Fewer pixels or points show no object.
const FEWEST: usize = 256;

/// A file to predict for.
pub(crate) struct Input {
    pub(crate) path: PathBuf,
    kind: FileKind,
}

/// All inputs: files as given, folders by their files in order of their names.
pub(crate) fn list(args: &Args) -> Result<Vec<Input>> {
    let mut inputs = Vec::new();
    let input = |path: PathBuf, kind| {
        // With a depth map of its own even a 16-bit grey picture is a picture.
        let own = args.depth.is_some() && kind == FileKind::Depth && !is_npy(&path);
        Input { path, kind: if own { FileKind::Picture } else { kind } }
    };
    for given in &args.input {
        if given.is_dir() {
            let before = inputs.len();
            for path in files(given)? {
                // A file that cannot be opened fails on its own when its turn comes.
                let unknown = if is_npy(&path) { FileKind::Scan } else { FileKind::Picture };
                if let Some(kind) = file_kind(&path).unwrap_or(Some(unknown)) {
                    inputs.push(input(path, kind));
                }
            }
            if inputs.len() == before {
                bail!(
                    "{}: expected a folder with png, jpg, webp, ply, pcd or npy files, found none",
                    given.display()
                );
            }
        } else {
            std::fs::metadata(given).with_context(|| given.display().to_string())?;
            let kind = file_kind(given)?.with_context(|| {
                format!(
                    "{}: expected a png, jpg, webp, ply, pcd or npy file or a folder, found another ending",
                    given.display()
                )
            })?;
            inputs.push(input(given.clone(), kind));
        }
    }
    let given = [
        ("--depth", args.depth.is_some()),
        ("--mask", args.mask.is_some()),
        ("--box", args.rectangle().is_some()),
    ];
    for (flag, given) in given {
        if given && inputs.len() != 1 {
            bail!("{flag}: expected one input that it belongs to, found {}", inputs.len());
        }
        if given && inputs.iter().any(|i| i.kind == FileKind::Scan) {
            bail!("{flag}: expected a picture or depth map as input, found a scan");
        }
    }
    if args.depth.is_some() && inputs.iter().any(|i| i.kind == FileKind::Depth) {
        bail!("--depth: expected a picture as input, found a depth map");
    }
    if args.has_camera() && inputs.len() == 1 && inputs.iter().all(|i| i.kind == FileKind::Scan) {
        bail!("--intrinsics, --fov: expected a picture or depth map as input, found a scan");
    }
    Ok(inputs)
}

fn is_npy(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy"))
}

fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let name = || folder.display().to_string();
    let entries: std::io::Result<Vec<_>> = std::fs::read_dir(folder).with_context(name)?.collect();
    let mut files: Vec<PathBuf> =
        entries.with_context(name)?.into_iter().map(|e| e.path()).filter(|p| p.is_file()).collect();
    files.sort();
    Ok(files)
}

impl Input {
    pub(crate) fn modality(&self) -> Modality {
        match self.kind {
            FileKind::Picture => Modality::Rgb,
            FileKind::Depth | FileKind::Scan => Modality::Cloud,
        }
    }

    pub(crate) fn read(&self, args: &Args) -> Result<Observation> {
        match self.kind {
            FileKind::Scan => Ok(Observation::Cloud { points: read_scan(&self.path)? }),
            FileKind::Picture => {
                let picture = read_picture(&self.path)?;
                let size = picture.size;
                if picture.turned && (args.depth.is_some() || args.given_intrinsics().is_some()) {
                    bail!(
                        "{}: expected the sensor's own picture beside --depth or --intrinsics, found one that its EXIF \
                         block turns",
                        self.path.display()
                    );
                }
                let depth = match &args.depth {
                    None => None,
                    Some(path) => {
                        let depth = read_depth(path, args.depth_scale)?;
                        same_size("--depth", path, depth.size, size)?;
                        Some(depth.metres)
                    }
                };
                let intrinsics = intrinsics(args, size);
                if depth.is_some() && intrinsics.is_none() {
                    bail!("--depth: expected --intrinsics or --fov with it, found neither");
                }
                let mask = mask_of(mask(args, size)?, picture.opaque, args);
                // Who points out the object wants to know its directions, wherever in the picture it is.
                let known = picture.camera.filter(|_| mask.is_some());
                Ok(Observation::Image {
                    size,
                    rgb: Some(picture.rgb),
                    depth,
                    intrinsics: intrinsics.or(known),
                    mask,
                })
            }
            FileKind::Depth => {
                let depth = read_depth(&self.path, args.depth_scale)?;
                let size = depth.size;
                let missing = || {
                    format!(
                        "{}: expected --intrinsics or --fov with a depth map, found neither",
                        self.path.display()
                    )
                };
                let intrinsics = Some(intrinsics(args, size).with_context(missing)?);
                Ok(Observation::Image {
                    size,
                    rgb: None,
                    depth: Some(depth.metres),
                    intrinsics,
                    mask: mask(args, size)?,
                })
            }
        }
    }
}

/// What can be meant as it is, but seldom is.
pub(crate) fn doubts(observation: &Observation) -> Vec<String> {
    let mut doubts = Vec::new();
    let (shown, unit) = match observation {
        Observation::Cloud { points } => (points.iter().filter(|point| is_measured(point)).count(), "points"),
        Observation::Image { rgb: None, .. } => (observation.foreground_points().len(), "points"),
        Observation::Image { size, mask: None, .. } => (size.pixels(), "pixels"),
        Observation::Image { mask: Some(mask), .. } => {
            (mask.iter().filter(|inside| **inside).count(), "pixels")
        }
    };
    if shown < FEWEST {
        doubts.push(format!("expected an object of thousands of {unit}, found {shown}"));
    }
    let Observation::Image { size, rgb, depth, intrinsics, .. } = observation else { return doubts };
    if rgb.as_ref().is_some_and(|rgb| rgb.iter().all(|colour| Some(colour) == rgb.first())) {
        doubts.push("expected a picture of an object, found a single colour".to_owned());
    }
    if let Some(Intrinsics { cx, cy, .. }) = intrinsics
        && !((0.0..=size.width as f32).contains(cx) && (0.0..=size.height as f32).contains(cy))
    {
        let ImageSize { width, height } = size;
        doubts.push(format!("expected intrinsics of {width} x {height} pixels, found an axis at {cx}, {cy}"));
    }
    let mut seen: Vec<f32> = depth.iter().flatten().copied().filter(|d| is_measured_depth(*d)).collect();
    let middle = seen.len() / 2;
    if middle > 0 {
        let (_, median, _) = seen.select_nth_unstable_by(middle, f32::total_cmp);
        if *median > FARTHEST {
            doubts.push(format!(
                "expected depth in metres, found a median of {median}: are these millimetres? (--depth-scale is for integers)"
            ));
        }
    }
    doubts
}

fn intrinsics(args: &Args, size: ImageSize) -> Option<Intrinsics> {
    args.given_intrinsics().or_else(|| args.fov.map(|fov| Intrinsics::from_fov(size, fov.to_radians())))
}

fn mask(args: &Args, size: ImageSize) -> Result<Option<Vec<bool>>> {
    if let Some(rectangle) = args.rectangle() {
        return inside(rectangle, size).map(Some);
    }
    let Some(path) = &args.mask else { return Ok(None) };
    let (found, mask) = read_mask(path)?;
    same_size("--mask", path, found, size)?;
    if !mask.contains(&true) {
        bail!(
            "--mask {}: expected pixels brighter than half, which are the object, found none",
            path.display()
        );
    }
    Ok(Some(mask))
}

/// A mask that is given replaces that of a cut-out; a rectangle keeps to it.
fn mask_of(given: Option<Vec<bool>>, opaque: Option<Vec<bool>>, args: &Args) -> Option<Vec<bool>> {
    match (given, opaque) {
        (Some(given), Some(opaque)) if args.rectangle().is_some() => {
            Some(given.iter().zip(opaque).map(|(given, opaque)| *given && opaque).collect())
        }
        (given, opaque) => given.or(opaque),
    }
}

/// The mask of a rectangle, as much of it as lies in the picture.
fn inside([left, top, width, height]: [i64; 4], size: ImageSize) -> Result<Vec<bool>> {
    let along = |first: i64, length: i64, whole: usize| {
        let inside = |at: i64| usize::try_from(at).unwrap_or(0).min(whole);
        inside(first)..inside(first.saturating_add(length))
    };
    let (columns, rows) = (along(left, width, size.width), along(top, height, size.height));
    if columns.is_empty() || rows.is_empty() {
        let ImageSize { width: w, height: h } = size;
        bail!("--box: expected a rectangle in {w} x {h} pixels, found {left},{top},{width},{height}");
    }
    let at = |i: usize| columns.contains(&(i % size.width)) && rows.contains(&(i / size.width));
    Ok((0..size.pixels()).map(at).collect())
}

fn same_size(flag: &str, path: &Path, found: ImageSize, expected: ImageSize) -> Result<()> {
    if found != expected {
        let ImageSize { width, height } = expected;
        bail!(
            "{flag} {}: expected {width}x{height} pixels as the input, found {}x{}",
            path.display(),
            found.width,
            found.height
        );
    }
    Ok(())
}
