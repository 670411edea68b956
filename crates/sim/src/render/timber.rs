//! Wood with a strong figure: rings of a trunk that a board was cut from, and knots.
//!
//! Its lines look like edges and gaps of fronts, so that networks for pictures learn to tell them apart. Boards are textures:
//! meshes without texture coordinates get one colour of theirs.

use std::sync::{Arc, OnceLock};

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use rand::{Rng, RngExt};
use where2act_core::Seed;

use super::pattern::{fractal, unit_hash};

/// Across and along the grain, pixels.
const SIZE: [u32; 2] = [160, 320];
/// Boards of an object.
const BOARDS: usize = 2;
/// Share of the objects whose paint is drawn anew that are made of it.
const SHARE: f64 = 0.3;
/// Share of the materials of such an object.
const OF_MATERIALS: f64 = 0.75;

/// What an object is made of: one species, a few boards.
pub(super) struct Timber {
    species: Species,
    seed: Seed,
    /// Those that were asked for so far.
    boards: [OnceLock<Arc<RgbImage>>; BOARDS],
}

impl Timber {
    /// That of an object, if it is a wooden one.
    pub(super) fn random(seed: Seed) -> Option<Self> {
        let rng = &mut seed.rng();
        rng.random_bool(SHARE).then(|| Self {
            species: Species::random(rng),
            seed,
            boards: Default::default(),
        })
    }

    /// A board for a material, if it is wood.
    pub(super) fn board(&self, seed: Seed) -> Option<Arc<RgbImage>> {
        let rng = &mut seed.rng();
        let number = rng.random_range(0..BOARDS);
        let board = || Arc::new(self.species.board(self.seed.child("board", number as u64)));
        rng.random_bool(OF_MATERIALS).then(|| Arc::clone(self.boards[number].get_or_init(board)))
    }
}

/// What boards of one kind have in common.
struct Species {
    /// Early and late wood, sRGB in [0, 1].
    colours: [[f32; 3]; 2],
    /// Rings in half a board's width, were it sawn through the middle of the trunk.
    rings: f32,
    /// How much rings wander, in half widths.
    wander: f32,
    /// How much tones differ between rings and across the board.
    contrast: f32,
    /// Knots in a board, at most.
    knots: u32,
}

impl Species {
    fn random(rng: &mut impl Rng) -> Self {
        let light: f32 = rng.random_range(0.25..0.95);
        // From reddish over yellowish to grey woods.
        let (green, blue) = (rng.random_range(0.62..0.88), rng.random_range(0.35..0.75));
        let early = [light, light * green, light * green * blue];
        let darker = rng.random_range(0.25..0.75f32);
        let late = [early[0] * darker, early[1] * darker * 0.92, early[2] * darker * 0.85];
        Self {
            colours: [early, late],
            rings: rng.random_range(4.0..16.0),
            wander: rng.random_range(0.1..0.7),
            contrast: rng.random_range(0.4..1.0),
            knots: rng.random_range(0..4),
        }
    }

    /// A board that repeats in both directions, as if mirrored.
    fn board(&self, seed: Seed) -> RgbImage {
        let rng = &mut seed.rng();
        let noise: u32 = rng.random();
        // How far beside the middle of the trunk it was sawn, in half widths: near it rings look like flames.
        let beside: f32 = rng.random_range(0.1..2.0);
        let taper = rng.random_range(0.2..1.6f32);
        let knots: Vec<[f32; 3]> = (0..rng.random_range(0..=self.knots))
            .map(|_| [rng.random_range(-0.9..0.9), rng.random_range(0.1..0.9), rng.random_range(0.03..0.12)])
            .collect();
        let [early, late] = self.colours.map(Vector3::from);
        RgbImage::from_fn(SIZE[0], SIZE[1], |i, j| {
            let fold = |i: u32, n: u32| 1.0 - (2.0 * (i as f32 + 0.5) / n as f32 - 1.0).abs();
            // Half a width from the middle, and along the board.
            let (x, y) = (2.0 * fold(i, SIZE[0]) - 1.0, fold(j, SIZE[1]));
            let at = |sx: f32, sy: f32, layer: u32| {
                fractal(Vector3::new(x * sx, y * sy, layer as f32 * 7.3), noise ^ layer) - 0.5
            };
            let depth = beside + taper * (at(0.3, 1.6, 1) * 2.0 + y);
            let mut radius =
                (x + self.wander * at(1.2, 1.8, 2)).hypot(depth) + 0.25 * self.wander * at(4.0, 3.0, 3);
            let mut knot = 0.0f32;
            for [kx, ky, size] in &knots {
                let away = ((x - kx) / size).hypot((y - ky) / (0.8 * size));
                radius += size * 1.5 * (-0.3 * away * away).exp();
                knot = knot.max((1.4 - away).clamp(0.0, 1.0));
            }
            let ring = radius * self.rings;
            let (number, phase) = (ring.floor(), ring - ring.floor());
            let own = unit_hash(number as i32, 0, 5, noise);
            // Late wood comes slowly and ends sharply.
            let tone = 0.75 * phase.powf(1.5) + 0.5 * own + 1.1 * at(0.9, 0.5, 4) + 0.5 * at(50.0, 3.0, 6);
            let tone = (0.3 + self.contrast * (tone - 0.3)).clamp(0.0, 1.0);
            let colour = early.lerp(&late, tone) * (1.0 - 0.75 * knot);
            Rgb([colour.x, colour.y, colour.z].map(|c| (c.clamp(0.0, 1.0) * 255.0) as u8))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_have_a_figure_and_no_seam() {
        for seed in 0..8 {
            let rng = &mut Seed(seed).rng();
            let board = Species::random(rng).board(Seed(seed));
            let (w, h) = board.dimensions();
            let tone = |u: u32, v: u32| f32::from(board.get_pixel(u % w, v % h)[0]);
            let step = |u: u32, v: u32| (tone(u + 1, v) - tone(u, v)).abs();
            let mean =
                (0..h).flat_map(|v| (0..w - 1).map(move |u| step(u, v))).sum::<f32>() / (h * (w - 1)) as f32;
            assert!(mean > 1.0, "{seed}: {mean}");
            assert!((0..h).all(|v| step(w - 1, v) == 0.0), "{seed}");
            assert!((0..w).all(|u| tone(u, h - 1) == tone(u, h)), "{seed}");
        }
    }
}
