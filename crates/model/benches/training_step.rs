//! A whole training step (forward, backward, Adam): our kernels, in f32 and bf16, against burn's operations, in alternating
//! blocks of one run, in wall-clock and processor time.
//!
//! `cargo bench -p where2act-model --bench training_step -- [rgb|cloud] [WIDTH] [BATCH] [BLOCKS] [fast]`; `fast` leaves burn out.

use std::time::Instant;

use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::{Device, Distribution, Tensor};
use where2act_core::{Primitive, Seed};
use where2act_model::{Hierarchy, Input, Modality, ModelConfig, Network, TrainingEngine};

#[global_allocator]
static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();

/// Trials per view.
const QUERIES: usize = 64;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let number = |i: usize, default: f64| arguments.get(i).and_then(|a| a.parse().ok()).unwrap_or(default);
    let modality = match arguments.first().map(String::as_str) {
        Some("cloud") => Modality::Cloud,
        _ => Modality::Rgb,
    };
    let usual = if modality == Modality::Rgb { 0.5 } else { 1.0 };
    let (width, batch, blocks) = (number(1, usual) as f32, number(2, 8.0) as usize, number(3, 3.0) as usize);
    let engines: &[TrainingEngine] = if arguments.iter().any(|a| a == "fast") {
        &[TrainingEngine::Fast, TrainingEngine::Bf16]
    } else {
        &[TrainingEngine::Fast, TrainingEngine::Bf16, TrainingEngine::Burn]
    };

    let device = Device::flex().autodiff();
    let config = ModelConfig::new(modality, &Primitive::ALL).with_width(width);
    let images = Tensor::<4>::random([batch, 3, 224, 224], Distribution::Default, &device);
    let shell = |i: usize| {
        let (a, b) = (i as f32 * 2.399, i as f32 / 5000.0 % 2.0 - 1.0);
        let r = (1.0 - b * b).sqrt() * 0.5;
        [r * a.cos(), r * a.sin(), b * 0.5]
    };
    let points: Vec<f32> = (0..batch * config.points).flat_map(shell).collect();
    let hierarchy = (modality == Modality::Cloud).then(|| Hierarchy::new(&points, batch));
    let inputs = if modality == Modality::Cloud { config.points } else { 224 * 224 };
    let queries: Vec<_> = (0..batch * QUERIES).map(|i| (i / QUERIES, i % QUERIES * 7919 % inputs)).collect();

    let mut runs: Vec<_> = engines
        .iter()
        .map(|_| (Network::new(&config, Seed(1), &device), AdamConfig::new().init(), Vec::new()))
        .collect();
    for block in 0..=blocks {
        for (engine, (network, optimizer, times)) in engines.iter().zip(&mut runs) {
            let (start, cpu) = (Instant::now(), cpu_seconds());
            let features = engine.scope(|| {
                network.features_at(
                    match &hierarchy {
                        Some(hierarchy) => Input::Clouds(hierarchy),
                        None => Input::Images(images.clone()),
                    },
                    &queries,
                )
            });
            let loss = features.powi_scalar(2).mean();
            let forward = start.elapsed().as_secs_f64();
            let gradients = GradientsParams::from_grads(loss.backward(), network);
            *network = optimizer.step(1e-3, network.clone(), gradients);
            times.push([forward, start.elapsed().as_secs_f64(), cpu_seconds() - cpu]);
            if block == 0 {
                times.clear();
            }
        }
    }
    let mut results = Vec::new();
    for (engine, (_, _, times)) in engines.iter().zip(&runs) {
        let median = |i: usize| {
            let mut column: Vec<f64> = times.iter().map(|t| 1e3 * t[i]).collect();
            column.sort_by(f64::total_cmp);
            column[column.len() / 2]
        };
        println!(
            "{engine:?}: forward {:.0} ms, step {:.0} ms, processor {:.0} ms",
            median(0),
            median(1),
            median(2)
        );
        results.push((median(1), median(2)));
    }
    for (engine, result) in engines.iter().zip(&results).skip(1) {
        println!(
            "{engine:?} / Fast: {:.2} in wall-clock, {:.2} in processor time",
            result.0 / results[0].0,
            result.1 / results[0].1
        );
    }
}

/// Processor time of this process so far; 0 where the system does not say.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // Fields 14 and 15 (user and system), in hundredths of a second; the name in field 2 may contain spaces.
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    after_name.split_whitespace().skip(11).take(2).filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>()
        / 100.0
}
