//! From a settled scene through `predict` and its prediction.json to `trial` and back, as a robot would use them: only
//! files and command lines in between. The network is random, for what is tested is the way: frames, units and poses.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use burn::tensor::Device;
use nalgebra::{Matrix3, Matrix4, Point3, Rotation3, Vector3, center};
use serde_json::Value;
use where2act_core::{Camera, Grasp, ImageSize, Pixel, Primitive, Seed};
use where2act_model::{Modality, ModelConfig, Network, Precision, save_weights};
use where2act_sim::render::{Look, View, render, visible_bounds};
use where2act_sim::{Attempt, Mode, Observer, Scene, SettledScene, object};

const OBJECT: &str = "StorageFurniture:17";
/// A drawer and a door a bit open.
const Q: [f32; 6] = [0.0, 0.15, 0.0, 0.5, 0.0, 0.0];
/// Metres per unit of the depth map: 5 m are 50,000 units.
const DEPTH_SCALE: f32 = 1e-4;
/// Metres, and entries of rotation matrices. Half a unit of depth is 5e-5.
const CLOSE: f32 = 1e-4;

fn settled() -> (SettledScene, View) {
    let scene = Scene::new(Arc::new(object::open(OBJECT).unwrap()), Q.to_vec()).unwrap().settle().unwrap();
    let poses = scene.world_from_links();
    let (min, max) = visible_bounds(scene.object(), &poses);
    let size = ImageSize::square(Camera::PUBLISHED_SIDE);
    let camera =
        Camera::orbit(center(&min, &max), Camera::PUBLISHED_DISTANCE, 3.75, 0.5, size, Camera::PUBLISHED_FOV);
    let view = render(scene.object(), &poses, &camera, &Look::default());
    (scene, view)
}

/// What a camera would leave on disk: a picture, a depth map, and a mask of the parts that move.
fn save(view: &View, folder: &Path) {
    let side = Camera::PUBLISHED_SIDE as u32;
    view.to_image().save(folder.join("picture.png")).unwrap();
    let at = |u: u32, v: u32| (v * side + u) as usize;
    let units = |u, v| image::Luma([(view.depth[at(u, v)] / DEPTH_SCALE).round() as u16]);
    let depth: image::ImageBuffer<_, Vec<u16>> = image::ImageBuffer::from_fn(side, side, units);
    depth.save(folder.join("depth.png")).unwrap();
    let moves = |u, v| image::Luma([if view.link[at(u, v)] > 1 { 255 } else { 0 }]);
    image::GrayImage::from_fn(side, side, moves).save(folder.join("mask.png")).unwrap();
}

/// Runs a program of the workspace as a user would, and returns what it prints. Other packages' programs have no
/// variable of their own in a test; cargo knows whether they are up to date.
fn run(program: &str, folder: &Path, args: &[&str]) -> String {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml");
    let output = Command::new(env!("CARGO"))
        .args(["run", "--quiet", "--bin", program, "--manifest-path"])
        .arg(manifest)
        .arg("--")
        .args(args)
        .current_dir(folder)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {args:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

fn floats(value: &Value) -> Vec<f32> {
    let list = value.as_array().unwrap_or_else(|| panic!("a list, not {value}"));
    list.iter().map(|x| x.as_f64().unwrap() as f32).collect()
}

fn vector(value: &Value) -> Vector3<f32> {
    Vector3::from_column_slice(&floats(value))
}

/// A 4x4 matrix by rows.
fn pose(value: &Value) -> Matrix4<f32> {
    let rows: Vec<f32> = value.as_array().unwrap().iter().flat_map(floats).collect();
    Matrix4::from_row_slice(&rows)
}

fn position(pose: &Matrix4<f32>) -> Vector3<f32> {
    pose.fixed_view::<3, 1>(0, 3).into()
}

#[track_caller]
fn same(a: &Matrix4<f32>, b: &Matrix4<f32>) {
    let difference = (a - b).amax();
    assert!(difference < CLOSE, "{difference}: {a}{b}");
}

/// The poses that the documentation promises for a proposal, in words of the documentation: the hand's origin 0.15 m
/// behind the contact, then 0.10 or 0.11 m, then the primitive's own way.
fn promised(primitive: Primitive, proposal: &Value) -> Vec<Matrix4<f32>> {
    let [point, z, x] = ["point", "approach", "forward"].map(|name| vector(&proposal[name]));
    let y = z.cross(&x);
    let rotation = Matrix3::from_columns(&[x, y, z]);
    let hand = |at: Vector3<f32>| rotation.to_homogeneous().append_translation(&at);
    let (start, near, nearer) = (point - 0.15 * z, point - 0.11 * z, point - 0.10 * z);
    let way = match primitive {
        Primitive::Pushing => vec![start, nearer],
        Primitive::PushingUp => vec![start, near, near + 0.05 * y],
        Primitive::PushingLeft => vec![start, near, near + 0.05 * x],
        Primitive::Pulling => vec![start, nearer, start],
        Primitive::PullingUp => vec![start, nearer, nearer + 0.05 * y],
        Primitive::PullingLeft => vec![start, nearer, nearer + 0.05 * x],
    };
    way.into_iter().map(hand).collect()
}

/// Executes a proposal with `trial` and compares what it says it does with what the prediction says.
fn execute(folder: &Path, (scene, view): (&SettledScene, &View), primitive: Primitive, proposal: &Value) {
    let world_from_camera = view.camera.world_from_camera;
    let point = world_from_camera * Point3::from(vector(&proposal["point"]));
    let [approach, forward] = ["approach", "forward"].map(|n| world_from_camera * vector(&proposal[n]));
    let pixel = floats(&serde_json::json!([proposal["pixel"]["u"], proposal["pixel"]["v"]]));
    let link = view.link_at(Pixel { u: pixel[0] as u32, v: pixel[1] as u32 }).unwrap();

    let surface = scene.nearest_surface(&point, None).unwrap();
    assert!(surface.distance < CLOSE, "{primitive}: {} m from any surface", surface.distance);
    assert_eq!(surface.link, link);

    let text = |v: &Vector3<f32>| format!("{},{},{}", v.x, v.y, v.z);
    let said = run(
        "trial",
        folder,
        &[
            OBJECT,
            "--primitive",
            primitive.name(),
            &format!("--point={}", text(&point.coords)),
            &format!("--approach={}", text(&approach)),
            &format!("--forward={}", text(&forward)),
            &format!("--q={}", Q.map(|q| q.to_string()).join(",")),
            "--target",
            &scene.object().links[link].name,
            "--json",
        ],
    );
    let said: Value = serde_json::from_str(&said).unwrap();
    assert!((vector(&said["point"]) - point.coords).norm() < 1e-6);
    let expected = proposal["waypoints"].as_array().unwrap();
    let done = said["waypoints"].as_array().unwrap();
    assert_eq!(expected.len(), done.len(), "{primitive}");
    for (camera_from_hand, world_from_hand) in expected.iter().zip(done) {
        same(&(world_from_camera.to_homogeneous() * pose(camera_from_hand)), &pose(world_from_hand));
    }
    assert_eq!(proposal["hand_pose"], expected[0]);

    // The outcome is the library's, to the last bit.
    let grasp_in_world = Grasp::new(point, approach, forward);
    let normal_in_world = scene.nearest_surface(&point, Some(link)).map(|s| s.normal_in_world);
    let attempt = Attempt { primitive, link, grasp_in_world, normal_in_world };
    let verdict = scene.attempt(&attempt, Mode::Faithful, None);
    let number = |name: &str| said[name].as_f64().unwrap() as f32;
    assert_eq!((number("q_start"), number("q_end")), (verdict.q_start, verdict.q_end), "{primitive}");
    assert_eq!(verdict.q_start, scene.q()[link - 1]);
    assert_eq!(vector(&said["motion"]), verdict.motion);
    assert_eq!(said["success"], verdict.success);
    assert_eq!(said["valid"], verdict.invalid.is_none());
}

/// Where the hand really is as the simulator drives it along a proposal, three metres above the object, where it
/// touches nothing.
fn flies_there(scene: &SettledScene, view: &View, primitive: Primitive, proposal: &Value) {
    let in_air = nalgebra::Translation3::new(0.0, 0.0, 3.0) * view.camera.world_from_camera;
    let rows: Vec<f32> = proposal["rotation"].as_array().unwrap().iter().flat_map(floats).collect();
    let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_row_slice(&rows));
    let grasp = Grasp { point: vector(&proposal["point"]).into(), rotation };
    let grasp_in_world = grasp.transformed(&in_air);
    let attempt = Attempt { primitive, link: 1, grasp_in_world, normal_in_world: None };
    let mut flown = Vec::new();
    let mut look = |moment: &where2act_sim::Moment| flown.push(moment.world_from_hand.to_homogeneous());
    let observer = Observer { every: 1, look: &mut look };
    assert_eq!(scene.attempt(&attempt, Mode::Faithful, Some(observer)).invalid, None);
    let mut from = 0;
    for waypoint in proposal["waypoints"].as_array().unwrap() {
        let waypoint = in_air.to_homogeneous() * pose(waypoint);
        let distance = |pose: &Matrix4<f32>| (position(pose) - position(&waypoint)).norm();
        // In order: each after the one before.
        let nearest =
            (from..flown.len()).min_by(|a, b| distance(&flown[*a]).total_cmp(&distance(&flown[*b])));
        let nearest = nearest.unwrap();
        let turned = (flown[nearest] - waypoint).fixed_view::<3, 3>(0, 0).amax();
        println!("{primitive}: step {nearest}, {} m, {turned}", distance(&flown[nearest]));
        assert!(distance(&flown[nearest]) < CLOSE && turned < CLOSE, "{primitive}: step {nearest}");
        from = nearest;
    }
}

#[test]
fn what_predict_writes_is_what_trial_does() {
    let (scene, view) = settled();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    save(&view, folder);
    let i = view.camera.intrinsics;
    let intrinsics = format!("{},{},{},{}", i.fx, i.fy, i.cx, i.cy);
    for (modality, input) in
        [(Modality::Cloud, &["depth.png"][..]), (Modality::Rgb, &["picture.png", "--depth", "depth.png"])]
    {
        let config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(2048);
        let network = Network::new(&config, Seed(7), &Device::flex());
        let weights = folder.join(format!("{modality:?}"));
        save_weights(&weights, &network, "random", Precision::F32).unwrap();
        let out: PathBuf = folder.join(format!("{modality:?}-out"));
        let scale = DEPTH_SCALE.to_string();
        let more =
            ["--mask", "mask.png", "--depth-scale", &scale, "--intrinsics", &intrinsics, "--keep-scale"];
        let to = ["--weights", weights.to_str().unwrap(), "--out", out.to_str().unwrap(), "--no-pictures"];
        run("predict", folder, &[input, &more, &to].concat());
        let prediction: Value =
            serde_json::from_slice(&std::fs::read(out.join("prediction.json")).unwrap()).unwrap();
        assert_eq!(
            (&prediction["frame"], &prediction["units"]),
            (&"camera_optical".into(), &"metres".into())
        );
        assert_eq!(prediction["primitives"].as_array().unwrap().len(), 6);
        for of in prediction["primitives"].as_array().unwrap() {
            let primitive: Primitive = of["primitive"].as_str().unwrap().parse().unwrap();
            let proposals = of["proposals"].as_array().unwrap();
            assert!(proposals.len() > 3, "{modality:?}, {primitive}: {}", proposals.len());
            for proposal in proposals {
                let promised = promised(primitive, proposal);
                let written: Vec<_> = proposal["waypoints"].as_array().unwrap().iter().map(pose).collect();
                assert_eq!(written.len(), promised.len());
                promised.iter().zip(&written).for_each(|(a, b)| same(a, b));
                let (close_at, width) =
                    if primitive.is_pulling() { (Value::from(1), 0.08) } else { (Value::Null, 0.0) };
                assert_eq!(proposal["close_at"], close_at);
                assert!((proposal["gripper_width"].as_f64().unwrap() - width).abs() < 1e-6);
            }
            execute(folder, (&scene, &view), primitive, &proposals[0]);
            flies_there(&scene, &view, primitive, &proposals[0]);
        }
    }
}
