//! Pictures of materials, drawn from noise that repeats at the edges.

use image::{Rgb, RgbImage};

use super::dice::Dice;

/// sRGB in [0, 1].
pub(super) type Colour = [f32; 3];

/// Value noise in [-1, 1] that repeats every `period` cells.
struct Noise(u32);

impl Noise {
    fn new(dice: &mut Dice) -> Self {
        Self(dice.count(0, u32::MAX as usize) as u32)
    }

    fn lattice(&self, x: i32, y: i32) -> f32 {
        let mut h = self.0 ^ (x as u32).wrapping_mul(0x85eb_ca6b) ^ (y as u32).wrapping_mul(0xc2b2_ae35);
        h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
        h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
        (h ^ (h >> 15)) as f32 / u32::MAX as f32 * 2.0 - 1.0
    }

    /// `x` and `y` in [0, 1) over the picture, `cells` across and down it.
    fn at(&self, x: f32, y: f32, cells: [i32; 2]) -> f32 {
        let (x, y) = (x * cells[0] as f32, y * cells[1] as f32);
        let (i, j) = (x.floor(), y.floor());
        let ease = |t: f32| t * t * (3.0 - 2.0 * t);
        let (s, t) = (ease(x - i), ease(y - j));
        let v = |di: i32, dj: i32| {
            self.lattice((i as i32 + di).rem_euclid(cells[0]), (j as i32 + dj).rem_euclid(cells[1]))
        };
        let low = v(0, 0) + (v(1, 0) - v(0, 0)) * s;
        let high = v(0, 1) + (v(1, 1) - v(0, 1)) * s;
        low + (high - low) * t
    }

    fn turbulence(&self, x: f32, y: f32, cells: i32) -> f32 {
        (0..4).map(|octave| self.at(x, y, [cells << octave; 2]) / (1 << octave) as f32).sum()
    }
}

/// A picture whose every pixel is a colour of its place in [0, 1)^2.
fn paint(size: [u32; 2], mut colour: impl FnMut(f32, f32) -> Colour) -> RgbImage {
    RgbImage::from_fn(size[0], size[1], |x, y| {
        let c = colour(x as f32 / size[0] as f32, y as f32 / size[1] as f32);
        Rgb(c.map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8))
    })
}

/// A colour made lighter (factor above 1) or darker.
pub(super) fn shade(colour: Colour, factor: f32) -> Colour {
    colour.map(|c| (c * factor).clamp(0.0, 1.0))
}

/// A colour between two.
pub(super) fn blend(a: Colour, b: Colour, share: f32) -> Colour {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * share)
}

/// Wood, its grain along v; `contrast` in [0, 1]; boards side by side if `boards` > 1.
pub(super) fn wood(dice: &mut Dice, base: Colour, contrast: f32, boards: u32) -> RgbImage {
    let noise = Noise::new(dice);
    let rings = dice.real(3.0, 9.0).round();
    let wobble = dice.real(0.1, 0.5);
    let dark = [base[0] * 0.55, base[1] * 0.48, base[2] * 0.42];
    paint([96, 160], |x, y| {
        let board = (x * boards as f32).floor();
        let shift = noise.lattice(board as i32, 77) * 0.5;
        let along = (y + shift).rem_euclid(1.0);
        let bend = noise.at(x, along, [2 * boards as i32, 2]) * wobble;
        let ring =
            (std::f32::consts::TAU * (x * rings * boards as f32 + 1.6 * bend * rings)).sin() * 0.5 + 0.5;
        let fibre = noise.at(x, along, [64, 6]) * 0.5 + 0.5;
        let seam = boards > 1 && (x * boards as f32).fract() < 0.05;
        let tone = contrast * (0.55 * ring * ring + 0.45 * fibre) + if seam { 0.5 } else { 0.0 };
        shade(blend(base, dark, tone.min(1.0)), 1.0 + 0.12 * shift)
    })
}

/// Brushed metal, scratches along v.
pub(super) fn brushed(dice: &mut Dice, base: Colour, strength: f32) -> RgbImage {
    let noise = Noise::new(dice);
    paint([128, 64], |x, y| {
        let streak = noise.at(x, y, [128, 2]) * 0.6 + noise.at(x, y, [40, 1]) * 0.4;
        shade(base, 1.0 + strength * streak)
    })
}

/// Grains: stone, worn paint, cast plastic.
pub(super) fn speckled(dice: &mut Dice, base: Colour, spot: Colour, amount: f32) -> RgbImage {
    let noise = Noise::new(dice);
    paint([128, 128], |x, y| {
        let grain = noise.at(x, y, [96, 96]) * 0.6 + noise.at(x, y, [32, 32]) * 0.4;
        blend(base, spot, (amount * (0.5 + 1.2 * grain)).clamp(0.0, 1.0))
    })
}

/// Veined stone.
pub(super) fn marble(dice: &mut Dice, base: Colour, vein: Colour) -> RgbImage {
    let noise = Noise::new(dice);
    paint([128, 128], |x, y| {
        let wave = (std::f32::consts::TAU * (x + y) + 3.0 * noise.turbulence(x, y, 3)).sin().abs();
        blend(vein, base, wave.powf(0.35))
    })
}

/// Corrugated cardboard.
pub(super) fn cardboard(dice: &mut Dice, base: Colour) -> RgbImage {
    let noise = Noise::new(dice);
    paint([128, 128], |x, y| {
        let flute = (std::f32::consts::TAU * 32.0 * x).sin() * 0.02;
        shade(base, 1.0 + flute + 0.03 * noise.turbulence(x, y, 8))
    })
}

/// Wicker or coarse cloth: strands over and under.
pub(super) fn woven(dice: &mut Dice, base: Colour) -> RgbImage {
    let noise = Noise::new(dice);
    let cells = dice.count(8, 14) as f32;
    paint([128, 128], |x, y| {
        let (u, v) = (x * cells, y * cells);
        let over = (u.floor() + v.floor()) as i32 % 2 == 0;
        let across = if over { u.fract() } else { v.fract() };
        let round = (std::f32::consts::PI * across).sin();
        shade(base, 0.45 + 0.6 * round + 0.1 * noise.at(x, y, [64, 64]))
    })
}

/// A printed pattern: stripes, dots or checks.
pub(super) fn printed(dice: &mut Dice, ground: Colour, ink: Colour) -> RgbImage {
    let kind = dice.count(0, 2);
    let repeats = dice.count(3, 8) as f32;
    let share = dice.real(0.25, 0.6);
    paint([128, 128], |x, y| {
        let (u, v) = ((x * repeats).fract(), (y * repeats).fract());
        let inked = match kind {
            0 => u < share,
            1 => (u - 0.5).hypot(v - 0.5) < share * 0.6,
            _ => (u < share) != (v < share),
        };
        if inked { ink } else { ground }
    })
}

/// A printed label: a few blocks and lines of text-like marks.
pub(super) fn label(dice: &mut Dice, ground: Colour, ink: Colour) -> RgbImage {
    let noise = Noise::new(dice);
    let rows = dice.count(5, 10) as f32;
    let band = dice.real(0.2, 0.5);
    paint([128, 128], |x, y| {
        let margin = 0.06;
        if x.min(1.0 - x).min(y).min(1.0 - y) < margin {
            return ground;
        }
        if y < band {
            return blend(ink, ground, if (y - band / 2.0).abs() < 0.05 && x < 0.7 { 0.8 } else { 0.0 });
        }
        let row = (y * rows).floor();
        let length = 0.35 + 0.5 * (noise.lattice(row as i32, 3) * 0.5 + 0.5);
        let word = noise.at(x, row / rows, [32, 64]) > -0.35;
        let inside = (y * rows).fract() > 0.45 && x < length;
        if inside && word { ink } else { ground }
    })
}
