//! What the network learns from. Every loss is a tensor of one number, or one number per query to be weighted.

use burn::tensor::Tensor;
use burn::tensor::activation::relu;

use crate::heads::{Code, rotation_matrix};

/// Added under the roots of the geodesic distance: at zero its slope stays finite and its value is 1.4e-3 rad.
const GEODESIC_EPSILON: f64 = 1e-6;

/// The weighted mean, 0 if all weights are 0.
///
/// # Shapes
/// `[q]`, `[q]` -> `[1]`
#[must_use]
pub fn weighted_mean(values: Tensor<1>, weights: Tensor<1>) -> Tensor<1> {
    let total = weights.clone().sum().clamp_min(1e-8);
    (values * weights).sum() / total
}

/// Binary cross-entropy of logits, in the form that neither overflows nor loses digits.
///
/// # Shapes
/// `[q]`, targets in [0, 1] `[q]` -> `[q]`
#[must_use]
pub fn binary_cross_entropy(logits: Tensor<1>, targets: Tensor<1>) -> Tensor<1> {
    let tail = logits.clone().abs().neg().exp().log1p();
    relu(logits.clone()) - logits * targets + tail
}

/// Squared error of a logit's sigmoid against a target in [0, 1]: how actionability is learned.
///
/// # Shapes
/// `[q]`, `[q]` -> `[q]`
#[must_use]
pub fn squared_error(logits: Tensor<1>, targets: Tensor<1>) -> Tensor<1> {
    (burn::tensor::activation::sigmoid(logits) - targets).powi_scalar(2)
}

/// Angle in radians between two rotations given by their orthonormal axes, smooth at 0 and at pi.
///
/// # Shapes
/// `[q, 6]`, `[q, 6]` -> `[q]`
#[must_use]
pub fn geodesic_distance(a: Tensor<2>, b: Tensor<2>) -> Tensor<1> {
    let [q, _] = a.dims();
    // With c the cosine of the angle, |A - B|^2 = 4 (1 - c) and tan(angle / 2)^2 = (1 - c) / (1 + c).
    let apart = (rotation_matrix(a) - rotation_matrix(b)).powi_scalar(2);
    let one_minus = apart.reshape([q, 9]).sum_dim(1).reshape([q]).div_scalar(4.0);
    let one_plus = relu(one_minus.clone().neg().add_scalar(2.0));
    let half = one_minus.add_scalar(GEODESIC_EPSILON).sqrt() / one_plus.add_scalar(GEODESIC_EPSILON).sqrt();
    half.atan().mul_scalar(2.0)
}

/// Divergence of the code's distribution from the standard normal one (Kullback and Leibler), summed over the code.
///
/// # Shapes
/// `[q, latent]` -> `[q]`
#[must_use]
pub fn kl_divergence(code: &Code) -> Tensor<1> {
    let [q, _] = code.mean.dims();
    let log_variance = code.log_variance.clone();
    let terms = code.mean.clone().powi_scalar(2) + log_variance.clone().exp() - log_variance.add_scalar(1.0);
    terms.sum_dim(1).reshape([q]).mul_scalar(0.5)
}

#[cfg(all(test, feature = "train"))]
mod tests;
