//! From linear light to the 8-bit picture of a camera that may be out of focus, noisy or badly exposed.

use std::sync::OnceLock;

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use where2act_core::{ImageSize, Seed};

/// What the camera does to a picture. The default does nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sensor {
    /// Factor on the light of each channel: exposure and white balance.
    pub gain: [f32; 3],
    /// Exponent applied to the light; 1 = none.
    pub gamma: f32,
    /// Standard deviation of a Gaussian blur, pixels; 0 = none.
    pub blur: f32,
    /// Standard deviation of the noise of every pixel, in units of the 8-bit picture; 0 = none.
    pub noise: f32,
    /// Where the noise comes from.
    pub noise_seed: Seed,
}

impl Default for Sensor {
    fn default() -> Self {
        Self { gain: [1.0; 3], gamma: 1.0, blur: 0.0, noise: 0.0, noise_seed: Seed(0) }
    }
}

impl Sensor {
    pub(super) fn random(rng: &mut impl Rng) -> Self {
        let exposure = rng.random_range(0.75..1.3);
        let gain = std::array::from_fn(|_| exposure * rng.random_range(0.92..1.08));
        Self {
            gain,
            gamma: rng.random_range(0.8..1.25),
            blur: if rng.random_bool(0.5) { rng.random_range(0.3..1.4) } else { 0.0 },
            noise: if rng.random_bool(0.7) { rng.random_range(0.0..7.0) } else { 0.0 },
            noise_seed: Seed(rng.random()),
        }
    }

    /// Whether it only encodes.
    pub(super) fn is_plain(&self) -> bool {
        self.gain == [1.0; 3] && self.gamma == 1.0 && self.blur == 0.0 && self.noise == 0.0
    }

    /// The picture of `light`, linear RGB, row-major.
    pub(super) fn expose(&self, light: &[Vector3<f32>], size: ImageSize) -> Vec<[u8; 3]> {
        let soft = (self.blur > 0.0).then(|| blurred(light, size, self.blur));
        let light = soft.as_deref().unwrap_or(light);
        let table = encoder();
        let plain = self.gain == [1.0; 3] && self.gamma == 1.0;
        let mut noise = (self.noise > 0.0).then(|| self.noise_seed.rng());
        light
            .iter()
            .map(|l| {
                std::array::from_fn(|channel| {
                    let value =
                        if plain { l[channel] } else { (l[channel] * self.gain[channel]).powf(self.gamma) };
                    let code = encode(value, table);
                    match &mut noise {
                        Some(rng) => {
                            (f32::from(code) + self.noise * gaussian(rng)).round().clamp(0.0, 255.0) as u8
                        }
                        None => code,
                    }
                })
            })
            .collect()
    }
}

/// Nearly normal with variance 1: the sum of three uniform numbers. Noise needs no tails.
fn gaussian(rng: &mut impl Rng) -> f32 {
    let bits = rng.next_u64();
    let part = |shift: u32| ((bits >> shift) & 0xffff) as f32 / 32768.0 - 1.0;
    part(0) + part(16) + part(32)
}

/// Separable Gaussian blur; pixels beyond the border repeat.
fn blurred(light: &[Vector3<f32>], size: ImageSize, sigma: f32) -> Vec<Vector3<f32>> {
    let radius = (2.5 * sigma).ceil() as isize;
    let weights: Vec<f32> = (-radius..=radius).map(|d| (-0.5 * (d as f32 / sigma).powi(2)).exp()).collect();
    let sum: f32 = weights.iter().sum();
    let pass = |source: &[Vector3<f32>], count: usize, stride: usize, at: usize, position: usize| {
        let mut total = Vector3::zeros();
        for (weight, d) in weights.iter().zip(-radius..=radius) {
            let there = (position as isize + d).clamp(0, count as isize - 1) as usize;
            total += source[at - position * stride + there * stride] * *weight;
        }
        total / sum
    };
    let (w, h) = (size.width, size.height);
    let rows: Vec<_> = (0..w * h).map(|at| pass(light, w, 1, at, at % w)).collect();
    (0..w * h).map(|at| pass(&rows, h, w, at, at / w)).collect()
}

/// sRGB codes of linear light.
pub(super) fn code(light: &Vector3<f32>) -> [u8; 3] {
    let table = encoder();
    [light.x, light.y, light.z].map(|channel| encode(channel, table))
}

/// Linear light to an sRGB code (IEC 61966-2-1).
fn encode(linear: f32, table: &[u8; STEPS + 1]) -> u8 {
    // `as` saturates, and turns NaN into 0.
    table[((linear * STEPS as f32 + 0.5) as i32).clamp(0, STEPS as i32) as usize]
}

/// Resolution of the table for [`encode`]: finer than one code everywhere.
const STEPS: usize = 8192;

fn encoder() -> &'static [u8; STEPS + 1] {
    static TABLE: OnceLock<[u8; STEPS + 1]> = OnceLock::new();
    TABLE.get_or_init(|| {
        let code = |l: f32| if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
        std::array::from_fn(|i| (code(i as f32 / STEPS as f32) * 255.0).round() as u8)
    })
}

/// Linear light of every sRGB code.
pub(super) fn decoder() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| std::array::from_fn(|i| linear(i as f32 / 255.0)))
}

/// An sRGB value in [0, 1] to linear light.
pub(super) fn linear(srgb: f32) -> f32 {
    if srgb <= 0.040_45 { srgb / 12.92 } else { ((srgb + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_survive_decoding_and_encoding() {
        for code in 0..=255 {
            assert_eq!(encode(decoder()[usize::from(code)], encoder()), code);
        }
        assert_eq!([f32::NAN, -1.0, 7.0].map(|l| encode(l, encoder())), [0, 0, 255]);
    }

    #[test]
    fn noise_has_the_strength_it_says_and_blur_keeps_the_light() {
        let size = ImageSize::square(64);
        let grey = vec![Vector3::repeat(0.2); size.pixels()];
        let sensor = Sensor { noise: 5.0, ..Sensor::default() };
        let clean = f32::from(encode(0.2, encoder()));
        let errors: Vec<f32> =
            sensor.expose(&grey, size).iter().flatten().map(|&c| f32::from(c) - clean).collect();
        let deviation = (errors.iter().map(|e| e * e).sum::<f32>() / errors.len() as f32).sqrt();
        assert!((deviation - 5.0).abs() < 0.3, "{deviation}");
        let mut dot = vec![Vector3::zeros(); size.pixels()];
        dot[32 * 64 + 32] = Vector3::repeat(1.0);
        let spread = blurred(&dot, size, 1.0);
        assert!((spread.iter().map(|l| l.x).sum::<f32>() - 1.0).abs() < 1e-4);
        assert!(spread[32 * 64 + 33].x > 0.05 && spread[32 * 64 + 33].x < spread[32 * 64 + 32].x);
    }
}
