//! Data sets on disk: a folder of shards beside a manifest.
//!
//! A shard is one safetensors file of up to some dozens of scenes, read through a memory map. A scene is one view
//! of one settled object and the trials made on it. Tensors of a shard with `scenes` scenes and `trials` trials:
//!
//! | tensor | type | shape |
//! | --- | --- | --- |
//! | `rgb` | u8 | `[scenes, 224, 224, 3]`, sRGB |
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
//! takes 753 kB and 73 bytes a trial.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use memmap2::Mmap;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use crate::{
    Camera, Category, Grasp, ImageSize, Intrinsics, Invalid, Pixel, Policy, Primitive, Seed, Trial, Verdict,
    write_whole,
};

/// Version of the shard and manifest layout.
pub const FORMAT: u32 = 1;
/// Side of the stored colour picture: what the RGB network sees.
pub const RGB_SIDE: usize = 224;
/// Side of the stored depth map and link ids: the published camera.
pub const DEPTH_SIDE: usize = Camera::PUBLISHED_SIDE;
/// Metres per unit of the stored depth: 0.2 mm reaches 13 m.
pub const DEPTH_UNIT: f32 = 2e-4;

const RGB_PIXELS: usize = RGB_SIDE * RGB_SIDE;
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

/// Who a scene is, for splitting and for repeating it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneInfo {
    /// Number of the scene in its data set.
    pub index: u64,
    /// Seed of the scene: everything random in it derives from it.
    pub seed: Seed,
    /// Name of the object, unique in the data set; splits go by it.
    pub object: String,
    /// Category of the object, if known.
    pub category: Option<Category>,
    /// Settled joint positions, one per movable link.
    pub q: Vec<f32>,
    /// How each movable link can move from there; empty in data that was collected before this was written down.
    #[serde(default)]
    pub freedoms: Vec<Freedom>,
}

/// How a movable link can move from where it stands, seen from the scene's camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Freedom {
    /// Whether it turns about its axis or slides along it.
    pub turns: bool,
    /// Axis of its joint, camera frame.
    pub axis: Unit<Vector3<f32>>,
    /// A point on the axis, camera frame, metres.
    pub point: Point3<f32>,
    /// How far its position can fall and rise, radians or metres.
    pub room: [f32; 2],
}

impl Freedom {
    /// How fast a point of the link moves when its joint's position rises by 1 rad or 1 m a second: metres a second,
    /// camera frame.
    #[must_use]
    pub fn velocity(&self, point: &Point3<f32>) -> Vector3<f32> {
        if self.turns { self.axis.cross(&(point - self.point)) } else { self.axis.into_inner() }
    }
}

/// One view of one settled object and its trials.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneRecord {
    /// Who it is.
    pub info: SceneInfo,
    /// The camera of the 448 picture.
    pub camera: Camera,
    /// Colours at 224x224, sRGB.
    pub rgb: Vec<[u8; 3]>,
    /// Depth at 448x448 in [`DEPTH_UNIT`]; 0 = background.
    pub depth: Vec<u16>,
    /// Link ids at 448x448: 0 = background, else 1 + index of the link.
    pub link: Vec<u8>,
    /// Trials on this view.
    pub trials: Vec<Trial>,
}

impl SceneRecord {
    /// Depth in metres; 0 = background.
    #[must_use]
    pub fn depth_metres(&self) -> Vec<f32> {
        self.depth.iter().map(|&d| f32::from(d) * DEPTH_UNIT).collect()
    }

    /// Pixels of the depth map that show the object, row by row, with their points in the camera frame.
    #[must_use]
    pub fn foreground(&self) -> Vec<(Pixel, Point3<f32>)> {
        foreground(&self.camera, &self.depth)
    }

    /// Metres to stored units; anything not representable becomes background.
    #[must_use]
    pub fn quantise_depth(metres: f32) -> u16 {
        let units = (metres / DEPTH_UNIT).round();
        if units >= 1.0 && units <= f32::from(u16::MAX) { units as u16 } else { 0 }
    }
}

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

/// Shards present in a data folder, in order of their numbers.
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

/// Writes scenes as one shard, whole or not at all.
///
/// # Errors
/// [`ShardError::Io`]; [`ShardError::Damaged`] if a buffer of a scene has the wrong size.
pub fn write_shard(path: &Path, scenes: &[SceneRecord]) -> Result<(), ShardError> {
    let damaged = |why: String| ShardError::Damaged { path: path.to_owned(), why };
    let mut columns = Columns::default();
    for scene in scenes {
        let sizes = (scene.rgb.len(), scene.depth.len(), scene.link.len());
        if sizes != (RGB_PIXELS, DEPTH_PIXELS, DEPTH_PIXELS) {
            return Err(damaged(format!("scene {}: buffers of {sizes:?} pixels", scene.info.index)));
        }
        columns.push(scene);
    }
    let header = Header { format: FORMAT, scenes: scenes.iter().map(|s| s.info.clone()).collect() };
    let header = serde_json::to_string(&header).map_err(|e| damaged(e.to_string()))?;
    // One entry only: the map's order is random and shards must be the same bit for bit.
    let metadata = HashMap::from([(METADATA_KEY.to_owned(), header)]);
    let (s, t, starts) = (scenes.len(), columns.trials, columns.starts());
    let view = |dtype, shape: &[usize], data| {
        TensorView::new(dtype, shape.to_vec(), data).map_err(|e| damaged(e.to_string()))
    };
    let tensors = [
        ("rgb", view(Dtype::U8, &[s, RGB_SIDE, RGB_SIDE, 3], &columns.rgb)?),
        ("depth", view(Dtype::U16, &[s, DEPTH_SIDE, DEPTH_SIDE], &columns.depth)?),
        ("link", view(Dtype::U8, &[s, DEPTH_SIDE, DEPTH_SIDE], &columns.link)?),
        ("camera", view(Dtype::F32, &[s, 11], &columns.camera)?),
        ("trial_start", view(Dtype::U32, &[s + 1], &starts)?),
        ("label", view(Dtype::U8, &[t, 5], &columns.label)?),
        ("pixel", view(Dtype::U16, &[t, 2], &columns.pixel)?),
        ("grasp", view(Dtype::F32, &[t, 9], &columns.grasp)?),
        ("outcome", view(Dtype::F32, &[t, 5], &columns.outcome)?),
    ];
    let bytes = safetensors::serialize(tensors, Some(metadata)).map_err(|e| damaged(e.to_string()))?;
    write_whole(path, |w| w.write_all(&bytes))
        .map_err(|source| ShardError::Io { path: path.to_owned(), source })
}

/// The one metadata entry of a shard.
#[derive(Serialize, Deserialize)]
struct Header {
    format: u32,
    scenes: Vec<SceneInfo>,
}

const METADATA_KEY: &str = "where2act";

/// A shard's tensors as bytes.
#[derive(Default)]
struct Columns {
    rgb: Vec<u8>,
    depth: Vec<u8>,
    link: Vec<u8>,
    camera: Vec<u8>,
    ends: Vec<u32>,
    label: Vec<u8>,
    pixel: Vec<u8>,
    grasp: Vec<u8>,
    outcome: Vec<u8>,
    trials: usize,
}

impl Columns {
    fn push(&mut self, scene: &SceneRecord) {
        self.rgb.extend(scene.rgb.iter().flatten());
        self.depth.extend(scene.depth.iter().flat_map(|d| d.to_le_bytes()));
        self.link.extend(&scene.link);
        let (k, pose) = (scene.camera.intrinsics, scene.camera.world_from_camera);
        let (t, q) = (pose.translation.vector, pose.rotation.coords);
        push_f32(&mut self.camera, &[k.fx, k.fy, k.cx, k.cy, t.x, t.y, t.z, q.x, q.y, q.z, q.w]);
        for trial in &scene.trials {
            let (v, g) = (&trial.verdict, &trial.grasp_in_camera);
            let invalid = v.invalid.map_or(0, |reason| reason as u8);
            self.label.extend([
                trial.primitive as u8,
                trial.policy as u8,
                trial.link,
                invalid,
                u8::from(v.success),
            ]);
            for coordinate in [trial.pixel.u, trial.pixel.v] {
                self.pixel.extend((coordinate as u16).to_le_bytes());
            }
            push_f32(&mut self.grasp, g.point.coords.as_slice());
            push_f32(&mut self.grasp, g.approach().as_slice());
            push_f32(&mut self.grasp, g.forward().as_slice());
            push_f32(&mut self.outcome, &[v.q_start, v.q_end, v.motion.x, v.motion.y, v.motion.z]);
        }
        self.trials += scene.trials.len();
        self.ends.push(self.trials as u32);
    }

    fn starts(&self) -> Vec<u8> {
        std::iter::once(&0u32).chain(&self.ends).flat_map(|n| n.to_le_bytes()).collect()
    }
}

fn push_f32(bytes: &mut Vec<u8>, values: &[f32]) {
    bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
}

/// A shard opened for reading. Only what is asked for is read from disk.
#[derive(Debug)]
pub struct Shard {
    path: PathBuf,
    map: Mmap,
    infos: Vec<SceneInfo>,
    /// Byte ranges of the tensors in the map.
    ranges: HashMap<String, std::ops::Range<usize>>,
    trial_start: Vec<usize>,
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
        let mut ranges = HashMap::new();
        let base = map.as_ptr() as usize;
        for (name, dtype, shape) in [
            ("rgb", Dtype::U8, vec![s, RGB_SIDE, RGB_SIDE, 3]),
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
        let shard = Self { path: path.to_owned(), map, infos: header.scenes, ranges, trial_start };
        for scene in 0..s {
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

    /// Colours at 224x224.
    #[must_use]
    pub fn rgb(&self, scene: usize) -> Vec<[u8; 3]> {
        self.row("rgb", scene, RGB_PIXELS * 3).chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect()
    }

    /// Depth at 448x448 in [`DEPTH_UNIT`].
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

fn foreground(camera: &Camera, depth: &[u16]) -> Vec<(Pixel, Point3<f32>)> {
    let seen = depth.iter().enumerate().filter(|(_, depth)| **depth > 0);
    seen.map(|(i, depth)| {
        let pixel = Pixel { u: (i % DEPTH_SIDE) as u32, v: (i / DEPTH_SIDE) as u32 };
        (pixel, camera.intrinsics.pixel_to_point(pixel, f32::from(*depth) * DEPTH_UNIT))
    })
    .collect()
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(index: u64, trials: usize) -> SceneRecord {
        let size = ImageSize::square(DEPTH_SIDE);
        let camera = Camera::orbit(Point3::origin(), 5.0, index as f32, 0.6, size, Camera::PUBLISHED_FOV);
        let grasp = Grasp::new(Point3::new(0.1, 0.2, 5.0), Vector3::z(), Vector3::x());
        let verdict = Verdict {
            invalid: None,
            q_start: 0.0,
            q_end: 0.3,
            motion: Vector3::new(0.0, 0.0, 0.1),
            success: true,
        };
        let trial = |t: usize| Trial {
            primitive: Primitive::ALL[t % 6],
            policy: Policy::Guided,
            pixel: Pixel { u: t as u32, v: 447 },
            link: 2,
            grasp_in_camera: grasp,
            verdict: Verdict { invalid: (t == 1).then_some(Invalid::HandFirst), success: t != 1, ..verdict },
        };
        SceneRecord {
            info: SceneInfo {
                index,
                seed: Seed(index),
                object: format!("Safe:{index}"),
                category: Some(Category::Safe),
                q: vec![0.5],
                freedoms: vec![Freedom {
                    turns: true,
                    axis: Unit::new_normalize(Vector3::new(0.3, -0.2, 0.7)),
                    point: Point3::new(0.1, 0.7, 1.3),
                    room: [0.5, 1.1],
                }],
            },
            camera,
            rgb: vec![[index as u8, 2, 3]; RGB_PIXELS],
            depth: (0..DEPTH_PIXELS).map(|i| (i % 60_000) as u16).collect(),
            link: (0..DEPTH_PIXELS).map(|i| (i % 3) as u8).collect(),
            trials: (0..trials).map(trial).collect(),
        }
    }

    #[test]
    fn scenes_survive_the_disk_and_files_are_the_same_every_time() {
        let folder = tempfile::tempdir().unwrap();
        let scenes = [scene(1, 3), scene(2, 0), scene(3, 7)];
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        write_shard(&a, &scenes).unwrap();
        write_shard(&b, &scenes).unwrap();
        assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap());
        let shard = Shard::open(&a).unwrap();
        for (i, scene) in scenes.iter().enumerate() {
            assert_eq!(shard.record(i).unwrap(), *scene);
        }
    }

    #[test]
    fn a_door_moves_across_its_radius_and_a_drawer_along_its_axis() {
        let axis = Vector3::z_axis();
        let door = Freedom { turns: true, axis, point: Point3::new(1.0, 0.0, 5.0), room: [0.0, 1.5] };
        assert_eq!(door.velocity(&Point3::new(1.5, 0.0, 0.0)), Vector3::new(0.0, 0.5, 0.0));
        let drawer = Freedom { turns: false, ..door };
        assert_eq!(drawer.velocity(&Point3::new(1.5, 0.0, 0.0)), Vector3::z());
    }

    #[test]
    fn damage_and_other_versions_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shard");
        write_shard(&path, &[scene(1, 3)]).unwrap();
        let good = fs::read(&path).unwrap();
        fs::write(&path, &good[..good.len() - 1000]).unwrap();
        assert!(matches!(Shard::open(&path), Err(ShardError::Damaged { .. })));
        let header = String::from_utf8_lossy(&good[8..2000]).replace("format\\\":1", "format\\\":9");
        let mut other = good.clone();
        other[8..8 + 100].copy_from_slice(&header.as_bytes()[..100]);
        fs::write(&path, other).unwrap();
        assert!(matches!(Shard::open(&path), Err(ShardError::Version { .. })));
        fs::write(&path, b"").unwrap();
        assert!(Shard::open(&path).is_err());
    }
}
