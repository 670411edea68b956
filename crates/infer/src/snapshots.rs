//! What users see, pinned: the JSON byte by byte, the overlay as a coarse picture.
//!
//! `UPDATE_SNAPSHOTS=1 cargo test -p where2act-infer snapshots` writes them anew; look at the difference.

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Rotation3, Vector3};
use where2act_core::{
    ActionabilitySummary, Grasp, ImageSize, InputInfo, Intrinsics, ModelInfo, Observation, PREDICTION_SCHEMA,
    Pixel, Prediction, Primitive, PrimitivePrediction, Proposal, Timing,
};
use where2act_model::preprocess::Letterbox;

use crate::dense::{DenseMaps, Geometry};
use crate::pose::proposal;
use crate::{draw_overlay, draw_sheet};

const SIZE: ImageSize = ImageSize { width: 160, height: 120 };
const INTRINSICS: Intrinsics = Intrinsics { fx: 200.0, fy: 200.0, cx: 80.0, cy: 60.0 };

fn observation() -> Observation {
    let rgb =
        (0..SIZE.pixels()).map(|i| if (40..120).contains(&(i % 160)) { [90, 120, 160] } else { [240; 3] });
    Observation::Image {
        size: SIZE,
        rgb: Some(rgb.collect()),
        depth: None,
        intrinsics: Some(INTRINSICS),
        mask: None,
    }
}

/// Maps of two primitives with a hill at pixel (100, 40) of the input.
fn maps(observation: &Observation) -> DenseMaps<'_> {
    let letterbox = Letterbox::new(SIZE, 64).unwrap();
    let hill = |row: usize| {
        let (x, y) = ((row % 64) as f32 - 40.0, (row / 64) as f32 - 24.0);
        (-0.02 * (x * x + y * y)).exp() * 0.9
    };
    let values =
        [1.0, 0.3].into_iter().flat_map(|height| (0..64 * 64).map(move |row| height * hill(row))).collect();
    let primitives = vec![Primitive::Pulling, Primitive::PushingLeft];
    DenseMaps { observation, primitives, values, geometry: Geometry::Grid(letterbox) }
}

fn prediction() -> Prediction {
    let of = |primitive: Primitive, max: f32| {
        let point = Point3::new(0.1, -0.1, 1.0);
        let approach = Vector3::new(0.0, 0.6, 0.8);
        let at = |rank: usize, pixel, point: Option<Point3<f32>>, score| {
            let grasp = Grasp::new(Point3::origin(), approach, Vector3::x());
            Proposal { rank, ..proposal(primitive, pixel, point, &grasp.rotation, (score, max)) }
        };
        PrimitivePrediction {
            primitive,
            actionability: ActionabilitySummary {
                max,
                mean: 0.125,
                map: Some(format!("map_{primitive}.npy")),
            },
            proposals: vec![
                at(1, Pixel { u: 100, v: 40 }, Some(point), 0.75),
                at(2, Pixel { u: 60, v: 90 }, None, 0.5),
            ],
        }
    };
    Prediction {
        schema: PREDICTION_SCHEMA.to_owned(),
        input: InputInfo {
            source: "cabinet.png".to_owned(),
            kind: "rgbd".to_owned(),
            width: SIZE.width,
            height: SIZE.height,
            network_from_metres: 1.0,
            intrinsics: Some(INTRINSICS),
        },
        model: ModelInfo { name: "example".to_owned(), sha256: "0123456789abcdef".repeat(4) },
        frame: "camera_optical".to_owned(),
        units: "metres".to_owned(),
        primitives: vec![of(Primitive::Pulling, 0.9), of(Primitive::PushingLeft, 0.27)],
        timing: Timing { preprocess: 1.5, backbone: 30.0, decode: 8.25, total: 39.75 },
    }
}

fn snapshot(name: &str, found: &str, same: impl Fn(&str, &str) -> bool) {
    let path: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots").join(name);
    if std::env::var_os("UPDATE_SNAPSHOTS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, found).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap();
    assert!(same(&expected, found), "{name} changed; found:\n{found}");
}

/// Mean brightness of red, green and blue in a grid of 16 x 12 tiles.
fn coarse(picture: &image::RgbImage) -> String {
    let small = image::imageops::resize(picture, 16, 12, image::imageops::FilterType::Triangle);
    let rows = small.rows().map(|row| row.map(|p| format!("{:?}", p.0)).collect::<Vec<_>>().join(" "));
    format!("{}x{}\n{}\n", picture.width(), picture.height(), rows.collect::<Vec<_>>().join("\n"))
}

/// The same size, and every number within some grey levels: fonts and anti-aliasing may move an edge.
fn alike(a: &str, b: &str) -> bool {
    let numbers = |text: &str| -> Vec<i32> {
        text.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect()
    };
    let (a, b) = (numbers(a), numbers(b));
    a.len() == b.len()
        && a.iter().zip(&b).enumerate().all(|(i, (a, b))| (a - b).abs() <= if i < 2 { 0 } else { 6 })
}

#[test]
fn json() {
    let found = serde_json::to_string_pretty(&prediction()).unwrap() + "\n";
    snapshot("prediction.json", &found, |a, b| a == b);
    let schema = include_str!("../schema/prediction.schema.json");
    let validator = jsonschema::validator_for(&serde_json::from_str(schema).unwrap()).unwrap();
    let value = serde_json::from_str(&found).unwrap();
    assert!(validator.is_valid(&value));
    let mut wrong: serde_json::Value = value;
    wrong["primitives"][0]["proposals"][0]["rotation"] = serde_json::json!([[1, 0, 0]]);
    assert!(!validator.is_valid(&wrong), "the schema can fail");
    assert_eq!(serde_json::from_str::<Prediction>(&found).unwrap(), prediction());
}

#[test]
fn overlay() {
    let observation = observation();
    let prediction = prediction();
    let picture = draw_overlay(&maps(&observation), &prediction.primitives[0]);
    snapshot("overlay.txt", &coarse(&picture), alike);
    if let Some(folder) = std::env::var_os("UPDATE_SNAPSHOTS_PICTURES") {
        picture.save(Path::new(&folder).join("overlay.png")).unwrap();
        let sheet = draw_sheet(&maps(&observation), &prediction);
        sheet.save(Path::new(&folder).join("sheet.png")).unwrap();
    }
}

#[test]
fn heat_is_where_the_map_is_and_the_hand_points_along_the_approach() {
    let observation = observation();
    let mut prediction = prediction();
    let bare = PrimitivePrediction { proposals: vec![], ..prediction.primitives[0].clone() };
    let heat = draw_overlay(&maps(&observation), &bare);
    // 640 pixels for 160, below a title of 40.
    let at = |picture: &image::RgbImage, u: u32, v: u32| {
        picture.get_pixel(u * 4 + 2, 40 + v * 4 + 2).0.map(i32::from)
    };
    let ([r, _, b], [far_r, _, far_b]) = (at(&heat, 100, 40), at(&heat, 140, 110));
    assert!(r > b + 80 && far_r < far_b + 30, "{r} {b} {far_r} {far_b}");

    // A hand that comes from the left: its stem is left of the contact.
    let grasp = Grasp::new(Point3::origin(), Vector3::x(), Vector3::y());
    let rotation: Rotation3<f32> = grasp.rotation;
    prediction.primitives[0].proposals = vec![Proposal {
        rank: 1,
        ..proposal(Primitive::Pulling, Pixel { u: 80, v: 60 }, None, &rotation, (0.5, 0.5))
    }];
    let drawn = draw_overlay(&maps(&observation), &prediction.primitives[0]);
    let changed =
        |range: std::ops::Range<u32>| range.filter(|&u| at(&drawn, u, 60) != at(&heat, u, 60)).count();
    assert!(changed(60..78) > 10, "{}", changed(60..78));
    assert!(changed(95..130) == 0, "{}", changed(95..130));
}
