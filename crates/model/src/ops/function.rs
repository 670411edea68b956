//! How a differentiable function of flex tensors enters burn's graph.

use std::fmt::Debug;
use std::marker::PhantomData;

use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::NoCheckpointing};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::flex::{FlexTensor, Layout};
use burn::backend::tensor::FloatTensor;
use burn::backend::{Autodiff, Bytes, DType, Flex, TensorMetadata};
use burn::tensor::Tensor;

use super::TrainingEngine;

/// A tensor of the graph.
pub(super) type Variable = FloatTensor<Autodiff<Flex>>;

/// A function of `N` tensors and its gradient.
pub(super) trait Function<const N: usize>: Debug + Clone + Send + 'static {
    /// The result; keeps in `self` what [`Function::backward`] will need (clones of tensors share their memory). None
    /// if it does not apply to these inputs.
    fn forward(&mut self, inputs: [&FlexTensor; N]) -> Option<FlexTensor>;

    /// Gradients of the `wanted` inputs, given that of the result; others may be None.
    fn backward(&self, gradient: &FlexTensor, wanted: [bool; N]) -> [Option<FlexTensor>; N];
}

/// Applies a function. Returns it as well, with what its forward pass has left in it.
pub(super) fn apply<F: Function<N>, const N: usize>(
    mut function: F,
    inputs: [Variable; N],
) -> Option<(Variable, F)> {
    let dense = inputs.each_ref().map(|input| dense(input.primitive()));
    let output = function.forward(dense.each_ref())?;
    let node = Node::<F>(PhantomData);
    let output = match node
        .prepare::<NoCheckpointing>(inputs.each_ref().map(Variable::node))
        .compute_bound()
        .stateful()
    {
        OpsKind::Tracked(prepared) => prepared.finish(function.clone(), output),
        OpsKind::UnTracked(prepared) => prepared.finish(output),
    };
    Some((output, function))
}

/// The step of the backward pass that calls a function.
#[derive(Debug)]
struct Node<F>(PhantomData<fn() -> F>);

impl<F: Function<N>, const N: usize> Backward<Flex, N> for Node<F> {
    type State = F;

    fn backward(self, ops: Ops<F, N>, grads: &mut Gradients, _: &mut Checkpointer) {
        let gradient = dense(&grads.consume::<Flex>(&ops.node));
        let wanted = ops.parents.each_ref().map(Option::is_some);
        for (parent, gradient) in ops.parents.iter().zip(ops.state.backward(&gradient, wanted)) {
            if let (Some(parent), Some(gradient)) = (parent, gradient) {
                grads.register::<Flex>(parent.id, gradient);
            }
        }
    }
}

/// The tensor as a variable of the flex backend's graph, if the fast engine is wanted and that is what it is.
pub(super) fn variable<const D: usize>(tensor: &Tensor<D>) -> Option<Variable> {
    if TrainingEngine::current() == TrainingEngine::Burn {
        return None;
    }
    let variable = tensor.clone().try_into_primitive::<Autodiff<Flex>>().ok()?;
    (variable.primitive().dtype() == DType::F32).then_some(variable)
}

/// The tensor of a variable.
pub(super) fn tensor<const D: usize>(variable: Variable) -> Tensor<D> {
    Tensor::from_primitive::<Autodiff<Flex>>(variable)
}

/// A constant of the graph on the same backend.
pub(super) fn constant(values: Vec<f32>) -> Tensor<1> {
    let n = values.len();
    Tensor::from_primitive::<Flex>(flex(values, [n]))
}

/// Values as a tensor, without a copy.
pub(super) fn flex<const D: usize>(values: Vec<f32>, shape: [usize; D]) -> FlexTensor {
    FlexTensor::new(Bytes::from_elems(values), Layout::contiguous(shape.into()), DType::F32)
}

/// The tensor with its values in order; shares them if they are.
fn dense(tensor: &FlexTensor) -> FlexTensor {
    if tensor.is_contiguous() { tensor.clone() } else { tensor.to_contiguous() }
}

/// The values of a dense f32 tensor; none of another.
pub(super) fn values(tensor: &FlexTensor) -> &[f32] {
    tensor.as_slice().unwrap_or_default()
}

/// The sizes of a tensor with `D` dimensions.
pub(super) fn sizes<const D: usize>(tensor: &FlexTensor) -> Option<[usize; D]> {
    tensor.shape().as_slice().try_into().ok()
}
