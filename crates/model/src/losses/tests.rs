//! Values against closed forms, gradients against finite differences (computed in f64 by the closed forms themselves).

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::{Matrix3, Rotation3, Vector3};
use where2act_core::{Orientation6, orthonormal_frame};

use super::*;
use crate::heads::to_axes;
use crate::testing::{devices, values};

fn row(v: &[f32], device: &Device) -> Tensor<1> {
    Tensor::from_data(TensorData::new(v.to_vec(), [v.len()]), device)
}

fn sixes(v: &[[f32; 6]], device: &Device) -> Tensor<2> {
    Tensor::from_data(TensorData::new(v.concat(), [v.len(), 6]), device)
}

/// Compares the gradient of the sum of a loss with central differences of `exact` at every number.
fn check_gradient(
    at: &[f32],
    loss: impl Fn(Tensor<1>) -> Tensor<1>,
    exact: impl Fn(&[f64]) -> f64,
    tolerance: f64,
) {
    for device in devices() {
        let x = row(at, &device.clone().autodiff()).require_grad();
        let y = loss(x.clone()).sum();
        let at: Vec<f64> = at.iter().map(|v| f64::from(*v)).collect();
        let value = f64::from(values(y.clone())[0]);
        assert!((value - exact(&at)).abs() < tolerance * (1.0 + value.abs()), "{value} {}", exact(&at));
        let gradient = values(x.grad(&y.backward()).unwrap());
        for i in 0..at.len() {
            let step = 1e-6;
            let moved = |by: f64| {
                let mut moved = at.clone();
                moved[i] += by;
                exact(&moved)
            };
            let expected = (moved(step) - moved(-step)) / (2.0 * step);
            let found = f64::from(gradient[i]);
            assert!(
                (found - expected).abs() < tolerance * (1.0 + expected.abs()),
                "{i}: {found}, {expected}"
            );
        }
    }
}

#[test]
fn cross_entropy_also_of_huge_logits() {
    let targets = [1.0f32, 0.0, 1.0, 0.3];
    let exact = |x: &[f64]| -> f64 {
        let of = |(x, t): (&f64, &f32)| x.max(0.0) - x * f64::from(*t) + (-x.abs()).exp().ln_1p();
        x.iter().zip(&targets).map(of).sum()
    };
    let loss = |x: Tensor<1>| {
        let targets = row(&targets, &x.device());
        binary_cross_entropy(x, targets)
    };
    check_gradient(&[0.3, -2.0, -7.0, 1.5], loss, exact, 1e-5);
    let extreme = row(&[1e4, -1e4, -1e4, 1e4], &Device::flex().autodiff()).require_grad();
    let y = loss(extreme.clone());
    assert_eq!(values(y.clone())[..3], [0.0, 0.0, 1e4]);
    assert!(values(extreme.grad(&y.sum().backward()).unwrap()).iter().all(|g| g.is_finite()));
}

#[test]
fn actionability_and_divergence() {
    let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
    let targets = [0.9f32, 0.0, 0.4];
    let exact = |x: &[f64]| x.iter().zip(&targets).map(|(x, t)| (sigmoid(*x) - f64::from(*t)).powi(2)).sum();
    let loss = |x: Tensor<1>| {
        let targets = row(&targets, &x.device());
        squared_error(x, targets)
    };
    check_gradient(&[0.3, -2.0, 4.0], loss, exact, 1e-5);

    // Four means, then four logarithms of variances: two queries with codes of two numbers.
    let exact = |x: &[f64]| (0..4).map(|i| 0.5 * (x[i].powi(2) + x[4 + i].exp() - 1.0 - x[4 + i])).sum();
    let loss = |x: Tensor<1>| {
        let half = |range: std::ops::Range<usize>| x.clone().slice([range]).reshape([2, 2]);
        kl_divergence(&Code { mean: half(0..4), log_variance: half(4..8) })
    };
    check_gradient(&[0.3, -2.0, 0.0, 1.0, 0.0, 0.5, -3.0, 1.0], loss, exact, 1e-5);
}

#[test]
fn weights_that_are_all_zero_give_no_loss_and_no_gradient() {
    let device = Device::flex().autodiff();
    let x = row(&[1.0, 2.0], &device).require_grad();
    let y = weighted_mean(x.clone(), row(&[0.0, 0.0], &device));
    assert_eq!(values(y.clone()), [0.0]);
    assert_eq!(values(x.grad(&y.backward()).unwrap()), [0.0, 0.0]);
    let mean = weighted_mean(row(&[1.0, 2.0], &device), row(&[1.0, 3.0], &device));
    assert_eq!(values(mean), [1.75]);
}

/// Gram-Schmidt and the angle in f64.
fn exact_angle(raw: &[f64], target: &Matrix3<f64>) -> f64 {
    let z = Vector3::new(raw[0], raw[1], raw[2]).normalize();
    let f = Vector3::new(raw[3], raw[4], raw[5]);
    let x = (f - z * z.dot(&f)).normalize();
    let m = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let cosine = ((m.transpose() * target).trace() - 1.0) / 2.0;
    let e = GEODESIC_EPSILON;
    2.0 * ((1.0 - cosine + e) / (1.0 + cosine + e)).sqrt().atan()
}

#[test]
fn the_angle_and_its_gradient_through_gram_schmidt() {
    let target = Rotation3::from_euler_angles(0.4, -0.9, 2.2);
    let axes = Orientation6::from_rotation(&target).0;
    let exact = target.matrix().cast::<f64>();
    for raw in
        [[0.1, 0.2, 0.3, 0.5, -0.2, 0.9], [3.0, -2.0, 0.3, 0.5, 4.0, 0.1], [-0.5, 0.5, 0.1, 0.0, 0.01, 2.0]]
    {
        let loss = |x: Tensor<1>| {
            let device = x.device();
            geodesic_distance(to_axes(x.reshape([1, 6])), sixes(&[axes], &device))
        };
        check_gradient(&raw, loss, |x| exact_angle(x, &exact), 2e-4);
    }
}

#[test]
fn angles_from_zero_to_pi_are_right_and_their_gradients_finite() {
    let start = Rotation3::from_euler_angles(1.0, 0.2, -0.4);
    let axis = nalgebra::Unit::new_normalize(Vector3::new(1.0, -2.0, 0.5));
    for angle in [0.0, 1e-3, 0.1, 1.0, 2.0, 3.0, std::f32::consts::PI] {
        let device = Device::flex().autodiff();
        let end = Rotation3::from_axis_angle(&axis, angle) * start;
        let of = |r: &Rotation3<f32>| sixes(&[Orientation6::from_rotation(r).0], &device);
        let raw = of(&start).require_grad();
        let distance = geodesic_distance(to_axes(raw.clone()), of(&end));
        let found = values(distance.clone())[0];
        assert!((found - angle).abs() < 2.1e-3, "{found} {angle}");
        let gradient = values(raw.grad(&distance.backward()).unwrap());
        assert!(gradient.iter().all(|g| g.is_finite() && g.abs() < 10.0), "{angle}: {gradient:?}");
        assert!(
            (orthonormal_frame(end.matrix().column(2).into(), end.matrix().column(0).into()).angle_to(&end))
                < 1e-2
        );
    }
}
