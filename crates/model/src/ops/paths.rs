//! Every instruction set forced in turn, through whole networks.

use std::process::Command;

use burn::optim::GradientsParams;
use burn::tensor::{Device, Tensor, TensorData};
use where2act_core::{Primitive, Seed};
use where2act_kernels::Isa;

use crate::testing::{furthest, named_gradients};
use crate::{Input, Modality, ModelConfig, Network, TrainingEngine};

/// The switch of the kernels.
const FORCED: &str = "WHERE2ACT_ISA";

fn numbers(len: usize, k: usize) -> Vec<f32> {
    (0..len).map(|i| ((i * k) as f32 * 0.618).sin()).collect()
}

/// Gradients of every parameter, with our kernels and with burn's operations, to 1e-3 of the parameter's largest.
///
/// Only of a U-Net: rounding decides some of a PointNet++'s maxima, and even burn's two backends differ by several
/// percent there. Its operations are compared one by one in `tests`.
#[test]
fn gradients_of_a_whole_network_are_burns() {
    let config = ModelConfig::new(Modality::Rgb, &[Primitive::Pushing]).with_width(0.25);
    let device = Device::flex().autodiff();
    let tensor = |shape: [usize; 4], k: usize| {
        Tensor::<4>::from_data(TensorData::new(numbers(shape.iter().product(), k), shape), &device)
    };
    let gradients = |engine: TrainingEngine| {
        let network = Network::new(&config, Seed(1), &device);
        let images = Input::Images(tensor([2, 3, 64, 96], 1));
        let queries = [(0, 5), (1, 6143), (1, 2000), (0, 3111)];
        let features = engine.scope(|| network.features_at(images, &queries));
        let [n, width] = features.dims();
        let target = tensor([1, 1, n, width], 7).reshape([n, width]);
        let loss = (features - target).powi_scalar(2).mean();
        named_gradients(&network, &GradientsParams::from_grads(loss.backward(), &network))
    };
    let (fast, burn) = (gradients(TrainingEngine::Fast), gradients(TrainingEngine::Burn));
    assert!(fast.keys().eq(burn.keys()) && fast.len() > 30, "{} parameters", fast.len());
    for (name, expected) in &burn {
        let largest = expected.iter().fold(0.0f32, |m, x| m.max(x.abs()));
        let error = furthest(&fast[name], expected);
        assert!(error < 1e-6 + 1e-3 * largest, "{name} on {}: {error} of {largest}", Isa::best().name());
    }
}

#[test]
fn the_forced_path_is_taken() {
    if let Ok(name) = std::env::var(FORCED) {
        assert_eq!(Isa::best().name(), name);
    }
}

/// The operations take the best instruction set there is, once and for all: so this test runs a program of the others
/// for each that this processor has, with that one forced.
#[test]
fn every_path_passes_the_tests_of_training() {
    for isa in Isa::available() {
        let program = std::env::current_exe().unwrap();
        let tests = ["ops::", "unet::tests::gradients", "--skip", "every_path"];
        let output = Command::new(program).args(tests).env(FORCED, isa.name()).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{}: {text}", isa.name());
        for ran in ["the_forced_path_is_taken ... ok", "gradients_of_a_training_step_are_pytorchs ... ok"] {
            assert!(text.contains(ran), "{}: {text}", isa.name());
        }
    }
}
