//! Shards in, weights and honest numbers out.
//!
//! | step | where |
//! | --- | --- |
//! | which objects may be trained on | [`Part`] |
//! | shards, memory-mapped | [`Dataset`] |
//! | what a step sees | [`batch`] |
//! | losses | [`step`] |
//! | the whole run: epochs, validation, checkpoints | [`run`] |
//! | numbers: metrics, intervals, executed proposals | [`metrics`], [`evaluate`] |

pub mod adaptive;
pub mod batch;
pub mod checkpoint;
mod config;
mod curves;
mod dataset;
pub mod evaluate;
mod mean;
pub mod metrics;
mod muon;
pub mod probes;
mod questions;
mod replay;
pub mod run;
mod sensor;
mod shown;
mod split;
mod start;
pub mod step;
pub mod teacher;
mod validate;

pub use config::{
    AdaptiveConfig, Arithmetic, BatchConfig, CollectConfig, ConfigError, Decay, LossConfig, NetworkConfig,
    Optimiser, ScheduleConfig, TeacherConfig, TrainConfig,
};
pub use dataset::{Counts, DataError, Dataset, Folder, SceneId};
pub use mean::{MeanError, mean};
pub use replay::Replay;
pub use split::Part;
pub use start::first_weights;
pub use validate::{Validation, score_scenes};
