//! What surfaces keep away from each other: light from everywhere in gaps and corners, and a lamp's behind what stands out.
//!
//! Both are looked up in the picture's own depth map, so that what the camera does not see keeps nothing away. This is less
//! than what light does, and enough for what pictures of furniture show: dark gaps, and shadows below handles.

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use where2act_core::Pixel;

use super::View;

/// Places around a pixel that are asked what they hide of the surroundings.
const AROUND: usize = 12;
/// Turn from one of them to the next, radians: the golden angle spreads any number of them evenly.
const GOLDEN_ANGLE: f32 = 2.399_963_2;
/// Places on the way to the lamp.
const ON_THE_WAY: usize = 32;
/// Pixels in a square of this side ask at different places, and are then averaged.
const TILE: usize = 4;
/// Surfaces are taken to be as thick as that, metres: what passes further behind them is not hidden by them.
const THICKNESS: f32 = 0.3;
/// Sine of the elevation above the surface from which on something hides anything; curved surfaces hide nothing of themselves.
const LEAST_ELEVATION: f32 = 0.12;

/// How much darker a picture is where surfaces hide light. The default is the published look, which has no shadows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shadow {
    /// Share of the light that is missing where half of the surroundings are hidden.
    pub corners: f32,
    /// How near something must be to hide surroundings, metres.
    pub reach: f32,
    /// Share of the light that is missing where the first lamp is hidden.
    pub cast: f32,
    /// How far away what hides the lamp may be, metres.
    pub length: f32,
}

impl Shadow {
    /// None in a quarter of the pictures; as on an overcast day, as below a lamp, or both in the others.
    pub(super) fn random(rng: &mut impl Rng) -> Self {
        let [corners, cast] = [rng.random_range(0.2..1.0), rng.random_range(0.2..0.8)];
        let (reach, length) = (rng.random_range(0.04..0.3), rng.random_range(0.05..0.6));
        match rng.random_range(0..4) {
            0 => Self::default(),
            1 => Self { corners, reach, cast: 0.0, length },
            2 => Self { corners: 0.0, reach, cast, length },
            _ => Self { corners, reach, cast, length },
        }
    }

    /// Takes from the light at the pixels of a view, row-major, what surfaces hide. `lamp` is in the world.
    pub(super) fn fall(&self, view: &View, lamp: Option<Point3<f32>>, lights: &mut [Vector3<f32>]) {
        if self.corners <= 0.0 && (self.cast <= 0.0 || lamp.is_none()) {
            return;
        }
        let lamp = lamp.map(|lamp| view.camera.world_from_camera.inverse_transform_point(&lamp));
        let (width, height) = (view.camera.size.width, view.camera.size.height);
        let kept: Vec<f32> = (0..view.depth.len())
            .into_par_iter()
            .with_min_len(width.max(1))
            .map(|at| self.kept(view, (at % width, at / width), lamp))
            .collect();
        lights.par_chunks_mut(width.max(1)).enumerate().for_each(|(v, row)| {
            for (u, light) in row.iter_mut().enumerate() {
                let at = v * width + u;
                let alike = |n: &usize| {
                    view.link[*n] == view.link[at]
                        && (view.depth[*n] - view.depth[at]).abs() < 0.02 * view.depth[at]
                };
                if view.depth[at] > 0.0 {
                    let (left, top) = (u.saturating_sub(TILE / 2), v.saturating_sub(TILE / 2));
                    let rows = top..(v + TILE / 2).min(height);
                    let square =
                        rows.flat_map(|y| (left..(u + TILE / 2).min(width)).map(move |x| y * width + x));
                    let (sum, count) = square
                        .filter(alike)
                        .fold((0.0, 0.0f32), |(sum, count), n| (sum + kept[n], count + 1.0));
                    *light *= if count > 0.0 { sum / count } else { kept[at] };
                }
            }
        });
    }

    /// What is left of the light at one pixel.
    fn kept(&self, view: &View, (u, v): (usize, usize), lamp: Option<Point3<f32>>) -> f32 {
        let seen = Seen::new(view);
        let Some(point) = seen.at(u as isize, v as isize) else { return 1.0 };
        let normal = view.camera.world_from_camera.rotation.inverse()
            * view.normals_in_world[v * view.camera.size.width + u];
        let turn = ((u % TILE) * TILE + v % TILE) as f32 / (TILE * TILE) as f32;
        let corners = if self.corners > 0.0 {
            1.0 - self.corners * (2.0 * self.hidden(&seen, (u, v), &point, &normal, turn)).min(1.0)
        } else {
            1.0
        };
        let cast = match lamp {
            Some(lamp) if self.cast > 0.0 && self.is_hidden(&seen, &lamp, &point, &normal, turn) => {
                1.0 - self.cast
            }
            _ => 1.0,
        };
        corners * cast
    }

    /// The share of a point's surroundings that others hide, in [0, 1]: 0.5 at the foot of a wall.
    fn hidden(
        &self,
        seen: &Seen<'_>,
        (u, v): (usize, usize),
        point: &Point3<f32>,
        normal: &Vector3<f32>,
        turn: f32,
    ) -> f32 {
        let pixels = seen.0.camera.intrinsics.fx * self.reach / point.z;
        let sum: f32 = (0..AROUND)
            .map(|n| {
                let away = pixels * ((n as f32 + 0.5) / AROUND as f32).sqrt();
                let (sin, cos) = (n as f32 * GOLDEN_ANGLE + turn * std::f32::consts::TAU).sin_cos();
                let there = seen.at(u as isize + (away * cos) as isize, v as isize + (away * sin) as isize);
                let Some(there) = there else { return 0.0 };
                let towards = there - point;
                let distance = towards.norm();
                let elevation = normal.dot(&towards) / distance.max(1e-6);
                (elevation - LEAST_ELEVATION).max(0.0) * (1.0 - distance / (2.0 * self.reach)).max(0.0)
            })
            .sum();
        2.0 * sum / AROUND as f32
    }

    /// Whether something stands between a point that faces the lamp and the lamp.
    fn is_hidden(
        &self,
        seen: &Seen<'_>,
        lamp: &Point3<f32>,
        point: &Point3<f32>,
        normal: &Vector3<f32>,
        turn: f32,
    ) -> bool {
        let towards = (lamp - point).normalize();
        if normal.dot(&towards) <= LEAST_ELEVATION {
            return false;
        }
        let start = point + normal * (0.003 * point.z);
        (0..ON_THE_WAY).any(|n| {
            let way = self.length * ((n as f32 + turn) / ON_THE_WAY as f32).powf(1.5);
            let place = start + towards * way;
            let Some((x, y)) = seen.0.camera.intrinsics.project(&place) else { return false };
            let there = seen.at(x.floor() as isize, y.floor() as isize);
            there.is_some_and(|there| (0.002 * place.z..THICKNESS).contains(&(place.z - there.z)))
        })
    }
}

/// The points of a view, camera frame.
struct Seen<'v>(&'v View);

impl<'v> Seen<'v> {
    fn new(view: &'v View) -> Self {
        Self(view)
    }

    /// What is seen at a pixel; `None` for background and outside of the picture.
    fn at(&self, u: isize, v: isize) -> Option<Point3<f32>> {
        let size = self.0.camera.size;
        let (u, v) = (usize::try_from(u).ok()?, usize::try_from(v).ok()?);
        if u >= size.width || v >= size.height {
            return None;
        }
        let depth = self.0.depth[v * size.width + u];
        let point = || self.0.camera.intrinsics.pixel_to_point(Pixel { u: u as u32, v: v as u32 }, depth);
        (depth > 0.0).then(point)
    }
}
