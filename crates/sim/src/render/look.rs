//! What may differ between two pictures of the same scene: light, paint, background, sensor, shadows.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use where2act_core::Seed;

use super::backdrop::Backdrop;
use super::sensor::Sensor;
use super::shadow::Shadow;

/// How a scene is lit and shown. The default is the published look: white background, three lights, no noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Look {
    /// Light from everywhere, as a share of full brightness. Published: mild.
    pub ambient: f32,
    /// Point lights.
    pub lights: Vec<Light>,
    /// Materials drawn anew from this seed; `None` keeps those of the object.
    pub paint: Option<Seed>,
    /// What is behind the object.
    pub backdrop: Backdrop,
    /// What the camera does to the picture.
    pub sensor: Sensor,
    /// Where surfaces hide light.
    #[serde(default)]
    pub shadow: Shadow,
}

/// A point light without fall-off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Light {
    /// Position in the world, metres; objects face -x.
    pub position: [f32; 3],
    /// Linear RGB intensity: what a white surface that faces the light adds.
    pub colour: [f32; 3],
}

impl Default for Look {
    fn default() -> Self {
        Self {
            ambient: 0.25,
            lights: vec![
                Light { position: [-4.0, -1.0, 4.0], colour: [0.5; 3] },
                Light { position: [3.0, 4.0, 3.5], colour: [0.2; 3] },
                Light { position: [3.0, -4.0, 3.5], colour: [0.2; 3] },
            ],
            paint: None,
            backdrop: Backdrop::default(),
            sensor: Sensor::default(),
            shadow: Shadow::default(),
        }
    }
}

impl Look {
    /// A random look for training on pictures that shall resemble photos: one time in ten the published look.
    #[must_use]
    pub fn random(rng: &mut impl Rng) -> Self {
        if rng.random_bool(0.1) {
            return Self::default();
        }
        let paint = rng.random_bool(0.7).then(|| Seed(rng.random()));
        let (ambient, lights) = random_lights(rng);
        let (backdrop, sensor) = (Backdrop::random(rng), Sensor::random(rng));
        Self { ambient, lights, paint, backdrop, sensor, shadow: Shadow::random(rng) }
    }
}

/// One to four lights above the horizon, of slightly different colours, together about as bright as the published.
fn random_lights(rng: &mut impl Rng) -> (f32, Vec<Light>) {
    let ambient = rng.random_range(0.15..0.6);
    let count = rng.random_range(1..=4);
    let total = rng.random_range(0.6..1.3);
    let shares: Vec<f32> = (0..count).map(|_| rng.random_range(0.2..1.0)).collect();
    let sum: f32 = shares.iter().sum();
    let lights = shares
        .iter()
        .map(|share| {
            let azimuth = rng.random_range(0.0..std::f32::consts::TAU);
            let elevation: f32 = rng.random_range(0.15..1.5);
            let distance = rng.random_range(2.5..8.0);
            let flat = elevation.cos() * distance;
            let warmth: f32 = rng.random_range(-0.15..0.15);
            let intensity = total * share / sum;
            Light {
                position: [flat * azimuth.cos(), flat * azimuth.sin(), elevation.sin() * distance],
                colour: [1.0 + warmth, 1.0, 1.0 - warmth].map(|c| c * intensity),
            }
        })
        .collect();
    (ambient, lights)
}
