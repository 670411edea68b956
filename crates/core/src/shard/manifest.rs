//! The folder of a data set: what it is, and which shards are there.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::{FORMAT, ShardError};
use crate::{Seed, write_whole};

/// A data set's description: everything needed to make it again.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of the program that collected it.
    pub version: String,
    /// Seed of the whole data set.
    pub seed: Seed,
    /// Number of scenes when complete.
    pub scenes: u64,
    /// Scenes in every shard but the last.
    pub scenes_per_shard: u64,
    /// The collector's configuration.
    pub recipe: serde_json::Value,
}

impl Manifest {
    /// Name of the manifest in a data folder.
    pub const FILE: &str = "manifest.json";

    /// Number of shards when complete.
    #[must_use]
    pub fn shards(&self) -> u64 {
        self.scenes.div_ceil(self.scenes_per_shard.max(1))
    }

    /// Numbers of the scenes of one shard.
    #[must_use]
    pub fn scenes_of(&self, shard: u64) -> std::ops::Range<u64> {
        let start = shard * self.scenes_per_shard;
        start..(start + self.scenes_per_shard).min(self.scenes)
    }

    /// Path of one shard in a data folder.
    #[must_use]
    pub fn shard_path(folder: &Path, shard: u64) -> PathBuf {
        folder.join(format!("shard-{shard:05}.safetensors"))
    }

    /// Writes `manifest.json`.
    ///
    /// # Errors
    /// [`ShardError::Io`].
    pub fn save(&self, folder: &Path) -> Result<(), ShardError> {
        let path = folder.join(Self::FILE);
        write_whole(&path, |w| {
            serde_json::to_writer_pretty(&mut *w, self)?;
            w.write_all(b"\n")
        })
        .map_err(|source| ShardError::Io { path, source })
    }

    /// Reads `manifest.json`.
    ///
    /// # Errors
    /// Any [`ShardError`].
    pub fn load(folder: &Path) -> Result<Self, ShardError> {
        let path = folder.join(Self::FILE);
        let text = fs::read(&path).map_err(|source| ShardError::Io { path: path.clone(), source })?;
        let value: serde_json::Value = serde_json::from_slice(&text)
            .map_err(|e| ShardError::Damaged { path: path.clone(), why: e.to_string() })?;
        match value.get("format") {
            Some(found) if *found != serde_json::json!(FORMAT) => {
                Err(ShardError::Version { path, found: found.to_string() })
            }
            _ => serde_json::from_value(value).map_err(|e| ShardError::Damaged { path, why: e.to_string() }),
        }
    }
}

/// Shards present in a data folder, in order of their names: of their numbers, up to 100,000 shards.
///
/// # Errors
/// [`ShardError::Io`] if the folder cannot be listed.
pub fn list_shards(folder: &Path) -> Result<Vec<PathBuf>, ShardError> {
    let io = |source| ShardError::Io { path: folder.to_owned(), source };
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        if name.starts_with("shard-") && name.ends_with(".safetensors") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}
