//! Some rows of a picture: from triangles to samples, from samples to pixels.
//!
//! Bands are independent of each other, so threads share them out and every picture is the same for any number of
//! threads. A pixel needs the samples of its rows, the one above and two below, which neighbouring bands make twice.

use std::cell::Cell;
use std::ops::Range;
use std::slice;

use nalgebra::Vector3;
use where2act_core::{ImageSize, Pixel};

use super::backdrop::Behind;
use super::light::{CENTRE, GLASS, KINDS, Planes, filter};
use super::raster::{Buffer, Grid, Region};
use super::scene::{Drawn, LAYERS, Scene};
use super::shade::Shader;

/// Pixel rows in a band: enough that little is made twice, few enough that its samples stay in a core's cache.
pub(super) const ROWS: usize = 32;

/// Bands of a picture.
pub(super) fn count(size: ImageSize) -> usize {
    size.height.div_ceil(ROWS)
}

/// Which of some bands need some samples.
pub(super) fn reached(samples: &Region, bands: usize) -> Range<usize> {
    // A band has the sample row above its own and two below.
    samples.top.saturating_sub(2) / (2 * ROWS)..bands.min(samples.bottom / (2 * ROWS) + 1)
}

/// Memory of a band, kept by its thread for the next one.
struct Scratch {
    /// The triangles of the band, sorted by depth.
    layers: [Vec<Drawn>; LAYERS],
    solid: Buffer,
    glass: Buffer,
    planes: Planes,
    /// Places in the planes that are to be shaded: row and column.
    shaded: Vec<(usize, usize)>,
    /// Light of a row of pixels.
    row: Vec<[f32; 3]>,
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
    band.rasterise(top / ROWS);
    band.find_surfaces();
    band.fill_lights(top, &mut rows);
    for v in frame.top..frame.bottom {
        let colours = &mut rows.colours[(v - top) * width..][frame.left..frame.right];
        for (colour, light) in colours.iter_mut().zip(band.resolve(v)) {
            *colour = encode(&Vector3::from(*light));
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

    /// Rows of the grid of pixels, likewise.
    fn rows(&self) -> usize {
        self.bottom - self.top + 2
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
            layers: Default::default(),
            solid: Buffer::new(grid),
            glass: Buffer::new(grid),
            planes: Planes::default(),
            shaded: Vec::new(),
            row: Vec::new(),
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
    /// Finds the nearest triangles of a band, from near to far: what is hidden needs no drawing.
    fn rasterise(&mut self, band: usize) {
        let (scene, region) = (self.scene, self.frame.samples);
        let Scratch { layers, solid, glass, .. } = &mut *self.scratch;
        solid.clear(scene.grid, region);
        glass.clear(
            scene.grid,
            if scene.has_glass { region } else { Region { bottom: region.top, ..region } },
        );
        for drawn in scene.drawn(band) {
            layers[scene.layer(drawn.nearness)].push(*drawn);
        }
        for layer in layers {
            for drawn in layer.drain(..) {
                let instance = &scene.instances[drawn.instance as usize];
                let buffer = if instance.is_glass { &mut *glass } else { &mut *solid };
                let bounds = drawn.bounds().rows(region.top, region.bottom);
                if !buffer.hides(&bounds, drawn.nearness) {
                    buffer.draw(instance.corners(drawn.index as usize), bounds, drawn.index);
                }
            }
            solid.look_again();
            glass.look_again();
        }
    }

    /// Sorts what samples show by their place in the pixel.
    fn find_surfaces(&mut self) {
        let (frame, scene) = (self.frame, self.scene);
        let Scratch { solid, glass, planes, .. } = &mut *self.scratch;
        planes.clear(frame.columns(), frame.rows());
        let region = frame.samples;
        let mut instance = &scene.instances[0];
        for j in region.top..region.bottom {
            let glass = if scene.has_glass { glass.row(j) } else { &[] };
            for (n, (i, &number)) in (region.left..region.right).zip(solid.row(j)).enumerate() {
                let surface = match (number, glass.get(n)) {
                    (_, Some(&pane)) if pane != 0 => GLASS,
                    (0, _) => continue,
                    _ => {
                        let triangle = number as usize - 1;
                        if !instance.triangles().contains(&triangle) {
                            instance = scene.instance(triangle);
                        }
                        instance.surface
                    }
                };
                planes.surfaces[2 * (j % 2) + i % 2][frame.at(i / 2, j / 2)] = surface;
            }
        }
    }

    /// Finds the light at every sample, and depth, normals and link ids of the view.
    fn fill_lights<T>(&mut self, top: usize, rows: &mut Rows<'_, T>) {
        self.fill_background();
        for kind in KINDS {
            self.scratch.shaded.clear();
            self.scratch.planes.interpolate(kind, &mut self.scratch.shaded);
            self.shade(kind, top, rows);
        }
    }

    fn fill_background(&mut self) {
        let (frame, size) = (self.frame, self.scene.camera.size);
        for plane in &mut self.scratch.planes.lights {
            plane.clear();
            match self.behind {
                Behind::Plain(colour) => plane.resize(frame.columns() * frame.rows(), (*colour).into()),
                Behind::Picture(..) => {
                    for v in frame.top..frame.bottom + 2 {
                        let v = v.saturating_sub(1).min(size.height - 1) as u32;
                        plane.extend((frame.left..frame.right + 2).map(|u| {
                            let u = u.saturating_sub(1).min(size.width - 1) as u32;
                            <[f32; 3]>::from(self.behind.at(Pixel { u, v }))
                        }));
                    }
                }
            }
        }
    }

    /// Shades the samples of a kind that are to be shaded, first what is solid, then the glass before it.
    fn shade<T>(&mut self, kind: usize, top: usize, rows: &mut Rows<'_, T>) {
        let Self { scene, frame, shader, .. } = self;
        let Scratch { solid, glass, planes, shaded, .. } = &mut *self.scratch;
        let width = scene.camera.size.width;
        let columns = frame.columns();
        let lights = &mut planes.lights[kind];
        for panes in [false, true].into_iter().take(1 + usize::from(scene.has_glass)) {
            for &(row, column) in &*shaded {
                let (u, v) = (frame.left + column - 1, frame.top + row - 1);
                let (i, j) = (2 * u + kind % 2, 2 * v + kind / 2);
                let mut seen = solid.get(i, j);
                if panes {
                    seen = glass.get(i, j).filter(|pane| seen.is_none_or(|solid| pane.1 < solid.1));
                }
                let Some((triangle, depth)) = seen else { continue };
                shader.shade(triangle, scene.grid.ray(i, j) * depth, row * columns + column, lights);
                if kind == CENTRE && (frame.top..frame.bottom).contains(&v) {
                    let at = (v - top) * width + u;
                    rows.depth[at] = depth;
                    (rows.normals_in_world[at], rows.link[at]) = shader.normal(triangle);
                }
            }
            shader.flush(lights);
        }
    }

    /// Light of the pixels of a row.
    fn resolve(&mut self, v: usize) -> &[[f32; 3]] {
        let Self { scene, behind, frame, .. } = self;
        let Scratch { planes, row, .. } = &mut *self.scratch;
        row.resize(frame.right - frame.left, [0.0; 3]);
        filter(planes.around(frame.at(frame.left, v), row.len()), row);
        if let Behind::Picture(..) = behind {
            let region = &scene.region;
            for (u, light) in (frame.left..frame.right).zip(&mut *row) {
                if frame.is_inside(u, v, region) {
                    continue;
                }
                // Outside of the region every pixel has its own background only.
                let background = behind.at(Pixel { u: u as u32, v: v as u32 }).into();
                let mut samples = planes.around(frame.at(u, v), 1).map(|row| row.map(|light| light[0]));
                for (j, samples) in (2 * v..).zip(&mut samples) {
                    for (i, sample) in (2 * u..).zip(samples) {
                        if i < region.left || i >= region.right || j < region.top || j >= region.bottom {
                            *sample = background;
                        }
                    }
                }
                filter(
                    samples.each_ref().map(|row| row.each_ref().map(slice::from_ref)),
                    slice::from_mut(light),
                );
            }
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_reach_the_bands_that_need_their_samples() {
        let (height, bands) = (100, 4);
        assert_eq!(count(ImageSize { width: 7, height }), bands);
        for top in 0..2 * height + 1 {
            for bottom in top + 1..=2 * height + 1 {
                let samples = Region { left: 0, top, right: 9, bottom };
                let needs = |band: &usize| {
                    let (first, end) = (band * ROWS, height.min((band + 1) * ROWS));
                    !samples.rows((2 * first).saturating_sub(1), 2 * end + 2).is_empty()
                };
                let expected: Vec<usize> = (0..bands).filter(needs).collect();
                assert_eq!(reached(&samples, bands).collect::<Vec<_>>(), expected, "rows {top} to {bottom}");
            }
        }
    }
}
