//! The network for scans against the published one in PyTorch, on every backend of this build.
//!
//! Source: `tests/fixtures/where2act_3d`, its README has the semantics. Tolerance 1e-4 absolute: the largest
//! activations are of the order of 10, and sums of up to 768 products are ordered differently here.

use std::path::PathBuf;

use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Tensor, TensorData};
use where2act_core::{Primitive, Seed};
use where2act_model::{Modality, ModelConfig, Network, Tensors};

const TOLERANCE: f32 = 1e-4;

fn fixture(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/where2act_3d").join(name)
}

fn tensor<const D: usize>(io: &Tensors, name: &str, device: &Device) -> Tensor<D> {
    let stored = &io.by_name[name];
    Tensor::from_data(TensorData::new(stored.values.clone(), stored.shape.clone()), device)
}

fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec::<f32>().unwrap()
}

/// The largest difference; not a number if one of them is none.
fn furthest(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).max_by(f32::total_cmp).unwrap()
}

/// What the published network says, under the fixture's names and as it lays them out.
fn outputs(device: &Device) -> [(&'static str, Vec<f32>); 4] {
    let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(2048);
    let network =
        Network::new(&config, Seed(1), device).with_published(&fixture("weights.safetensors")).unwrap();
    let io = Tensors::read(&fixture("io.safetensors")).unwrap();
    let features = network.features_cloud(tensor(&io, "points", device));
    let of_first = features.clone().slice([0..2, 0..1]).reshape([2, 128]);
    let score = network.heads.score.forward(of_first.clone(), tensor(&io, "query_6d", device));
    let raw = network.heads.proposal.decode(of_first, tensor(&io, "z", device));
    let logits = network.heads.actionability.forward(features.clone().reshape([2 * 2048, 128]));
    [
        ("features", values(features.swap_dims(1, 2))),
        ("critic_logit", values(score)),
        ("proposal_raw", values(raw)),
        ("actionability", values(sigmoid(logits))),
    ]
}

fn agrees_on(device: &Device) {
    let io = Tensors::read(&fixture("io.safetensors")).unwrap();
    for (name, found) in outputs(device) {
        let error = furthest(&found, &io.by_name[name].values);
        assert!(error < TOLERANCE, "{name}: {error}");
    }
}

#[test]
fn flex_agrees_with_pytorch() {
    agrees_on(&Device::flex());
}

#[test]
#[cfg(feature = "ndarray")]
#[expect(deprecated, reason = "selectable until burn drops it")]
fn ndarray_agrees_with_pytorch() {
    agrees_on(&Device::ndarray());
}

#[test]
#[cfg(feature = "ndarray")]
#[expect(deprecated, reason = "selectable until burn drops it")]
fn flex_and_ndarray_agree_with_each_other() {
    let (flex, ndarray) = (outputs(&Device::flex()), outputs(&Device::ndarray()));
    for ((name, flex), (_, ndarray)) in flex.into_iter().zip(ndarray) {
        let error = furthest(&flex, &ndarray);
        assert!(error < TOLERANCE, "{name}: {error}");
    }
}
