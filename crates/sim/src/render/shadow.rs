//! Shadows: soft ones in gaps and corners, and one lamp's. Each dims the finished light of a pixel.
//!
//! Both are looked up in the picture's own depth map, so that what the camera does not see throws none. This is less than what
//! light does, and enough for what pictures of furniture show: dark gaps, and shadows below handles.

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

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
    /// Share of the light that is missing in the narrowest corners, in [0, 1].
    pub corners: f32,
    /// What is that near hides half as much of the surroundings as what touches, and at twice the distance nothing; metres.
    pub reach: f32,
    /// Share of the light that is missing where the first lamp is hidden from a surface that faces it, in [0, 1].
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

    /// Whether there are none.
    pub(super) fn is_none(&self) -> bool {
        self.corners <= 0.0 && self.cast <= 0.0
    }

    /// Takes from the light at the pixels of a view, row-major, what surfaces hide. `lamp` is in the world.
    pub(super) fn fall(&self, view: &View, lamp: Option<Point3<f32>>, lights: &mut [Vector3<f32>]) {
        if self.is_none() {
            return;
        }
        let lamp = lamp.map(|lamp| view.camera.world_from_camera.inverse_transform_point(&lamp));
        let (width, height) = (view.camera.size.width, view.camera.size.height);
        let kept: Vec<f32> = (0..view.depth.len())
            .into_par_iter()
            .with_min_len(width.max(1))
            .map(|at| self.kept(view, [at % width, at / width], lamp))
            .collect();
        lights.par_chunks_mut(width.max(1)).enumerate().for_each(|(v, row)| {
            for (u, light) in row.iter_mut().enumerate() {
                let at = v * width + u;
                let is_alike = |n: &usize| {
                    view.link[*n] == view.link[at]
                        && (view.depth[*n] - view.depth[at]).abs() < 0.02 * view.depth[at]
                };
                if view.depth[at] > 0.0 {
                    let (left, top) = (u.saturating_sub(TILE / 2), v.saturating_sub(TILE / 2));
                    let (right, bottom) = ((u + TILE / 2).min(width), (v + TILE / 2).min(height));
                    let square = (top..bottom).flat_map(|y| (left..right).map(move |x| y * width + x));
                    let alike = square.filter(is_alike);
                    let (sum, count) = alike.fold((0.0, 0.0), |(sum, count), n| (sum + kept[n], count + 1.0));
                    *light *= sum / count; // the pixel itself is among them
                }
            }
        });
    }

    /// What is left of the light at one pixel.
    fn kept(&self, view: &View, pixel: [usize; 2], lamp: Option<Point3<f32>>) -> f32 {
        let [u, v] = pixel;
        let Some(point) = view.point_in_camera(u as isize, v as isize) else { return 1.0 };
        let camera = &view.camera;
        let normal =
            camera.world_from_camera.rotation.inverse() * view.normals_in_world[v * camera.size.width + u];
        let turn = ((u % TILE) * TILE + v % TILE) as f32 / (TILE * TILE) as f32;
        let mut kept = 1.0;
        if self.corners > 0.0 {
            kept -= self.corners.min(1.0) * self.hidden(view, pixel, &point, &normal, turn);
        }
        if self.cast > 0.0 && lamp.is_some_and(|lamp| self.is_hidden(view, &lamp, &point, &normal, turn)) {
            kept *= 1.0 - self.cast.min(1.0);
        }
        kept
    }

    /// How narrow the corner is that a point lies in: 0 in the open, at most 1.
    fn hidden(
        &self,
        view: &View,
        [u, v]: [usize; 2],
        point: &Point3<f32>,
        normal: &Vector3<f32>,
        turn: f32,
    ) -> f32 {
        let pixels = view.camera.intrinsics.fx * self.reach / point.z;
        let hides = |n: usize| {
            let away = pixels * ((n as f32 + 0.5) / AROUND as f32).sqrt();
            let (sin, cos) = (n as f32 * GOLDEN_ANGLE + turn * std::f32::consts::TAU).sin_cos();
            let [right, down] = [away * cos, away * sin].map(|along| along as isize);
            let there =
                view.point_in_camera((u as isize).saturating_add(right), (v as isize).saturating_add(down));
            let Some(there) = there else { return 0.0 };
            let towards = there - point;
            let distance = towards.norm();
            let elevation = normal.dot(&towards) / distance.max(1e-6);
            (elevation - LEAST_ELEVATION).max(0.0) * (1.0 - distance / (2.0 * self.reach)).max(0.0)
        };
        let mean = (0..AROUND).map(hides).sum::<f32>() / AROUND as f32;
        // At the foot of a wall, which hides half of the surroundings, most of the light is gone.
        (4.0 * mean).min(1.0)
    }

    /// Whether something stands between a point that faces the lamp and the lamp.
    fn is_hidden(
        &self,
        view: &View,
        lamp: &Point3<f32>,
        point: &Point3<f32>,
        normal: &Vector3<f32>,
        turn: f32,
    ) -> bool {
        let to_lamp = lamp - point;
        let towards = to_lamp.normalize();
        if normal.dot(&towards) <= LEAST_ELEVATION {
            return false;
        }
        let start = point + normal * (0.003 * point.z);
        let length = self.length.min(to_lamp.norm());
        (0..ON_THE_WAY).any(|n| {
            let place = start + towards * (length * ((n as f32 + turn) / ON_THE_WAY as f32).powf(1.5));
            let Some((x, y)) = view.camera.intrinsics.project(&place) else { return false };
            let there = view.point_in_camera(x.floor() as isize, y.floor() as isize);
            there.is_some_and(|there| (0.002 * place.z..THICKNESS).contains(&(place.z - there.z)))
        })
    }
}
