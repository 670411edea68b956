//! A data set on disk: which shards there are, which are missing, and making those.

use std::num::NonZeroU64;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use where2act_core::shard::{FORMAT, Manifest, SceneRecord, Shard, ShardError, list_shards, write_shard};

use crate::object::ObjectError;

use super::compare::refuse_other;
use super::{CollectError, Preparer, Recipe, Tally, collect_scene};

/// Raised whenever a recipe no longer gives the objects, views and trials that it gave before: a data set begun with others
/// is not gone on with.
const GENERATORS: u32 = 3;

/// Share of a data set that one machine makes: shards k with k % of == index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Number of the share.
    pub index: u64,
    /// Number of shares.
    pub of: NonZeroU64,
}

impl Part {
    /// Everything.
    pub const WHOLE: Part = Part { index: 0, of: NonZeroU64::MIN };
}

impl std::str::FromStr for Part {
    type Err = String;

    /// `I/N` with I < N.
    fn from_str(text: &str) -> Result<Self, String> {
        let part = text
            .split_once('/')
            .and_then(|(i, n)| Some(Part { index: i.parse().ok()?, of: n.parse().ok()? }));
        part.filter(|p| p.index < p.of.get())
            .ok_or_else(|| format!("{text:?}, expected I/N with I < N, such as 0/2"))
    }
}

/// How much to make of a recipe, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Scenes of the whole data set.
    pub scenes: u64,
    /// Scenes in every shard but the last. A shard is what an interruption can cost.
    pub scenes_per_shard: u64,
    /// What of it this run makes.
    pub part: Part,
    /// Whether to go on with a data set that is there.
    pub resume: bool,
}

impl Plan {
    /// A new data set of so many scenes, in shards of 16: 12 MB.
    #[must_use]
    pub fn new(scenes: u64) -> Self {
        Self { scenes, scenes_per_shard: 16, part: Part::WHOLE, resume: false }
    }
}

/// Makes a data set in a folder.
pub struct Collector {
    folder: PathBuf,
    manifest: Manifest,
    preparer: Preparer,
    part: Part,
    /// Whether nothing was there before.
    is_new: bool,
}

/// What a run of a [`Collector`] did and found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Collected {
    /// Shards of this part that were there before.
    pub shards_found: u64,
    /// Shards made by this run.
    pub shards_made: u64,
    /// Scenes in all of them.
    pub scenes: u64,
    /// Trials in all of them.
    pub tally: Tally,
    /// Trials made by this run.
    pub trials_made: u64,
}

impl Collector {
    /// Opens or creates the folder and its manifest. A folder that holds a data set is refused if its recipe differs, and
    /// without `resume` unless only a part is to be made: the others may have been begun in the same folder.
    ///
    /// # Errors
    /// As said, and whatever the file system reports.
    pub fn new(folder: &Path, recipe: Recipe, plan: Plan) -> Result<Self, CollectError> {
        let path = folder.join(Manifest::FILE);
        let as_json = |value: &Recipe| {
            serde_json::to_value(value)
                .map_err(|e| ShardError::Damaged { path: path.clone(), why: e.to_string() })
        };
        let manifest = Manifest {
            format: FORMAT,
            version: format!("{}+{GENERATORS}", env!("CARGO_PKG_VERSION")),
            seed: recipe.seed,
            scenes: plan.scenes,
            scenes_per_shard: plan.scenes_per_shard.max(1),
            recipe: as_json(&recipe)?,
        };
        let is_new = !path.exists();
        if is_new {
            if list_shards(folder).is_ok_and(|shards| !shards.is_empty()) {
                return Err(CollectError::Orphans { path: folder.to_owned() });
            }
            manifest.save(folder)?;
        } else {
            let found = Manifest::load(folder)?;
            refuse_other(&path, &found, &manifest)?;
            if !plan.resume && plan.part == Part::WHOLE {
                return Err(CollectError::Exists { path: folder.to_owned() });
            }
        }
        let preparer = Preparer::new(recipe);
        Ok(Self { folder: folder.to_owned(), manifest, preparer, part: plan.part, is_new })
    }

    /// Number of scenes of this part.
    #[must_use]
    pub fn scenes(&self) -> u64 {
        self.shards().map(|k| self.manifest.scenes_of(k)).map(|r| r.end - r.start).sum()
    }

    fn shards(&self) -> impl Iterator<Item = u64> + '_ {
        (0..self.manifest.shards()).filter(|k| *k % self.part.of == self.part.index)
    }

    /// Makes the missing shards. `progress` hears of every finished scene: how
    /// many at once, and the state so far; `stop` ends the work
    /// after the scenes under way, without their shard.
    ///
    /// # Errors
    /// [`CollectError::Interrupted`] after a stop; what the file system says; what is wrong with an object that cannot be
    /// loaded, if no other of the whole set can be: else its scenes are left out, whatever part this run makes. Finished
    /// shards stay; if there are none, nothing does.
    pub fn run(
        &self,
        stop: &AtomicBool,
        progress: &(dyn Fn(u64, &Collected) + Sync),
    ) -> Result<Collected, CollectError> {
        let outcome = self.make(stop, progress);
        // Other machines may rely on the manifest of a data set that is shared out.
        let is_empty = || list_shards(&self.folder).is_ok_and(|shards| shards.is_empty());
        if outcome.is_err() && self.is_new && self.part == Part::WHOLE && is_empty() {
            // The error counts; what cannot be removed does no harm. Folders go only if they are empty.
            let _ = std::fs::remove_file(self.folder.join(Manifest::FILE));
            let _ = std::fs::remove_dir(&self.folder);
        }
        outcome
    }

    fn make(
        &self,
        stop: &AtomicBool,
        progress: &(dyn Fn(u64, &Collected) + Sync),
    ) -> Result<Collected, CollectError> {
        let state = Mutex::new(Collected::default());
        let with = |f: &mut dyn FnMut(&mut Collected)| {
            f(&mut state.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
        };
        let mut missing = Vec::new();
        for shard in self.shards() {
            let path = Manifest::shard_path(&self.folder, shard);
            match Shard::open(&path) {
                Ok(found) => {
                    let mut tally = Tally::default();
                    for scene in 0..found.scenes().len() {
                        tally.add(&found.trials(scene)?);
                    }
                    let scenes = found.scenes().len() as u64;
                    with(&mut |s| {
                        s.shards_found += 1;
                        s.scenes += scenes;
                        s.tally.merge(&tally);
                        progress(scenes, s);
                    });
                }
                Err(other_version @ ShardError::Version { .. }) => return Err(other_version.into()),
                Err(_) => missing.push(shard),
            }
        }
        let mut any_loads = false;
        for shard in missing {
            let records = self.manifest.scenes_of(shard).into_par_iter().map(|index| {
                if stop.load(Ordering::Relaxed) {
                    return Ok(Ok(None));
                }
                let record = match collect_scene(&self.preparer, index) {
                    Err(CollectError::Object(error)) => Err(error),
                    record => Ok(record?),
                };
                with(&mut |s| {
                    if let Ok(Some(record)) = &record {
                        s.tally.add(&record.trials);
                        s.scenes += 1;
                        s.trials_made += record.trials.len() as u64;
                    }
                    progress(1, s);
                });
                if matches!(record, Ok(None)) {
                    tracing::warn!("scene {index}: no object settled in view of a camera, left out");
                }
                Ok(record)
            });
            let records: Vec<Result<Option<SceneRecord>, ObjectError>> =
                records.collect::<Result<_, CollectError>>()?;
            if stop.load(Ordering::Relaxed) {
                let finished = |k: &u64| Manifest::shard_path(&self.folder, *k).exists();
                let (done, shards) =
                    (self.shards().filter(finished).count() as u64, self.shards().count() as u64);
                return Err(CollectError::Interrupted { path: self.folder.clone(), done, shards });
            }
            let (mut made, mut unloadable) = (Vec::new(), Vec::new());
            for (index, record) in self.manifest.scenes_of(shard).zip(records) {
                match record {
                    Ok(record) => {
                        any_loads = true;
                        made.extend(record);
                    }
                    Err(error) => unloadable.push((index, error)),
                }
            }
            // What was there when the data set was begun has gone: rather a disk than an object.
            if let Some(at) = unloadable.iter().position(|(_, e)| matches!(e, ObjectError::NotFound { .. })) {
                return Err(unloadable.swap_remove(at).1.into());
            }
            // An object that cannot be loaded costs no other its scenes, if there is any other. Which scenes a shard
            // or a part happens to hold must not matter.
            any_loads = any_loads || self.preparer.any_loads();
            if !any_loads && let Some((_, error)) = unloadable.pop() {
                return Err(error.into());
            }
            for (index, error) in unloadable {
                tracing::warn!("scene {index}: {error}, left out");
            }
            write_shard(&Manifest::shard_path(&self.folder, shard), &made)?;
            with(&mut |s| s.shards_made += 1);
        }
        Ok(state.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}
