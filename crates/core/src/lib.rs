//! The words every stage of where2act shares. No physics engine, no network.
//!
//! The story of the data, and the type that carries each step:
//!
//! | step | type |
//! | --- | --- |
//! | what a camera sees | [`Observation`], through a [`Camera`] |
//! | what a hand tries | [`Primitive`] at a [`Grasp`], which plans a [`Motion`] |
//! | what came of it | [`Trial`] with its [`Verdict`] |
//! | what is kept for training | [`shard::SceneRecord`] in a [`shard::Shard`] |
//! | what a network says | [`Prediction`] |
//!
//! # Frames and units
//!
//! Metres, radians, kilograms, seconds. The world is z-up. The camera frame is *optical*: x right, y down,
//! z forward, as in OpenCV and ROS. The hand frame has z along the approach, x along "forward" and
//! y = z cross x along "left". `a_from_b` maps coordinates in frame `b` to coordinates in frame `a`.

mod artifact;
mod camera;
mod category;
mod gripper;
mod observation;
mod one_line;
mod orientation;
mod prediction;
mod primitive;
#[cfg(feature = "program")]
pub mod program;
mod seed;
pub mod shard;
mod trial;

/// The version whose points and transforms the public types have.
pub use nalgebra;

pub use artifact::{sha256_hex, write_together, write_whole};
pub use camera::{Camera, ImageSize, Intrinsics, Pixel};
pub use category::{Category, Split, UnknownCategory};
pub use gripper::{GRIPPER, GripperGeometry};
pub use observation::{Observation, is_measured, is_measured_depth};
pub use one_line::one_line;
pub use orientation::{Orientation6, orthonormal_frame};
pub use prediction::{
    ActionabilitySummary, InputInfo, ModelInfo, PREDICTION_SCHEMA, Prediction, PrimitivePrediction, Proposal,
    Timing,
};
pub use primitive::{FingerState, Grasp, Motion, Primitive, Stage, UnknownPrimitive};
pub use seed::Seed;
pub use trial::{Invalid, Policy, Trial, Verdict};
