//! Where prediction's time goes: medians of the stages at batch 1, all six primitives, for the published networks, the
//! shipped ones and what the score with alignments costs; each also with hands that have no room
//! ([`Options::clearance`], which only scans and depth maps tell).
//! `cargo bench --profile dev --bench predict`

use std::path::Path;

use anyhow::Context;
use burn::tensor::Device;
use where2act_core::{ImageSize, Observation, Primitive, Seed, Timing};
use where2act_infer::{Backend, Options, Predictor};
use where2act_model::{Modality, ModelConfig, Network, Weights};

const RUNS: usize = 31;

fn main() -> anyhow::Result<()> {
    let size = ImageSize { width: 640, height: 480 };
    let rgb = (0..size.pixels()).map(|i| [(i % 251) as u8, (i % 241) as u8, (i % 239) as u8]).collect();
    let picture = Observation::Image { size, rgb: Some(rgb), depth: None, intrinsics: None, mask: None };
    let point = |i: usize| {
        let (a, h) = (i as f32 * 2.399_963, (i as f32 + 0.5) / 60_000.0);
        let s = (1.0 - h * h).sqrt();
        nalgebra::Point3::new(0.8 * s * a.cos(), 0.8 * s * a.sin(), 4.0 - 0.8 * h)
    };
    let scan = Observation::Cloud { points: (0..60_000).map(point).collect() };
    println!(
        "network                          preprocess  backbone    decode     total [ms]   decode / backbone"
    );
    let everywhere = Options { clearance: false, ..Options::default() };
    for (name, modality, observation) in
        [("picture", Modality::Rgb, &picture), ("scan", Modality::Cloud, &scan)]
    {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../weights");
        let folder = folder.join(if modality == Modality::Rgb { "rgb" } else { "cloud" });
        let shipped = Weights::load(&folder, &Device::flex())?;
        let published = ModelConfig::new(modality, &Primitive::ALL);
        let aligned = ModelConfig { alignments: 16, ..shipped.network.config().clone() };
        let random = |config: &ModelConfig| Weights {
            network: Network::new(config, Seed(1), &Device::flex()),
            sha256: String::new(),
        };
        for (of, weights) in
            [("published", random(&published)), ("shipped", shipped), ("16 alignments", random(&aligned))]
        {
            let predictor = Predictor::from_weights(weights, Backend::Fast)?;
            for (hands, options) in [("", &Options::default()), (", any hand", &everywhere)] {
                let runs: Vec<Timing> = (0..RUNS)
                    .map(|_| Ok(predictor.predict(observation, options)?.timing))
                    .collect::<anyhow::Result<_>>()
                    .with_context(|| format!("{name}, {of}"))?;
                let median = |of: fn(&Timing) -> f64| {
                    let mut sorted: Vec<f64> = runs.iter().map(of).collect();
                    sorted.sort_by(f64::total_cmp);
                    sorted[sorted.len() / 2]
                };
                let [p, b, d, t] = [
                    median(|t| t.preprocess),
                    median(|t| t.backbone),
                    median(|t| t.decode),
                    median(|t| t.total),
                ];
                let name = format!("{name}, {of}{hands}");
                println!("{name:<32} {p:>10.1} {b:>9.1} {d:>9.1} {t:>9.1}        {:>9.0} %", 100.0 * d / b);
            }
        }
    }
    Ok(())
}
