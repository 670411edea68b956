//! Batch-norm for training, fused with the residual and the ReLU that follow it, and its gradients.
//!
//! Two layouts: `planes` for pictures (`[batch, channels, pixels]`) and `rows` for points (`[rows, channels]`). Moments
//! are taken in runs that stay in the first-level cache, in two passes each, and combined in f64 in a fixed order: as
//! exact as two passes over everything, at the price of one, and the same bits for any number of threads.

pub mod planes;
pub mod pool;
pub mod rows;

/// What a batch says about each channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Moments {
    /// Mean.
    pub mean: Vec<f32>,
    /// Mean squared distance from the mean (the biased estimate).
    pub variance: Vec<f32>,
}

/// Parameters of a batch-norm, one number per channel.
#[derive(Clone, Copy, Debug)]
pub struct Affine<'a> {
    /// Scale.
    pub gamma: &'a [f32],
    /// Shift.
    pub beta: &'a [f32],
    /// Added to the variance.
    pub epsilon: f32,
}

/// What the backward pass gives.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// Of the input.
    pub input: Vec<f32>,
    /// Of the scale.
    pub gamma: Vec<f32>,
    /// Of the shift.
    pub beta: Vec<f32>,
}

impl Affine<'_> {
    /// Normalisation of channel `c` as `x * scale + shift`.
    fn line(&self, moments: &Moments, c: usize) -> (f32, f32) {
        let scale = self.gamma[c] / (moments.variance[c] + self.epsilon).sqrt();
        (scale, self.beta[c] - moments.mean[c] * scale)
    }
}

/// Count, mean and summed squared distance from the mean of some values.
#[derive(Clone, Copy, Default)]
struct Tally {
    count: f64,
    mean: f64,
    squares: f64,
}

impl Tally {
    /// Of both (Chan, Golub and LeVeque, 1979).
    fn join(self, other: Self) -> Self {
        let count = self.count + other.count;
        if count == 0.0 {
            return self;
        }
        let apart = other.mean - self.mean;
        Self {
            count,
            mean: self.mean + apart * other.count / count,
            squares: self.squares + other.squares + apart * apart * self.count * other.count / count,
        }
    }
}

impl FromIterator<Tally> for Moments {
    fn from_iter<I: IntoIterator<Item = Tally>>(channels: I) -> Self {
        let channel = |t: Tally| (t.mean as f32, (t.squares / t.count.max(1.0)) as f32);
        let (mean, variance) = channels.into_iter().map(channel).unzip();
        Self { mean, variance }
    }
}

/// Allocates `len` values that `fill` writes; not zeroed, which would be one more pass over memory.
pub(crate) fn written(len: usize, fill: impl FnOnce(&mut [std::mem::MaybeUninit<f32>])) -> Vec<f32> {
    let mut values = Vec::with_capacity(len);
    fill(&mut values.spare_capacity_mut()[..len]);
    // SAFETY: `len` values were reserved; every caller writes each of them (its loops cover the slice).
    unsafe { values.set_len(len) };
    values
}
