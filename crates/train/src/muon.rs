//! Muon, the optimiser of the backbone's weights: a step goes along the nearest matrix with orthogonal rows to the momentum.
//!
//! K. Jordan et al., *Muon: An optimizer for hidden layers in neural networks* (2024), with the rate of J. Liu et al., *Muon is
//! Scalable for LLM Training* (2025). A kernel is `in * height * width` numbers wide, many times as wide as high, and burn's Muon
//! multiplies all of it ten times in a step. Here the five iterations are those of its Gram matrix, and only that and the result
//! take the whole kernel.

use burn::optim::momentum::{Momentum, MomentumConfig};
use burn::optim::{MuonState, Optimizer};
use burn::tensor::{Device, Tensor};

/// Of the gradients' running sum, each step.
const MOMENTUM: f64 = 0.95;
/// Coefficients of the polynomial that brings singular values towards 1, from K. Jordan's article.
const QUINTIC: [f32; 3] = [3.4445, -4.775, 2.0315];
/// So often it is applied.
const ITERATIONS: usize = 5;
/// A step is `0.2 * sqrt(rows or columns, whichever are more)` times the rate: then Adam's rates do, by J. Liu et al.
const RATE: f64 = 0.2;
/// Added to a gradient, as a share of its mean size: nothing that a number of that size would notice. Without it the momentum of
/// channels that have died fades into denormal numbers, on which Muon's matrix products take ten times as long.
const FLOOR: f32 = 1e-10;

/// Muon, to which a kernel `[out, in, height, width]` is the matrix `[out, in * height * width]`.
#[derive(Clone)]
pub(crate) struct KernelMuon {
    momentum: Momentum,
    weight_decay: f64,
}

impl KernelMuon {
    /// With so much of the weights taken away in a step, times the rate.
    pub(crate) fn new(weight_decay: f32) -> Self {
        let momentum = MomentumConfig { momentum: MOMENTUM, dampening: 0.0, nesterov: true };
        Self { momentum: Momentum::new(&momentum), weight_decay: weight_decay.into() }
    }
}

impl Optimizer for KernelMuon {
    type State<const D: usize> = MuonState<2>;

    fn step<const D: usize>(
        &self,
        rate: f64,
        weight: Tensor<D>,
        gradient: Tensor<D>,
        state: Option<MuonState<2>>,
    ) -> (Tensor<D>, Option<MuonState<2>>) {
        let shape = weight.dims();
        let rows = shape.first().map_or(1, |&rows| rows as i32);
        let gradient: Tensor<2> = gradient.reshape([rows, -1]);
        let floor = sum(gradient.clone().abs()).mul_scalar(FLOOR / shape.iter().product::<usize>() as f32);
        let (direction, momentum) = self.momentum.transform(gradient + floor, state.map(|s| s.momentum));
        let [rows, columns] = direction.dims();
        let length = rate * RATE * (rows.max(columns) as f64).sqrt();
        let step = orthogonal(direction).mul_scalar(length).reshape(shape);
        (weight.mul_scalar(1.0 - rate * self.weight_decay) - step, Some(MuonState::new(momentum)))
    }

    fn to_device<const D: usize>(mut state: MuonState<2>, device: &Device) -> MuonState<2> {
        state.momentum = state.momentum.to_device(device);
        state
    }
}

/// A matrix with the same singular vectors whose singular values are near 1.
///
/// The iteration `x <- p(x xT) x`, `p(g) = a + b g + c g^2`, multiplies by symmetric matrices that commute with one another. So
/// what they come to, `q`, and the Gram matrix `g = x xT`, which becomes `p g p`, can be had without `x`.
fn orthogonal(x: Tensor<2>) -> Tensor<2> {
    let [rows, columns] = x.dims();
    if rows > columns {
        return orthogonal(x.transpose()).transpose();
    }
    let norm = sum(x.clone().square()).sqrt().clamp_min(1e-7);
    let x = x / norm;
    let [a, b, c] = QUINTIC;
    let polynomial = |g: &Tensor<2>| {
        let one = Tensor::eye(rows, &g.device());
        one.mul_scalar(a) + g.clone().mul_scalar(b) + g.clone().matmul(g.clone()).mul_scalar(c)
    };
    let mut gram = x.clone().matmul(x.clone().transpose());
    let mut q = polynomial(&gram);
    let mut p = q.clone();
    for _ in 1..ITERATIONS {
        gram = p.clone().matmul(gram).matmul(p);
        p = polynomial(&gram);
        q = p.clone().matmul(q);
    }
    q.matmul(x)
}

/// The sum of a matrix, `[1, 1]`, row by row: backends may spread the sum of very many numbers over threads as they happen to be
/// free, and then it is not the same bits twice.
fn sum(x: Tensor<2>) -> Tensor<2> {
    x.sum_dim(1).sum_dim(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::optim::decay::WeightDecayConfig;
    use burn::optim::{AdjustLrFn, MuonConfig};
    use burn::tensor::{TensorData, Tolerance};

    fn kernel(shape: [usize; 4], seed: usize) -> Tensor<4> {
        let number = |i: usize| ((i * 37 + i * i * 11 + seed * 7) % 101) as f32 / 101.0 - 0.5;
        let numbers = (0..shape.iter().product()).map(number).collect();
        Tensor::from_data(TensorData::new(numbers, shape), &Device::flex())
    }

    #[test]
    fn a_kernel_moves_as_with_burns_muon() {
        for shape in [[8, 12, 3, 3], [16, 3, 2, 2], [6, 6, 1, 1], [1, 5, 1, 1]] {
            let rows = shape[0] as i32;
            let (decay, rate) = (0.02, 0.1);
            let burns = MuonConfig::new()
                .with_weight_decay(Some(WeightDecayConfig::new(decay)))
                .with_adjust_lr_fn(AdjustLrFn::MatchRmsAdamW)
                .build();
            let ours = KernelMuon::new(decay);
            let mut found = (kernel(shape, 1), None);
            let mut expected = (found.0.clone().reshape([rows, -1]), None);
            for seed in 2..5 {
                let gradient = kernel(shape, seed);
                let matrix: Tensor<2> = gradient.clone().reshape([rows, -1]);
                found = ours.step(rate, found.0, gradient, found.1);
                expected = burns.step::<2>(rate, expected.0, matrix, expected.1);
            }
            assert_eq!(found.0.dims(), shape);
            let expected: Tensor<4> = expected.0.reshape(shape);
            found.0.into_data().assert_approx_eq::<f32>(&expected.into_data(), Tolerance::absolute(1e-5));
        }
    }

    #[test]
    fn a_channel_without_a_gradient_stays_where_it_is() {
        let tensor =
            |values: Vec<f32>| Tensor::<2>::from_data(TensorData::new(values, [4, 5]), &Device::flex());
        let gradient = |i: usize| if i < 15 { ((i * 37) % 19) as f32 / 19.0 - 0.5 } else { 0.0 };
        let (mut weight, mut state) = (tensor(vec![1.0; 20]), None);
        for _ in 0..20 {
            let gradient = tensor((0..20).map(gradient).collect());
            (weight, state) = KernelMuon::new(0.0).step(0.1, weight, gradient, state);
        }
        let moved: Vec<f32> =
            weight.into_data().convert::<f32>().iter::<f32>().map(|x| (x - 1.0).abs()).collect();
        assert!(moved[..15].iter().any(|x| *x > 0.1) && moved[15..].iter().all(|x| *x < 1e-5), "{moved:?}");
    }
}
