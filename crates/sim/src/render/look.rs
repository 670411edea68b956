//! What may differ between two pictures of the same scene: light, paint, background, sensor.

use nalgebra::Vector3;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use where2act_core::Seed;

use super::backdrop::Backdrop;
use super::sensor::Sensor;

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
        Self { ambient, lights, paint, backdrop: Backdrop::random(rng), sensor: Sensor::random(rng) }
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

/// A surface as shading sees it, in linear light.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    pub(super) albedo: Vector3<f32>,
    pub(super) specular: f32,
    pub(super) shininess: f32,
}

impl Look {
    /// Light that a surface sends to the camera. All in the camera frame; `normal` is a unit vector on the viewer's
    /// side, `up` the world's z axis, `lights` positions and colours.
    pub(super) fn shade(
        surface: &Surface,
        point: &Vector3<f32>,
        normal: &Vector3<f32>,
        (ambient, up): (f32, &Vector3<f32>),
        lights: &[(Vector3<f32>, Vector3<f32>)],
    ) -> Vector3<f32> {
        // Surfaces that face the ceiling get a little more of the light from everywhere.
        let mut diffuse = Vector3::repeat(ambient * (0.85 + 0.15 * normal.dot(up)));
        let mut highlight = Vector3::zeros();
        let to_camera = -point * point.norm_squared().sqrt().recip();
        for (position, colour) in lights {
            let offset = position - point;
            let to_light = offset * offset.norm_squared().sqrt().recip();
            let facing = normal.dot(&to_light);
            if facing <= 0.0 {
                continue;
            }
            diffuse += colour * facing;
            if surface.specular > 0.0 {
                let half = to_light + to_camera;
                let cosine = normal.dot(&half) / half.norm().max(1e-6);
                if cosine > 0.7 {
                    highlight += colour * cosine.powf(surface.shininess);
                }
            }
        }
        surface.albedo.component_mul(&diffuse) + highlight * surface.specular
    }
}
