//! The engine against the burn path.

use super::*;
use burn::module::{Module, ModuleMapper, Param};
use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use where2act_core::{Primitive, Seed};

use crate::config::{Modality, ModelConfig};

/// Random statistics for the batch-norms, which a new network has at zero and one.
struct Stir(ChaCha8Rng);

impl ModuleMapper for Stir {
    fn map_float<const D: usize>(&mut self, param: Param<Tensor<D>>) -> Param<Tensor<D>> {
        param.map(|old| {
            if D > 1 {
                return old;
            }
            let shape = old.dims();
            let count = shape.iter().product();
            let noise: Vec<f32> = (0..count).map(|_| self.0.random_range(-0.1..0.2)).collect();
            old.clone() + Tensor::from_data(TensorData::new(noise, shape), &old.device())
        })
    }
}

fn network(modality: Modality, change: impl FnOnce(ModelConfig) -> ModelConfig) -> Network {
    let config = change(ModelConfig::new(modality, &Primitive::ALL));
    let network = Network::new(&config, Seed(3), &Device::flex());
    let network = network.map(&mut Stir(Seed(4).rng()));
    // The running statistics are not parameters; `map` leaves them, so they are stirred through the tensors.
    let mut tensors = network.tensors();
    let mut rng = Seed(5).rng();
    for (name, tensor) in &mut tensors.by_name {
        if name.contains("running") {
            tensor.values.iter_mut().for_each(|x| *x += rng.random_range(0.0..0.3));
        }
    }
    network.with_tensors(&tensors).unwrap()
}

fn noise(len: usize) -> Vec<f32> {
    let mut rng = Seed(6).rng();
    (0..len).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// Largest difference over largest value.
fn error(expected: &[f32], found: &[f32]) -> f32 {
    assert_eq!(expected.len(), found.len());
    let largest = expected.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
    let difference = expected.iter().zip(found).map(|(a, b)| if a == b { 0.0 } else { (a - b).abs() });
    difference.fold(0.0, |a: f32, b| if b.is_nan() { f32::INFINITY } else { a.max(b) }) / largest
}

#[test]
fn pictures_give_what_burn_gives() {
    for (width, [b, height, w]) in [(0.25, [3, 64, 96]), (0.3, [1, 32, 32]), (0.5, [1, 224, 224])] {
        let network = network(Modality::Rgb, |config| config.with_width(width));
        let images = noise(b * 3 * height * w);
        let tensor = Tensor::from_data(TensorData::new(images.clone(), [b, 3, height, w]), &Device::flex());
        let expected = fold::values(network.features_rgb(tensor));
        for isa in Isa::available() {
            let engine = Engine::compile_for(isa, &network).unwrap();
            let found = engine.features_rgb(&images, [b, height, w]).unwrap();
            let error = error(&expected, &found);
            assert!(error < 1e-4, "{} width {width}: {error:e}", isa.name());
        }
    }
}

#[test]
fn an_open_engine_and_its_last_layer_give_the_features() {
    // 40 features are no whole blocks, which only an open engine can do.
    for (width, features, expected_inputs, most) in
        [(0.3, 128, 32, 1e-5), (0.5, 128, 32, 1e-5), (1.0, 40, 64, 1e-4)]
    {
        let network = network(Modality::Rgb, |config| ModelConfig { features, ..config.with_width(width) });
        let images = noise(3 * 64 * 64);
        let expected = match Engine::compile(&network) {
            Ok(engine) => engine.features_rgb(&images, [1, 64, 64]).unwrap().to_vec(),
            Err(_) => {
                let pixels = TensorData::new(images.clone(), [1, 3, 64, 64]);
                fold::values(network.features_rgb(Tensor::from_data(pixels, &Device::flex())))
            }
        };
        let (engine, last) = Engine::open(Isa::best(), &network).unwrap();
        let LinearLayer { weights, bias } = last.unwrap();
        assert_eq!((engine.features(), weights.len()), (expected_inputs, expected_inputs * bias.len()));
        let rows = engine.features_rgb(&images, [1, 64, 64]).unwrap();
        let found: Vec<f32> = rows
            .chunks_exact(expected_inputs)
            .flat_map(|row| {
                let mut features = bias.clone();
                for (x, weights) in row.iter().zip(weights.chunks_exact(bias.len())) {
                    features.iter_mut().zip(weights).for_each(|(f, w)| *f += x * w);
                }
                features
            })
            .collect();
        let error = error(&expected, &found);
        assert!(error < most, "width {width}: {error:e}");
    }
    let wide = network(Modality::Rgb, |config| ModelConfig { features: 16, ..config.with_width(0.25) });
    assert!(Engine::open(Isa::best(), &wide).unwrap().1.is_none(), "no fewer numbers before the layer");
    let cloud = network(Modality::Cloud, |config| config);
    assert!(Engine::open(Isa::best(), &cloud).unwrap().1.is_none(), "an activation after the layer");
}

#[test]
fn clouds_give_what_burn_gives() {
    // Sizes that are no multiples of 16, too.
    for (surroundings, width) in [(false, 1.0), (true, 1.0), (true, 0.125), (false, 1.3)] {
        let network = network(Modality::Cloud, |config| {
            ModelConfig { points: 2048, surroundings, ..config }.with_width(width)
        });
        let points: Vec<f32> = noise(2 * 2048 * 3).iter().map(|x| x * 0.5).collect();
        let scans: Vec<f32> = noise(2 * 9000 * 3).iter().map(|x| x * 0.5).collect();
        let hierarchy = Hierarchy::new(&points, 2);
        let surround =
            |hierarchy: Hierarchy| hierarchy.with_surroundings(&[&scans[..27_000], &scans[27_000..]]);
        let surrounded = surround(hierarchy.clone());
        // As many targets as points in all, which are others.
        let targets = [scans[..3 * 3000].to_vec(), scans[27_000..][..3 * 1096].to_vec()];
        let targeted = surround(Hierarchy::with_targets(&points, &targets));
        let Backbone::PointNet2(net) = &network.backbone else { panic!("a network for clouds") };
        for hierarchy in [hierarchy, surrounded, targeted] {
            let expected = fold::values(net.forward_rows(&hierarchy, &Device::flex()));
            for isa in Isa::available() {
                let engine = Engine::compile_for(isa, &network).unwrap();
                // Later calls find earlier numbers in their buffers, and need no others.
                let call = || {
                    let found = engine.features_cloud(&hierarchy).unwrap();
                    let error = error(&expected, &found);
                    assert!(error < 1e-4, "{}: {error:e}", isa.name());
                    let memory = engine.cloud_memory.lock().unwrap();
                    let mut buffers: Vec<_> =
                        memory[0].free.iter().map(|b| (b.as_ptr(), b.capacity())).collect();
                    buffers.sort();
                    buffers
                };
                let _ = (call(), call());
                assert_eq!(call(), call());
            }
        }
    }
}

#[test]
fn many_threads_share_an_engine() {
    let network = network(Modality::Rgb, |config| config.with_width(0.25));
    let engine = Engine::compile(&network).unwrap();
    let images = noise(3 * 64 * 64);
    let expected = engine.features_rgb(&images, [1, 64, 64]).unwrap().to_vec();
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| assert_eq!(*engine.features_rgb(&images, [1, 64, 64]).unwrap(), expected[..]));
        }
    });
}

#[test]
fn wrong_inputs_are_refused() {
    let engine = Engine::compile(&network(Modality::Rgb, |config| config.with_width(0.25))).unwrap();
    assert!(engine.features_rgb(&[0.0; 5], [1, 32, 32]).is_err());
    assert!(engine.features_rgb(&[0.0; 3 * 33 * 32], [1, 33, 32]).is_err());
    assert!(engine.features_cloud(&Hierarchy::new(&[0.0; 64 * 3], 1)).is_err());
    let odd = network(Modality::Rgb, |config| ModelConfig { features: 100, ..config.with_width(0.25) });
    assert!(Engine::compile(&odd).is_err());
}

#[test]
fn bf16_comes_near_and_scans_stay_as_they_are() {
    let Some(isa) = Isa::bf16() else { return };
    // Of width 0.3 some layers have an odd number of channels.
    for width in [0.3, 0.5] {
        let network = network(Modality::Rgb, |config| config.with_width(width));
        let images = noise(2 * 3 * 224 * 224);
        let features = |isa| {
            let engine = Engine::compile_for(isa, &network).unwrap();
            engine.features_rgb(&images, [2, 224, 224]).unwrap().to_vec()
        };
        let (exact, found) = (features(Isa::best()), features(isa));
        // 2^-9 for each operand of some twenty layers one after the other. These random weights make 0.065 of it, trained
        // ones 0.013.
        let apart = error(&exact, &found);
        assert!(apart > 1e-5 && apart < 0.1, "{apart:e}");
        assert!(found == features(isa), "the same bits every time");
    }
    let network = network(Modality::Cloud, |config| config.with_points(256));
    let hierarchy = Hierarchy::new(&noise(256 * 3), 1);
    let features =
        |isa| Engine::compile_for(isa, &network).unwrap().features_cloud(&hierarchy).unwrap().to_vec();
    assert!(features(Isa::best()) == features(isa));
    assert_eq!(Engine::compile_for(isa, &network).unwrap().isa(), Isa::best());
}
