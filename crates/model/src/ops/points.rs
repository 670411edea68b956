//! What PointNet++ does besides matrix products.

use std::sync::Arc;

use burn::backend::flex::FlexTensor;
use burn::nn::BatchNorm;
use burn::tensor::Tensor;
use where2act_kernels::Isa;
use where2act_kernels::norm_train::{pool, rows};
use where2act_kernels::points::{Selection, gather_around, offset_gradient};

use super::function::{Function, apply, flex, sizes, tensor, values, variable};
use super::norm::{Kept, affine, known, track};

/// The first layer of a neighbourhood's MLP before batch-norm: `offsets * weight + features[rows]`.
///
/// # Shapes
/// - `features`: `[m, c]`, the points' features times their part of the weight
/// - `weight`: `[3, c]`, the offsets' part
/// - `rows`: n numbers below m; `offsets`: 3 n numbers
/// - output: `[n, c]`
pub(crate) fn group(
    features: &Tensor<2>,
    weight: &Tensor<2>,
    rows: &[i64],
    offsets: &[f32],
) -> Option<Tensor<2>> {
    let inputs = [variable(features)?, variable(weight)?];
    let [m, _] = features.dims();
    let selection = Arc::new(select(rows, None, 1, m)?);
    let (y, _) = apply(Group { selection, offsets: offsets.into() }, inputs)?;
    Some(tensor(y))
}

/// `base` plus, for every row, the weighted sum of three rows of `coarse`.
///
/// # Shapes
/// - `coarse`: `[m, c]`, `base`: `[n, c]`
/// - `rows`: 3 n numbers below m, `weights`: 3 n numbers
/// - output: `[n, c]`
pub(crate) fn interpolate_onto(
    base: &Tensor<2>,
    coarse: &Tensor<2>,
    rows: &[i64],
    weights: &[f32],
) -> Option<Tensor<2>> {
    let inputs = [variable(base)?, variable(coarse)?];
    let [m, _] = coarse.dims();
    let selection = Arc::new(select(rows, Some(weights.to_vec()), 3, m)?);
    let (y, _) = apply(Interpolate { selection }, inputs)?;
    Some(tensor(y))
}

/// Batch-norm with the batch's statistics, ReLU, and the greatest of every `neighbours` rows; updates the running
/// statistics.
///
/// # Shapes
/// `[n * neighbours, c]` -> `[n, c]`
pub(crate) fn norm_relu_pool(norm: &BatchNorm, x: &Tensor<2>, neighbours: usize) -> Option<Tensor<2>> {
    let inputs = [variable(x)?, variable(&norm.gamma.val())?, variable(&norm.beta.val())?];
    let function = Pool { neighbours, epsilon: norm.epsilon as f32, kept: None };
    let (y, function) = apply(function, inputs)?;
    track(norm, function.kept?.0.moments);
    Some(tensor(y))
}

/// Why a gradient cannot fail.
const CHECKED: &str = "the forward pass has checked the sizes";

fn select(rows: &[i64], weights: Option<Vec<f32>>, per_row: usize, inputs: usize) -> Option<Selection> {
    let rows = rows.iter().map(|&row| u32::try_from(row)).collect::<Result<_, _>>().ok()?;
    Selection::new(rows, weights, per_row, inputs).ok()
}

#[derive(Clone, Debug)]
struct Group {
    selection: Arc<Selection>,
    offsets: Arc<[f32]>,
}

impl Function<2> for Group {
    fn forward(&mut self, [features, weight]: [&FlexTensor; 2]) -> Option<FlexTensor> {
        let [_, channels] = sizes(features)?;
        let y = gather_around(Isa::best(), &self.selection, &self.offsets, values(weight), values(features))
            .ok()?;
        Some(flex(y, [self.selection.rows(), channels]))
    }

    fn backward(&self, gradient: &FlexTensor, wanted: [bool; 2]) -> [Option<FlexTensor>; 2] {
        let [_, channels] = sizes(gradient).expect(CHECKED);
        let dy = values(gradient);
        let of_features = wanted[0].then(|| {
            let sums = self.selection.scatter(Isa::best(), channels, dy).expect(CHECKED);
            flex(sums, [self.selection.inputs(), channels])
        });
        let of_weight = wanted[1].then(|| {
            flex(offset_gradient(Isa::best(), channels, &self.offsets, dy).expect(CHECKED), [3, channels])
        });
        [of_features, of_weight]
    }
}

#[derive(Clone, Debug)]
struct Interpolate {
    selection: Arc<Selection>,
}

impl Function<2> for Interpolate {
    fn forward(&mut self, [base, coarse]: [&FlexTensor; 2]) -> Option<FlexTensor> {
        let [n, channels] = sizes(base)?;
        let y = self.selection.gather(Isa::best(), channels, values(coarse), Some(values(base))).ok()?;
        Some(flex(y, [n, channels]))
    }

    fn backward(&self, gradient: &FlexTensor, wanted: [bool; 2]) -> [Option<FlexTensor>; 2] {
        let [_, channels] = sizes(gradient).expect(CHECKED);
        let of_coarse = wanted[1].then(|| {
            let sums = self.selection.scatter(Isa::best(), channels, values(gradient)).expect(CHECKED);
            flex(sums, [self.selection.inputs(), channels])
        });
        [wanted[0].then(|| gradient.clone()), of_coarse]
    }
}

#[derive(Clone, Debug)]
struct Pool {
    neighbours: usize,
    epsilon: f32,
    /// Besides the usual, which neighbour was the greatest.
    kept: Option<(Kept, Arc<[u8]>)>,
}

impl Function<3> for Pool {
    fn forward(&mut self, [x, gamma, beta]: [&FlexTensor; 3]) -> Option<FlexTensor> {
        let [n, channels] = sizes(x)?;
        let moments = known(rows::moments(Isa::best(), channels, values(x)).ok()?)?;
        let affine = affine(gamma, beta, self.epsilon);
        let (y, which) = pool::forward(Isa::best(), self.neighbours, values(x), &affine, &moments).ok()?;
        let kept = Kept { x: x.clone(), gamma: gamma.clone(), beta: beta.clone(), output: None, moments };
        self.kept = Some((kept, which.into()));
        Some(flex(y, [n / self.neighbours, channels]))
    }

    fn backward(&self, gradient: &FlexTensor, _: [bool; 3]) -> [Option<FlexTensor>; 3] {
        let (kept, which) = self.kept.as_ref().expect("forward comes first");
        let shape @ [_, channels] = sizes(&kept.x).expect(CHECKED);
        let affine = affine(&kept.gamma, &kept.beta, self.epsilon);
        let (dy, x) = (values(gradient), values(&kept.x));
        let of = pool::backward(Isa::best(), self.neighbours, dy, which, x, &affine, &kept.moments)
            .expect(CHECKED);
        [Some(flex(of.input, shape)), Some(flex(of.gamma, [channels])), Some(flex(of.beta, [channels]))]
    }
}
