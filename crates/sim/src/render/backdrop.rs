//! What a camera sees where there is no object.

use nalgebra::{Point3, Vector3};
use rand::{Rng, RngExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use where2act_core::{Camera, Pixel};

use super::pattern::{Pattern, PatternKind, random_colour};
use super::sensor::linear;

/// What is behind the object. The default is white, as published.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backdrop {
    /// One colour, sRGB in [0, 1].
    Solid([f32; 3]),
    /// From top to bottom of the picture, sRGB in [0, 1].
    Gradient([f32; 3], [f32; 3]),
    /// A pattern over the picture, whose height is 1.
    Pattern(Pattern),
    /// A floor under the object and a wall behind it.
    Room {
        /// Pattern of the floor, metres.
        floor: Pattern,
        /// Pattern of the wall, metres.
        wall: Pattern,
        /// Free space between object and wall, metres.
        gap: f32,
        /// Turn of the wall against the view direction, radians.
        turn: f32,
    },
}

impl Default for Backdrop {
    fn default() -> Self {
        Self::Solid([1.0; 3])
    }
}

impl Backdrop {
    pub(super) fn random(rng: &mut impl Rng) -> Self {
        match rng.random_range(0..10) {
            0 => Self::Solid([1.0; 3]),
            1 => Self::Solid(random_colour(rng)),
            2 => Self::Gradient(random_colour(rng), random_colour(rng)),
            3 | 4 => Self::Pattern(Pattern::random(rng, 0.05..0.8)),
            _ => Self::Room {
                floor: Pattern::random(rng, 0.08..0.9),
                wall: Pattern { kind: wall_kind(rng), ..Pattern::random(rng, 0.1..1.5) },
                gap: rng.random_range(0.0..1.5),
                turn: rng.random_range(-0.5..0.5),
            },
        }
    }

    /// Draws the backdrop of an object that fills the box `bounds` in the world.
    pub(super) fn draw(
        &self,
        camera: &Camera,
        bounds: impl FnOnce() -> (Point3<f32>, Point3<f32>),
    ) -> Behind {
        let size = camera.size;
        let per_pixel = |f: &(dyn Fn(f32, f32) -> Vector3<f32> + Sync)| {
            let pixels = (0..size.pixels())
                .into_par_iter()
                .with_min_len(size.width.max(1))
                .map(|i| f((i % size.width) as f32 + 0.5, (i / size.width) as f32 + 0.5))
                .collect();
            Behind::Picture(pixels, size.width)
        };
        let height = size.height as f32;
        match self {
            Self::Solid(colour) => Behind::Plain(to_linear(*colour)),
            Self::Gradient(top, bottom) => {
                let (top, bottom) = (to_linear(*top), to_linear(*bottom));
                per_pixel(&|_, y| top.lerp(&bottom, y / height))
            }
            Self::Pattern(pattern) => {
                let paint = pattern.painter();
                per_pixel(&|x, y| paint(x / height, y / height))
            }
            Self::Room { floor, wall, gap, turn } => {
                let room = RoomGeometry::new(camera, bounds(), *gap, *turn);
                let (floor, wall) = (floor.painter(), wall.painter());
                per_pixel(&|x, y| room.colour(camera, (x, y), &floor, &wall))
            }
        }
    }
}

fn wall_kind(rng: &mut impl Rng) -> PatternKind {
    use PatternKind::{Clutter, Noise, Plain, Tiles};
    [Plain, Plain, Plain, Noise, Tiles, Clutter][rng.random_range(0..6)]
}

fn to_linear(srgb: [f32; 3]) -> Vector3<f32> {
    Vector3::from(srgb.map(linear))
}

/// A drawn backdrop, in linear light.
pub(super) enum Behind {
    Plain(Vector3<f32>),
    Picture(Vec<Vector3<f32>>, usize),
}

impl Behind {
    pub(super) fn at(&self, pixel: Pixel) -> Vector3<f32> {
        match self {
            Self::Plain(colour) => *colour,
            Self::Picture(pixels, width) => pixels[pixel.v as usize * width + pixel.u as usize],
        }
    }
}

struct RoomGeometry {
    floor_z: f32,
    /// Unit normal of the wall, away from the camera, and its distance from the world's origin.
    wall_normal: Vector3<f32>,
    wall_offset: f32,
    centre: Point3<f32>,
    radius: f32,
}

impl RoomGeometry {
    fn new(camera: &Camera, (min, max): (Point3<f32>, Point3<f32>), gap: f32, turn: f32) -> Self {
        let forward = camera.world_from_camera * Vector3::z();
        let heading = forward.y.atan2(forward.x) + turn;
        let wall_normal = Vector3::new(heading.cos(), heading.sin(), 0.0);
        let centre = nalgebra::center(&min, &max);
        let radius = 0.5 * (max - min).xy().norm();
        Self {
            floor_z: min.z,
            wall_normal,
            wall_offset: wall_normal.dot(&centre.coords) + radius + gap,
            centre,
            radius,
        }
    }

    fn colour(
        &self,
        camera: &Camera,
        (x, y): (f32, f32),
        floor: impl Fn(f32, f32) -> Vector3<f32>,
        wall: impl Fn(f32, f32) -> Vector3<f32>,
    ) -> Vector3<f32> {
        let eye = camera.world_from_camera.translation.vector;
        let ray = camera.world_from_camera * camera.intrinsics.back_project(x, y, 1.0).coords;
        let to_floor = if ray.z < 0.0 { (self.floor_z - eye.z) / ray.z } else { f32::INFINITY };
        let toward = self.wall_normal.dot(&ray);
        let to_wall = if toward > 1e-3 {
            (self.wall_offset - self.wall_normal.dot(&eye)) / toward
        } else {
            f32::INFINITY
        };
        if to_floor < to_wall {
            let p = eye + ray * to_floor;
            // A soft shadow where the object stands.
            let away = (p - self.centre.coords).xy().norm() / self.radius.max(1e-3);
            floor(p.x, p.y) * (0.75 - 0.4 * (-away * away).exp())
        } else {
            let p = eye + ray * to_wall.min(100.0);
            let along = p.y * self.wall_normal.x - p.x * self.wall_normal.y;
            wall(along, p.z) * 0.9
        }
    }
}
