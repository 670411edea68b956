//! How weights are kept: tensors by plain names, folders that describe themselves, files of others.

mod assign;
mod folder;
#[cfg(feature = "import")]
mod import;
pub(crate) mod names;
mod tensors;
#[cfg(all(test, feature = "train"))]
mod tests;
mod widen;

use std::io;
use std::path::PathBuf;

use crate::config::ConfigError;
pub use folder::{CARD_FILE, CONFIG_FILE, SUMS_FILE, WEIGHTS_FILE, Weights, save_weights, verify_weights};
pub use tensors::{Precision, StoredTensor, Tensors};

/// What is wrong with a file of weights.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The file system said no.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: io::Error,
    },
    /// The folder is none of weights.
    #[error(
        "{path}: expected this file beside {CONFIG_FILE} and {WEIGHTS_FILE}, as in every weights folder, found none"
    )]
    NoWeights {
        /// `SHA256SUMS` of the folder.
        path: PathBuf,
    },
    /// The file is no container of tensors, or a damaged one.
    #[error("{path}: {why}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What was expected and found.
        why: String,
    },
    /// `config.json` describes no network.
    #[error("{path}: {source}")]
    Json {
        /// The file.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// The configuration's numbers are out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A tensor that the network needs is not in the file.
    #[error("{path}: tensor {name} is missing, expected shape {expected:?}")]
    Missing {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// The shape it should have.
        expected: Vec<usize>,
    },
    /// A tensor has another shape than the network's.
    #[error("{path}: tensor {name} has shape {found:?}, expected {expected:?}")]
    Shape {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// The network's shape.
        expected: Vec<usize>,
        /// The file's shape.
        found: Vec<usize>,
    },
    /// The file holds a tensor that the network has no place for.
    #[error("{path}: tensor {name} of shape {found:?} belongs to another network")]
    Unknown {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A tensor holds infinities or is not a number, or would after rounding to 16 bits.
    #[error("{path}: tensor {name} holds numbers that are not finite")]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// The tensor.
        name: String,
    },
    /// A file is not the one its folder was saved with.
    #[error("{path}: SHA-256 is {found}, expected {expected} as SHA256SUMS says")]
    Checksum {
        /// The file.
        path: PathBuf,
        /// What SHA256SUMS says.
        expected: String,
        /// What the file has.
        found: String,
    },
    /// The file is meant for the other kind of network.
    #[error("{path}: {why}")]
    Foreign {
        /// The file.
        path: PathBuf,
        /// What was expected.
        why: &'static str,
    },
}
