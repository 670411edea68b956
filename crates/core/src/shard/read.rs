//! A shard to scenes.

use std::collections::HashMap;
use std::fs::File;
use std::path::{Path, PathBuf};

use memmap2::Mmap;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use safetensors::tensor::{Dtype, SafeTensors};

use super::scene::{check_camera, check_rgb_side, foreground};
use super::{DEPTH_PIXELS, DEPTH_SIDE, FORMAT, Header, METADATA_KEY, SceneInfo, SceneRecord, ShardError};
use crate::{Camera, Grasp, ImageSize, Intrinsics, Invalid, Pixel, Policy, Primitive, Trial, Verdict};

/// A shard opened for reading. Only what is asked for is read from disk.
#[derive(Debug)]
pub struct Shard {
    path: PathBuf,
    map: Mmap,
    infos: Vec<SceneInfo>,
    /// Byte ranges of the tensors in the map.
    ranges: HashMap<String, std::ops::Range<usize>>,
    trial_start: Vec<usize>,
    rgb_side: usize,
}

impl Shard {
    /// Opens and checks a shard: format, tensors, shapes, labels.
    ///
    /// # Errors
    /// Any [`ShardError`].
    pub fn open(path: &Path) -> Result<Self, ShardError> {
        let io = |source| ShardError::Io { path: path.to_owned(), source };
        let damaged = |why: String| ShardError::Damaged { path: path.to_owned(), why };
        let file = File::open(path).map_err(io)?;
        // SAFETY: shards are written once under another name and renamed; nothing truncates them while in use. If
        // someone does, the process receives SIGBUS, as with any memory-mapped data.
        #[allow(unsafe_code, reason = "memory maps have no safe constructor")]
        let map = unsafe { Mmap::map(&file) }.map_err(io)?;
        let (_, metadata) = SafeTensors::read_metadata(&map).map_err(|e| damaged(e.to_string()))?;
        let header = metadata
            .metadata()
            .as_ref()
            .and_then(|m| m.get(METADATA_KEY))
            .ok_or_else(|| damaged("not a shard of where2act".to_owned()))?;
        let header: serde_json::Value = serde_json::from_str(header).map_err(|e| damaged(e.to_string()))?;
        if header["format"] != serde_json::json!(FORMAT) {
            return Err(ShardError::Version { path: path.to_owned(), found: header["format"].to_string() });
        }
        let header: Header = serde_json::from_value(header).map_err(|e| damaged(e.to_string()))?;
        let tensors = SafeTensors::deserialize(&map).map_err(|e| damaged(e.to_string()))?;
        let s = header.scenes.len();
        let starts = tensors.tensor("trial_start").map_err(|e| damaged(e.to_string()))?;
        let trial_start: Vec<usize> = starts
            .data()
            .chunks_exact(4)
            .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize)
            .collect();
        let rising = trial_start.windows(2).all(|w| w[0] <= w[1]);
        if trial_start.len() != s + 1 || trial_start[0] != 0 || !rising {
            return Err(damaged("trial_start does not count the trials".to_owned()));
        }
        let t = trial_start[s];
        let rgb = tensors.tensor("rgb").map_err(|e| damaged(e.to_string()))?;
        let rgb_side = rgb.shape().get(1).copied().unwrap_or_default();
        check_rgb_side(rgb_side).map_err(damaged)?;
        let mut ranges = HashMap::new();
        let base = map.as_ptr() as usize;
        for (name, dtype, shape) in [
            ("rgb", Dtype::U8, vec![s, rgb_side, rgb_side, 3]),
            ("depth", Dtype::U16, vec![s, DEPTH_SIDE, DEPTH_SIDE]),
            ("link", Dtype::U8, vec![s, DEPTH_SIDE, DEPTH_SIDE]),
            ("camera", Dtype::F32, vec![s, 11]),
            ("label", Dtype::U8, vec![t, 5]),
            ("pixel", Dtype::U16, vec![t, 2]),
            ("grasp", Dtype::F32, vec![t, 9]),
            ("outcome", Dtype::F32, vec![t, 5]),
        ] {
            let tensor = tensors.tensor(name).map_err(|e| damaged(e.to_string()))?;
            if tensor.dtype() != dtype || tensor.shape() != shape {
                let found = (tensor.dtype(), tensor.shape());
                return Err(damaged(format!("tensor {name}: {found:?}, expected {:?}", (dtype, shape))));
            }
            let start = tensor.data().as_ptr() as usize - base;
            ranges.insert(name.to_owned(), start..start + tensor.data().len());
        }
        let shard = Self { path: path.to_owned(), map, infos: header.scenes, ranges, trial_start, rgb_side };
        for scene in 0..s {
            check_camera(&shard.camera(scene)).map_err(|why| damaged(format!("scene {scene}: {why}")))?;
            shard.trials(scene)?;
        }
        Ok(shard)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The scenes of this shard.
    #[must_use]
    pub fn scenes(&self) -> &[SceneInfo] {
        &self.infos
    }

    /// The camera of a scene's 448 picture.
    ///
    /// # Panics
    /// If `scene` is out of range, as all accessors below.
    #[must_use]
    pub fn camera(&self, scene: usize) -> Camera {
        let c = floats(self.row("camera", scene, 44));
        Camera {
            size: ImageSize::square(DEPTH_SIDE),
            intrinsics: Intrinsics { fx: c[0], fy: c[1], cx: c[2], cy: c[3] },
            world_from_camera: Isometry3::from_parts(
                Translation3::new(c[4], c[5], c[6]),
                // Kept as stored: normalising again would change the last bit.
                UnitQuaternion::new_unchecked(Quaternion::new(c[10], c[7], c[8], c[9])),
            ),
        }
    }

    /// Width and height of the stored pictures: 448, or what divides it.
    #[must_use]
    pub fn rgb_side(&self) -> usize {
        self.rgb_side
    }

    /// Colours, [`Self::rgb_side`] squared.
    #[must_use]
    pub fn rgb(&self, scene: usize) -> Vec<[u8; 3]> {
        self.row("rgb", scene, self.rgb_side.pow(2) * 3).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
    }

    /// Depth at 448x448 in [`DEPTH_UNIT`](super::DEPTH_UNIT).
    #[must_use]
    pub fn depth(&self, scene: usize) -> Vec<u16> {
        let bytes = self.row("depth", scene, DEPTH_PIXELS * 2);
        bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    }

    /// Pixels of the depth map that show the object, with their points in the camera frame.
    #[must_use]
    pub fn foreground(&self, scene: usize) -> Vec<(Pixel, Point3<f32>)> {
        foreground(&self.camera(scene), &self.depth(scene))
    }

    /// Link ids at 448x448, straight from the map.
    #[must_use]
    pub fn link(&self, scene: usize) -> &[u8] {
        self.row("link", scene, DEPTH_PIXELS)
    }

    /// Trials of a scene.
    ///
    /// # Errors
    /// [`ShardError::Damaged`] for numbers that mean nothing; never for a shard that [`Self::open`] accepted.
    pub fn trials(&self, scene: usize) -> Result<Vec<Trial>, ShardError> {
        (self.trial_start[scene]..self.trial_start[scene + 1])
            .map(|t| {
                self.trial(t).ok_or_else(|| ShardError::Damaged {
                    path: self.path.clone(),
                    why: format!("trial {t} of scene {scene} holds impossible values"),
                })
            })
            .collect()
    }

    fn trial(&self, t: usize) -> Option<Trial> {
        let label = self.row("label", t, 5);
        let pixel = self.row("pixel", t, 4);
        let g = floats(self.row("grasp", t, 36));
        let o = floats(self.row("outcome", t, 20));
        let pixel = Pixel {
            u: u32::from(u16::from_le_bytes([pixel[0], pixel[1]])),
            v: u32::from(u16::from_le_bytes([pixel[2], pixel[3]])),
        };
        let invalid = if label[3] == 0 { None } else { Some(Invalid::from_number(label[3])?) };
        let inside = (pixel.u as usize) < DEPTH_SIDE && (pixel.v as usize) < DEPTH_SIDE;
        (inside && label[4] <= 1 && g.iter().all(|x| x.is_finite())).then_some(())?;
        Some(Trial {
            primitive: Primitive::from_number(label[0])?,
            policy: Policy::from_number(label[1])?,
            pixel,
            link: label[2],
            grasp_in_camera: Grasp::new(
                Point3::new(g[0], g[1], g[2]),
                Vector3::new(g[3], g[4], g[5]),
                Vector3::new(g[6], g[7], g[8]),
            ),
            verdict: Verdict {
                invalid,
                q_start: o[0],
                q_end: o[1],
                motion: Vector3::new(o[2], o[3], o[4]),
                success: label[4] == 1,
            },
        })
    }

    /// Everything about a scene.
    ///
    /// # Errors
    /// As [`Self::trials`].
    pub fn record(&self, scene: usize) -> Result<SceneRecord, ShardError> {
        Ok(SceneRecord {
            info: self.infos[scene].clone(),
            camera: self.camera(scene),
            rgb: self.rgb(scene),
            depth: self.depth(scene),
            link: self.link(scene).to_vec(),
            trials: self.trials(scene)?,
        })
    }

    fn row(&self, tensor: &str, row: usize, bytes: usize) -> &[u8] {
        let start = self.ranges[tensor].start + row * bytes;
        &self.map[start..start + bytes]
    }
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}
