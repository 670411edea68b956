//! Batch-norm in training, with what follows it.

use burn::backend::flex::FlexTensor;
use burn::module::RunningState;
use burn::nn::BatchNorm;
use burn::tensor::Tensor;
use where2act_kernels::Isa;
use where2act_kernels::norm_train::planes::{self, Followed};
use where2act_kernels::norm_train::{Affine, Moments, rows};

use super::function::{Function, apply, constant, flex, sizes, tensor, values, variable};

/// Batch-norm of pictures with the batch's statistics, `+ residual`, ReLU if `relu`; updates the running statistics.
///
/// # Shapes
/// `[b, c, h, w]` -> the same
pub(crate) fn norm_planes(
    norm: &BatchNorm,
    x: &Tensor<4>,
    residual: Option<&Tensor<4>>,
    relu: bool,
) -> Option<Tensor<4>> {
    let (gamma, beta) = (variable(&norm.gamma.val())?, variable(&norm.beta.val())?);
    let function = Planes { relu, epsilon: norm.epsilon as f32, kept: None };
    let (y, moments) = match residual {
        None => {
            let (y, function) = apply(function, [variable(x)?, gamma, beta])?;
            (y, function.kept?.moments)
        }
        Some(residual) => {
            let (y, function) = apply(function, [variable(x)?, gamma, beta, variable(residual)?])?;
            (y, function.kept?.moments)
        }
    };
    track(norm, moments);
    Some(tensor(y))
}

/// Batch-norm of points with the batch's statistics, then ReLU; updates the running statistics.
///
/// # Shapes
/// `[rows, c]` -> the same
pub(crate) fn norm_rows_relu(norm: &BatchNorm, x: &Tensor<2>) -> Option<Tensor<2>> {
    let inputs = [variable(x)?, variable(&norm.gamma.val())?, variable(&norm.beta.val())?];
    let (y, function) = apply(Rows { epsilon: norm.epsilon as f32, kept: None }, inputs)?;
    track(norm, function.kept?.moments);
    Some(tensor(y))
}

/// Moves the running statistics toward a batch's, as burn does (with the biased variance).
pub(super) fn track(norm: &BatchNorm, moments: Moments) {
    let update = |state: &RunningState<Tensor<1>>, new: Vec<f32>| {
        let old = state.value_sync();
        let new = constant(new).to_device(&old.device());
        state.update(old.mul_scalar(1.0 - norm.momentum).add(new.mul_scalar(norm.momentum)).detach());
    };
    update(&norm.running_mean, moments.mean);
    update(&norm.running_var, moments.variance);
}

/// Moments that are numbers. Kernels make zeros of what is none; burn's own operations, which do the rest then, keep it, so that the
/// loss shows that something went wrong.
pub(super) fn known(moments: Moments) -> Option<Moments> {
    let finite = moments.mean.iter().chain(&moments.variance).all(|x| x.is_finite());
    finite.then_some(moments)
}

/// Why a gradient cannot fail.
const CHECKED: &str = "the forward pass has checked the sizes";

/// What the forward pass leaves for the backward pass.
#[derive(Clone, Debug)]
pub(super) struct Kept {
    pub(super) x: FlexTensor,
    pub(super) gamma: FlexTensor,
    pub(super) beta: FlexTensor,
    /// The result, if it says which values the ReLU let pass.
    pub(super) output: Option<FlexTensor>,
    pub(super) moments: Moments,
}

/// The parameters as the kernels take them.
pub(super) fn affine<'a>(gamma: &'a FlexTensor, beta: &'a FlexTensor, epsilon: f32) -> Affine<'a> {
    Affine { gamma: values(gamma), beta: values(beta), epsilon }
}

#[derive(Clone, Debug)]
struct Planes {
    relu: bool,
    epsilon: f32,
    kept: Option<Kept>,
}

impl Planes {
    fn run(
        &mut self,
        [x, gamma, beta]: [&FlexTensor; 3],
        residual: Option<&FlexTensor>,
    ) -> Option<FlexTensor> {
        let [b, c, h, w] = sizes(x)?;
        let (isa, size) = (Isa::best(), [b, c, h * w]);
        let moments = known(planes::moments(isa, size, values(x)).ok()?)?;
        let affine = affine(gamma, beta, self.epsilon);
        let y =
            planes::forward(isa, size, values(x), residual.map(values), &affine, &moments, self.relu).ok()?;
        let y = flex(y, [b, c, h, w]);
        let output = self.relu.then(|| y.clone());
        self.kept = Some(Kept { x: x.clone(), gamma: gamma.clone(), beta: beta.clone(), output, moments });
        Some(y)
    }

    /// Of x, gamma, beta and the residual.
    fn gradients(&self, dy: &FlexTensor, residual: bool) -> [Option<FlexTensor>; 4] {
        let kept = self.kept.as_ref().expect("forward comes first");
        let shape @ [b, c, h, w] = sizes(&kept.x).expect(CHECKED);
        let affine = affine(&kept.gamma, &kept.beta, self.epsilon);
        let followed = match &kept.output {
            None => Followed::Nothing,
            Some(output) if residual => Followed::AddRelu(values(output)),
            Some(output) => Followed::Relu(values(output)),
        };
        let (dy, x) = (values(dy), values(&kept.x));
        let (of, of_residual) =
            planes::backward(Isa::best(), [b, c, h * w], dy, x, followed, &affine, &kept.moments)
                .expect(CHECKED);
        [
            Some(flex(of.input, shape)),
            Some(flex(of.gamma, [c])),
            Some(flex(of.beta, [c])),
            of_residual.map(|values| flex(values, shape)),
        ]
    }
}

impl Function<3> for Planes {
    fn forward(&mut self, inputs: [&FlexTensor; 3]) -> Option<FlexTensor> {
        self.run(inputs, None)
    }

    fn backward(&self, gradient: &FlexTensor, _: [bool; 3]) -> [Option<FlexTensor>; 3] {
        let [x, gamma, beta, _] = self.gradients(gradient, false);
        [x, gamma, beta]
    }
}

impl Function<4> for Planes {
    fn forward(&mut self, [x, gamma, beta, residual]: [&FlexTensor; 4]) -> Option<FlexTensor> {
        // A residual without a ReLU is left to burn.
        self.relu.then(|| self.run([x, gamma, beta], Some(residual)))?
    }

    fn backward(&self, gradient: &FlexTensor, wanted: [bool; 4]) -> [Option<FlexTensor>; 4] {
        self.gradients(gradient, wanted[3])
    }
}

#[derive(Clone, Debug)]
struct Rows {
    epsilon: f32,
    kept: Option<Kept>,
}

impl Function<3> for Rows {
    fn forward(&mut self, [x, gamma, beta]: [&FlexTensor; 3]) -> Option<FlexTensor> {
        let [n, c] = sizes(x)?;
        let moments = known(rows::moments(Isa::best(), c, values(x)).ok()?)?;
        let affine = affine(gamma, beta, self.epsilon);
        let y = rows::forward(Isa::best(), values(x), &affine, &moments).ok()?;
        self.kept =
            Some(Kept { x: x.clone(), gamma: gamma.clone(), beta: beta.clone(), output: None, moments });
        Some(flex(y, [n, c]))
    }

    fn backward(&self, gradient: &FlexTensor, _: [bool; 3]) -> [Option<FlexTensor>; 3] {
        let kept = self.kept.as_ref().expect("forward comes first");
        let shape @ [_, c] = sizes(&kept.x).expect(CHECKED);
        let affine = affine(&kept.gamma, &kept.beta, self.epsilon);
        let of = rows::backward(Isa::best(), values(gradient), values(&kept.x), &affine, &kept.moments)
            .expect(CHECKED);
        [Some(flex(of.input, shape)), Some(flex(of.gamma, [c])), Some(flex(of.beta, [c]))]
    }
}
