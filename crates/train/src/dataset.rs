//! Shards opened for training: which scenes there are, and how often each primitive succeeds in them.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use where2act_core::Primitive;
use where2act_core::shard::{Manifest, Shard, ShardError, list_shards};

use crate::split::Part;

/// What is wrong with a data folder.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// A shard or manifest cannot be read.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// There are no shards.
    #[error("{}: no shards, expected shard-00000.safetensors and so on (make them with `collect`)", .0.display())]
    Empty(PathBuf),
    /// No scene belongs to a part that is needed.
    #[error("{}: none of the {scenes} scenes belongs to {part:?}; collect more objects", path.display())]
    EmptyPart {
        /// The folder.
        path: PathBuf,
        /// Which part.
        part: Part,
        /// Scenes there are.
        scenes: usize,
    },
    /// A primitive never succeeds, so nothing can be learnt about it.
    #[error("{}: no successful trial of {primitive} among {trials}; collect more trials or leave it out", path.display())]
    NoSuccess {
        /// The folder.
        path: PathBuf,
        /// Which primitive.
        primitive: Primitive,
        /// Trials of it.
        trials: usize,
    },
    /// A view cannot be shown to the network.
    #[error("{}: scene {scene}: {source}", path.display())]
    View {
        /// The shard.
        path: PathBuf,
        /// Which of its scenes.
        scene: usize,
        /// Why.
        source: where2act_model::preprocess::PreprocessError,
    },
}

/// A scene of a data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SceneId {
    /// Index of the shard.
    pub shard: usize,
    /// Index of the scene in it.
    pub scene: usize,
}

/// Memory-mapped shards. What is held in memory is the scenes' names and the counts below, not the data.
#[derive(Debug)]
pub struct Dataset {
    folder: PathBuf,
    shards: Vec<Shard>,
    /// Damaged shards that were skipped because the caller asked for it.
    pub skipped: Vec<ShardError>,
}

/// Trials and successes per primitive, in the order of [`Primitive::ALL`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Trials.
    pub trials: [usize; 6],
    /// Successful ones.
    pub successes: [usize; 6],
}

impl Dataset {
    /// Opens all shards of a folder.
    ///
    /// # Errors
    /// A damaged shard, unless `skip_damaged`; shards of another format version always.
    pub fn open(folder: &Path, skip_damaged: bool) -> Result<Self, DataError> {
        Manifest::load(folder)?;
        let mut shards = Vec::new();
        let mut skipped = Vec::new();
        for path in list_shards(folder)? {
            match Shard::open(&path) {
                Ok(shard) => shards.push(shard),
                Err(damage @ ShardError::Damaged { .. }) if skip_damaged => skipped.push(damage),
                Err(error) => return Err(error.into()),
            }
        }
        if shards.is_empty() {
            return Err(DataError::Empty(folder.to_owned()));
        }
        Ok(Self { folder: folder.to_owned(), shards, skipped })
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The shards.
    #[must_use]
    pub fn shards(&self) -> &[Shard] {
        &self.shards
    }

    /// Scenes whose object belongs to a part, in order.
    ///
    /// # Errors
    /// [`DataError::EmptyPart`].
    pub fn scenes(&self, part: Part) -> Result<Vec<SceneId>, DataError> {
        let all = self.shards.iter().enumerate().flat_map(|(shard, s)| {
            s.scenes().iter().enumerate().map(move |(scene, info)| (SceneId { shard, scene }, info))
        });
        let mine: Vec<SceneId> =
            all.filter(|(_, info)| Part::of(&info.object, info.category) == part).map(|(id, _)| id).collect();
        if mine.is_empty() {
            let scenes = self.shards.iter().map(|s| s.scenes().len()).sum();
            return Err(DataError::EmptyPart { path: self.folder.clone(), part, scenes });
        }
        Ok(mine)
    }

    /// Counts trials of some scenes.
    ///
    /// # Errors
    /// Those of [`Shard::trials`].
    pub fn counts(&self, scenes: &[SceneId]) -> Result<Counts, DataError> {
        let mut counts = Counts::default();
        for id in scenes {
            for trial in self.shards[id.shard].trials(id.scene)? {
                counts.trials[trial.primitive as usize] += 1;
                counts.successes[trial.primitive as usize] += usize::from(trial.verdict.success);
            }
        }
        Ok(counts)
    }

    /// Counts trials and checks that each of the primitives succeeds at least once.
    ///
    /// # Errors
    /// [`DataError::NoSuccess`].
    pub fn require_successes(
        &self,
        scenes: &[SceneId],
        primitives: &[Primitive],
    ) -> Result<Counts, DataError> {
        let counts = self.counts(scenes)?;
        for &primitive in primitives {
            if counts.successes[primitive as usize] == 0 {
                let trials = counts.trials[primitive as usize];
                return Err(DataError::NoSuccess { path: self.folder.clone(), primitive, trials });
            }
        }
        Ok(counts)
    }
}
