//! Six numbers to a rotation in tensors, as [`where2act_core::orthonormal_frame`] does for one.

use burn::tensor::{Bool, Device, Tensor};

/// A direction whose largest number is not above this has no direction; the same bound as in
/// [`where2act_core::orthonormal_frame`].
const SHORTEST: f32 = 1e-6;

/// Gram-Schmidt: the approach scaled to length one, the forward made orthogonal to it. Zero and parallel directions
/// are replaced by fixed ones *before* anything is divided by their length, so that gradients are finite too.
///
/// # Shapes
/// `[n, 6]` -> `[n, 6]`
#[must_use]
pub fn to_axes(raw: Tensor<2>) -> Tensor<2> {
    let [n, _] = raw.dims();
    let device = raw.device();
    let constant = |v: [f32; 3]| Tensor::<2>::from_floats([v], &device).expand([n, 3]);
    let approach = raw.clone().slice([0..n, 0..3]);
    let forward = raw.slice([0..n, 3..6]);

    let none = is_short(&approach);
    let z = unit(approach.mask_where(none, constant([0.0, 0.0, 1.0])));
    let none = is_short(&forward);
    // A forward without direction becomes the approach, and is replaced as every parallel one below.
    let forward = unit(forward.mask_where(none, z.clone()));
    let across = without(forward, &z);
    let parallel = is_short(&across);
    let x = unit(across.mask_where(parallel, any_orthogonal(&z, &device)));
    let x = unit(without(x, &z));
    Tensor::cat(vec![z, x], 1)
}

/// The rotation `[x y z]` of orthonormal axes.
///
/// # Shapes
/// `[n, 6]` -> `[n, 3, 3]`, columns forward, left, approach
#[must_use]
pub fn rotation_matrix(axes: Tensor<2>) -> Tensor<3> {
    let [n, _] = axes.dims();
    let z = axes.clone().slice([0..n, 0..3]);
    let x = axes.slice([0..n, 3..6]);
    let y = cross(&z, &x);
    Tensor::stack(vec![x, y, z], 2)
}

/// `[n, 3]` -> `[n, 3]`: scaled to length one. First by the largest number, so that squares neither vanish nor overflow.
fn unit(v: Tensor<2>) -> Tensor<2> {
    let largest = v.clone().abs().max_dim(1).detach();
    let v = v / largest;
    let length = v.clone().powi_scalar(2).sum_dim(1).sqrt();
    v / length
}

/// `[n, 3]` -> `[n, 3]`: whether it has no direction.
fn is_short(v: &Tensor<2>) -> Tensor<2, Bool> {
    let [n, _] = v.dims();
    v.clone().detach().abs().max_dim(1).lower_equal_elem(SHORTEST).expand([n, 3])
}

/// `v` without its part along the unit vector `z`.
fn without(v: Tensor<2>, z: &Tensor<2>) -> Tensor<2> {
    let along = (v.clone() * z.clone()).sum_dim(1);
    v - z.clone() * along
}

fn any_orthogonal(z: &Tensor<2>, device: &Device) -> Tensor<2> {
    let [n, _] = z.dims();
    let z = z.clone().detach();
    let along_x = z.clone().slice([0..n, 0..1]).abs().lower_elem(0.9).expand([n, 3]);
    let constant = |v: [f32; 3]| Tensor::<2>::from_floats([v], device).expand([n, 3]);
    let helper = constant([0.0, 1.0, 0.0]).mask_where(along_x, constant([1.0, 0.0, 0.0]));
    unit(without(helper, &z))
}

pub(super) fn cross(a: &Tensor<2>, b: &Tensor<2>) -> Tensor<2> {
    let [n, _] = a.dims();
    let at = |v: &Tensor<2>, i: usize| v.clone().slice([0..n, i..i + 1]);
    let minor = |i, j| at(a, i) * at(b, j) - at(a, j) * at(b, i);
    Tensor::cat(vec![minor(1, 2), minor(2, 0), minor(0, 1)], 1)
}
