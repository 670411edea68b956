//! Against PyTorch: `tests/fixtures/unet`, made by `generate.py` there. Tolerance 1e-4 absolute on values of the order
//! of 1: sums are ordered differently, and batch-norm is folded into the convolutions here.

use burn::module::Module;
use burn::optim::{AdamConfig, GradientsParams};
use burn::tensor::Device;
use where2act_core::{Primitive, Seed};

use super::UNet;
use crate::config::{Modality, ModelConfig};
use crate::network::{Backbone, Network};
use crate::testing::{devices, fixture, furthest, named_gradients, tensor, values};
use crate::weights::Tensors;

const TOLERANCE: f32 = 1e-4;

fn small() -> ModelConfig {
    let config = ModelConfig::new(Modality::Rgb, &[Primitive::Pushing]).with_width(0.125);
    ModelConfig { features: 16, ..config }
}

fn unet(network: Network) -> UNet {
    match network.backbone {
        Backbone::UNet(unet) => unet,
        Backbone::PointNet2(_) => unreachable!("the configuration says pictures"),
    }
}

/// The U-Net of the fixture; the file holds inputs and outputs beside its parameters.
fn load(device: &Device) -> (UNet, Tensors) {
    let file = Tensors::read(&fixture("unet/unet.safetensors")).unwrap();
    let mut parameters = file.clone();
    parameters.by_name.retain(|name, _| name.starts_with("backbone."));
    let network = Network::new(&small(), Seed(1), device);
    (unet(network.assign(&parameters, |name| name.starts_with("backbone.")).unwrap()), file)
}

#[test]
fn agrees_with_pytorch_on_both_backends() {
    for device in devices() {
        let (unet, file) = load(&device);
        let images = tensor::<4>(&file, "images", &device);
        let [b, _, h, w] = images.dims();
        let expected = tensor::<4>(&file, "features", &device).reshape([b, 16, h * w]).swap_dims(1, 2);
        let features = unet.forward(images.clone());
        let error = furthest(&values(features.clone()), &values(expected));
        assert!(error < TOLERANCE, "{device:?}: {error}");

        let queries = [(1, 6143), (0, 0), (1, 17)];
        let at = unet.forward_at(images, &queries);
        let rows = features.reshape([(b * h * w) as i32, 16]);
        let rows = queries.map(|(image, pixel)| rows.clone().narrow(0, image * h * w + pixel, 1));
        let error = furthest(&values(at), &values(burn::tensor::Tensor::cat(rows.to_vec(), 0)));
        assert!(error < 1e-5, "{device:?}: {error}");
    }
}

#[test]
fn the_encoder_is_torchvisions_resnet18_from_either_format() {
    let device = Device::flex();
    let (_, file) = load(&device);
    for name in ["resnet18.safetensors", "resnet18.pth"] {
        let network =
            Network::new(&small(), Seed(1), &device).with_resnet18(&fixture("unet").join(name)).unwrap();
        let stages = unet(network).encoder.forward(tensor(&file, "images", &device));
        for (i, stage) in stages.into_iter().enumerate() {
            let expected = values(tensor::<4>(&file, &format!("stage{i}"), &device));
            let error = furthest(&values(stage), &expected);
            assert!(error < TOLERANCE, "{name}, stage {i}: {error}");
        }
    }
}

#[test]
fn gradients_of_a_training_step_are_pytorchs() {
    let step = Tensors::read(&fixture("unet/training.safetensors")).unwrap();
    for device in devices() {
        let plain = device.clone();
        let device = device.autodiff();
        let (unet, file) = load(&device);
        let queries = [(0, 5), (0, 3000), (1, 77), (1, 6143), (1, 77), (0, 2048)];
        let target = tensor::<2>(&step, "target", &device);
        let loss_of = |unet: &UNet| {
            let at = unet.forward_at(tensor(&file, "images", &device), &queries);
            ((at.clone() - target.clone()).powi_scalar(2).mean(), at)
        };
        let (loss, at) = loss_of(&unet);
        let error = furthest(&values(at), &values(tensor::<2>(&step, "at", &plain)));
        assert!(error < TOLERANCE, "{plain:?}: features {error}");
        let gradients = GradientsParams::from_grads(loss.backward(), &unet);
        let named = named_gradients(&unet, &gradients);
        let mut compared = 0;
        for (name, expected) in
            step.by_name.iter().filter_map(|(n, t)| Some((n.strip_prefix("grad.backbone.")?, t)))
        {
            let largest = expected.values.iter().fold(0.0f32, |m, x| m.max(x.abs()));
            let error = furthest(&named[name], &expected.values);
            // Gradients have been through up to 30 batch-norms, each a difference of large sums.
            assert!(error < 1e-5 + 1e-3 * largest, "{plain:?}: {name}: {error} of {largest}");
            compared += 1;
        }
        assert_eq!(compared, named.len());
        let unet = AdamConfig::new().with_epsilon(1e-8).init().step(1e-3, unet, gradients);
        let (after, _) = loss_of(&unet);
        let error = furthest(&values(after), &step.by_name["loss_after"].values);
        assert!(error < 1e-3, "{plain:?}: loss after the step {error}");
        assert!(unet.num_params() > 0);
    }
}
