//! The CPU kernels that decide where2act's speed: convolution, point sampling and grouping.
//!
//! Plain slices in, plain vectors out: nothing here knows of burn. Each algorithm is written once and compiled
//! for every instruction set of [`Isa`]; the best one the processor has is chosen at run time. Results do not
//! depend on the number of threads.
#![allow(unsafe_code, reason = "kernels are the one place for it; every block states why it is sound")]
#![allow(clippy::needless_range_loop, reason = "a lane or an axis indexes several arrays at once")]

mod aligned;
mod blocked;
mod conv;
pub mod conv_train;
mod error;
mod gemm;
mod isa;
mod keep;
mod mlp;
pub mod norm_train;
mod parallel;
mod perceptron;
pub mod points;
mod pool;
mod simd;
#[cfg(test)]
mod testing;
pub mod unet;
mod winograd;

pub use aligned::AlignedBuf;
pub use blocked::Blocked;
pub use conv::{Add, Conv, Form, Head, Picture, Source, Stem, Weights, Workspace};
pub use error::ShapeError;
pub use isa::Isa;
pub use keep::KeepLarge;
pub use mlp::{Activation, Lookup, Mlp, MlpInput, MlpLayer};
pub use perceptron::Perceptron;
pub use pool::max_pool;
