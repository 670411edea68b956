use std::fs;

use nalgebra::{Point3, Unit, Vector3};

use super::*;
use crate::{
    Category, Grasp, ImageSize, Intrinsics, Invalid, Pixel, Policy, Primitive, Seed, Trial, Verdict,
};

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
        rgb: vec![[index as u8, 2, 3]; RGB_SIDE * RGB_SIDE],
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
fn pictures_may_be_as_large_as_depth_maps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard");
    let large = |index| SceneRecord {
        rgb: (0..DEPTH_PIXELS).map(|i| [i as u8, (i >> 8) as u8, 3]).collect(),
        ..scene(index, 2)
    };
    write_shard(&path, &[large(1), large(2)]).unwrap();
    let shard = Shard::open(&path).unwrap();
    assert_eq!((shard.rgb_side(), shard.record(1).unwrap()), (DEPTH_SIDE, large(2)));
    let mixed = write_shard(&path, &[large(1), scene(2, 2)]).unwrap_err().to_string();
    assert!(mixed.contains("scene 2") && mixed.contains("expected [200704"), "{mixed}");
    let odd = write_shard(&path, &[SceneRecord { rgb: vec![[0; 3]; 100 * 100], ..scene(5, 0) }]).unwrap_err();
    assert!(odd.to_string().contains("pictures of 100 pixels"), "{odd}");
}

#[test]
fn a_hand_survives_the_disk_as_nearly_as_its_axes_are_orthonormal() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard");
    let mut kept = scene(1, 6);
    for (t, trial) in (0..).zip(&mut kept.trials) {
        let turn = 0.7 * t as f32;
        let (approach, forward) = (Vector3::new(turn.sin(), -0.5, 0.8), Vector3::new(0.2, 0.9, turn.cos()));
        trial.grasp_in_camera = Grasp::new(Point3::new(0.1, 0.2, 5.0 / 3.0), approach, forward);
    }
    write_shard(&path, std::slice::from_ref(&kept)).unwrap();
    let read = Shard::open(&path).unwrap().record(0).unwrap();
    for (found, expected) in read.trials.iter().zip(&kept.trials) {
        let (found, expected) = (found.grasp_in_camera, expected.grasp_in_camera);
        assert_eq!(found.point, expected.point);
        let difference = (found.rotation.matrix() - expected.rotation.matrix()).amax();
        assert!(difference < 1e-6, "{difference}");
    }
}

/// As they lie in a shard.
fn focal_lengths(scene: &SceneRecord) -> Vec<u8> {
    let Intrinsics { fx, fy, .. } = scene.camera.intrinsics;
    [fx, fy].into_iter().flat_map(f32::to_le_bytes).collect()
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
    // A camera of zeros: its numbers are the only ones like these.
    let lengths = focal_lengths(&scene(1, 3));
    let at = good.windows(8).position(|bytes| *bytes == lengths).unwrap();
    let mut blind = good.clone();
    blind[at..at + 8].fill(0);
    fs::write(&path, blind).unwrap();
    assert!(Shard::open(&path).unwrap_err().to_string().contains("focal"));
}

#[test]
fn what_could_not_be_read_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard");
    let refuses = |word: &str, change: fn(&mut SceneRecord)| {
        let mut scene = scene(7, 3);
        change(&mut scene);
        let error = write_shard(&path, &[self::scene(1, 3), scene]).expect_err(word).to_string();
        assert!(error.contains("scene 7") && error.contains(word), "{error}");
        assert!(!path.exists());
    };
    refuses("pixels", |s| s.link.truncate(10));
    refuses("focal", |s| s.camera.intrinsics.fx = 0.0);
    refuses("rotation", |s| s.camera.world_from_camera.translation.x = f32::NAN);
    refuses("NaN", |s| s.info.q[0] = f32::NAN);
    refuses("inf", |s| s.info.freedoms[0].room[1] = f32::INFINITY);
    refuses("NaN", |s| s.info.freedoms[0].axis = Unit::new_unchecked(Vector3::repeat(f32::NAN)));
    refuses("inf", |s| s.info.freedoms[0].point.y = f32::INFINITY);
    refuses("trial 2", |s| s.trials[2].pixel.v = 448);
    refuses("trial 1", |s| s.trials[1].grasp_in_camera.point.x = f32::NAN);
}
