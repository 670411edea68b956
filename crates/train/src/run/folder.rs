//! The folder of a run.

use std::fs;
use std::io::Write;
use std::path::Path;

use where2act_core::write_whole;

use super::{TrainError, io};
use crate::checkpoint;
use crate::config::TrainConfig;
use crate::dataset::Dataset;
use crate::start::contents;

/// Names of the files in a run's folder.
pub mod files {
    /// Locked while a program trains in the folder; empty.
    pub const LOCK: &str = ".lock";
    /// The configuration.
    pub const CONFIG: &str = "config.toml";
    /// One JSON line per step and epoch.
    pub const METRICS: &str = "metrics.jsonl";
    /// The picture of the curves.
    pub const CURVES: &str = "curves.png";
    /// Checkpoints.
    pub const CHECKPOINTS: &str = "checkpoints";
    /// The best weights by validation.
    pub const WEIGHTS: &str = "weights";
    /// The weights after the newest epoch: those to take. Validation knows trials that others proposed; what the network
    /// itself proposes goes on getting better when that does not (`weights/EXPERIMENTS.md`).
    pub const LAST: &str = "last";
}

/// Keeps other programs out of the run's folder until the file is closed.
pub(super) fn lock(out: &Path) -> Result<fs::File, TrainError> {
    let path = out.join(files::LOCK);
    let open = || {
        fs::create_dir_all(out)?;
        fs::OpenOptions::new().create(true).write(true).truncate(false).open(&path)
    };
    let file = open().map_err(|e| io(&path, e))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(TrainError::Busy { path: out.to_owned() }),
        // Some network file systems have no locks.
        Err(fs::TryLockError::Error(error)) if error.kind() == std::io::ErrorKind::Unsupported => {
            tracing::warn!("{}: cannot be locked; see to it that no other run writes here", path.display());
            Ok(file)
        }
        Err(fs::TryLockError::Error(error)) => Err(io(&path, error)),
    }
}

/// Whether a run in this folder would begin, for want of a checkpoint.
///
/// # Errors
/// [`TrainError::OtherRun`] if there are weights that it would write over.
pub fn begins(out: &Path) -> Result<bool, TrainError> {
    let begins = checkpoint::list(&out.join(files::CHECKPOINTS)).is_ok_and(|all| all.is_empty());
    if begins && (out.join(files::LAST).exists() || out.join(files::WEIGHTS).exists()) {
        let what = "weights, but no checkpoint to go on from";
        return Err(TrainError::OtherRun { path: out.to_owned(), what });
    }
    Ok(begins)
}

/// Creates the run's folder with its configuration, or checks that it holds the same one.
pub(super) fn prepare_folder(
    config: &TrainConfig,
    dataset: &Dataset,
    out: &Path,
) -> Result<String, TrainError> {
    let text = toml::to_string(config).map_err(|e| io(out, std::io::Error::other(e)))?;
    let path = out.join(files::CONFIG);
    let begins = begins(out)?;
    match fs::read_to_string(&path) {
        Ok(found) if found == text => {}
        // A run that never came to a checkpoint has nothing to lose.
        Ok(_) if begins => {
            write_whole(&path, |w| w.write_all(text.as_bytes())).map_err(|e| io(&path, e))?;
        }
        Ok(_) => return Err(TrainError::OtherRun { path: out.to_owned(), what: "another configuration" }),
        Err(_) => write_whole(&path, |w| w.write_all(text.as_bytes())).map_err(|e| io(&path, e))?,
    }
    let fingerprint = checkpoint::fingerprint(&text, &contents(dataset)?.concat());
    tracing::debug!("{}: data and configuration {fingerprint}", out.display());
    Ok(fingerprint)
}

/// Drops lines of steps that will be done again.
pub(super) fn forget_metrics_after(path: &Path, step: usize) -> Result<(), TrainError> {
    let Ok(text) = fs::read_to_string(path) else { return Ok(()) };
    let is_kept = |line: &&str| {
        serde_json::from_str::<serde_json::Value>(line)
            .is_ok_and(|value| value["step"].as_u64().is_some_and(|s| s as usize <= step))
    };
    let kept: String = text.lines().filter(is_kept).map(|line| format!("{line}\n")).collect();
    write_whole(path, |w| w.write_all(kept.as_bytes())).map_err(|e| io(path, e))
}
