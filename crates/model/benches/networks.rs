//! Medians of the networks' work, in milliseconds.
//!
//! `cargo bench -p where2act-model --bench networks --profile dev [-- FILTER]` (the dev profile is fully optimised, and built already). With `WHERE2ACT_PYTHON` set to a Python that has PyTorch, the same work is
//! measured there too, between two rounds of our own, so that both see the same machine.

use std::hint::black_box;
use std::process::Command;
use std::time::Instant;

use burn::tensor::{Device, Distribution, Tensor};
use rand::RngExt;
use where2act_core::{Primitive, Seed};
use where2act_kernels::points::furthest_point_sampling;
use where2act_model::{Engine, Hierarchy, Input, Modality, ModelConfig, Network};

/// Measures work of a name, so many times, and prints it.
type Report<'a> = dyn Fn(&str, usize, &mut dyn FnMut()) + 'a;

/// Median of several runs after one to warm up.
fn median(runs: usize, mut work: impl FnMut()) -> f64 {
    work();
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[runs / 2]
}

/// Points on the faces of a box of about a metre, as a scan of a piece of furniture has them.
fn scan(n: usize, seed: u64) -> Vec<f32> {
    let mut rng = Seed(seed).rng();
    let mut points = Vec::with_capacity(3 * n);
    for i in 0..n {
        let mut p: [f32; 3] = [0.4, 0.3, 0.5].map(|half| rng.random_range(-half..half));
        let axis = i % 3;
        p[axis] = [0.4, 0.3, 0.5][axis];
        points.extend(p);
    }
    points
}

fn ours(filter: &str) {
    let device = Device::flex();
    let report = |name: &str, runs: usize, work: &mut dyn FnMut()| {
        if name.contains(filter) {
            println!("{name:<44} {:>9.1} ms", median(runs, work));
        }
    };
    let many = scan(30_000, 1);
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool of one thread");
    report("sampling 30,000 -> 10,000, one core", 9, &mut || {
        one_core.install(|| drop(black_box(furthest_point_sampling(&many, 10_000, 0))));
    });

    let cloud = Network::new(&ModelConfig::new(Modality::Cloud, &Primitive::ALL), Seed(1), &device);
    let points = scan(10_000, 2);
    report("cloud of 10,000: neighbourhoods", 9, &mut || drop(black_box(Hierarchy::new(&points, 1))));
    let known = Hierarchy::new(&points, 1);
    report("cloud of 10,000: all but neighbourhoods", 9, &mut || {
        black_box(cloud.features_at(Input::Clouds(&known), &[(0, 0)]));
    });
    report("cloud of 10,000: all", 9, &mut || {
        let hierarchy = Hierarchy::new(&points, 1);
        black_box(cloud.features_at(Input::Clouds(&hierarchy), &[(0, 0)]));
    });

    let engine = Engine::compile(&cloud).expect("this network compiles");
    report("engine, cloud of 10,000: all", 15, &mut || {
        drop(black_box(engine.features_cloud(&Hierarchy::new(&points, 1)).expect("a network for clouds")));
    });

    let rgb = Network::new(&ModelConfig::new(Modality::Rgb, &Primitive::ALL), Seed(1), &device);
    let image = Tensor::random([1, 3, 224, 224], Distribution::Normal(0.0, 1.0), &device);
    report("picture 224 x 224: all", 5, &mut || drop(black_box(rgb.features_rgb(image.clone()))));
    training(&report);
}

#[cfg(feature = "train")]
fn training(report: &Report<'_>) {
    use burn::optim::{AdamConfig, GradientsParams};

    let device = Device::flex().autodiff();
    let step = |network: &mut Network, input: Input<'_>, queries: &[(usize, usize)]| {
        let mut adam = AdamConfig::new().init();
        let loss = network.features_at(input, queries).powi_scalar(2).mean();
        let gradients = GradientsParams::from_grads(loss.backward(), network);
        *network = adam.step(1e-3, network.clone(), gradients);
        black_box(network.device());
    };
    let queries: Vec<(usize, usize)> = (0..512).map(|i| (i % 8, i * 19)).collect();

    let mut cloud = Network::new(&ModelConfig::new(Modality::Cloud, &Primitive::ALL), Seed(1), &device);
    let points: Vec<f32> = (0..8).flat_map(|i| scan(10_000, i)).collect();
    let hierarchy = Hierarchy::new(&points, 8);
    report("training step, 8 clouds of 10,000", 3, &mut || {
        step(&mut cloud, Input::Clouds(&hierarchy), &queries);
    });

    let config = ModelConfig::new(Modality::Rgb, &Primitive::ALL).with_width(0.5);
    let mut rgb = Network::new(&config, Seed(1), &device);
    let images = Tensor::random([8, 3, 128, 128], Distribution::Normal(0.0, 1.0), &device);
    report("training step, half width, 8 x 128 x 128", 3, &mut || {
        step(&mut rgb, Input::Images(images.clone()), &queries);
    });
}

#[cfg(not(feature = "train"))]
fn training(_: &Report<'_>) {}

fn main() {
    let filter = std::env::args().skip(1).find(|a| !a.starts_with('-')).unwrap_or_default();
    ours(&filter);
    if let Some(python) = std::env::var_os("WHERE2ACT_PYTHON") {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/pytorch.py");
        let status =
            Command::new(python).arg(script).arg(&filter).status().expect("WHERE2ACT_PYTHON can be started");
        assert!(status.success(), "the PyTorch side failed");
        ours(&filter);
    }
}
