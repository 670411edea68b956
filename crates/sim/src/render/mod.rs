//! Pictures of objects: an own z-buffer rasteriser with deferred shading.
//!
//! Colours are sampled twice as densely as pixels in both directions and filtered with a tent; depth, normals and
//! link ids are taken at pixel centres, which are among these samples. Bands of rows are drawn in parallel, every band
//! from near to far so that most of what is hidden is not drawn; colours are found for several samples at a time.

mod backdrop;
mod band;
mod light;
mod lit;
mod look;
mod paint;
mod pattern;
mod raster;
mod scene;
mod sensor;
mod shade;
mod shadow;
mod tiles;
mod timber;
mod view;
mod viewpoint;

use nalgebra::{Isometry3, Point3, Vector3};
use rayon::prelude::*;
use where2act_core::{Camera, ImageSize, Pixel};

pub use backdrop::Backdrop;
pub use look::{Light, Look};
pub use pattern::{Pattern, PatternKind};
pub use sensor::Sensor;
pub use shadow::Shadow;
pub use view::View;
pub use viewpoint::{Held, close_up, front_camera, sample_camera, visible_bounds};

use crate::object::{Material, Mesh, Object};
use backdrop::Behind;
use band::Rows;
use scene::Scene;

/// A mesh in the picture that is no part of the object, such as the hand. It hides what is behind it and has link
/// id 0.
#[derive(Clone, Copy, Debug)]
pub struct Extra<'a> {
    /// Triangles.
    pub mesh: &'a Mesh,
    /// Where they are.
    pub world_from_mesh: Isometry3<f32>,
    /// What they look like.
    pub material: &'a Material,
}

/// What `camera` sees of an object whose links are at `world_from_links`.
#[must_use]
pub fn render(object: &Object, world_from_links: &[Isometry3<f32>], camera: &Camera, look: &Look) -> View {
    render_with(object, world_from_links, &[], camera, look)
}

/// [`render`] with other things in the picture.
#[must_use]
pub fn render_with(
    object: &Object,
    world_from_links: &[Isometry3<f32>],
    extras: &[Extra<'_>],
    camera: &Camera,
    look: &Look,
) -> View {
    let behind = look.backdrop.draw(camera, || visible_bounds(object, world_from_links));
    // Most pictures are mostly white: what shows nothing needs no work.
    let plain = match &behind {
        Behind::Plain(colour) if look.sensor.is_plain() && look.shadow.is_none() => {
            Some(sensor::code(colour))
        }
        _ => None,
    };
    let place = || Scene::new(object, world_from_links, extras, camera, look);
    let (scene, mut view) = rayon::join(place, || View::empty(*camera, plain));
    if plain.is_some() {
        let mut rgb = std::mem::take(&mut view.rgb);
        draw(&scene, &behind, &mut view, &mut rgb, sensor::code);
        view.rgb = rgb;
    } else {
        let size = camera.size;
        let mut lights: Vec<Vector3<f32>> =
            (0..size.pixels()).map(|at| behind.at(pixel_at(size, at))).collect();
        draw(&scene, &behind, &mut view, &mut lights, |light| *light);
        look.shadow.fall(&view, look.lights.first().map(|lamp| lamp.position.into()), &mut lights);
        view.rgb = look.sensor.expose(&lights, size);
    }
    view
}

/// Draws a scene into a view and into its `colours`, in parallel.
fn draw<T: Send>(
    scene: &Scene<'_>,
    behind: &Behind,
    view: &mut View,
    colours: &mut [T],
    encode: impl Fn(&Vector3<f32>) -> T + Sync,
) {
    let together = (band::ROWS * view.camera.size.width).max(1);
    let bands = (
        colours.par_chunks_mut(together),
        view.depth.par_chunks_mut(together),
        view.normals_in_world.par_chunks_mut(together),
        view.link.par_chunks_mut(together),
    );
    bands.into_par_iter().enumerate().for_each(|(band, (colours, depth, normals_in_world, link))| {
        let rows = Rows { colours, depth, normals_in_world, link };
        band::draw(scene, behind, band * band::ROWS, rows, &encode);
    });
}

/// The pixel with a row-major index.
fn pixel_at(size: ImageSize, at: usize) -> Pixel {
    Pixel { u: (at % size.width) as u32, v: (at / size.width) as u32 }
}

/// A unit vector on the camera's side: against the ray to `point`, both in the camera frame.
fn towards_camera(normal: Vector3<f32>, point: &Point3<f32>) -> Vector3<f32> {
    if normal.dot(&point.coords) > 0.0 { -normal } else { normal }
}

#[cfg(test)]
mod tests;
