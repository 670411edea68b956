//! What overlays are drawn on: the input as a picture of a size that screens show.

use nalgebra::Point3;
use where2act_core::{ImageSize, Intrinsics, Observation, Pixel, is_measured_depth};

use super::canvas::{Canvas, Xy};
use super::splat::{NOTHING, splat};

/// Longest side of the picture in an overlay, pixels.
const LONG_SIDE: usize = 640;
/// Shortest side: an input of one pixel is shown as a square one sees.
const SHORT_SIDE: usize = 64;

/// How to get from the input to the canvas.
pub(crate) struct Lens {
    /// Canvas pixels per input pixel.
    scale: (f32, f32),
    /// The camera, in canvas pixels.
    pub(crate) intrinsics: Option<Intrinsics>,
}

impl Lens {
    /// Canvas position of the centre of an input pixel.
    pub(crate) fn centre(&self, pixel: Pixel) -> Xy {
        ((pixel.u as f32 + 0.5) * self.scale.0, (pixel.v as f32 + 0.5) * self.scale.1)
    }
}

/// Where a canvas pixel's value comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Spot {
    /// A position in the input picture, pixels.
    Picture(f32, f32),
    /// A point of the scan.
    Point(u32),
    /// Nothing was seen there.
    Nothing,
}

/// The input, ready to be drawn on.
pub(crate) struct View {
    pub(crate) size: ImageSize,
    /// sRGB, row-major.
    pub(crate) pixels: Vec<[u8; 3]>,
    pub(crate) lens: Lens,
    /// For scans: the point seen in each pixel, or [`NOTHING`].
    points: Option<Vec<u32>>,
}

impl View {
    pub(crate) fn new(observation: &Observation) -> Self {
        match observation {
            Observation::Cloud { points } => Self::of_scan(points),
            Observation::Image { size, rgb, depth, intrinsics, .. } => {
                let shown = shown_size(*size);
                let scale =
                    (shown.width as f32 / size.width as f32, shown.height as f32 / size.height as f32);
                let pixels = match (rgb, depth) {
                    (Some(rgb), _) => resize(rgb, *size, shown),
                    (None, Some(depth)) => resize(&relief(depth), *size, shown),
                    (None, None) => vec![[255; 3]; shown.pixels()],
                };
                let intrinsics = intrinsics.map(|i| i.scaled(scale.0, scale.1));
                Self { size: shown, pixels, lens: Lens { scale, intrinsics }, points: None }
            }
        }
    }

    fn of_scan(points: &[Point3<f32>]) -> Self {
        let size = ImageSize::square(LONG_SIDE);
        let (intrinsics, seen) = splat(points, size);
        let near = seen.iter().filter_map(|s| points.get(s.point as usize)).map(|p| p.z);
        let (low, high) = near.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), z| (l.min(z), h.max(z)));
        let shade = |s: &super::splat::Seen| match points.get(s.point as usize) {
            Some(p) => {
                let far = ((p.z - low) / (high - low).max(1e-6)).clamp(0.0, 1.0);
                [((1.0 - 0.45 * far) * s.light * 225.0) as u8; 3]
            }
            None => [255; 3],
        };
        Self {
            size,
            pixels: seen.iter().map(shade).collect(),
            lens: Lens { scale: (1.0, 1.0), intrinsics: Some(intrinsics) },
            points: Some(seen.iter().map(|s| s.point).collect()),
        }
    }

    /// Where the value of a canvas pixel comes from.
    pub(crate) fn spot(&self, x: usize, y: usize) -> Spot {
        match &self.points {
            None => {
                let (sx, sy) = self.lens.scale;
                Spot::Picture((x as f32 + 0.5) / sx, (y as f32 + 0.5) / sy)
            }
            Some(points) => match points.get(y * self.size.width + x) {
                Some(&point) if point != NOTHING => Spot::Point(point),
                _ => Spot::Nothing,
            },
        }
    }

    /// The input itself on a canvas, `muted` to a light grey that colours stand out on.
    pub(crate) fn canvas(&self, muted: bool) -> Option<Canvas> {
        let mut canvas = Canvas::new(self.size.width, self.size.height, [255; 4])?;
        for (i, &[r, g, b]) in self.pixels.iter().enumerate() {
            let (x, y) = ((i % self.size.width) as i32, (i / self.size.width) as i32);
            let [r, g, b] = if muted {
                // Rec. 709 luminance; a tenth of the colour is kept.
                let grey = 0.2126 * f32::from(r) + 0.7152 * f32::from(g) + 0.0722 * f32::from(b);
                [r, g, b].map(|c| (55.0 + 0.72 * (0.9 * grey + 0.1 * f32::from(c))) as u8)
            } else {
                [r, g, b]
            };
            canvas.blend(x, y, [r, g, b, 255]);
        }
        Some(canvas)
    }
}

fn shown_size(size: ImageSize) -> ImageSize {
    let long = size.width.max(size.height).max(1);
    let side = |n: usize| (n * LONG_SIDE / long).clamp(SHORT_SIDE, LONG_SIDE);
    ImageSize { width: side(size.width), height: side(size.height) }
}

/// Mean of the source pixels under each target pixel, or the nearest one where the picture grows.
fn resize(source: &[[u8; 3]], from: ImageSize, to: ImageSize) -> Vec<[u8; 3]> {
    let span = |i: usize, n: usize, of: usize| {
        let start = i * of / n;
        start..((i + 1) * of / n).clamp(start + 1, of.max(start + 1))
    };
    let mut pixels = Vec::with_capacity(to.pixels());
    for y in 0..to.height {
        let rows = span(y, to.height, from.height);
        for x in 0..to.width {
            let columns = span(x, to.width, from.width);
            let (mut sum, mut n) = ([0u32; 3], 0);
            // Of very large pictures a few rows and columns will do.
            for row in rows.clone().step_by(rows.len().div_ceil(4)) {
                for column in columns.clone().step_by(columns.len().div_ceil(4)) {
                    if let Some(colour) = source.get(row * from.width + column) {
                        sum.iter_mut().zip(colour).for_each(|(s, c)| *s += u32::from(*c));
                        n += 1;
                    }
                }
            }
            pixels.push(sum.map(|s| s.checked_div(n).unwrap_or(255) as u8));
        }
    }
    pixels
}

/// A depth map as a picture: near is light, nothing seen is white.
fn relief(depth: &[f32]) -> Vec<[u8; 3]> {
    let seen = |z: &f32| is_measured_depth(*z);
    let bounds = depth.iter().filter(|z| seen(z));
    let (low, high) = bounds.fold((f32::INFINITY, 0.0f32), |(l, h), &z| (l.min(z), h.max(z)));
    let grey = |z: &f32| match seen(z) {
        true => [(215.0 - 150.0 * (z - low) / (high - low).max(1e-6)) as u8; 3],
        false => [255; 3],
    };
    depth.iter().map(grey).collect()
}
