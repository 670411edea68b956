//! Some rows of a picture: from triangles to samples, from samples to pixels.
//!
//! Bands are independent of each other, so threads share them out and every picture is the same for any number of
//! threads. A pixel needs the samples of its rows, the one above and two below, which neighbouring bands make twice.

use std::cell::Cell;

use nalgebra::Vector3;
use where2act_core::Pixel;

use super::backdrop::Behind;
use super::raster::{Buffer, Grid, NOTHING, Region};
use super::scene::Scene;
use super::shade::Shader;

/// Pixel rows in a band: enough that little is made twice, few enough that its samples stay in a core's cache.
pub(super) const ROWS: usize = 32;

/// Marks a sample with glass before whatever else is there.
const GLASS: u32 = NOTHING - 1;

/// The places of samples in a pixel (u, v): its upper left corner (2u, 2v), the middles of its upper and its left
/// edge, its centre. Samples of a kind are kept together, so that neighbours lie at fixed distances.
const CORNER: usize = 0;
const UPPER: usize = 1;
const LEFT: usize = 2;
const CENTRE: usize = 3;

/// Memory of a band, kept by its thread for the next one.
struct Scratch {
    solid: Buffer,
    glass: Buffer,
    /// Of every kind of sample: the mesh it shows, [`GLASS`] or [`NOTHING`].
    meshes: [Vec<u32>; 4],
    /// Of every kind of sample: its light.
    lights: [Vec<Vector3<f32>>; 4],
}

thread_local! {
    static SCRATCH: Cell<Option<Box<Scratch>>> = const { Cell::new(None) };
}

/// Rows of a view, to be filled.
pub(super) struct Rows<'v, T> {
    pub(super) colours: &'v mut [T],
    pub(super) depth: &'v mut [f32],
    pub(super) normals_in_world: &'v mut [Vector3<f32>],
    pub(super) link: &'v mut [u8],
}

/// Draws a scene into the rows of a view from row `top` on. Colours are written where they can differ from the
/// background, as `encode` makes them of light.
pub(super) fn draw<T>(
    scene: &Scene<'_>,
    behind: &Behind,
    top: usize,
    mut rows: Rows<'_, T>,
    encode: impl Fn(&Vector3<f32>) -> T,
) {
    let width = scene.camera.size.width;
    let Some(frame) = Frame::new(scene, top, top + rows.link.len() / width.max(1)) else { return };
    let scratch = SCRATCH.take().unwrap_or_else(|| Box::new(Scratch::new(scene.grid)));
    let mut band = Band { scene, behind, frame, scratch, shader: Shader::new(scene) };
    band.rasterise();
    band.find_meshes();
    band.measure(top, &mut rows);
    band.fill_lights();
    for v in frame.top..frame.bottom {
        for u in frame.left..frame.right {
            rows.colours[(v - top) * width + u] = encode(&band.resolve(u, v));
        }
    }
    SCRATCH.set(Some(band.scratch));
}

/// Which pixels and samples a band is about.
#[derive(Clone, Copy)]
struct Frame {
    /// Pixels to be written: columns and rows, ends excluded.
    left: usize,
    right: usize,
    top: usize,
    bottom: usize,
    /// Samples needed for them.
    samples: Region,
}

impl Frame {
    /// The part of some rows that can show anything.
    fn new(scene: &Scene<'_>, top: usize, bottom: usize) -> Option<Self> {
        let (region, size) = (scene.region, scene.camera.size);
        let frame = Self {
            left: region.left.saturating_sub(1) / 2,
            right: size.width.min(region.right.div_ceil(2)),
            top: top.max(region.top.saturating_sub(1) / 2),
            bottom: bottom.min(region.bottom.div_ceil(2)),
            samples: region.rows((2 * top).saturating_sub(1), 2 * bottom + 2),
        };
        (frame.left < frame.right && frame.top < frame.bottom && !region.is_empty()).then_some(frame)
    }

    /// Columns of the grid of pixels: those written and one more on every side.
    fn columns(&self) -> usize {
        self.right - self.left + 2
    }

    fn pixels(&self) -> usize {
        self.columns() * (self.bottom - self.top + 2)
    }

    /// Index of a pixel in the grid.
    fn at(&self, u: usize, v: usize) -> usize {
        (v + 1 - self.top) * self.columns() + (u + 1 - self.left)
    }

    /// Whether all samples of a pixel are among those of a region.
    fn is_inside(&self, u: usize, v: usize, region: &Region) -> bool {
        2 * u >= region.left && 2 * u + 2 < region.right && 2 * v >= region.top && 2 * v + 2 < region.bottom
    }
}

impl Scratch {
    fn new(grid: Grid) -> Self {
        Self {
            solid: Buffer::new(grid),
            glass: Buffer::new(grid),
            meshes: Default::default(),
            lights: Default::default(),
        }
    }
}

struct Band<'s> {
    scene: &'s Scene<'s>,
    behind: &'s Behind,
    frame: Frame,
    scratch: Box<Scratch>,
    shader: Shader<'s>,
}

impl Band<'_> {
    fn rasterise(&mut self) {
        let (scene, region) = (self.scene, self.frame.samples);
        let Scratch { solid, glass, .. } = &mut *self.scratch;
        solid.clear(scene.grid, region);
        glass.clear(
            scene.grid,
            if scene.has_glass { region } else { Region { bottom: region.top, ..region } },
        );
        for (id, drawn) in (0u32..).zip(&scene.drawn).filter(|(_, drawn)| drawn.reaches(&region)) {
            let buffer =
                if scene.instances[drawn.instance as usize].is_glass { &mut *glass } else { &mut *solid };
            buffer.draw(scene.corners(drawn), drawn.bounds().rows(region.top, region.bottom), id);
        }
    }

    /// Sorts what samples show by their place in the pixel.
    fn find_meshes(&mut self) {
        let (frame, scene) = (self.frame, self.scene);
        let Scratch { solid, glass, meshes, .. } = &mut *self.scratch;
        for plane in &mut *meshes {
            plane.clear();
            plane.resize(frame.pixels(), NOTHING);
        }
        let region = frame.samples;
        for j in region.top..region.bottom {
            let glass = if scene.has_glass { glass.row(j) } else { &[] };
            for (n, (i, &triangle)) in (region.left..region.right).zip(solid.row(j)).enumerate() {
                let mesh = match (triangle, glass.get(n)) {
                    (_, Some(&pane)) if pane != NOTHING => GLASS,
                    (NOTHING, _) => continue,
                    _ => scene.drawn[triangle as usize].instance,
                };
                meshes[2 * (j % 2) + i % 2][frame.at(i / 2, j / 2)] = mesh;
            }
        }
    }

    /// Fills depth, normals and link ids of a view.
    fn measure<T>(&mut self, top: usize, rows: &mut Rows<'_, T>) {
        let width = self.scene.camera.size.width;
        for v in self.frame.top..self.frame.bottom {
            for u in self.frame.left..self.frame.right {
                let Some((triangle, depth)) = self.nearest(2 * u + 1, 2 * v + 1) else { continue };
                let at = (v - top) * width + u;
                rows.depth[at] = depth;
                (rows.normals_in_world[at], rows.link[at]) = self.shader.normal(triangle);
            }
        }
    }

    /// The nearest surface at a sample, glass or not.
    fn nearest(&self, i: usize, j: usize) -> Option<(u32, f32)> {
        match (self.scratch.solid.get(i, j), self.scratch.glass.get(i, j)) {
            (Some(solid), Some(glass)) => Some(if glass.1 < solid.1 { glass } else { solid }),
            (one, other) => one.or(other),
        }
    }

    /// Finds the light at every sample.
    ///
    /// Pixel centres are shaded. Between centres of one mesh light is interpolated, of textured ones the corners
    /// between four pixels are shaded too: twice a pixel is enough for both. Everything else is shaded.
    fn fill_lights(&mut self) {
        self.fill_background();
        let Frame { left, top, bottom, .. } = self.frame;
        let columns = self.frame.columns();
        let height = bottom - top + 2;
        let down = columns as isize;
        // Kind of sample, the rows of pixels that need it, and the kinds and places of its neighbours.
        let kinds = [
            (CENTRE, 0..height, None),
            (CORNER, 1..height, Some([(CENTRE, -down - 1), (CENTRE, -down), (CENTRE, -1), (CENTRE, 0)])),
            (UPPER, 1..height, Some([(CORNER, 0), (CORNER, 1), (CENTRE, -down), (CENTRE, 0)])),
            (LEFT, 1..height - 1, Some([(CENTRE, -1), (CENTRE, 0), (CORNER, 0), (CORNER, down)])),
        ];
        for (kind, rows, neighbours) in kinds {
            for row in rows {
                for column in 1..columns {
                    let at = row * columns + column;
                    let Scratch { meshes, lights, .. } = &*self.scratch;
                    let mesh = meshes[kind][at];
                    if mesh == NOTHING {
                        continue;
                    }
                    let between = neighbours.filter(|_| {
                        mesh != GLASS && (kind != CORNER || self.scene.instances[mesh as usize].is_even)
                    });
                    let between = between.map(|n| n.map(|(kind, way)| (kind, at.wrapping_add_signed(way))));
                    let light = match between.filter(|n| n.iter().all(|&(k, n)| meshes[k][n] == mesh)) {
                        Some(n) => {
                            let [a, b, c, d] = n.map(|(kind, at)| lights[kind][at]);
                            (a + b + c + d) * 0.25
                        }
                        None => {
                            let (i, j) = (2 * (left + column - 1) + kind % 2, 2 * (top + row) - 2 + kind / 2);
                            let background = lights[kind][at];
                            self.sample(i, j, background)
                        }
                    };
                    self.scratch.lights[kind][at] = light;
                }
            }
        }
    }

    fn fill_background(&mut self) {
        let (frame, size) = (self.frame, self.scene.camera.size);
        for plane in &mut self.scratch.lights {
            plane.clear();
            match self.behind {
                Behind::Plain(colour) => plane.resize(frame.pixels(), *colour),
                Behind::Picture(..) => {
                    for v in frame.top..frame.bottom + 2 {
                        let v = v.saturating_sub(1).min(size.height - 1) as u32;
                        plane.extend((frame.left..frame.right + 2).map(|u| {
                            let u = u.saturating_sub(1).min(size.width - 1) as u32;
                            self.behind.at(Pixel { u, v })
                        }));
                    }
                }
            }
        }
    }

    /// Light at one sample.
    fn sample(&mut self, i: usize, j: usize, background: Vector3<f32>) -> Vector3<f32> {
        let ray = self.scene.grid.ray(i, j);
        let solid = self.scratch.solid.get(i, j);
        let glass = self.scratch.glass.get(i, j);
        let light = solid.map_or(background, |(triangle, depth)| self.shader.shade(triangle, ray * depth).0);
        match glass {
            Some((triangle, depth)) if solid.is_none_or(|s| depth < s.1) => {
                let (tint, opacity) = self.shader.shade(triangle, ray * depth);
                light.lerp(&tint, opacity)
            }
            _ => light,
        }
    }

    /// Light of a pixel: its samples through a tent as wide as two pixels.
    fn resolve(&self, u: usize, v: usize) -> Vector3<f32> {
        let (at, below) = (self.frame.at(u, v), self.frame.at(u, v + 1));
        let [corner, upper, left, centre] = &self.scratch.lights;
        let mut rows = [
            [corner[at], upper[at], corner[at + 1]],
            [left[at], centre[at], left[at + 1]],
            [corner[below], upper[below], corner[below + 1]],
        ];
        if let Behind::Picture(..) = self.behind
            && !self.frame.is_inside(u, v, &self.scene.region)
        {
            // Outside of the region every pixel has its own background only.
            let region = &self.scene.region;
            let background = self.behind.at(Pixel { u: u as u32, v: v as u32 });
            for (j, row) in (2 * v..).zip(&mut rows) {
                for (i, light) in (2 * u..).zip(row) {
                    if i < region.left || i >= region.right || j < region.top || j >= region.bottom {
                        *light = background;
                    }
                }
            }
        }
        let mut sum = Vector3::zeros();
        for ([a, b, c], weight) in rows.into_iter().zip([0.25, 0.5, 0.25]) {
            sum += (a + b * 2.0 + c) * (0.25 * weight);
        }
        sum
    }
}
