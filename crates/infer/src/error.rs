//! What can go wrong, in the caller's words: what, expected, found.

use std::path::PathBuf;

use where2act_core::{ImageSize, Primitive};

/// Contents of a file that are not what their format promises. Carries no file name: see [`ReadError`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected {expected}, found {found}")]
pub struct Malformed {
    /// What a sound file has there.
    pub expected: String,
    /// What this one has.
    pub found: String,
}

impl Malformed {
    pub(crate) fn new(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self { expected: expected.into(), found: found.into() }
    }
}

/// A file that could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// The file is damaged, lies about its size, is too large, or is of another kind.
    #[error("{}: {source}", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        source: Malformed,
    },
}

/// Why there is no prediction.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The weights folder could not be loaded.
    #[error("{}: {source}", path.display())]
    Weights {
        /// Which folder.
        path: PathBuf,
        /// What is wrong with it.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// No weights folder was found.
    #[error(
        "weights: expected a folder with config.json and model.safetensors, found none at {}",
        list(looked_at)
    )]
    NoWeights {
        /// Where it was looked for.
        looked_at: Vec<PathBuf>,
    },
    /// The weights are of the other modality.
    #[error("weights {model:?}: expected a network that reads {needed}, found one that reads {found}")]
    Modality {
        /// Name of the weights.
        model: String,
        /// What the observation needs: `pictures` or `scans`.
        needed: &'static str,
        /// What the weights read.
        found: &'static str,
    },
    /// The network knows nothing of a primitive that was asked for.
    #[error("primitive: expected one of this network's ({}), found {found}", names(known))]
    UnknownPrimitive {
        /// What was asked for.
        found: Primitive,
        /// What the network was trained on.
        known: Vec<Primitive>,
    },
    /// A buffer of the observation does not fit its size.
    #[error(
        "{buffer}: expected {} x {} = {} values, found {found}",
        size.width,
        size.height,
        size.width.saturating_mul(size.height)
    )]
    BufferSize {
        /// `rgb`, `depth` or `mask`.
        buffer: &'static str,
        /// The observation's size.
        size: ImageSize,
        /// Values the buffer holds.
        found: usize,
    },
    /// The observation or an option is of no use.
    #[error("{what}: expected {expected}, found {found}")]
    Invalid {
        /// Which part of the observation or options.
        what: &'static str,
        /// What would do.
        expected: String,
        /// What was given.
        found: String,
    },
    /// Nothing of the object is where proposals may be.
    #[error("{what}: expected pixels or points of the object, found none")]
    NothingThere {
        /// `mask` or `region`.
        what: &'static str,
    },
    /// The network itself failed.
    #[error("network: {0}")]
    Network(String),
}

impl Error {
    pub(crate) fn invalid(what: &'static str, expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Invalid { what, expected: expected.into(), found: found.into() }
    }
}

fn list(paths: &[PathBuf]) -> String {
    paths.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn names(primitives: &[Primitive]) -> String {
    primitives.iter().map(|p| p.name()).collect::<Vec<_>>().join(", ")
}
