//! Linear layers as numbers, cut and joined.

use burn::nn::Linear;
use burn::tensor::Tensor;
use where2act_kernels::{Activation, Isa, Mlp, MlpLayer};
use where2act_model::LastLayer;

use super::heads::failed;
use crate::Error;

/// A linear layer: weights `[inputs, outputs]`.
pub(super) struct Plain {
    pub(super) weights: Vec<f32>,
    pub(super) bias: Vec<f32>,
}

impl Plain {
    pub(super) fn of(linear: &Linear) -> Result<Self, Error> {
        let weight = linear.weight.val();
        let [_, outputs] = weight.dims();
        let bias = match &linear.bias {
            Some(bias) => numbers(bias.val())?,
            None => vec![0.0; outputs],
        };
        Ok(Self { weights: numbers(weight)?, bias })
    }

    pub(super) fn outputs(&self) -> usize {
        self.bias.len()
    }

    pub(super) fn inputs(&self) -> usize {
        self.weights.len() / self.outputs().max(1)
    }

    /// This layer on what `last` takes, where its first inputs are what `last` gives. Both are linear.
    pub(super) fn after(self, last: Option<&LastLayer>) -> Self {
        let Some(last) = last else { return self };
        let outputs = self.outputs();
        let (of_features, of_others) =
            self.weights.split_at((last.bias.len() * outputs).min(self.weights.len()));
        let through = |row: &[f32], mut sum: Vec<f32>| {
            for (x, weights) in row.iter().zip(of_features.chunks_exact(outputs)) {
                sum.iter_mut().zip(weights).for_each(|(sum, w)| *sum += x * w);
            }
            sum
        };
        let rows = last.weights.chunks_exact(last.bias.len().max(1));
        let mut weights: Vec<f32> = rows.flat_map(|row| through(row, vec![0.0; outputs])).collect();
        weights.extend(of_others);
        let bias = through(&last.bias, self.bias.clone());
        Self { weights, bias }
    }

    /// More outputs, all zero.
    pub(super) fn widened(mut self, outputs: usize) -> Self {
        let padding = vec![0.0; outputs - self.outputs()];
        let rows = self.weights.chunks_exact(self.outputs());
        self.weights = rows.flat_map(|row| row.iter().chain(&padding)).copied().collect();
        self.bias.resize(outputs, 0.0);
        self
    }

    /// The outputs in another order: the first is what was the output `order(0)`.
    pub(super) fn ordered(self, order: impl Fn(usize) -> usize) -> Self {
        let outputs = self.outputs();
        let arrange = |row: &[f32]| -> Vec<f32> {
            (0..outputs).filter_map(|output| row.get(order(output)).copied()).collect()
        };
        let weights = self.weights.chunks_exact(outputs).flat_map(arrange).collect();
        Self { weights, bias: arrange(&self.bias) }
    }

    /// The layer on its first `inputs`, and the weights of the others.
    pub(super) fn split(mut self, inputs: usize) -> (Self, Vec<f32>) {
        let others = self.weights.split_off((inputs * self.outputs()).min(self.weights.len()));
        (self, others)
    }

    /// The layer alone, compiled.
    pub(super) fn mlp(&self, isa: Isa) -> Result<Mlp, Error> {
        Mlp::new(isa, self.inputs(), &[self.layer()]).map_err(failed)
    }

    pub(super) fn layer(&self) -> MlpLayer<'_> {
        MlpLayer { weights: &self.weights, bias: &self.bias, activation: Activation::Identity }
    }
}

pub(super) fn numbers<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, Error> {
    tensor.into_data().convert::<f32>().try_into_vec().map_err(|e| Error::Network(format!("{e:?}")))
}
