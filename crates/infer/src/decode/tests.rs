use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Point3;
use where2act_core::{Orientation6, Primitive, Seed};
use where2act_kernels::Isa;
use where2act_model::preprocess::{CloudInput, CloudScale, ImageInput};
use where2act_model::{Engine, LinearLayer, Modality, ModelConfig, Network, Weights, hand_frame, to_axes};

use super::heads::normal;
use super::{DecodingHeads, Scored, sigmoid};
use crate::read::{read_picture, read_scan};

fn tensor(values: &[f32], width: usize) -> Tensor<2> {
    Tensor::from_data(TensorData::new(values.to_vec(), [values.len() / width, width]), &Device::flex())
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec().unwrap()
}

/// Relative to the largest value: sums of some hundred products in another order.
const TOLERANCE: f32 = 2e-5;

#[track_caller]
fn close(what: &str, found: &[f32], expected: &[f32], tolerance: f32) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let largest = expected.iter().fold(1.0f32, |m, x| m.max(x.abs()));
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < tolerance * largest, "{what}: {a}, expected {b}");
    }
}

/// How short the directions that become axes are beside the raw numbers, at most 1: rounding turns short ones further.
fn shortness(raw: &Orientation6) -> f32 {
    let (approach, forward) = (raw.approach(), raw.forward());
    let z = approach.normalize();
    let across = forward - z * z.dot(&forward);
    approach.norm().min(across.norm()).min(1.0)
}

/// Decoding of `rows`, which `last` makes features of, against the model's heads, for every output.
fn check(network: &Network, last: Option<&LinearLayer>, rows: &[f32], candidates: &[u32]) {
    let (config, model) = (network.config(), &network.heads);
    let outputs = config.primitives.len();
    let heads = DecodingHeads::new(model, config, last).unwrap();
    let features = match last {
        Some(last) => {
            let bias = tensor(&last.bias, last.bias.len());
            numbers(tensor(rows, last.inputs()).matmul(tensor(&last.weights, last.bias.len())) + bias)
        }
        None => rows.to_vec(),
    };
    let count = features.len() / config.features;
    let all = numbers(model.actionability.forward(tensor(&features, config.features)).transpose());
    close("actionability", &heads.actionability(rows, &[0..1, 1..count]).unwrap(), &all, TOLERANCE);

    let samples = 11;
    let codes = heads.codes(samples, Seed(5));
    let z = tensor(&normal(samples * config.latent, Seed(5)), config.latent);
    for output in 0..outputs {
        let found = heads.propose(rows, candidates, output, &codes).unwrap();
        assert_eq!(found.len(), candidates.len());
        for (row, found) in candidates.iter().zip(found) {
            let own = &features[*row as usize * config.features..][..config.features];
            let feature = tensor(&own.repeat(samples), config.features);
            let of_output = output..output + 1;
            let raw = model.proposal.decode(feature.clone(), z.clone());
            let raw = raw.slice([0..samples, of_output.clone(), 0..6]).reshape([samples, 6]);
            let axes = to_axes(raw.clone());
            let logits = model.score.forward(feature.clone(), axes.clone());
            let logits = model.with_ways(logits, feature, axes.clone().unsqueeze_dim(1));
            let logits = logits.slice([0..samples, of_output]);
            let (axes, logits) = (numbers(axes), numbers(logits));
            assert_eq!(found.scores.len(), samples);
            for (sample, &score) in found.scores.iter().enumerate() {
                let rotation = found.rotation(sample);
                assert_eq!(found.approach(sample), rotation.matrix().column(2));
                let raw = Orientation6(numbers(raw.clone()).as_chunks().0[sample]);
                let what = format!("output {output}, row {row}, sample {sample}");
                let within = TOLERANCE / shortness(&raw);
                close(&what, &Orientation6::from_rotation(&rotation).0, &axes[6 * sample..][..6], within);
                close(&what, &[score], &[sigmoid(logits[sample])], within);
            }
        }
    }
}

/// The heads of the model crate, one row at a time, for every output: what decoding must equal.
#[test]
fn decoding_equals_the_heads_of_the_model() {
    let noise = |n: usize| (0..n).map(|i| ((i * 37 % 101) as f32 / 50.0 - 1.0).powi(3)).collect::<Vec<_>>();
    for (hidden, alignments, dense) in [(40, 5, None), (40, 0, Some(24)), (256, 16, Some(64))] {
        let mut config = ModelConfig::new(Modality::Cloud, &Primitive::ALL[1..4]);
        (config.hidden, config.latent, config.alignments) = (hidden, 7, alignments);
        (config.actionability_hidden, config.ways) = (dense, (alignments > 0).then_some(3.0));
        let network = Network::new(&config, Seed(3), &Device::flex());
        check(&network, None, &noise(50 * 128), &[49, 3]);
        let last = LinearLayer { weights: noise(32 * 128), bias: noise(128) };
        check(&network, Some(&last), &noise(50 * 32), &[17, 0]);
    }
}

/// The second look of the model crate, whose scores decoding must equal.
#[test]
fn a_second_look_equals_the_models() {
    let noise = |n: usize| (0..n).map(|i| ((i * 37 % 101) as f32 / 50.0 - 1.0).powi(3)).collect::<Vec<_>>();
    for alignments in [0, 5] {
        let mut config = ModelConfig::new(Modality::Cloud, &Primitive::ALL[1..4]).with_points(64);
        (config.hidden, config.alignments, config.second_look) = (40, alignments, true);
        config.ways = (alignments > 0).then_some(3.0);
        let network = Network::new(&config, Seed(3), &Device::flex());
        let heads = DecodingHeads::new(&network.heads, &config, None).unwrap();
        let points: Vec<Point3<f32>> =
            noise(900).as_chunks().0.iter().map(|&[x, y, z]| Point3::new(x, y, 3.0 + 0.1 * z)).collect();
        let cloud = CloudInput::new(&points, CloudScale::PerMetre(0.7), &config, &mut Seed(1).rng()).unwrap();
        let (features, rows) = (noise(64 * 128), [7, 60]);
        let rotation = |i: usize| Orientation6(std::array::from_fn(|k| noise(99)[6 * i + k])).to_rotation();
        let hand = |i: usize| Scored {
            candidate: i % 2,
            pixel: where2act_core::Pixel { u: 0, v: 0 },
            rotation: rotation(i),
            score: 0.0,
        };
        let hands: Vec<Scored> = (0..6).map(hand).collect();
        let row = |hand: &Scored| rows[hand.candidate] as usize;
        let orientations: Vec<_> = hands.iter().map(|h| Orientation6::from_rotation(&h.rotation)).collect();
        let own: Vec<f32> = hands.iter().flat_map(|h| features[128 * row(h)..][..128].to_vec()).collect();
        let frames: Vec<_> = hands
            .iter()
            .zip(&orientations)
            .map(|(h, orientation)| hand_frame(cloud.xyz.as_chunks().0[row(h)], orientation))
            .collect();
        let axes: Vec<f32> = orientations.iter().flat_map(|o| o.0).collect();
        let (score, look) = (&network.heads.score, network.heads.second_look.as_ref().unwrap());
        let own = tensor(&own, 128);
        let axes = tensor(&axes, 6).unsqueeze_dim(1);
        let seen = score.hands(own.clone(), axes.clone());
        let logits = look.forward(own.clone(), seen, &cloud.hand_views(&frames));
        let logits = numbers(network.heads.with_ways(logits, own, axes));
        for output in 0..3 {
            let found =
                heads.second_look.as_ref().unwrap().score(&features, &cloud, &rows, hands.clone(), output);
            let found: Vec<f32> = found.unwrap().iter().map(|h| h.score).collect();
            let expected: Vec<f32> = logits.iter().skip(output).step_by(3).map(|l| sigmoid(*l)).collect();
            close(&format!("output {output}"), &found, &expected, TOLERANCE);
        }
    }
}

fn repository(path: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

fn trained(name: &str) -> Network {
    Weights::load(&repository("weights").join(name), &Device::flex()).unwrap().network
}

#[test]
fn trained_weights_decode_a_picture_as_the_heads_of_the_model() {
    let network = trained("rgb");
    let picture = read_picture(&repository("examples/cabinet.png")).unwrap();
    let with = &network.config().preprocessing;
    let side = with.image_side;
    let input = ImageInput::new(picture.size, &picture.rgb, None, with).unwrap();
    let (engine, last) = Engine::open(Isa::best(), &network).unwrap();
    let rows = engine.features_rgb(&input.values, [1, side, side]).unwrap();
    assert!(last.is_some(), "the shipped U-Net has fewer channels than features");
    check(&network, last.as_ref(), &rows, &[0, 20_000, 25_112, 30_000, 50_175]);
}

#[test]
fn trained_weights_decode_a_scan_as_the_heads_of_the_model() {
    let network = trained("cloud");
    let scan = read_scan(&repository("examples/cabinet.ply")).unwrap();
    let config = network.config();
    let input = CloudInput::new(&scan, CloudScale::Trained, config, &mut Seed(1).rng()).unwrap();
    let (engine, last) = Engine::open(Isa::best(), &network).unwrap();
    let rows = engine.features_cloud(&input.whole_hierarchy(config)).unwrap();
    check(&network, last.as_ref(), &rows, &[0, 1000, 2000, 3000, 4095]);
}

#[test]
fn codes_are_normal_and_depend_on_the_seed() {
    let z = normal(100_000, Seed(1));
    let n = z.len() as f32;
    let mean = z.iter().sum::<f32>() / n;
    let variance = z.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / n;
    // Standard errors at 100,000 numbers: 0.003 and 0.0045.
    assert!(mean.abs() < 0.015 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
    assert_ne!(z, normal(100_000, Seed(2)));
    assert_eq!(z[..50], normal(50, Seed(1)));
}

#[test]
fn the_sigmoid_is_one() {
    for i in -200_000..=200_000 {
        let x = i as f32 * 6e-4;
        let expected = 1.0 / (1.0 + (-f64::from(x)).exp());
        let found = f64::from(sigmoid(x));
        assert!((found - expected).abs() <= 3e-7 * expected + 1e-37, "{x}: {found}, expected {expected}");
    }
    assert!(sigmoid(f32::NAN).is_nan());
    assert_eq!((sigmoid(f32::INFINITY), sigmoid(0.0)), (1.0, 0.5));
}
