//! From burn's parameters to plain numbers, batch-norms folded in.

use burn::nn::conv::Conv2d;
use burn::nn::{BatchNorm, Linear};
use burn::tensor::Tensor;
use where2act_kernels::unet::{BlockLayers, Folded, UNetLayers};
use where2act_kernels::{Activation, Isa, Mlp, ShapeError};

use super::linear::LinearLayer;
use crate::layers::folded;
use crate::unet::{BasicBlock, UNet};

/// The numbers of a tensor, row by row.
pub(super) fn values<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec::<f32>().unwrap_or_default()
}

/// A convolution and the batch-norm after it.
fn conv(conv: &Conv2d, norm: &BatchNorm) -> Folded {
    let (scale, shift) = folded(norm);
    let scale = values(scale);
    let mut kernel = values(conv.weight.val());
    let per_output = kernel.len() / scale.len().max(1);
    for (kernel, scale) in kernel.chunks_exact_mut(per_output.max(1)).zip(&scale) {
        kernel.iter_mut().for_each(|w| *w *= scale);
    }
    Folded { kernel, bias: values(shift) }
}

fn block(block: &BasicBlock) -> BlockLayers {
    BlockLayers {
        first: conv(&block.conv1, &block.bn1),
        second: conv(&block.conv2, &block.bn2),
        around: block.downsample.as_ref().map(|d| conv(&d.conv, &d.bn)),
    }
}

/// All layers of a U-Net; `None` if it does not have two blocks in each level and five steps up.
pub(super) fn unet(unet: &UNet) -> Option<UNetLayers> {
    let encoder = &unet.encoder;
    let level = |blocks: &[BasicBlock]| match blocks {
        [one, two] => Some([block(one), block(two)]),
        _ => None,
    };
    let levels =
        [level(&encoder.layer1)?, level(&encoder.layer2)?, level(&encoder.layer3)?, level(&encoder.layer4)?];
    let steps = unet.decoder.blocks.iter();
    let ups: Vec<_> = steps.map(|up| [conv(&up.conv1, &up.bn1), conv(&up.conv2, &up.bn2)]).collect();
    let [features, _, _, _] = unet.head.weight.dims();
    let bias = unet.head.bias.as_ref().map_or_else(|| vec![0.0; features], |bias| values(bias.val()));
    Some(UNetLayers {
        stem: conv(&encoder.conv1, &encoder.bn1),
        levels,
        ups: ups.try_into().ok()?,
        head: Folded { kernel: values(unet.head.weight.val()), bias },
    })
}

/// Takes the linear layer off the end of a U-Net, if it makes more numbers of fewer or no whole blocks of 16; in its place
/// is one that passes them on, with zeros up to a multiple of 16.
pub(super) fn take_head(layers: &mut UNetLayers) -> Option<LinearLayer> {
    let features = layers.head.bias.len();
    let channels = layers.head.kernel.len() / features.max(1);
    let inputs = channels.next_multiple_of(16);
    if inputs >= features && features.is_multiple_of(16) {
        return None;
    }
    let mut same = Folded { kernel: vec![0.0; inputs * channels], bias: vec![0.0; inputs] };
    same.kernel.iter_mut().step_by(channels + 1).take(channels).for_each(|one| *one = 1.0);
    let head = std::mem::replace(&mut layers.head, same);
    let mut weights = vec![0.0; inputs * features];
    for (feature, row) in head.kernel.chunks_exact(channels).enumerate() {
        weights.iter_mut().skip(feature).step_by(features).zip(row).for_each(|(to, w)| *to = *w);
    }
    Some(LinearLayer { weights, bias: head.bias })
}

/// A linear layer and the batch-norm after it.
pub(super) fn linear(linear: &Linear, norm: &BatchNorm) -> LinearLayer {
    let (scale, shift) = folded(norm);
    let scale = values(scale);
    let mut layer = LinearLayer { bias: values(shift), ..LinearLayer::of(linear) };
    for row in layer.weights.chunks_exact_mut(scale.len().max(1)) {
        row.iter_mut().zip(&scale).for_each(|(w, scale)| *w *= scale);
    }
    layer
}

/// Layers compiled to one MLP, with the same activation after each.
pub(super) fn mlp(isa: Isa, layers: &[LinearLayer], activation: Activation) -> Result<Mlp, ShapeError> {
    let inputs = layers.first().map_or(0, LinearLayer::inputs);
    let layers: Vec<_> = layers.iter().map(|layer| layer.followed_by(activation)).collect();
    Mlp::new(isa, inputs, &layers)
}
