//! A moving picture of a trial.

use std::f32::consts::TAU;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, DynamicImage, Frame};
use nalgebra::Point3;
use rayon::prelude::*;
use where2act_core::{Camera, ImageSize, write_whole};
use where2act_sim::object::Material;
use where2act_sim::render::{Extra, Look, render, render_with};
use where2act_sim::{Attempt, Moment, SettledScene};

use crate::hand;

/// Frames at most, and how long each is shown.
const FRAMES: usize = 80;
const FRAME_MS: u32 = 60;
/// Distance and field of view of the camera: about a metre around the contact point.
const DISTANCE: f32 = 1.7;
const FOV: f32 = 0.6;

pub(crate) fn write(path: &Path, scene: &SettledScene, attempt: &Attempt, moments: &[Moment]) -> Result<()> {
    let camera = camera(scene, attempt);
    let every = moments.len().div_ceil(FRAMES).max(1);
    let (meshes, materials) = (hand::meshes(), hand::materials());
    let frame = |moment: &Moment| {
        let [left, right] = moment.world_from_fingers;
        let parts: [(_, &Material); 3] =
            [(moment.world_from_hand, &materials[0]), (left, &materials[1]), (right, &materials[1])];
        let extra = |(mesh, (world_from_mesh, material))| Extra { mesh, world_from_mesh, material };
        let extras: Vec<Extra<'_>> = meshes.iter().zip(parts).map(extra).collect();
        let view = render_with(scene.object(), &moment.world_from_links, &extras, &camera, &Look::default());
        let picture = DynamicImage::ImageRgb8(view.to_image()).into_rgba8();
        Frame::from_parts(picture, 0, 0, Delay::from_numer_denom_ms(FRAME_MS, 1))
    };
    let shown: Vec<&Moment> = moments.iter().step_by(every).chain(moments.last()).collect();
    let frames: Vec<Frame> = shown.into_par_iter().map(frame).collect();
    let mut bytes = Vec::new();
    {
        let mut encoder = GifEncoder::new_with_speed(&mut bytes, 10);
        encoder.set_repeat(Repeat::Infinite)?;
        encoder.encode_frames(frames)?;
    }
    write_whole(path, |w| w.write_all(&bytes))
        .with_context(|| format!("{}: expected to write a moving picture here", path.display()))
}

/// A camera that sees the contact point and the hand from the side: the best of a grid around it.
fn camera(scene: &SettledScene, attempt: &Attempt) -> Camera {
    let grasp = &attempt.grasp_in_world;
    let hand = grasp.point - grasp.approach() * 0.15;
    let poses = scene.world_from_links();
    let candidates =
        (0..24).flat_map(|i| [0.25, 0.5, 0.8].map(|elevation| (i as f32 / 24.0 * TAU, elevation)));
    let at = |(azimuth, elevation): (f32, f32), side: usize| {
        Camera::orbit(hand, DISTANCE, azimuth, elevation, ImageSize::square(side), FOV)
    };
    let score = |place: (f32, f32)| {
        let camera = at(place, 96);
        let view = render(scene.object(), &poses, &camera, &Look::default());
        let seen = |point: &Point3<f32>, slack: f32| {
            let local = camera.camera_from_world() * point;
            let Some((x, y)) = camera.intrinsics.project(&local) else { return 0.0 };
            let inside = |t: f32| (0.0..96.0).contains(&t).then_some(t as usize);
            let Some((u, v)) = inside(x).zip(inside(y)) else { return 0.0 };
            let depth = view.depth[v * 96 + u];
            f32::from(u8::from(depth <= 0.0 || depth > local.z - slack))
        };
        let to_hand = (hand - Point3::from(camera.world_from_camera.translation.vector)).normalize();
        let along = to_hand.dot(&grasp.approach());
        // From the side and a little from behind the hand, where neither the hand nor the part hides the touch.
        2.0 * seen(&grasp.point, 0.03) + 2.0 * seen(&hand, 0.0) - (along - 0.35).abs() - 0.2 * place.1
    };
    let scored: Vec<_> =
        candidates.collect::<Vec<_>>().into_par_iter().map(|place| (score(place), place)).collect();
    let best = scored.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or((0.0, 0.5), |(_, place)| place);
    at(best, Camera::PUBLISHED_SIDE)
}
