//! Scenes to a shard.

use std::collections::HashMap;
use std::io::Write;
use std::path::Path;

use safetensors::tensor::{Dtype, TensorView};

use super::scene::{check_camera, check_rgb_side};
use super::{
    DEPTH_PIXELS, DEPTH_SIDE, FORMAT, Freedom, Header, METADATA_KEY, RGB_SIDE, SceneInfo, SceneRecord,
    ShardError,
};
use crate::{Pixel, write_whole};

/// Writes scenes as one shard, whole or not at all.
///
/// # Errors
/// [`ShardError::Io`]; [`ShardError::Damaged`] for a scene that [`Shard::open`](super::Shard::open) would refuse: a
/// buffer of the wrong size, a number that is not finite, a pixel outside of the picture.
pub fn write_shard(path: &Path, scenes: &[SceneRecord]) -> Result<(), ShardError> {
    let damaged = |why: String| ShardError::Damaged { path: path.to_owned(), why };
    let mut columns = Columns::default();
    let side = scenes.first().map_or(RGB_SIDE, SceneRecord::rgb_side);
    for scene in scenes {
        check(scene, side).map_err(|why| damaged(format!("scene {}: {why}", scene.info.index)))?;
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
        ("rgb", view(Dtype::U8, &[s, side, side, 3], &columns.rgb)?),
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

/// What could be written but not be read: JSON has no word for numbers that are not finite. `side` is that of the first
/// scene's picture, which all of a shard have.
fn check(scene: &SceneRecord, side: usize) -> Result<(), String> {
    check_rgb_side(side)?;
    let (found, expected) =
        ([scene.rgb.len(), scene.depth.len(), scene.link.len()], [side.pow(2), DEPTH_PIXELS, DEPTH_PIXELS]);
    if found != expected {
        return Err(format!("buffers of {found:?} pixels, expected {expected:?}"));
    }
    check_camera(&scene.camera)?;
    let finite = |numbers: &[f32]| numbers.iter().all(|x| x.is_finite());
    let SceneInfo { q, freedoms, .. } = &scene.info;
    if !finite(q) {
        return Err(format!("joint positions {q:?}, expected finite numbers"));
    }
    let known =
        |f: &Freedom| finite(f.axis.as_slice()) && finite(f.point.coords.as_slice()) && finite(&f.room);
    if let Some(freedom) = freedoms.iter().find(|f| !known(f)) {
        return Err(format!("{freedom:?}, expected finite numbers"));
    }
    for (n, trial) in scene.trials.iter().enumerate() {
        let (Pixel { u, v }, grasp) = (trial.pixel, &trial.grasp_in_camera);
        if u.max(v) as usize >= DEPTH_SIDE {
            return Err(format!("trial {n}: pixel {u},{v}, expected numbers below {DEPTH_SIDE}"));
        }
        if ![grasp.point.coords, grasp.approach(), grasp.forward()].iter().all(|v| finite(v.as_slice())) {
            return Err(format!("trial {n}: {grasp:?}, expected finite numbers"));
        }
    }
    Ok(())
}

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
