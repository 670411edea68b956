//! Every fast operation against burn's own, values and gradients.

use std::cell::Cell;

use burn::nn::{BatchNorm, BatchNormConfig};
use burn::tensor::activation::relu;
use burn::tensor::module::{conv2d, interpolate};
use burn::tensor::ops::{ConvOptions, InterpolateMode, InterpolateOptions};
use burn::tensor::{Device, Tensor, TensorData};
use rand::RngExt;
use where2act_core::Seed;

use super::*;

/// Relative to the largest value: what sums of a few thousand f32 products in another order may differ by.
const TOLERANCE: f32 = 1e-4;

fn device() -> Device {
    Device::flex().autodiff()
}

/// Nearly normal numbers, other ones at every call and the same ones in every run: a sum that rounding puts on another
/// side of a ReLU than burn's would fail by chance.
fn random<const D: usize>(shape: [usize; D]) -> Tensor<D> {
    thread_local! {
        static CALLS: Cell<u64> = const { Cell::new(0) };
    }
    let mut rng = Seed(1).child("random", CALLS.replace(CALLS.get() + 1)).rng();
    let mut normal = || (0..12).map(|_| rng.random::<f32>()).sum::<f32>() - 6.0;
    let values: Vec<f32> = (0..shape.iter().product()).map(|_| normal()).collect();
    Tensor::from_data(TensorData::new(values, shape), &Device::flex())
}

/// The values as a new leaf of the graph.
fn leaf<const D: usize>(values: &Tensor<D>) -> Tensor<D> {
    Tensor::<D>::from_data(values.clone().into_data(), &device()).require_grad()
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().try_to_vec().unwrap()
}

#[track_caller]
fn assert_close<const D: usize>(what: &str, found: Tensor<D>, expected: Tensor<D>) {
    assert_eq!(found.dims(), expected.dims(), "{what}");
    let (found, expected) = (numbers(found), numbers(expected));
    let scale = expected.iter().fold(1e-3f32, |m, v| m.max(v.abs()));
    for (a, b) in found.iter().zip(&expected) {
        assert!((a - b).abs() <= TOLERANCE * scale, "{what}: {a}, expected {b}, scale {scale}");
    }
}

/// A loss whose gradient differs from value to value.
fn loss<const D: usize>(y: Tensor<D>) -> Tensor<1> {
    let n = y.shape().num_elements();
    let weights = Tensor::<1>::from_data(
        TensorData::new((0..n).map(|i| (i as f32 * 0.7).sin()).collect::<Vec<_>>(), [n]),
        &y.device(),
    );
    (y.clone().powi_scalar(2).reshape([n]) * weights.clone() + y.reshape([n]) * weights).sum()
}

#[test]
fn convolutions_equal_burns() {
    for [b, c, h, w, o, k, s, p] in [
        [2, 5, 8, 8, 7, 3, 1, 1],
        [1, 16, 33, 21, 24, 3, 1, 1],
        [3, 9, 12, 16, 8, 3, 2, 1],
        [2, 3, 32, 32, 16, 7, 2, 3],
        [3, 8, 15, 15, 12, 1, 2, 0],
        [2, 7, 9, 11, 9, 3, 2, 0],
        [9, 16, 7, 7, 16, 3, 1, 1],
    ] {
        let (x, weight) = (random([b, c, h, w]), random([o, c, k, k]));
        let run = |fast: bool| {
            let (x, weight) = (leaf(&x), leaf(&weight));
            let y = if fast {
                conv(&x, &weight, s, p).unwrap()
            } else {
                conv2d(x.clone(), weight.clone(), None, ConvOptions::new([s, s], [p, p], [1, 1], 1))
            };
            let gradients = loss(y.clone()).backward();
            (y.inner(), x.grad(&gradients).unwrap(), weight.grad(&gradients).unwrap())
        };
        let (fast, burn) = (run(true), run(false));
        assert_close("output", fast.0, burn.0);
        assert_close("gradient of the input", fast.1, burn.1);
        assert_close("gradient of the weight", fast.2, burn.2);
    }
}

#[test]
fn upsampled_convolutions_equal_burns() {
    for [b, c, beside, h, w, o] in [[2, 5, 3, 8, 12, 7], [1, 16, 3, 34, 30, 9], [3, 4, 8, 6, 2, 16]] {
        let (x, skip, weight) =
            (random([b, c, h / 2, w / 2]), random([b, beside, h, w]), random([o, c + beside, 3, 3]));
        let run = |fast: bool| {
            let (x, skip, weight) = (leaf(&x), leaf(&skip), leaf(&weight));
            let y = if fast {
                conv_upsampled(&x, &skip, &weight, 1).unwrap()
            } else {
                let options = InterpolateOptions::new(InterpolateMode::Nearest).with_output_size([h, w]);
                let all = Tensor::cat(vec![interpolate(x.clone(), options), skip.clone()], 1);
                conv2d(all, weight.clone(), None, ConvOptions::new([1, 1], [1, 1], [1, 1], 1))
            };
            let gradients = loss(y.clone()).backward();
            let of = |t: &Tensor<4>| t.grad(&gradients).unwrap();
            (y.inner(), of(&x), of(&skip), of(&weight))
        };
        let (fast, burn) = (run(true), run(false));
        assert_close("output", fast.0, burn.0);
        assert_close("gradient of the input", fast.1, burn.1);
        assert_close("gradient of the skip", fast.2, burn.2);
        assert_close("gradient of the weight", fast.3, burn.3);
    }
}

/// A batch-norm of its own (clones share their running statistics) with the given parameters.
fn norm([gamma, beta]: &[Tensor<1>; 2]) -> BatchNorm {
    let mut norm = BatchNormConfig::new(gamma.dims()[0]).init(&device());
    norm.gamma = burn::module::Param::from_tensor(leaf(gamma));
    norm.beta = burn::module::Param::from_tensor(leaf(beta));
    norm
}

#[test]
fn batch_norms_of_pictures_equal_burns() {
    for (relu_after, residual) in [(false, false), (true, false), (true, true)] {
        let shape = [3, 5, 9, 7];
        let (x, r) = (random(shape).mul_scalar(2.0).add_scalar(3.0), random(shape));
        let parameters = [random([5]), random([5])];
        let run = |fast: bool| {
            let (x, r, norm) = (leaf(&x), leaf(&r), norm(&parameters));
            let y = if fast {
                norm_planes(&norm, &x, residual.then_some(&r), relu_after).unwrap()
            } else {
                let y = norm.forward(x.clone());
                let y = if residual { y + r.clone() } else { y };
                if relu_after { relu(y) } else { y }
            };
            let gradients = loss(y.clone()).backward();
            let parameters = [norm.gamma.val().grad(&gradients), norm.beta.val().grad(&gradients)];
            let statistics = [norm.running_mean.value_sync(), norm.running_var.value_sync()];
            (y.inner(), [x.grad(&gradients), r.grad(&gradients)], parameters, statistics)
        };
        let (fast, burn) = (run(true), run(false));
        assert_close("output", fast.0, burn.0);
        for (a, b) in fast.1.into_iter().zip(burn.1) {
            assert_eq!(a.is_some(), b.is_some());
            if let (Some(a), Some(b)) = (a, b) {
                assert_close("gradients of the inputs", a, b);
            }
        }
        for (a, b) in fast.2.into_iter().zip(burn.2) {
            assert_close("gradients of the parameters", a.unwrap(), b.unwrap());
        }
        for (a, b) in fast.3.into_iter().zip(burn.3) {
            assert_close("running statistics", a, b);
        }
    }
}

/// Zeros instead would hide from the loss that something went wrong.
#[test]
fn what_is_no_number_is_left_to_burn() {
    let parameters = [random([2]), random([2])];
    let with_nan = |shape: [usize; 2]| {
        let mut values = numbers(random(shape));
        values[3] = f32::NAN;
        leaf(&Tensor::<2>::from_data(TensorData::new(values, shape), &Device::flex()))
    };
    let points = with_nan([6, 2]);
    assert!(norm_rows_relu(&norm(&parameters), &points).is_none());
    assert!(norm_planes(&norm(&parameters), &points.reshape([1, 2, 3, 2]), None, true).is_none());
}

#[test]
fn batch_norms_of_points_equal_burns() {
    for [rows, channels] in [[1000, 32], [37, 5], [20_000, 3]] {
        let x = random([rows, channels]).mul_scalar(2.0).add_scalar(3.0);
        let parameters = [random([channels]), random([channels])];
        let run = |fast: bool| {
            let (x, norm) = (leaf(&x), norm(&parameters));
            let y =
                if fast { norm_rows_relu(&norm, &x).unwrap() } else { relu(norm.forward::<2>(x.clone())) };
            let gradients = loss(y.clone()).backward();
            let of = |t: Tensor<1>| t.grad(&gradients).unwrap();
            let statistics = [norm.running_mean.value_sync(), norm.running_var.value_sync()];
            (y.inner(), x.grad(&gradients).unwrap(), [of(norm.gamma.val()), of(norm.beta.val())], statistics)
        };
        let (fast, burn) = (run(true), run(false));
        assert_close("output", fast.0, burn.0);
        assert_close("gradient of the input", fast.1, burn.1);
        for (a, b) in fast.2.into_iter().chain(fast.3).zip(burn.2.into_iter().chain(burn.3)) {
            assert_close("parameters and statistics", a, b);
        }
    }
}

#[test]
fn constants_and_the_burn_engine_are_declined() {
    let (x, weight) = (random([1, 2, 4, 4]), random([3, 2, 3, 3]));
    assert!(conv(&x, &weight, 1, 1).is_none(), "no autodiff");
    let (x, weight) = (leaf(&x), leaf(&weight));
    assert!(conv(&x, &weight, 1, 1).is_some());
    assert!(TrainingEngine::Burn.scope(|| conv(&x, &weight, 1, 1)).is_none());
}

/// Gradients too: what is computed in the backward pass, outside of the scope, follows the forward pass.
#[test]
fn bf16_comes_near_f32() {
    if where2act_kernels::Isa::bf16().is_none() {
        return;
    }
    let [x, skip] = [random([2, 6, 8, 8]), random([2, 5, 16, 16])];
    let [first, second] = [random([9, 6, 3, 3]), random([4, 14, 3, 3])];
    let run = |engine: TrainingEngine| {
        let [x, skip, first, second] = [&x, &skip, &first, &second].map(leaf);
        let y = engine.scope(|| conv_upsampled(&conv(&x, &first, 1, 1).unwrap(), &skip, &second, 1).unwrap());
        let gradients = loss(y.clone()).backward();
        let gradients = [x, skip, first, second].map(|leaf| numbers(leaf.grad(&gradients).unwrap()));
        [vec![numbers(y.inner())], gradients.to_vec()].concat()
    };
    for (exact, found) in run(TrainingEngine::Fast).into_iter().zip(run(TrainingEngine::Bf16)) {
        let largest = exact.iter().fold(0.0f32, |m, x| m.max(x.abs()));
        let error = exact.iter().zip(&found).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!((1e-5..2e-2).contains(&(error / largest)), "{error} of {largest}");
    }
}

#[test]
#[cfg(feature = "ndarray")]
#[expect(deprecated, reason = "selectable until burn drops it")]
fn other_backends_are_declined() {
    let other = Device::ndarray().autodiff();
    let of = |t: Tensor<4>| Tensor::<4>::from_data(t.into_data(), &other);
    assert!(conv(&of(random([1, 2, 4, 4])), &of(random([3, 2, 3, 3])), 1, 1).is_none());
}

#[test]
fn grouping_equals_burns() {
    let (m, n, c) = (40, 300, 12);
    let (features, weight, offsets) = (random([m, c]), random([3, c]), random([n, 3]));
    let near: Vec<i64> = (0..n as i64).map(|i| i * i % (m as i64 - 1)).collect();
    let run = |fast: bool| {
        let (features, weight) = (leaf(&features), leaf(&weight));
        let y = if fast {
            group(&features, &weight, &near, &numbers(offsets.clone())).unwrap()
        } else {
            let chosen = crate::pointnet::rows(near.clone(), &device());
            leaf(&offsets).matmul(weight.clone()) + features.clone().select(0, chosen)
        };
        let gradients = loss(y.clone()).backward();
        (y.inner(), features.grad(&gradients).unwrap(), weight.grad(&gradients).unwrap())
    };
    let (fast, burn) = (run(true), run(false));
    assert_close("output", fast.0, burn.0);
    assert_close("gradient of the features", fast.1, burn.1);
    assert_close("gradient of the weight", fast.2, burn.2);
}

#[test]
fn interpolation_equals_burns() {
    let (m, n, c) = (20, 130, 7);
    let (base, coarse) = (random([n, c]), random([m, c]));
    let near: Vec<i64> = (0..3 * n as i64).map(|i| i * i % (m as i64 - 1)).collect();
    let weights: Vec<f32> = (0..3 * n).map(|i| (i as f32 * 0.3).sin()).collect();
    let run = |fast: bool| {
        let (base, coarse) = (leaf(&base), leaf(&coarse));
        let y = if fast {
            interpolate_onto(&base, &coarse, &near, &weights).unwrap()
        } else {
            let data = burn::tensor::TensorData::new(weights.clone(), [n, 3, 1]);
            let three = coarse.clone().select(0, crate::pointnet::rows(near.clone(), &device()));
            let sum = (three.reshape([n, 3, c]) * Tensor::<3>::from_data(data, &device())).sum_dim(1);
            base.clone() + sum.reshape([n, c])
        };
        let gradients = loss(y.clone()).backward();
        (y.inner(), base.grad(&gradients).unwrap(), coarse.grad(&gradients).unwrap())
    };
    let (fast, burn) = (run(true), run(false));
    assert_close("output", fast.0, burn.0);
    assert_close("gradient of the base", fast.1, burn.1);
    assert_close("gradient of the coarse points", fast.2, burn.2);
}

#[test]
fn pooled_batch_norms_equal_burns() {
    for [groups, neighbours, channels] in [[50, 32, 24], [3, 5, 7], [200, 1, 16]] {
        let x = random([groups * neighbours, channels]).mul_scalar(2.0).add_scalar(1.0);
        let parameters = [random([channels]), random([channels])];
        let run = |fast: bool| {
            let (x, norm) = (leaf(&x), norm(&parameters));
            let y = if fast {
                norm_relu_pool(&norm, &x, neighbours).unwrap()
            } else {
                let all = relu(norm.forward::<2>(x.clone())).reshape([groups, neighbours, channels]);
                all.max_dim(1).reshape([groups, channels])
            };
            let gradients = loss(y.clone()).backward();
            let of = |t: Tensor<1>| t.grad(&gradients).unwrap();
            let statistics = [norm.running_mean.value_sync(), norm.running_var.value_sync()];
            (y.inner(), x.grad(&gradients).unwrap(), [of(norm.gamma.val()), of(norm.beta.val())], statistics)
        };
        let (fast, burn) = (run(true), run(false));
        assert_close("output", fast.0, burn.0);
        assert_close("gradient of the input", fast.1, burn.1);
        for (a, b) in fast.2.into_iter().chain(fast.3).zip(burn.2.into_iter().chain(burn.3)) {
            assert_close("parameters and statistics", a, b);
        }
    }
}
