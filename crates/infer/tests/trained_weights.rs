//! The kernels on the trained weights of this repository and real inputs: on every instruction set, for any number of
//! threads, the numbers that burn's own operations give, and in bf16 what is near them.

use std::path::{Path, PathBuf};

use burn::tensor::{Device, Tensor};
use where2act_core::Seed;
use where2act_infer::read::{read_picture, read_scan};
use where2act_kernels::Isa;
use where2act_model::preprocess::{CloudInput, CloudScale, ImageInput};
use where2act_model::{Engine, Network, Weights};

/// Largest difference over largest value: rounding in another order.
const TOLERANCE: f32 = 1e-4;
/// The same for convolutions in bf16: 2^-9 for each operand of some twenty layers one after the other.
const BF16_TOLERANCE: f32 = 3e-2;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

fn network(name: &str) -> Network {
    Weights::load(&repository("weights").join(name), &Device::flex()).unwrap().network
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_into_vec().unwrap()
}

#[track_caller]
fn close(what: &str, isa: Isa, found: &[f32], expected: &[f32]) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(0.0f32, |m, x| m.max(x.abs()));
    assert!(largest.is_finite() && largest > 0.0, "{what}");
    let furthest = found.iter().zip(expected).fold(0.0f32, |m, (a, b)| {
        let apart = (a - b).abs();
        if apart.is_nan() { f32::INFINITY } else { m.max(apart) }
    });
    println!("{what} on {}: {:.1e} of the largest", isa.name(), furthest / largest);
    let tolerance = if isa != isa.exact() { BF16_TOLERANCE } else { TOLERANCE };
    assert!(furthest < tolerance * largest, "{what} on {}: {furthest} of {largest}", isa.name());
}

/// `run` gives the features of an engine; `expected` are burn's.
fn check(network: &Network, expected: &[f32], run: impl Fn(&Engine) -> Vec<f32> + Sync) {
    for isa in Isa::available().into_iter().chain(Isa::bf16()) {
        let engine = Engine::compile_for(isa, network).unwrap();
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&engine))
        };
        let features = with(1);
        close("features", engine.isa(), &features, expected);
        for threads in [2, 5] {
            assert!(with(threads) == features, "{threads} threads on {}", isa.name());
        }
    }
}

#[test]
fn a_picture_gives_on_every_path_what_burn_gives() {
    let network = network("rgb");
    let picture = read_picture(&repository("examples/cabinet.png")).unwrap();
    let with = &network.config().preprocessing;
    let input = ImageInput::new(picture.size, &picture.rgb, None, with).unwrap();
    let side = with.image_side;
    let images = ImageInput::batch(std::slice::from_ref(&input), &Device::flex());
    let expected = numbers(network.features_rgb(images));
    check(&network, &expected, |engine| {
        engine.features_rgb(&input.values, [1, side, side]).unwrap().to_vec()
    });
}

#[test]
fn a_scan_gives_on_every_path_what_burn_gives() {
    let network = network("cloud");
    let scan = read_scan(&repository("examples/cabinet.ply")).unwrap();
    let input = CloudInput::new(&scan, CloudScale::Trained, network.config(), &mut Seed(1).rng()).unwrap();
    let hierarchy = input.whole_hierarchy(network.config());
    let expected = numbers(network.features_of(&hierarchy));
    check(&network, &expected, |engine| engine.features_cloud(&hierarchy).unwrap().to_vec());
}
