//! The layers that the backbones are made of, and the one place where convolution meets batch-norm.

use burn::module::Param;
use burn::nn::conv::{Conv2d, Conv2dConfig};
use burn::nn::{BatchNorm, BatchNormConfig, Initializer, Linear, LinearConfig, PaddingConfig2d};
use burn::tensor::activation::{leaky_relu, relu};
use burn::tensor::module::{conv2d, interpolate};
use burn::tensor::ops::{ConvOptions, InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor};

#[cfg(feature = "train")]
use crate::ops;

/// Slope of the heads' activation for negative numbers (published; PyTorch's default).
pub(crate) const LEAK: f64 = 0.01;

/// A square convolution that keeps the size (up to its stride). Parameters start at zero: [`crate::Network::new`] draws them.
pub(crate) fn conv(
    channels: [usize; 2],
    kernel: usize,
    stride: usize,
    bias: bool,
    device: &Device,
) -> Conv2d {
    let pad = kernel / 2;
    Conv2dConfig::new(channels, [kernel, kernel])
        .with_stride([stride, stride])
        .with_padding(PaddingConfig2d::Explicit(pad, pad, pad, pad))
        .with_bias(bias)
        .with_initializer(Initializer::Zeros)
        .init(device)
}

/// Batch-norm with PyTorch's constants: epsilon 1e-5, momentum 0.1.
pub(crate) fn norm(channels: usize, device: &Device) -> BatchNorm {
    BatchNormConfig::new(channels).init(device)
}

/// A linear layer. Parameters start at zero: [`crate::Network::new`] draws them.
pub(crate) fn linear(inputs: usize, outputs: usize, bias: bool, device: &Device) -> Linear {
    LinearConfig::new(inputs, outputs).with_bias(bias).with_initializer(Initializer::Zeros).init(device)
}

/// The heads' activation.
pub(crate) fn leaky<const D: usize>(x: Tensor<D>) -> Tensor<D> {
    leaky_relu(x, LEAK)
}

/// What follows a batch-norm.
#[expect(
    clippy::large_enum_variant,
    reason = "lives for one call; a box would be one more allocation per layer"
)]
pub(crate) enum After {
    /// Nothing.
    Identity,
    /// max(x, 0).
    Relu,
    /// max(x + residual, 0).
    AddRelu(Tensor<4>),
}

impl After {
    fn of(self, y: Tensor<4>) -> Tensor<4> {
        match self {
            Self::Identity => y,
            Self::Relu => relu(y),
            Self::AddRelu(residual) => relu(y + residual),
        }
    }
}

/// Convolution, batch-norm and what follows: the only way the U-Net applies them.
///
/// # Shapes
/// `[b, in, h, w]` -> `[b, out, h / stride, w / stride]`
pub(crate) fn conv_norm(conv: &Conv2d, norm: &BatchNorm, x: Tensor<4>, after: After) -> Tensor<4> {
    if !trains(norm, &x) {
        let (scale, shift) = folded(norm);
        let [channels] = scale.dims();
        return after.of(convolve(conv, x, Some((scale.reshape([channels, 1, 1, 1]), shift))));
    }
    #[cfg(feature = "train")]
    if conv.bias.is_none()
        && let Some(y) = ops::conv(&x, &conv.weight.val(), conv.stride[0], conv.kernel_size[0] / 2)
    {
        return train_norm(norm, y, after);
    }
    train_norm(norm, convolve(conv, x, None), after)
}

/// [`conv_norm`] of `x` doubled by nearest upsampling with `skip` behind its channels, then ReLU.
///
/// # Shapes
/// `[b, in, h, w]` and `[b, skip, 2h, 2w]` -> `[b, out, 2h, 2w]`
pub(crate) fn up_conv_norm(conv: &Conv2d, norm: &BatchNorm, x: Tensor<4>, skip: Tensor<4>) -> Tensor<4> {
    #[cfg(feature = "train")]
    if trains(norm, &x)
        && let Some(y) = ops::conv_upsampled(&x, &skip, &conv.weight.val(), conv.kernel_size[0] / 2)
    {
        return train_norm(norm, y, After::Relu);
    }
    let [_, _, h, w] = skip.dims();
    // Nearest, not bilinear: 17 times cheaper here, and it can be folded into the next convolution.
    let up = interpolate(x, InterpolateOptions::new(InterpolateMode::Nearest).with_output_size([h, w]));
    conv_norm(conv, norm, Tensor::cat(vec![up, skip], 1), After::Relu)
}

/// Batch-norm with the batch's statistics, and what follows.
fn train_norm(norm: &BatchNorm, x: Tensor<4>, after: After) -> Tensor<4> {
    #[cfg(feature = "train")]
    if let Some(y) = match &after {
        After::Identity => ops::norm_planes(norm, &x, None, false),
        After::Relu => ops::norm_planes(norm, &x, None, true),
        After::AddRelu(residual) => ops::norm_planes(norm, &x, Some(residual), true),
    } {
        return y;
    }
    after.of(norm.forward(x))
}

/// The convolution, its weight scaled per output channel and its bias replaced if `fold` says so.
fn convolve(conv: &Conv2d, x: Tensor<4>, fold: Option<(Tensor<4>, Tensor<1>)>) -> Tensor<4> {
    let pad = conv.kernel_size[0] / 2;
    let options = ConvOptions::new(conv.stride, [pad, pad], conv.dilation, conv.groups);
    let weight = conv.weight.val();
    match fold {
        Some((scale, shift)) => conv2d(x, weight * scale, Some(shift), options),
        None => conv2d(x, weight, conv.bias.as_ref().map(Param::val), options),
    }
}

/// Batch-norm of rows, then ReLU.
///
/// # Shapes
/// `[rows, channels]` -> `[rows, channels]`
pub(crate) fn rows_norm_relu(norm: &BatchNorm, x: Tensor<2>) -> Tensor<2> {
    #[cfg(feature = "train")]
    if trains(norm, &x)
        && let Some(y) = ops::norm_rows_relu(norm, &x)
    {
        return y;
    }
    relu(norm.forward(x))
}

/// Whether batch-norm takes its statistics from this batch.
pub(crate) fn trains<const D: usize>(norm: &BatchNorm, x: &Tensor<D>) -> bool {
    x.device().is_autodiff() && norm.training.is_enabled()
}

/// Batch-norm with fixed statistics as `x * scale + shift`, each `[channels]`.
pub(crate) fn folded(norm: &BatchNorm) -> (Tensor<1>, Tensor<1>) {
    let scale = norm.gamma.val() / (norm.running_var.value().add_scalar(norm.epsilon)).sqrt();
    let shift = norm.beta.val() - norm.running_mean.value() * scale.clone();
    (scale, shift)
}
