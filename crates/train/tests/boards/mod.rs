//! A tiny data set made up for tests: slanted boards whose upper half can be pushed, and only from above. No physics,
//! so that tests take seconds and the truth is known.
#![allow(dead_code, reason = "every test program uses some of it")]

use std::ops::Range;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use where2act_core::shard::{
    DEPTH_SIDE, FORMAT, Freedom, Manifest, RGB_SIDE, SceneInfo, SceneRecord, write_shard,
};
use where2act_core::{Camera, Category, Grasp, ImageSize, Pixel, Policy, Primitive, Seed, Trial, Verdict};

/// Scenes of a full shard.
pub(crate) const PER_SHARD: u64 = 8;

/// One board, pushed forty times.
pub(crate) fn board(index: u64) -> SceneRecord {
    let mut rng = Seed(7).child("board", index).rng();
    let size = ImageSize::square(DEPTH_SIDE);
    let camera =
        Camera::orbit(Point3::origin(), 5.0, rng.random_range(0.0..6.0), 0.7, size, Camera::PUBLISHED_FOV);
    let slant = rng.random_range(-0.2f32..0.2);
    let inside = |i: usize| (100..350).contains(&(i % DEPTH_SIDE)) && (100..350).contains(&(i / DEPTH_SIDE));
    let metres = |i: usize| 5.0 + slant * (i % DEPTH_SIDE) as f32 / DEPTH_SIDE as f32;
    let depth = (0..size.pixels())
        .map(|i| if inside(i) { SceneRecord::quantise_depth(metres(i)) } else { 0 })
        .collect();
    let trial = |rng: &mut rand_chacha::ChaCha8Rng| {
        let pixel = Pixel { u: rng.random_range(101..349), v: rng.random_range(101..349) };
        let from_above = rng.random_bool(0.5);
        let approach = Vector3::new(0.0, if from_above { 0.5 } else { -0.5 }, 0.8);
        let point = camera.intrinsics.pixel_to_point(pixel, metres(size.index(pixel)));
        let success = pixel.v < 225 && from_above;
        Trial {
            primitive: Primitive::Pushing,
            policy: Policy::Random,
            pixel,
            link: 1,
            grasp_in_camera: Grasp::new(point, approach, Vector3::x()),
            verdict: Verdict { invalid: None, q_start: 0.0, q_end: 0.0, motion: Vector3::zeros(), success },
        }
    };
    SceneRecord {
        info: SceneInfo {
            index,
            seed: Seed(index),
            object: format!("Door:{index}"),
            category: Some(Category::Door),
            q: vec![0.0],
            // It can be pushed away from the camera.
            freedoms: vec![Freedom {
                turns: false,
                axis: Vector3::z_axis(),
                point: Point3::origin(),
                room: [0.0, 0.3],
            }],
        },
        camera,
        rgb: (0..RGB_SIDE * RGB_SIDE).map(|i| [(i / RGB_SIDE) as u8, 128, (i % RGB_SIDE) as u8]).collect(),
        depth,
        link: (0..size.pixels()).map(|i| if inside(i) { 2 } else { 0 }).collect(),
        trials: (0..40).map(|_| trial(&mut rng)).collect(),
    }
}

/// A data set of the boards of these numbers.
pub(crate) fn write(folder: &Path, boards: Range<u64>) {
    write_records(folder, boards, board);
}

/// The same boards, their pictures as large as their depth maps.
pub(crate) fn write_with_large_pictures(folder: &Path, boards: Range<u64>) {
    let colour = |i: usize| [(i / DEPTH_SIDE / 2) as u8, 128, (i % DEPTH_SIDE / 2) as u8];
    let rgb: Vec<_> = (0..DEPTH_SIDE * DEPTH_SIDE).map(colour).collect();
    write_records(folder, boards, |index| SceneRecord { rgb: rgb.clone(), ..board(index) });
}

/// The same boards, which nobody has pushed.
pub(crate) fn write_without_trials(folder: &Path, boards: Range<u64>) {
    write_records(folder, boards, |index| SceneRecord { trials: Vec::new(), ..board(index) });
}

fn write_records(folder: &Path, boards: Range<u64>, record: impl Fn(u64) -> SceneRecord) {
    let manifest = Manifest {
        format: FORMAT,
        version: "test".to_owned(),
        seed: Seed(7),
        scenes: boards.end - boards.start,
        scenes_per_shard: PER_SHARD,
        recipe: serde_json::Value::Null,
    };
    manifest.save(folder).unwrap();
    for (shard, first) in boards.clone().step_by(PER_SHARD as usize).enumerate() {
        let records: Vec<_> = (first..(first + PER_SHARD).min(boards.end)).map(&record).collect();
        write_shard(&Manifest::shard_path(folder, shard as u64), &records).unwrap();
    }
}
