//! The networks of where2act in burn, what they eat and how they are kept.
//!
//! | what | where |
//! | --- | --- |
//! | which network | [`ModelConfig`] |
//! | the network | [`Network`]: a [`UNet`] for pictures or a [`PointNet2`] for scans, and its [`Heads`] |
//! | the same, compiled for prediction | [`Engine`] |
//! | what it is fed | [`preprocess`], the same in training and prediction |
//! | what it learns from | [`losses`] |
//!
//! The backend is chosen at run time: `burn::tensor::Device::flex()` (fast), with the feature
//! `ndarray` also `Device::ndarray()`; with `.autodiff()` for training.

mod config;
mod engine;
mod heads;
mod init;
mod layers;
pub mod losses;
mod network;
#[cfg(feature = "train")]
mod ops;
mod pointnet;
pub mod preprocess;
mod summary;
#[cfg(all(test, feature = "train"))]
mod testing;
mod unet;
mod weights;

pub use config::{ConfigError, Modality, ModelConfig, Preprocessing, Schema};
pub use engine::{Engine, EngineError, Features, LinearLayer, SurroundingsEngine};
pub use heads::{
    ActionabilityHead, Choice, Code, HAND_VIEWS, HandView, Heads, MotionHead, ProposalDecoder,
    ProposalEncoder, ProposalHead, ScoreHead, SecondLook, SplitLinear, hand_frame, intended_axes,
    rotation_matrix, to_axes,
};
pub use init::draw_weights;
pub use network::{Backbone, Input, Network};
#[cfg(feature = "train")]
pub use ops::TrainingEngine;
pub use pointnet::{
    Abstraction, Grouping, Hierarchy, Interpolation, LEVELS, Level, MlpLayer, PointMlp, PointNet2,
    Propagation, SURROUNDINGS, Surroundings,
};
pub use summary::{Block, Summary};
pub use unet::{BasicBlock, Decoder, Downsample, Encoder, UNet, UpBlock};
pub use weights::{
    CARD_FILE, CONFIG_FILE, Precision, SUMS_FILE, StoredTensor, Tensors, WEIGHTS_FILE, Weights, WeightsError,
    save_weights, verify_weights,
};
