//! From articulated object to data: object, scene, settled scene, observation, trial, shard.

pub mod collect;
pub mod object;
mod physics;
pub mod render;
pub mod sampling;
mod scene;
mod surface;
mod trial;

pub use physics::PieceError;
pub use scene::{BadPositions, Scene, SettledScene, Unsettled};
pub use surface::SurfacePoint;
pub use trial::{Agreement, Attempt, Batch, BatchError, Mode, Moment, Observer, Outcome};
