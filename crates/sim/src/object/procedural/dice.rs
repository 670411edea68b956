//! The choices a generator makes.

use nalgebra::Vector2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A generator's source of choices.
pub(super) struct Dice(pub(super) ChaCha8Rng);

impl Dice {
    /// Uniform in `[low, high]`.
    pub(super) fn real(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.0.random::<f32>()
    }

    /// Uniform in `low..=high`.
    pub(super) fn count(&mut self, low: usize, high: usize) -> usize {
        self.0.random_range(low..=high)
    }

    /// True with this probability.
    pub(super) fn chance(&mut self, probability: f32) -> bool {
        self.0.random::<f32>() < probability
    }

    /// 1 or -1.
    pub(super) fn sign(&mut self) -> f32 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }

    /// One of these, all alike.
    pub(super) fn pick<T: Copy>(&mut self, options: &[T]) -> T {
        options[self.0.random_range(0..options.len())]
    }

    /// One of these, with weights.
    pub(super) fn weighted<T: Copy>(&mut self, options: &[(f32, T)]) -> T {
        let mut left = self.real(0.0, options.iter().map(|o| o.0).sum());
        for &(weight, option) in options {
            if left < weight {
                return option;
            }
            left -= weight;
        }
        options[options.len() - 1].1
    }

    /// `n` shares of `total`, none smaller than `1 / spread` of another.
    pub(super) fn shares(&mut self, total: f32, n: usize, spread: f32) -> Vec<f32> {
        let weights: Vec<f32> = (0..n).map(|_| self.real(1.0, spread)).collect();
        let sum: f32 = weights.iter().sum();
        weights.into_iter().map(|w| total * w / sum).collect()
    }

    /// A point of the texture plane, so that no two boards show the same grain.
    pub(super) fn texture_offset(&mut self) -> Vector2<f32> {
        Vector2::new(self.real(0.0, 1.0), self.real(0.0, 1.0))
    }
}
