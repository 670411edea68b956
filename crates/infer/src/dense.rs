//! Actionability everywhere: the raw maps behind a prediction.

use std::fmt;

use nalgebra::Point3;
use rayon::prelude::*;
use where2act_core::{Observation, Pixel, Primitive, is_measured, is_measured_depth};
use where2act_model::preprocess::{Letterbox, Window};

use crate::nearest::NearestIndex;

/// Dense actionability of every primitive of the network, at the input's resolution. Values are computed when they
/// are asked for, so that maps of large inputs need not be in memory.
pub struct DenseMaps<'a> {
    pub(crate) observation: &'a Observation,
    pub(crate) primitives: Vec<Primitive>,
    /// `[primitives, rows]`, in [0, 1].
    pub(crate) values: Vec<f32>,
    pub(crate) geometry: Geometry,
}

/// How the network's rows lie on the input.
pub(crate) enum Geometry {
    /// Pixels of a square picture that holds the input, or the part of it around its mask, letterboxed.
    Grid(Letterbox),
    /// Points.
    Points {
        /// In metres.
        index: NearestIndex,
        /// The point that was asked for, metres.
        asked: Option<Point3<f32>>,
    },
}

impl fmt::Debug for DenseMaps<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DenseMaps").field("primitives", &self.primitives).finish_non_exhaustive()
    }
}

impl DenseMaps<'_> {
    /// The primitives there are maps of: the network's.
    #[must_use]
    pub fn primitives(&self) -> &[Primitive] {
        &self.primitives
    }

    /// Actionability at a position of an input picture (pixel centres at + 0.5), between its pixels interpolated.
    /// `None` outside the picture or the object, for scans, and for primitives the network does not know.
    #[must_use]
    pub fn at(&self, primitive: Primitive, x: f32, y: f32) -> Option<f32> {
        let output = self.output(primitive)?;
        let Observation::Image { size, .. } = self.observation else { return None };
        let inside = x >= 0.0 && y >= 0.0 && x < size.width as f32 && y < size.height as f32;
        let pixel = inside.then_some(Pixel { u: x as u32, v: y as u32 })?;
        match &self.geometry {
            Geometry::Grid(letterbox) => {
                on_object(self.observation, pixel).then(|| self.bilinear(letterbox, output, x, y))
            }
            Geometry::Points { index, .. } => {
                self.interpolate(index, output, &seen_point(self.observation, pixel)?)
            }
        }
    }

    /// Actionability at a point of a scan. `None` for pictures, points that were not measured (not finite, or at (0, 0, 0)),
    /// and primitives the network does not know.
    #[must_use]
    pub fn at_point(&self, primitive: Primitive, point: usize) -> Option<f32> {
        let output = self.output(primitive)?;
        let (Observation::Cloud { points }, Geometry::Points { index, .. }) =
            (self.observation, &self.geometry)
        else {
            return None;
        };
        self.interpolate(index, output, points.get(point).filter(|p| is_measured(p))?)
    }

    /// One row of a picture's map; 0 off the object. For scans, row 0 holds every point.
    ///
    /// `values` is as long as the picture is wide, or the scan long.
    pub fn row(&self, primitive: Primitive, v: usize, values: &mut [f32]) {
        let scan = matches!(self.observation, Observation::Cloud { .. });
        values.par_iter_mut().with_min_len(256).enumerate().for_each(|(u, value)| {
            let found = if scan {
                self.at_point(primitive, u)
            } else {
                self.at(primitive, u as f32 + 0.5, v as f32 + 0.5)
            };
            *value = found.unwrap_or(0.0);
        });
    }

    /// A whole map, row-major: `[height * width]` of a picture or `[points]` of a scan; 0 off the object.
    #[must_use]
    pub fn dense(&self, primitive: Primitive) -> Vec<f32> {
        let (width, height) = match self.observation {
            Observation::Image { size, .. } => (size.width, size.height),
            Observation::Cloud { points } => (points.len(), 1),
        };
        let mut values = vec![0.0; width * height];
        for (v, row) in values.chunks_mut(width.max(1)).enumerate() {
            self.row(primitive, v, row);
        }
        values
    }

    fn output(&self, primitive: Primitive) -> Option<usize> {
        self.primitives.iter().position(|p| *p == primitive)
    }

    fn value(&self, row: usize, output: usize) -> f32 {
        let rows = self.values.len() / self.primitives.len();
        self.values.get(output * rows + row).copied().unwrap_or(0.0)
    }

    fn bilinear(&self, letterbox: &Letterbox, output: usize, x: f32, y: f32) -> f32 {
        let Letterbox { source, roll, window: Window { left, top, size }, side, inner, offset } = *letterbox;
        let [x, y] = roll.turn_back([x.into(), y.into()], source);
        // Positions between the centres of network pixels; only those that show the input count, at its edge too.
        let along = |t: f64, start: usize, from: usize, to: usize, offset: usize| {
            let inside =
                ((t - start as f64) as f32 * to as f32 / from as f32 - 0.5).clamp(0.0, to as f32 - 1.0);
            let first = inside as usize;
            (offset + first, offset + (first + 1).min(to - 1), inside - first as f32)
        };
        let (left, right, fx) = along(x, left, size.width, inner.width, offset.0);
        let (top, bottom, fy) = along(y, top, size.height, inner.height, offset.1);
        let at = |u: usize, v: usize| self.value(v * side + u, output);
        let upper = at(left, top) * (1.0 - fx) + at(right, top) * fx;
        let lower = at(left, bottom) * (1.0 - fx) + at(right, bottom) * fx;
        upper * (1.0 - fy) + lower * fy
    }

    /// Mean of the three nearest rows, weighted by 1 / distance.
    fn interpolate(&self, index: &NearestIndex, output: usize, at: &Point3<f32>) -> Option<f32> {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (row, squared) in index.nearest::<3>(at) {
            let weight = 1.0 / (squared.sqrt() + 1e-8);
            sum += weight * self.value(row as usize, output);
            weights += weight;
        }
        (weights > 0.0).then(|| sum / weights)
    }
}

/// Whether a pixel of an image belongs to the object: by its mask, else by its depth if there is no picture, else yes.
pub(crate) fn on_object(observation: &Observation, pixel: Pixel) -> bool {
    let Observation::Image { size, rgb, depth, mask, .. } = observation else { return false };
    let i = size.index(pixel);
    let masked = mask.as_ref().is_none_or(|m| m.get(i).copied().unwrap_or(false));
    let seen = match (rgb, depth) {
        (None, Some(depth)) => depth.get(i).copied().is_some_and(is_measured_depth),
        _ => true,
    };
    masked && seen
}

/// The point an image's pixel shows, if it is on the object.
pub(crate) fn seen_point(observation: &Observation, pixel: Pixel) -> Option<Point3<f32>> {
    let Observation::Image { size, depth: Some(depth), intrinsics: Some(intrinsics), .. } = observation
    else {
        return None;
    };
    let z = depth.get(size.index(pixel)).copied().filter(|z| is_measured_depth(*z))?;
    on_object(observation, pixel).then(|| intrinsics.pixel_to_point(pixel, z))
}
