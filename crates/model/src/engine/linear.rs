//! Linear layers as plain numbers, cut and joined.

use burn::nn::Linear;
use where2act_kernels::{Activation, MlpLayer};

use super::fold::values;

/// A linear layer with its bias.
#[derive(Clone, Debug)]
pub struct LinearLayer {
    /// `[inputs, outputs]`.
    pub weights: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

impl LinearLayer {
    /// The numbers of a layer.
    #[must_use]
    pub fn of(linear: &Linear) -> Self {
        let [_, outputs] = linear.weight.dims();
        let bias = linear.bias.as_ref().map_or_else(|| vec![0.0; outputs], |bias| values(bias.val()));
        Self { weights: values(linear.weight.val()), bias }
    }

    /// Numbers of an input row.
    #[must_use]
    pub fn inputs(&self) -> usize {
        self.weights.len() / self.outputs().max(1)
    }

    /// Numbers of an output row.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// This layer on what `last` takes, where its first inputs are what `last` gives: two linear layers in a row are one.
    #[must_use]
    pub fn after(self, last: Option<&Self>) -> Self {
        let Some(last) = last else { return self };
        let outputs = self.outputs();
        let (of_features, of_others) =
            self.weights.split_at((last.outputs() * outputs).min(self.weights.len()));
        let through = |row: &[f32], mut sum: Vec<f32>| {
            for (x, weights) in row.iter().zip(of_features.chunks_exact(outputs.max(1))) {
                sum.iter_mut().zip(weights).for_each(|(sum, w)| *sum += x * w);
            }
            sum
        };
        let rows = last.weights.chunks_exact(last.outputs().max(1));
        let mut weights: Vec<f32> = rows.flat_map(|row| through(row, vec![0.0; outputs])).collect();
        weights.extend(of_others);
        let bias = through(&last.bias, self.bias.clone());
        Self { weights, bias }
    }

    /// More outputs, all zero. Fewer are left as they are.
    #[must_use]
    pub fn widened(mut self, outputs: usize) -> Self {
        let padding = vec![0.0; outputs.saturating_sub(self.outputs())];
        let rows = self.weights.chunks_exact(self.outputs().max(1));
        self.weights = rows.flat_map(|row| row.iter().chain(&padding)).copied().collect();
        self.bias.extend(padding);
        self
    }

    /// The outputs in another order: the first is what was the output `order(0)`.
    #[must_use]
    pub fn ordered(self, order: impl Fn(usize) -> usize) -> Self {
        let outputs = self.outputs();
        let arrange = |row: &[f32]| -> Vec<f32> {
            (0..outputs).filter_map(|output| row.get(order(output)).copied()).collect()
        };
        let weights = self.weights.chunks_exact(outputs.max(1)).flat_map(arrange).collect();
        Self { weights, bias: arrange(&self.bias) }
    }

    /// The layer on its first `inputs`, and the weights of the others.
    #[must_use]
    pub fn split(mut self, inputs: usize) -> (Self, Vec<f32>) {
        let others = self.weights.split_off((inputs * self.outputs()).min(self.weights.len()));
        (self, others)
    }

    /// The layer and what follows, for an [`Mlp`](where2act_kernels::Mlp).
    #[must_use]
    pub fn followed_by(&self, activation: Activation) -> MlpLayer<'_> {
        MlpLayer { weights: &self.weights, bias: &self.bias, activation }
    }
}
