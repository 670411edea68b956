//! `objects render`.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use image::{ImageFormat, Rgb, RgbImage};
use where2act_core::{Camera, program, write_whole};
use where2act_sim::object::{self, JointKind, Material, Object, Visual};
use where2act_sim::render::{Look, View, front_camera, render};

#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  objects render Microwave:3 --out microwave.png
  objects render data/StorageFurniture/45746 --open 0.7 --azimuth 30 --out open.png
  objects render Faucet:1 --q 0.2,-0.5 --maps --out faucet.png")]
pub(crate) struct Args {
    /// A URDF file, its folder, or CATEGORY:SEED; with ~N at its end, variation N of it.
    object: String,
    /// The picture, a .png file.
    #[arg(long, value_name = "PNG")]
    out: PathBuf,
    /// Side of the picture, pixels.
    #[arg(long, value_name = "N", default_value_t = Camera::PUBLISHED_SIDE as u32, value_parser = clap::value_parser!(u32).range(16..=4096))]
    size: u32,
    /// Joint positions in the order of the movable links, radians or metres.
    #[arg(
        long,
        value_name = "Q1,Q2,...",
        value_delimiter = ',',
        allow_hyphen_values = true,
        conflicts_with = "open"
    )]
    q: Option<Vec<f32>>,
    /// Every joint this far open: 0 = closed, 1 = at the limit furthest from closed, or half a turn if it has none.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    open: f32,
    #[command(flatten)]
    view: Viewpoint,
    /// Draw the convex pieces that hands touch, each in its own colour, instead of what cameras see.
    #[arg(long)]
    pieces: bool,
    /// Depth, normals and part ids to the right of the picture.
    #[arg(long)]
    maps: bool,
}

/// Where the camera is; the published distance and field of view.
#[derive(clap::Args, Clone, Copy)]
pub(crate) struct Viewpoint {
    /// Degrees around the object; 0 looks at its front, positive from its left.
    #[arg(long, value_parser = program::finite, value_name = "DEGREES", default_value_t = 35.0, allow_hyphen_values = true)]
    azimuth: f32,
    /// Degrees above the horizon.
    #[arg(long, value_parser = program::finite, value_name = "DEGREES", default_value_t = 30.0, allow_hyphen_values = true)]
    elevation: f32,
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    if args.out.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
        bail!("--out {}: expected a .png file", args.out.display());
    }
    let mut object = object::open(&args.object)?;
    if args.pieces {
        show_pieces(&mut object);
    }
    let q = match &args.q {
        Some(q) => {
            check_positions(&object, q)?;
            q.clone()
        }
        None => opened(&object, args.open)?,
    };
    let view = look_at(&object, &q, args.size as usize, args.view);
    let picture = if args.maps { with_maps(&view) } else { view.to_image() };
    save(&picture, &args.out)?;
    Ok(ExitCode::SUCCESS)
}

fn check_positions(object: &Object, q: &[f32]) -> Result<()> {
    if q.len() != object.movable().len() || q.iter().any(|x| !x.is_finite()) {
        let names: Vec<_> = object.movable().map(|l| object.links[l].name.as_str()).collect();
        bail!("--q: expected {} finite numbers ({}), found {q:?}", names.len(), names.join(","));
    }
    Ok(())
}

/// Replaces what is seen by what is felt.
pub(crate) fn show_pieces(object: &mut Object) {
    object.materials.clear();
    for link in &mut object.links {
        link.visuals.clear();
        for piece in &link.pieces {
            let colour = palette(object.materials.len()).map(|c| f32::from(c) / 255.0);
            link.visuals.push(Visual { mesh: Arc::new(piece.mesh()), material: object.materials.len() });
            object.materials.push(Material { colour, ..Material::default() });
        }
    }
}

/// Joint positions with every part this far from closed, towards the limit that is further away; half a turn is all the
/// way where there are no limits.
pub(crate) fn opened(object: &Object, fraction: f32) -> Result<Vec<f32>> {
    if !(0.0..=1.0).contains(&fraction) {
        bail!("--open {fraction}: expected a number from 0 to 1");
    }
    let towards = |(link, closed): (usize, f32)| {
        let joint = object.joint(link);
        let (lower, upper) = joint.limits;
        let end = match joint.kind {
            JointKind::Continuous => closed + std::f32::consts::PI,
            _ if upper - closed >= closed - lower => upper,
            _ => lower,
        };
        closed + fraction * (end - closed)
    };
    Ok(object.movable().zip(object.closed()).map(towards).collect())
}

/// A picture of the whole object.
pub(crate) fn look_at(object: &Object, q: &[f32], size: usize, viewpoint: Viewpoint) -> View {
    let poses = object.world_from_links(q);
    let angles = [viewpoint.azimuth, viewpoint.elevation].map(f32::to_radians);
    let camera = front_camera(object, &poses, angles, size);
    render(object, &poses, &camera, &Look::default())
}

/// The picture, depth (near is bright), normals (xyz as RGB) and links (one colour each) side by side.
fn with_maps(view: &View) -> RgbImage {
    let size = view.camera.size;
    let (width, height) = (size.width as u32, size.height as u32);
    let seen = || view.depth.iter().copied().filter(|&d| d > 0.0);
    let (near, far) = seen().fold((f32::MAX, f32::MIN), |(n, f), d| (n.min(d), f.max(d)));
    let depth = |i: usize| match view.depth[i] {
        d if d > 0.0 => [(255.0 - 215.0 * (d - near) / (far - near).max(1e-6)) as u8; 3],
        _ => [0; 3],
    };
    let normal = |i: usize| {
        let n = view.normals_in_world[i];
        if view.depth[i] > 0.0 { [n.x, n.y, n.z].map(|c| (127.5 + 127.5 * c) as u8) } else { [0; 3] }
    };
    let link = |i: usize| link_colour(view.link[i]);
    let picture = |i: usize| view.rgb[i];
    let panels: [&dyn Fn(usize) -> [u8; 3]; 4] = [&picture, &depth, &normal, &link];
    RgbImage::from_fn(4 * width, height, |x, y| {
        Rgb(panels[(x / width) as usize]((y * width + x % width) as usize))
    })
}

/// Grey for the root, hues a golden angle apart for what moves.
fn link_colour(id: u8) -> [u8; 3] {
    match id {
        0 => [255; 3],
        1 => [150; 3],
        _ => palette(id.into()),
    }
}

/// Hues a golden angle apart.
fn palette(index: usize) -> [u8; 3] {
    let hue = index as f32 * 2.399_963;
    [0.0, 2.094, 4.189].map(|phase| (140.0 + 110.0 * (hue + phase).cos()) as u8)
}

pub(crate) fn save(picture: &RgbImage, path: &std::path::Path) -> Result<()> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, ImageFormat::Png)?;
    write_whole(path, |w| std::io::Write::write_all(w, bytes.get_ref()))
        .with_context(|| format!("{}: expected to write a picture here", path.display()))
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;

    #[test]
    fn hinges_open_to_their_limit_and_endless_ones_by_half_a_turn() {
        let mut object = object::open("Microwave:1").unwrap();
        let closed = object.closed();
        let mut open = |kind, limits| {
            let joint = object.links[1].joint.as_mut().unwrap();
            (joint.kind, joint.limits) = (kind, limits);
            opened(&object, 1.0).unwrap()[0]
        };
        assert_eq!(closed[0], 0.0);
        assert_eq!(open(JointKind::Revolute, (0.0, 4.5)), 4.5);
        assert_eq!(open(JointKind::Revolute, (-4.0, 1.0)), -4.0);
        assert_eq!(open(JointKind::Prismatic, (0.0, 5.0)), 5.0);
        assert_eq!(open(JointKind::Continuous, (-10.0, 10.0)), PI);
    }
}
