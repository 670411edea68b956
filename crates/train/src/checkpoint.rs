//! Where a run stands, on disk, so that it can go on exactly there.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::ModuleOptimizer;
use burn::store::ModuleRecord;
use burn::tensor::{Bytes, Tensor};
use serde::{Deserialize, Serialize};
use where2act_core::sha256_hex;

use crate::probes::Learner;
use crate::replay::Replay;

/// What a checkpoint knows beside weights and optimiser.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Progress {
    /// Steps done.
    pub step: usize,
    /// Best validation figure so far: mean average precision over primitives.
    pub best: Option<f64>,
    /// Seconds of training so far, over all interruptions.
    pub secs: f64,
    /// SHA-256 of the configuration and of what the data holds.
    pub fingerprint: String,
    /// SHA-256 of the teacher's weights, if the run has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub teacher: Option<String>,
}

/// Where a run stands.
#[derive(Clone)]
pub struct State {
    /// What is trained.
    pub learner: Learner,
    /// The running mean of its weights, if the run keeps one.
    pub mean: Option<Learner>,
    /// Adam or Muon, and what it remembers.
    pub optimiser: ModuleOptimizer,
    /// Newer trials.
    pub replay: Replay,
    /// The rest.
    pub progress: Progress,
}

/// A checkpoint that cannot be written or read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// It holds something else than this run needs.
    #[error("{}: {why}; without the folder of that checkpoint a run goes on from the one before", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
}

const LEARNER: &str = "learner.bpk";
const MEAN: &str = "mean.bpk";
const OPTIMISER: &str = "optimiser.bpk";
const REPLAY: &str = "replay.cbor";
const PROGRESS: &str = "progress.json";
/// Begins the names of folders that are not, or no longer, whole.
const PARTIAL: &str = ".partial-";
/// Checkpoints that are kept: the newest may be the one that a power cut hits.
const KEPT: usize = 2;

/// Writes a checkpoint as `folder/step-00001234`, whole or not at all, and forgets all but the newest two.
///
/// # Errors
/// [`CheckpointError::Io`].
pub fn save(folder: &Path, state: &State) -> Result<PathBuf, CheckpointError> {
    let path = folder.join(format!("step-{:08}", state.progress.step));
    let io = |source| CheckpointError::Io { path: path.clone(), source };
    let damaged = |why: String| CheckpointError::Damaged { path: path.clone(), why };
    fs::create_dir_all(folder).map_err(io)?;
    // What a killed run has left.
    for entry in fs::read_dir(folder).map_err(io)? {
        let left = entry.map_err(io)?;
        if left.file_name().to_string_lossy().starts_with(PARTIAL) {
            fs::remove_dir_all(left.path()).map_err(io)?;
        }
    }
    let partial = tempfile::Builder::new().prefix(PARTIAL).tempdir_in(folder).map_err(io)?;
    // Not a clone: burn keeps the last update of the running statistics apart from the parameters of a network that
    // trains, and shares them between clones.
    let weights = |learner: Learner| learner.into_record().into_bytes().map_err(|e| damaged(e.to_string()));
    let optimiser = state.optimiser.into_bytes().map_err(|e| damaged(e.to_string()))?;
    write(&partial.path().join(LEARNER), &weights(state.learner.valid())?).map_err(io)?;
    if let Some(mean) = state.mean.clone() {
        write(&partial.path().join(MEAN), &weights(mean)?).map_err(io)?;
    }
    write(&partial.path().join(OPTIMISER), &optimiser).map_err(io)?;
    let mut replay = Vec::new();
    ciborium::into_writer(&state.replay, &mut replay).map_err(|e| damaged(e.to_string()))?;
    write(&partial.path().join(REPLAY), &replay).map_err(io)?;
    let progress = serde_json::to_vec_pretty(&state.progress).map_err(|e| damaged(e.to_string()))?;
    write(&partial.path().join(PROGRESS), &progress).map_err(io)?;
    if path.exists() {
        discard(&path).map_err(io)?;
    }
    fs::rename(partial.keep(), &path).map_err(io)?;
    let all = list(folder).map_err(io)?;
    for old in all.iter().rev().skip(KEPT) {
        discard(old).map_err(io)?;
    }
    Ok(path)
}

/// Whether every weight and running statistic is finite: what is saved must be worth going on from.
#[must_use]
pub fn is_finite(learner: &Learner) -> bool {
    struct Finite(bool);
    impl ModuleVisitor for Finite {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            let data = param.val().into_data().convert::<f32>();
            self.0 &= data.as_slice::<f32>().is_ok_and(|values| values.iter().all(|x| x.is_finite()));
        }
    }
    let mut finite = Finite(true);
    learner.visit(&mut finite);
    finite.0
}

/// Deletes a checkpoint so that half of one is never taken for a whole one.
fn discard(path: &Path) -> std::io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let away = path.with_file_name(format!("{PARTIAL}{name}"));
    fs::rename(path, &away)?;
    fs::remove_dir_all(away)
}

fn write(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = fs::File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

/// Checkpoints of a run, the oldest first.
///
/// # Errors
/// If the folder exists and cannot be listed.
pub fn list(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let mut found: Vec<PathBuf> = fs::read_dir(folder)?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|p| p.file_name().and_then(|n| n.to_str()).is_some_and(|n| n.starts_with("step-")))
        .collect();
    found.sort();
    Ok(found)
}

/// Reads a checkpoint into the state of a run that has not begun.
///
/// # Errors
/// Any [`CheckpointError`].
pub fn load(path: &Path, fresh: State) -> Result<State, CheckpointError> {
    let damaged = |name: &str, why: String| CheckpointError::Damaged { path: path.join(name), why };
    let (replay, progress) = without_weights(path)?;
    let weights = |fresh: Learner, name: &str| {
        let record = ModuleRecord::from_bytes(Bytes::from_bytes_vec(read(path, name)?))
            .map_err(|e| damaged(name, e.to_string()))?;
        fresh.try_load_record(record).map_err(|e| damaged(name, e.to_string()))
    };
    let learner = weights(fresh.learner.valid(), LEARNER)?.train();
    let mean = fresh.mean.map(|mean| weights(mean, MEAN)).transpose()?;
    let optimiser = fresh
        .optimiser
        .from_bytes(Bytes::from_bytes_vec(read(path, OPTIMISER)?))
        .map_err(|e| damaged(OPTIMISER, e.to_string()))?;
    Ok(State { learner, mean, optimiser, replay, progress })
}

/// The newer trials of a checkpoint and where its run stood, without its weights.
///
/// # Errors
/// Any [`CheckpointError`].
pub fn without_weights(path: &Path) -> Result<(Replay, Progress), CheckpointError> {
    let damaged = |name: &str, why: String| CheckpointError::Damaged { path: path.join(name), why };
    let replay = ciborium::from_reader(read(path, REPLAY)?.as_slice());
    let progress = serde_json::from_slice(&read(path, PROGRESS)?);
    Ok((
        replay.map_err(|e| damaged(REPLAY, e.to_string()))?,
        progress.map_err(|e| damaged(PROGRESS, e.to_string()))?,
    ))
}

fn read(checkpoint: &Path, name: &str) -> Result<Vec<u8>, CheckpointError> {
    let path = checkpoint.join(name);
    fs::read(&path).map_err(|source| CheckpointError::Io { path, source })
}

/// What must be the same for a run to be resumed: its configuration and its data.
#[must_use]
pub fn fingerprint(config: &str, data: &str) -> String {
    sha256_hex(format!("{config}\0{data}").as_bytes())
}
