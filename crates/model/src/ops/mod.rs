//! Fast training operations: our own kernels inside burn's autodiff, on the flex backend in f32.
//!
//! Every operation here returns None where it does not apply (another backend, another type, gradient checkpointing, a
//! shape the kernels do not take, or [`TrainingEngine::Burn`] asked for); the caller then composes burn's own operations, which
//! is also what the tests compare with.

mod convolution;
mod engine;
mod function;
mod norm;
#[cfg(test)]
mod paths;
mod points;
#[cfg(test)]
mod tests;

pub(crate) use convolution::{conv, conv_upsampled};
pub use engine::TrainingEngine;
pub(crate) use norm::{norm_planes, norm_rows_relu};
pub(crate) use points::{group, interpolate_onto, norm_relu_pool};
