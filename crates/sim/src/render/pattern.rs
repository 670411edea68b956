//! Procedural surfaces: noise, grain, tiles, planks, clutter.

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};

use super::sensor::linear;

/// A repeating picture without repetition, over a plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pattern {
    /// What it looks like.
    pub kind: PatternKind,
    /// The colours it is made of, sRGB in [0, 1].
    pub colours: [[f32; 3]; 2],
    /// Size of its features, in the units of the plane.
    pub scale: f32,
    /// Which of all such patterns.
    pub seed: u32,
}

/// Kinds of [`Pattern`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PatternKind {
    /// One colour with a trace of unevenness: paint, plaster.
    Plain,
    /// Clouds between both colours: carpet, concrete, stone.
    Noise,
    /// Square tiles with joints.
    Tiles,
    /// Long boards with grain.
    Planks,
    /// Overlapping patches of any colour, as a crowded room out of focus.
    Clutter,
}

impl Pattern {
    pub(super) fn random(rng: &mut impl Rng, scale: std::ops::Range<f32>) -> Self {
        use PatternKind::{Clutter, Noise, Plain, Planks, Tiles};
        let kind = [Plain, Plain, Noise, Noise, Tiles, Planks, Clutter][rng.random_range(0..7)];
        let first = random_colour(rng);
        let second = if rng.random_bool(0.6) {
            let shift = rng.random_range(0.6..1.4);
            first.map(|c| (c * shift).clamp(0.0, 1.0))
        } else {
            random_colour(rng)
        };
        Self { kind, colours: [first, second], scale: rng.random_range(scale), seed: rng.random() }
    }

    /// Linear colours of the points of the plane.
    pub(super) fn painter(&self) -> impl Fn(f32, f32) -> Vector3<f32> + Sync {
        let colours = self.colours.map(|c| Vector3::from(c.map(linear)));
        move |x, y| self.at(x, y, colours)
    }

    fn at(&self, x: f32, y: f32, [a, b]: [Vector3<f32>; 2]) -> Vector3<f32> {
        let (x, y) = (x / self.scale, y / self.scale);
        let noise = |sx: f32, sy: f32| fractal(Vector3::new(x * sx, y * sy, 0.0), self.seed);
        match self.kind {
            PatternKind::Plain => a * (0.9 + 0.2 * noise(1.0, 1.0)),
            PatternKind::Noise => a.lerp(&b, noise(2.0, 2.0)),
            PatternKind::Tiles => {
                let joint = (x - x.floor()).min(y - y.floor()) < 0.04;
                let tile = 0.85 + 0.3 * unit_hash(x.floor() as i32, y.floor() as i32, 0, self.seed);
                if joint { b } else { a * tile }
            }
            PatternKind::Planks => {
                let row = y.floor();
                let shift = unit_hash(row as i32, 0, 1, self.seed);
                let board = unit_hash(row as i32, (x * 0.2 + shift).floor() as i32, 2, self.seed);
                let gap = if y - row < 0.03 { 0.5 } else { 1.0 };
                a.lerp(&b, 0.3 * board + 0.7 * noise(0.6, 9.0)) * gap
            }
            PatternKind::Clutter => self.clutter(x, y, a),
        }
    }

    fn clutter(&self, x: f32, y: f32, ground: Vector3<f32>) -> Vector3<f32> {
        let mut colour = ground;
        for layer in 0..3 {
            let size = [0.45, 1.0, 2.0][layer as usize];
            let (u, v) = (x * size, y * size);
            let (i, j) = (u.floor() as i32, v.floor() as i32);
            let hash = |n: i32| unit_hash(i, j, 16 * layer + n, self.seed);
            if hash(0) < 0.35 {
                continue;
            }
            let (dx, dy) = (u - i as f32 - 0.3 - 0.4 * hash(1), v - j as f32 - 0.3 - 0.4 * hash(2));
            let (rx, ry) = (0.1 + 0.35 * hash(3), 0.1 + 0.35 * hash(4));
            let inside = if hash(5) < 0.6 {
                dx.abs() < rx && dy.abs() < ry
            } else {
                (dx / rx).powi(2) + (dy / ry).powi(2) < 1.0
            };
            if inside {
                let shading = 1.0 + 0.5 * dx;
                colour = Vector3::new(hash(6), hash(7), hash(8)).map(linear) * shading;
            }
        }
        colour
    }
}

/// Any colour, greys and pale colours more often than bright ones.
pub(super) fn random_colour(rng: &mut impl Rng) -> [f32; 3] {
    let grey = rng.random_range(0.05..1.0f32);
    let saturation = rng.random_range(0.0..1.0f32).powi(2);
    std::array::from_fn(|_| grey * (1.0 - saturation) + saturation * rng.random_range(0.0..1.0))
}

/// Grain of a solid material, as of wood or brushed metal: noise stretched along an axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grain {
    frequency: Vector3<f32>,
    strength: f32,
    seed: u32,
}

impl Grain {
    pub(super) fn random(rng: &mut impl Rng) -> Self {
        let fine = rng.random_range(8.0..60.0f32);
        let coarse = fine * rng.random_range(0.03..0.6);
        let mut frequency = Vector3::repeat(fine);
        frequency[rng.random_range(0..3)] = coarse;
        Self { frequency, strength: rng.random_range(0.1..0.7), seed: rng.random() }
    }

    /// Factor on the colour at a point in the link frame.
    pub(super) fn at(&self, point: &Vector3<f32>) -> f32 {
        1.0 - self.strength * fractal(point.component_mul(&self.frequency), self.seed)
    }
}

/// The greatest integer not above `x`. Without SSE 4.1 the general function is a call.
pub(super) fn floor(x: f32) -> f32 {
    if x.abs() < (1 << 23) as f32 {
        let towards_zero = x as i32 as f32;
        if towards_zero > x { towards_zero - 1.0 } else { towards_zero }
    } else {
        x // an integer, or not finite
    }
}

/// Three octaves of value noise, in [0, 1].
pub(super) fn fractal(p: Vector3<f32>, seed: u32) -> f32 {
    (4.0 * value_noise(p, seed) + 2.0 * value_noise(p * 2.1, seed ^ 1) + value_noise(p * 4.3, seed ^ 2)) / 7.0
}

/// Random numbers on the integer lattice, smoothly interpolated; in [0, 1].
fn value_noise(p: Vector3<f32>, seed: u32) -> f32 {
    let cell = p.map(floor);
    let t = (p - cell).map(|t| t * t * (3.0 - 2.0 * t));
    let [i, j, k] = [cell.x as i32, cell.y as i32, cell.z as i32];
    let corner = |di, dj, dk| unit_hash(i.wrapping_add(di), j.wrapping_add(dj), k.wrapping_add(dk), seed);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let plane = |dk| {
        mix(mix(corner(0, 0, dk), corner(1, 0, dk), t.x), mix(corner(0, 1, dk), corner(1, 1, dk), t.x), t.y)
    };
    mix(plane(0), plane(1), t.z)
}

/// A number in [0, 1) for a lattice point.
pub(super) fn unit_hash(i: i32, j: i32, k: i32, seed: u32) -> f32 {
    let mut h = seed ^ (i as u32).wrapping_mul(0x8da6_b343) ^ (j as u32).wrapping_mul(0xd816_3841);
    h ^= (k as u32).wrapping_mul(0xcb1a_b31f);
    // The finaliser of MurmurHash3.
    h = (h ^ (h >> 16)).wrapping_mul(0x85eb_ca6b);
    h = (h ^ (h >> 13)).wrapping_mul(0xc2b2_ae35);
    ((h ^ (h >> 16)) >> 8) as f32 / (1 << 24) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_floor_is_the_usual_one() {
        for x in [0.0, -0.0, 0.7, -0.7, 3.0, -3.0, -3.0001, 8_388_607.5, -8_388_607.5, 3e9, -3e9, 1e30] {
            assert_eq!(floor(x), f32::floor(x), "{x}");
        }
        assert!(floor(f32::NAN).is_nan());
        assert_eq!(floor(f32::NEG_INFINITY), f32::NEG_INFINITY);
    }
}
