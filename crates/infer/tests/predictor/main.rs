//! The library with small random networks: what holds for any weights.

mod hands;
mod odd;
mod places;
mod sharing;

use nalgebra::Point3;
use where2act_core::{ImageSize, Intrinsics, Observation, Prediction, Primitive, Seed, Timing};
use where2act_infer::{Backend, Predictor};
use where2act_model::{Modality, ModelConfig, Network, Weights};

fn predictor_on(modality: Modality, backend: Backend) -> Predictor {
    let config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(1024);
    let network = Network::new(&config, Seed(7), &burn::tensor::Device::flex());
    Predictor::from_weights(Weights { network, sha256: "0".repeat(64) }, backend).unwrap()
}

fn predictor(modality: Modality) -> Predictor {
    predictor_on(modality, Backend::Fast)
}

fn picture(width: usize, height: usize) -> Observation {
    let rgb = (0..width * height)
        .map(|i| [(i % 251) as u8, (i / width.max(1)) as u8, (i % 13) as u8 * 19])
        .collect();
    let size = ImageSize { width, height };
    Observation::Image { size, rgb: Some(rgb), depth: None, intrinsics: None, mask: None }
}

/// A sphere of radius `r` at distance `z`, as far as it is seen.
fn ball(n: usize, r: f32, z: f32) -> Vec<Point3<f32>> {
    (0..n)
        .map(|i| {
            let (a, h) = (i as f32 * 2.399_963, (i as f32 + 0.5) / n as f32);
            let s = (1.0 - h * h).sqrt();
            Point3::new(r * s * a.cos(), r * s * a.sin(), z - r * h)
        })
        .collect()
}

fn untimed(mut prediction: Prediction) -> Prediction {
    prediction.timing = Timing::default();
    prediction
}

/// A wall with a step of 15 cm towards the camera on its right side.
fn step() -> Observation {
    let size = ImageSize::square(32);
    let depth = (0..size.pixels()).map(|i| if i % 32 < 16 { 2.0 } else { 1.85 }).collect();
    let rgb = Some(vec![[200, 180, 160]; size.pixels()]);
    let intrinsics = Some(Intrinsics::from_fov(size, 0.4));
    Observation::Image { size, rgb, depth: Some(depth), intrinsics, mask: None }
}
