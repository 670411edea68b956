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

fn furthest<const D: usize>(a: Tensor<D>, b: Tensor<D>) -> f32 {
    assert_eq!(a.dims(), b.dims());
    (a - b).abs().max().into_scalar::<f32>()
}

fn agrees_on(device: &Device) {
    let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(2048);
    let network =
        Network::new(&config, Seed(1), device).with_published(&fixture("weights.safetensors")).unwrap();
    let io = Tensors::read(&fixture("io.safetensors")).unwrap();

    let features = network.features_cloud(tensor(&io, "points", device));
    let expected = tensor::<3>(&io, "features", device).swap_dims(1, 2);
    let error = furthest(features.clone(), expected);
    assert!(error < TOLERANCE, "features: {error}");

    let of_first = features.clone().slice([0..2, 0..1]).reshape([2, 128]);
    let logits = network.heads.score.forward(of_first.clone(), tensor(&io, "query_6d", device));
    let error = furthest(logits, tensor(&io, "critic_logit", device));
    assert!(error < TOLERANCE, "score: {error}");

    let raw = network.heads.proposal.decode(of_first, tensor(&io, "z", device)).reshape([2, 6]);
    let error = furthest(raw, tensor(&io, "proposal_raw", device));
    assert!(error < TOLERANCE, "proposal: {error}");

    let logits = network.heads.actionability.forward(features.reshape([2 * 2048, 128]));
    let error = furthest(sigmoid(logits).reshape([2, 2048]), tensor(&io, "actionability", device));
    assert!(error < TOLERANCE, "actionability: {error}");
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
