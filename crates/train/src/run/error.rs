//! Why a run stops before its end.

use std::path::{Path, PathBuf};

use where2act_core::Primitive;
use where2act_model::{EngineError, Modality, WeightsError};

use crate::checkpoint::CheckpointError;
use crate::config::ConfigError;
use crate::curves::CurvesError;
use crate::dataset::DataError;

/// Why a run stopped before its end.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// The configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The processor does not have what `schedule.precision` asks for.
    #[error("schedule.{0}")]
    Engine(#[from] EngineError),
    /// The data cannot be used.
    #[error(transparent)]
    Data(#[from] DataError),
    /// A checkpoint cannot be written or read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// Weights cannot be written.
    #[error(transparent)]
    Weights(#[from] WeightsError),
    /// The picture of the curves cannot be drawn.
    #[error(transparent)]
    Curves(#[from] CurvesError),
    /// A file of a run cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the file system said.
        source: std::io::Error,
    },
    /// The run in this folder is another one.
    #[error("{}: this run has {what}; start another run with --out, or delete the folder", path.display())]
    OtherRun {
        /// The run's folder.
        path: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// Another program trains in this folder.
    #[error("{}: another program is training here; wait for it, or start another run with --out", path.display())]
    Busy {
        /// The run's folder.
        path: PathBuf,
    },
    /// The run whose trials are wanted had other data.
    #[error(
        "{}: expected a run on the same data, or its first folders, with its config.toml as it was, found another",
        path.display()
    )]
    OtherData {
        /// The run's folder.
        path: PathBuf,
    },
    /// The weights to start from are another network's.
    #[error("{}: these weights are of another network: {field} is {found}, expected {expected}", path.display())]
    OtherNetwork {
        /// The weights' folder.
        path: PathBuf,
        /// The first field of the network's description that differs.
        field: String,
        /// What it is in the weights' description.
        found: String,
        /// What the configuration makes of it.
        expected: String,
    },
    /// The teacher cannot teach this network.
    #[error(
        "{}: this network cannot teach: expected one for scans that knows the configuration's \
         primitives, found one for {modality:?} with {}",
        path.display(),
        primitives.iter().map(|p| p.name()).collect::<Vec<_>>().join(", ")
    )]
    OtherTeacher {
        /// The weights' folder.
        path: PathBuf,
        /// What it is for.
        modality: Modality,
        /// What it knows.
        primitives: Vec<Primitive>,
    },
    /// The loss is not a number any more, or far too large, or a weight is no number.
    #[error(
        "step {step}: the loss is {loss}; start another run with a smaller schedule.rate; last good checkpoint: {}",
        last_good.as_deref().unwrap_or(Path::new("none yet")).display()
    )]
    Diverged {
        /// At which step.
        step: usize,
        /// The loss; no number if a weight is none.
        loss: f32,
        /// The newest checkpoint, whose weights are numbers; `None` before the first.
        last_good: Option<PathBuf>,
    },
}

pub(crate) fn io(path: &Path, source: std::io::Error) -> TrainError {
    TrainError::Io { path: path.to_owned(), source }
}
