//! Collecting data: scenes and their trials, a recipe at a time.

mod compare;
mod folder;
mod prepare;
mod recipe;
mod tally;

use std::path::PathBuf;

use rand::RngExt;
use rayon::prelude::*;
use where2act_core::shard::{SceneRecord, ShardError};
use where2act_core::{Policy, Primitive, Seed, Trial};

pub use folder::{Collected, Collector, Part, Plan};
pub use prepare::{Preparer, ScenePrep};
pub use recipe::{ObjectSet, Recipe, categories_of};
pub use tally::{Count, Tally};

use crate::object::ObjectError;
use crate::sampling::{Candidate, Sampler};
use crate::trial::Mode;

/// What went wrong while collecting.
#[derive(Debug, thiserror::Error)]
pub enum CollectError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// A folder without objects.
    #[error("{}: no object of the wanted categories, expected <Category>/<id> or <id> with mobility.urdf or one other .urdf file", path.display())]
    NoObjects {
        /// The folder.
        path: PathBuf,
    },
    /// An object that cannot be loaded.
    #[error(transparent)]
    Object(#[from] ObjectError),
    /// A shard or manifest.
    #[error(transparent)]
    Shard(#[from] ShardError),
    /// A scene that was made by another recipe or version.
    #[error(
        "scene {scene} of {object}: cannot be made again, expected a scene of the same recipe and version"
    )]
    Foreign {
        /// Number of the scene.
        scene: u64,
        /// Its object.
        object: String,
    },
    /// A data set that is already there.
    #[error("{}: holds a data set, expected an empty folder (or --resume)", path.display())]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// Shards of which nobody knows how they were made.
    #[error("{}: holds shards without their manifest.json; expected that too, or an empty folder", path.display())]
    Orphans {
        /// The folder.
        path: PathBuf,
    },
    /// A data set of another recipe.
    #[error("{}: made with {field} {found}, expected {expected}", path.display())]
    OtherRecipe {
        /// The manifest.
        path: PathBuf,
        /// Where both differ.
        field: String,
        /// In the manifest.
        found: String,
        /// In this run.
        expected: String,
    },
    /// Someone asked to stop.
    #[error("{}: interrupted after {done} of {shards} shards; --resume goes on", path.display())]
    Interrupted {
        /// The folder.
        path: PathBuf,
        /// Shards that are finished.
        done: u64,
        /// Shards wanted.
        shards: u64,
    },
}

impl ScenePrep {
    /// Runs one candidate and writes down what came of it, as seen from the view's camera.
    #[must_use]
    pub fn run(&self, primitive: Primitive, policy: Policy, candidate: &Candidate, mode: Mode) -> Trial {
        let Candidate { pixel, link, grasp_in_world, normal_in_world } = candidate;
        let verdict = self.settled.run(primitive, *link, grasp_in_world, Some(*normal_in_world), mode);
        Trial::seen_from(
            &self.view.camera.camera_from_world(),
            (primitive, policy),
            (*pixel, *link as u8),
            grasp_in_world,
            &verdict,
        )
    }

    /// The record of this scene with the given trials and its picture at `side` x `side` pixels.
    #[must_use]
    pub fn record(&self, trials: Vec<Trial>, side: usize) -> SceneRecord {
        SceneRecord {
            info: self.info.clone(),
            camera: self.view.camera,
            rgb: self.view.rgb_at(side),
            depth: self.view.depth.iter().map(|&d| SceneRecord::quantise_depth(d)).collect(),
            link: self.view.link.clone(),
            trials,
        }
    }
}

/// Makes scene `index` of a recipe with all its trials; `None` if it cannot be made, see [`Preparer::prepare`].
///
/// # Errors
/// If an object cannot be loaded.
pub fn collect_scene(preparer: &Preparer, index: u64) -> Result<Option<SceneRecord>, CollectError> {
    let Some(prep) = preparer.prepare(index)? else { return Ok(None) };
    let recipe = preparer.recipe();
    let Some(sampler) = Sampler::new(&prep.settled, &prep.view) else { return Ok(None) };
    // Primitives take turns over the trials of all scenes: began each scene with the first one, it would get more trials.
    let turns = recipe.primitives.len().max(1);
    let first = (index % turns as u64) as usize * (recipe.trials % turns);
    let trial = |n: usize| {
        let seed: Seed = prep.info.seed.child("trial", n as u64);
        let rng = &mut seed.rng();
        let primitive = recipe.primitives[(first + n) % turns];
        let (policy, candidate) = if rng.random_bool(recipe.guided.clamp(0.0, 1.0)) {
            (Policy::Guided, sampler.guided_in_view(primitive, rng))
        } else {
            (Policy::Random, sampler.random(rng))
        };
        prep.run(primitive, policy, &candidate, recipe.mode())
    };
    let count = if recipe.primitives.is_empty() { 0 } else { recipe.trials };
    let trials = (0..count).into_par_iter().map(trial).collect();
    Ok(Some(prep.record(trials, recipe.picture_side)))
}
