//! Muon for convolutions too.

use burn::optim::{Muon, MuonState, Optimizer};
use burn::tensor::{Device, Tensor};

/// Added to a gradient, as a share of its mean size: nothing that a number of that size would notice. Without it the momentum of
/// channels that have died fades into denormal numbers, on which Muon's matrix products take ten times as long.
const FLOOR: f32 = 1e-10;

/// Muon, to which a kernel `[out, in, height, width]` is the matrix `[out, in * height * width]`.
#[derive(Clone)]
pub(crate) struct KernelMuon(pub(crate) Muon);

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
        let matrix = |tensor: Tensor<D>| tensor.reshape([rows, -1]);
        let gradient = matrix(gradient);
        let floor = gradient.clone().abs().mean().mul_scalar(FLOOR).unsqueeze();
        let (weight, state) = self.0.step::<2>(rate, matrix(weight), gradient + floor, state);
        (weight.reshape(shape), state)
    }

    fn to_device<const D: usize>(state: MuonState<2>, device: &Device) -> MuonState<2> {
        Muon::to_device::<2>(state, device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::optim::MuonConfig;
    use burn::tensor::TensorData;

    #[test]
    fn a_kernel_moves_as_its_matrix_does() {
        let numbers =
            |seed: usize| (0..48).map(|i| ((i * 37 + seed) % 19) as f32 / 19.0 - 0.5).collect::<Vec<_>>();
        let kernel =
            |seed| Tensor::<4>::from_data(TensorData::new(numbers(seed), [4, 3, 2, 2]), &Device::flex());
        let matrix = |seed| Tensor::<2>::from_data(TensorData::new(numbers(seed), [4, 12]), &Device::flex());
        let muon = MuonConfig::new().build();
        let (mut kernels, mut matrices) = ((kernel(1), None), (matrix(1), None));
        for step in 2..4 {
            kernels = KernelMuon(muon.clone()).step(0.1, kernels.0, kernel(step), kernels.1);
            matrices = muon.step(0.1, matrices.0, matrix(step), matrices.1);
        }
        assert_eq!(kernels.0.dims(), [4, 3, 2, 2]);
        let values = |data: TensorData| data.convert::<f32>().as_slice::<f32>().unwrap().to_vec();
        let (found, expected) = (values(kernels.0.into_data()), values(matrices.0.into_data()));
        assert_eq!(found, expected);
        assert_ne!(found, numbers(1));
    }

    #[test]
    fn a_channel_without_a_gradient_stays_where_it_is() {
        let tensor =
            |values: Vec<f32>| Tensor::<2>::from_data(TensorData::new(values, [4, 5]), &Device::flex());
        let gradient = |i: usize| if i < 15 { ((i * 37) % 19) as f32 / 19.0 - 0.5 } else { 0.0 };
        let (mut weight, mut state) = (tensor(vec![1.0; 20]), None);
        for _ in 0..20 {
            let gradient = tensor((0..20).map(gradient).collect());
            (weight, state) = KernelMuon(MuonConfig::new().build()).step(0.1, weight, gradient, state);
        }
        let moved: Vec<f32> =
            weight.into_data().convert::<f32>().iter::<f32>().map(|x| (x - 1.0).abs()).collect();
        assert!(moved[..15].iter().any(|x| *x > 0.1) && moved[15..].iter().all(|x| *x < 1e-5), "{moved:?}");
    }
}
