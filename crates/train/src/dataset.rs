//! Shards opened for training: which scenes there are, and how often each primitive succeeds in them.

use std::io::ErrorKind;
use std::ops::Range;
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
    /// There is no data set.
    #[error("{}: expected a folder that `collect` wrote, found no {}", .0.display(), Manifest::FILE)]
    NoData(PathBuf),
    /// There are no shards.
    #[error("{}: no shards, expected shard-00000.safetensors and so on (make them with `collect`)", .0.display())]
    Empty(PathBuf),
    /// No scene belongs to a part that is needed.
    #[error(
        "{folders}: none of the {scenes} scenes belongs to {part:?}, {novel} are of novel categories, which only judge; collect more objects of others"
    )]
    EmptyPart {
        /// The folders.
        folders: String,
        /// Which part.
        part: Part,
        /// Scenes there are.
        scenes: usize,
        /// Those of [`Part::Novel`] among them.
        novel: usize,
    },
    /// A primitive never succeeds, so nothing can be learnt about it.
    #[error(
        "{folders}: no successful trial of {primitive} among {trials}; collect more trials or leave it out"
    )]
    NoSuccess {
        /// The folders.
        folders: String,
        /// Which primitive.
        primitive: Primitive,
        /// Trials of it.
        trials: usize,
    },
    /// Pictures show less than the network sees.
    #[error(
        "{}: pictures of {side} pixels a side, expected at least network.image_side = {image_side}; collect with --picture-side 448", .path.display()
    )]
    SmallPictures {
        /// The shard.
        path: PathBuf,
        /// Their side.
        side: usize,
        /// The network's.
        image_side: usize,
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
    /// Index of the shard, through all folders.
    pub shard: usize,
    /// Index of the scene in it.
    pub scene: usize,
}

/// Memory-mapped shards. What is held in memory is the scenes' names and the counts below, not the data.
#[derive(Debug)]
pub struct Dataset {
    folders: Vec<Folder>,
    shards: Vec<Shard>,
    /// Damaged shards that were skipped because the caller asked for it.
    pub skipped: Vec<ShardError>,
}

/// A folder of a data set.
#[derive(Clone, Debug)]
pub struct Folder {
    /// Where it is.
    pub path: PathBuf,
    /// What it says of itself.
    pub manifest: Manifest,
    /// Its shards among those of the data set.
    pub shards: Range<usize>,
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
        Self::open_all(&[folder], skip_damaged)
    }

    /// Opens all shards of several folders, which become one data set: scenes with and without trials, generated objects
    /// and others.
    ///
    /// # Errors
    /// Those of [`Self::open`].
    pub fn open_all(folders: &[impl AsRef<Path>], skip_damaged: bool) -> Result<Self, DataError> {
        let mut dataset = Self { folders: Vec::new(), shards: Vec::new(), skipped: Vec::new() };
        for folder in folders {
            let folder = folder.as_ref();
            let before = dataset.shards.len();
            let manifest = Manifest::load(folder).map_err(|error| match error {
                ShardError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
                    DataError::NoData(folder.to_owned())
                }
                other => other.into(),
            })?;
            for path in list_shards(folder)? {
                match Shard::open(&path) {
                    Ok(shard) => dataset.shards.push(shard),
                    Err(damage @ ShardError::Damaged { .. }) if skip_damaged => dataset.skipped.push(damage),
                    Err(error) => return Err(error.into()),
                }
            }
            let shards = before..dataset.shards.len();
            if shards.is_empty() {
                return Err(DataError::Empty(folder.to_owned()));
            }
            dataset.folders.push(Folder { path: folder.to_owned(), manifest, shards });
        }
        Ok(dataset)
    }

    /// The folders.
    #[must_use]
    pub fn folders(&self) -> &[Folder] {
        &self.folders
    }

    /// Index of the folder that a shard is in.
    #[must_use]
    pub fn folder_of(&self, shard: usize) -> usize {
        self.folders.partition_point(|folder| folder.shards.end <= shard)
    }

    fn show_folders(&self) -> String {
        let names: Vec<_> = self.folders.iter().map(|folder| folder.path.display().to_string()).collect();
        names.join(", ")
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
        self.scenes_where(part, |_| true)
    }

    /// Those of [`Self::scenes`] that have trials of any of these primitives.
    ///
    /// # Errors
    /// [`DataError::EmptyPart`].
    pub fn tried_scenes(&self, part: Part, primitives: &[Primitive]) -> Result<Vec<SceneId>, DataError> {
        self.scenes_where(part, |id| self.is_tried(id, primitives))
    }

    fn scenes_where(&self, part: Part, keep: impl Fn(SceneId) -> bool) -> Result<Vec<SceneId>, DataError> {
        let all = self.shards.iter().enumerate().flat_map(|(shard, s)| {
            s.scenes().iter().enumerate().map(move |(scene, info)| (SceneId { shard, scene }, info))
        });
        let mine: Vec<SceneId> = all
            .filter(|(id, info)| keep(*id) && Part::of(&info.object, info.category) == part)
            .map(|(id, _)| id)
            .collect();
        if mine.is_empty() {
            let all = || self.shards.iter().flat_map(Shard::scenes);
            let novel = all().filter(|info| Part::of(&info.object, info.category) == Part::Novel).count();
            let (folders, scenes) = (self.show_folders(), all().count());
            return Err(DataError::EmptyPart { folders, part, scenes, novel });
        }
        Ok(mine)
    }

    /// Whether a scene has trials of any of these primitives.
    #[must_use]
    pub fn is_tried(&self, id: SceneId, primitives: &[Primitive]) -> bool {
        let trials = self.shards[id.shard].trials(id.scene);
        trials.is_ok_and(|trials| trials.iter().any(|trial| primitives.contains(&trial.primitive)))
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

    /// Checks that no picture is smaller than `image_side` pixels a side.
    ///
    /// # Errors
    /// [`DataError::SmallPictures`].
    pub fn require_pictures(&self, image_side: usize) -> Result<(), DataError> {
        self.shards.iter().find(|shard| shard.rgb_side() < image_side).map_or(Ok(()), |shard| {
            Err(DataError::SmallPictures {
                path: shard.path().to_owned(),
                side: shard.rgb_side(),
                image_side,
            })
        })
    }

    /// Checks that each of the primitives succeeds at least once.
    ///
    /// # Errors
    /// [`DataError::NoSuccess`].
    pub fn require_successes(&self, scenes: &[SceneId], primitives: &[Primitive]) -> Result<(), DataError> {
        let counts = self.counts(scenes)?;
        for &primitive in primitives {
            if counts.successes[primitive as usize] == 0 {
                let trials = counts.trials[primitive as usize];
                return Err(DataError::NoSuccess { folders: self.show_folders(), primitive, trials });
            }
        }
        Ok(())
    }
}

/// At most so many, evenly over all of them, so that every folder has its share.
pub(crate) fn spread<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    let count = most.min(all.len());
    (0..count).map(move |i| &all[i * all.len() / count])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_takes_from_all_over_and_none_twice() {
        let all: Vec<usize> = (0..10).collect();
        assert_eq!(spread(&all, 4).copied().collect::<Vec<_>>(), [0, 2, 5, 7]);
        assert_eq!(spread(&all, 99).copied().collect::<Vec<_>>(), all);
        assert_eq!(spread(&all[..0], 4).count(), 0);
    }
}
