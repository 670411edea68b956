//! Speed of every instruction set and what a second thread gives, as a Markdown table; then the stages of one prediction.
//!
//! `cargo bench -p where2act-model --bench paths --profile dev [-- ROUNDS]`. Thread counts alternate; medians of the rounds.
//! Each instruction set is a run of this program with `WHERE2ACT_ISA`, so that no part of the work escapes the switch.

use std::hint::black_box;
use std::process::Command;
use std::time::Instant;

use burn::tensor::Device;
use where2act_core::{Primitive, Seed};
use where2act_kernels::Isa;
use where2act_model::{Engine, Hierarchy, Modality, ModelConfig, Network};

#[global_allocator]
static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();

const SIDE: usize = 224;
const POINTS: usize = 10_000;

fn main() {
    let rounds = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(9);
    if std::env::var_os("WHERE2ACT_ISA").is_some() {
        path(rounds);
        return;
    }
    println!("| work | path | 1 thread, ms | 2 threads, ms | 1 / 2 |\n| --- | --- | --- | --- | --- |");
    let program = std::env::current_exe().expect("this program");
    for isa in Isa::available().iter().rev() {
        let run = Command::new(&program).arg(rounds.to_string()).env("WHERE2ACT_ISA", isa.name()).status();
        assert!(run.is_ok_and(|status| status.success()), "{} failed", isa.name());
    }
    stages(rounds);
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn millis(work: impl FnOnce()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e3
}

/// The rows of the table for the instruction set that is forced.
fn path(rounds: usize) {
    let pools = [1, 2].map(|n| rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a pool"));
    let row = |name: &str, work: &mut (dyn FnMut() + Send)| {
        let mut times = [Vec::new(), Vec::new()];
        for round in 0..=rounds {
            for (pool, times) in pools.iter().zip(&mut times) {
                let time = pool.install(|| millis(&mut *work));
                if round > 0 {
                    times.push(time);
                }
            }
        }
        let [one, two] = times.map(median);
        println!("| {name} | {} | {one:.1} | {two:.1} | {:.2} |", Isa::best().name(), one / two);
    };
    for width in [1.0, 0.5] {
        let (engine, images) = picture(width);
        row(&format!("U-Net, width {width}, one picture"), &mut || {
            drop(black_box(engine.features_rgb(&images, [1, SIDE, SIDE]).expect("a picture")));
        });
    }
    let (engine, points) = cloud();
    row("PointNet++, one scan of 10,000 points", &mut || {
        drop(black_box(engine.features_cloud(&Hierarchy::new(&points, 1)).expect("a cloud")));
    });
    training::step(&row);
}

fn picture(width: f32) -> (Engine, Vec<f32>) {
    let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(width);
    let network = Network::new(&config, Seed(1), &Device::flex());
    let images = (0..3 * SIDE * SIDE).map(|i| (i as f32 * 0.618).sin()).collect();
    (Engine::compile(&network).expect("this network compiles"), images)
}

fn cloud() -> (Engine, Vec<f32>) {
    let config = ModelConfig::new(Modality::Cloud, &Primitive::ALL);
    let network = Network::new(&config, Seed(1), &Device::flex());
    // A sphere of half a metre.
    let shell = |i: usize| {
        let (a, b) = (i as f32 * 2.399, i as f32 / (POINTS / 2) as f32 - 1.0);
        let r = (1.0 - b * b).sqrt() * 0.5;
        [r * a.cos(), r * a.sin(), b * 0.5]
    };
    (Engine::compile(&network).expect("this network compiles"), (0..POINTS).flat_map(shell).collect())
}

#[cfg(feature = "train")]
mod training {
    use super::*;
    use burn::optim::{AdamConfig, GradientsParams};
    use burn::tensor::{Distribution, Tensor};
    use where2act_model::Input;

    /// A step of half width on two pictures.
    pub(super) fn step(row: &dyn Fn(&str, &mut (dyn FnMut() + Send))) {
        let device = Device::flex().autodiff();
        let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(0.5);
        let mut network = Network::new(&config, Seed(1), &device);
        let mut adam = AdamConfig::new().init();
        let images = Tensor::<4>::random([2, 3, SIDE, SIDE], Distribution::Default, &device);
        let queries: Vec<_> = (0..128).map(|i| (i / 64, i * 391)).collect();
        row("training step, width 0.5, two pictures", &mut || {
            let features = network.features_at(Input::Images(images.clone()), &queries);
            let loss = features.powi_scalar(2).mean();
            let gradients = GradientsParams::from_grads(loss.backward(), &network);
            network = adam.step(1e-3, network.clone(), gradients);
        });
    }
}

#[cfg(not(feature = "train"))]
mod training {
    pub(super) fn step(_: &dyn Fn(&str, &mut (dyn FnMut() + Send))) {}
}

/// Where the time of one prediction goes, with all threads on the best path.
fn stages(rounds: usize) {
    println!("\n| stage | ms |\n| --- | --- |");
    for width in [1.0, 0.5] {
        let (engine, images) = picture(width);
        let runs: Vec<_> =
            (0..=rounds).map(|_| engine.stages_rgb(&images, [1, SIDE, SIDE]).expect("a picture")).collect();
        for (i, (name, _)) in runs[0].iter().enumerate() {
            let times = runs[1..].iter().map(|run| run[i].1.as_secs_f64() * 1e3).collect();
            println!("| U-Net, width {width}: {name} | {:.2} |", median(times));
        }
    }
    let (engine, points) = cloud();
    let mut times = [Vec::new(), Vec::new()];
    for _ in 0..=rounds {
        let mut known = None;
        times[0].push(millis(|| known = Some(Hierarchy::new(&points, 1))));
        let known = known.expect("just made");
        times[1].push(millis(|| drop(black_box(engine.features_cloud(&known).expect("a cloud")))));
    }
    let [neighbourhoods, layers] = times.map(|times| median(times[1..].to_vec()));
    println!("| PointNet++: sampling and neighbourhoods | {neighbourhoods:.2} |");
    println!("| PointNet++: layers and interpolation | {layers:.2} |");
}
