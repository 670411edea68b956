//! A picture and a scan of one view of a generated object, as `predict` reads them:
//!
//! ```text
//! cargo run -p where2act-sim --example scan -- StorageFurniture:17 0,0.15,0,0.5,0,0 examples/cabinet
//! ```
//!
//! opens a drawer and a door, lets the scene settle, and writes `examples/cabinet.png` (the published look)
//! and `examples/cabinet.ply`: 20,000 points of the depth map in the camera's optical frame, x right, y down,
//! z forward, metres. The same arguments write the same bytes.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use image::ImageFormat;
use nalgebra::Point3;
use rand::seq::index;
use where2act_core::{Camera, Seed, write_whole};
use where2act_sim::render::{Look, View, front_camera, render};
use where2act_sim::{Scene, SettledScene, object};

/// Points of a scan at most: enough for a network that takes 10,000, in a quarter of a megabyte.
const POINTS: usize = 20_000;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [spec, positions, out] = args.as_slice() else {
        bail!("expected OBJECT Q1,Q2,... OUT, found {args:?}");
    };
    let numbers: Result<Vec<f32>, _> = positions.split(',').map(str::parse).collect();
    let q = numbers.with_context(|| format!("expected joint positions Q1,Q2,..., found {positions:?}"))?;
    let scene = Scene::new(Arc::new(object::open(spec)?), q)?.settle()?;
    let view = look_at(&scene);
    let mut png = std::io::Cursor::new(Vec::new());
    view.to_image().write_to(&mut png, ImageFormat::Png)?;
    let out = Path::new(out);
    write_whole(&out.with_extension("png"), |to| to.write_all(png.get_ref()))?;
    write_whole(&out.with_extension("ply"), |to| write_ply(to, &scan(&view)))?;
    Ok(())
}

/// From the front, a little to the side and above, at the published distance and field of view.
fn look_at(scene: &SettledScene) -> View {
    let poses = scene.world_from_links();
    let camera =
        front_camera(scene.object(), &poses, [35.0, 30.0].map(f32::to_radians), Camera::PUBLISHED_SIDE);
    render(scene.object(), &poses, &camera, &Look::default())
}

/// Points of the object in the optical frame, drawn evenly from the pixels that show it.
fn scan(view: &View) -> Vec<Point3<f32>> {
    let all = view.observation().foreground_points();
    let mut drawn = index::sample(&mut Seed(0).rng(), all.len(), POINTS.min(all.len())).into_vec();
    drawn.sort_unstable();
    drawn.into_iter().map(|i| all[i].1).collect()
}

/// Binary little-endian PLY, 12 bytes a point.
fn write_ply(to: &mut impl Write, points: &[Point3<f32>]) -> std::io::Result<()> {
    let properties = "property float x\nproperty float y\nproperty float z\n";
    let count = points.len();
    write!(to, "ply\nformat binary_little_endian 1.0\ncomment camera_optical, metres\n")?;
    write!(to, "element vertex {count}\n{properties}end_header\n")?;
    points.iter().flat_map(|point| point.iter()).try_for_each(|x| to.write_all(&x.to_le_bytes()))
}
