//! Data sets on disk: a folder of shards beside a manifest.
//!
//! A shard is one safetensors file of up to some dozens of scenes, read through a memory map. A scene is one view
//! of one settled object and the trials made on it. Tensors of a shard with `scenes` scenes and `trials` trials:
//!
//! | tensor | type | shape |
//! | --- | --- | --- |
//! | `rgb` | u8 | `[scenes, side, side, 3]`, sRGB; a side of 224 unless more was wanted, see [`Shard::rgb_side`] |
//! | `depth` | u16 | `[scenes, 448, 448]`, in units of [`DEPTH_UNIT`], 0 = background |
//! | `link` | u8 | `[scenes, 448, 448]`, 0 = background, else 1 + index of the link |
//! | `camera` | f32 | `[scenes, 11]`: fx, fy, cx, cy (of the 448 picture); translation; quaternion xyzw of world_from_camera |
//! | `trial_start` | u32 | `[scenes + 1]`: trials of scene s are `trial_start[s]..trial_start[s + 1]` |
//! | `label` | u8 | `[trials, 5]`: primitive, policy, link, invalid (0 = valid), success |
//! | `pixel` | u16 | `[trials, 2]`: u, v in the 448 picture |
//! | `grasp` | f32 | `[trials, 9]`: point, approach, forward in the camera frame |
//! | `outcome` | f32 | `[trials, 5]`: q before, q after, motion of the touched point in the camera frame |
//!
//! The file's metadata holds one entry, `where2act`: JSON with `format` and `scenes`, a list of [`SceneInfo`]. A scene
//! takes 753 kB, with pictures of 448 pixels 1.2 MB, and 65 bytes a trial.

mod manifest;
mod read;
mod scene;
#[cfg(test)]
mod tests;
mod write;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::Camera;
pub use manifest::{Manifest, list_shards};
pub use read::Shard;
pub use scene::{Freedom, SceneInfo, SceneRecord};
pub use write::write_shard;

/// Version of the shard and manifest layout.
pub const FORMAT: u32 = 1;
/// Side of the stored colour picture unless more is wanted: what the published network sees.
pub const RGB_SIDE: usize = 224;
/// Side of the stored depth map and link ids: the published camera.
pub const DEPTH_SIDE: usize = Camera::PUBLISHED_SIDE;
/// Metres per unit of the stored depth: 0.2 mm reaches 13 m.
pub const DEPTH_UNIT: f32 = 2e-4;

const DEPTH_PIXELS: usize = DEPTH_SIDE * DEPTH_SIDE;

/// What went wrong with a shard or manifest.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// The file system said no.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
    /// The file is not what it should be.
    #[error("{}: damaged: {why}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The file was written by another version.
    #[error("{}: format version {found}, expected {FORMAT}", path.display())]
    Version {
        /// Which file.
        path: PathBuf,
        /// Its version.
        found: String,
    },
}

/// The one metadata entry of a shard.
#[derive(Serialize, Deserialize)]
struct Header {
    format: u32,
    scenes: Vec<SceneInfo>,
}

const METADATA_KEY: &str = "where2act";
