//! The `predict` program from outside: what it writes, what it prints, how it refuses.

use std::path::{Path, PathBuf};

use assert_cmd::Command;
use where2act_core::{Prediction, Primitive, Seed};
use where2act_model::{Modality, ModelConfig, Network, Precision, save_weights};

/// A folder with small random networks in `weights/rgb` and `weights/cloud`, and a picture, a depth map and a scan.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, modality) in [("rgb", Modality::Rgb), ("cloud", Modality::Cloud)] {
            let config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(1024);
            let network = Network::new(&config, Seed(7), &burn::tensor::Device::flex());
            save_weights(&folder.path().join("weights").join(name), &network, "random", Precision::F32)
                .unwrap();
        }
        let bench = Self { folder };
        let picture =
            image::RgbImage::from_fn(160, 120, |x, y| image::Rgb([x as u8, y as u8, (x ^ y) as u8]));
        picture.save(bench.path("picture.png")).unwrap();
        let depth = image::ImageBuffer::from_fn(160, 120, |x, y| {
            let inside = (20..140).contains(&x) && (10..110).contains(&y);
            image::Luma([if inside { 1500 + 2 * x as u16 + y as u16 } else { 0 }])
        });
        image::DynamicImage::ImageLuma16(depth).save(bench.path("depth.png")).unwrap();
        let points: String = (0..3000)
            .map(|i| {
                format!(
                    "{} {} {}\n",
                    (i % 60) as f32 * 0.01,
                    (i / 60) as f32 * 0.01,
                    1.5 + (i % 7) as f32 * 0.001
                )
            })
            .collect();
        let header = "ply\nformat ascii 1.0\nelement vertex 3000\nproperty float x\nproperty float y\nproperty float z\n";
        std::fs::write(bench.path("scan.ply"), format!("{header}end_header\n{points}")).unwrap();
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn predict(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_predict"));
        command.current_dir(self.folder.path()).args(args);
        command
    }

    fn prediction(&self, folder: &str) -> Prediction {
        let text = std::fs::read_to_string(self.path(folder).join("prediction.json")).unwrap();
        validate(&text);
        serde_json::from_str(&text).unwrap()
    }
}

/// Checks JSON against the committed schema.
fn validate(json: &str) {
    let schema = Path::new(env!("CARGO_MANIFEST_DIR")).join("schema/prediction.schema.json");
    let schema = serde_json::from_slice(&std::fs::read(schema).unwrap()).unwrap();
    let validator = jsonschema::validator_for(&schema).unwrap();
    let errors: Vec<String> = validator
        .iter_errors(&serde_json::from_str(json).unwrap())
        .map(|e| format!("{}: {e}", e.instance_path()))
        .collect();
    assert!(errors.is_empty(), "{errors:#?}");
}

/// The prediction without what may differ between runs: timing, and names of files.
fn essence(mut prediction: Prediction) -> Prediction {
    prediction.timing = Default::default();
    prediction.input.source.clear();
    for of in &mut prediction.primitives {
        of.actionability.map = None;
    }
    prediction
}

fn parse_line(stdout: &[u8]) -> Prediction {
    serde_json::from_slice(stdout).unwrap()
}

#[test]
fn a_picture_gives_everything_it_promises() {
    let bench = Bench::new();
    let run = bench.predict(&["picture.png", "--out", "out"]).assert().success();
    let table = String::from_utf8_lossy(&run.get_output().stdout).into_owned();
    let prediction = bench.prediction("out");
    assert_eq!(prediction.primitives.len(), 6);
    for of in &prediction.primitives {
        assert!(table.contains(of.primitive.name()));
        assert_eq!(of.proposals.len(), 10);
        assert!(of.proposals.iter().all(|p| p.point.is_none() && p.waypoints.is_empty()));
        let map = std::fs::read(bench.path("out").join(of.actionability.map.as_ref().unwrap())).unwrap();
        let npy = npyz::NpyFile::new(&map[..]).unwrap();
        assert_eq!(npy.shape(), [120, 160]);
        let values = npy.into_vec::<f32>().unwrap();
        let best = values.iter().copied().fold(0.0, f32::max);
        // Interpolation between the network's pixels may miss the peak, never exceed it.
        assert!(best <= of.actionability.max + 1e-6 && best > 0.9 * of.actionability.max);
        let overlay = image::open(bench.path(&format!("out/overlay_{}.png", of.primitive))).unwrap();
        assert!(overlay.width() > 600);
    }
    assert!(image::open(bench.path("out/sheet.png")).unwrap().width() > 2000);
}

#[test]
fn depth_gives_points_and_poses() {
    let bench = Bench::new();
    bench
        .predict(&["picture.png", "--depth", "depth.png", "--fov", "40", "--out", "both"])
        .assert()
        .success();
    bench.predict(&["depth.png", "--fov", "40", "--out", "depth"]).assert().success();
    bench.predict(&["scan.ply", "--out", "scan"]).assert().success();
    for (folder, kind) in [("both", "rgbd"), ("depth", "depth"), ("scan", "cloud")] {
        let prediction = bench.prediction(folder);
        assert_eq!(prediction.input.kind, kind);
        let proposals: Vec<_> = prediction.primitives.iter().flat_map(|p| &p.proposals).collect();
        assert!(proposals.len() > 12, "{kind}: {}", proposals.len());
        for p in proposals {
            let point = p.point.unwrap();
            assert!((1.4..2.2).contains(&point[2]), "{kind}: metres of the input, {point:?}");
            let hand = p.hand_pose.unwrap();
            for axis in 0..3 {
                assert!((hand[axis][3] - (point[axis] - 0.15 * p.approach[axis])).abs() < 1e-5);
            }
        }
    }
    // A 16-bit grey picture with a depth map of its own is no depth map, in a folder either.
    std::fs::create_dir(bench.path("grey")).unwrap();
    std::fs::copy(bench.path("depth.png"), bench.path("grey/depth.png")).unwrap();
    for input in ["depth.png", "grey"] {
        let run = bench.predict(&[input, "--depth", "depth.png", "--fov", "40", "--json"]).assert().success();
        assert_eq!(parse_line(&run.get_output().stdout).input.kind, "rgbd", "{input}");
    }
    let cloud = std::fs::read(bench.path("scan/cloud_pulling.ply")).unwrap();
    assert_eq!(where2act_infer::read::parse_ply(&cloud).unwrap().len(), 3000);
}

#[test]
fn the_same_bits_from_library_program_folder_and_any_number_of_threads() {
    let bench = Bench::new();
    let json = |args: &[&str]| {
        let run = bench.predict(args).assert().success();
        let text = String::from_utf8(run.get_output().stdout.clone()).unwrap();
        validate(&text);
        essence(parse_line(text.as_bytes()))
    };
    for input in ["picture.png", "scan.ply"] {
        let one = json(&[input, "--json", "--jobs", "1"]);
        for jobs in ["2", "3", "8"] {
            assert_eq!(one, json(&[input, "--json", "--jobs", jobs]));
        }
        assert_ne!(one, json(&[input, "--json", "--seed", "1"]));

        let (modality, observation) = if input == "scan.ply" {
            let points = where2act_infer::read::read_scan(&bench.path(input)).unwrap();
            ("cloud", where2act_core::Observation::Cloud { points })
        } else {
            let picture = where2act_infer::read::read_picture(&bench.path(input)).unwrap();
            let (size, rgb) = (picture.size, Some(picture.rgb));
            (
                "rgb",
                where2act_core::Observation::Image { size, rgb, depth: None, intrinsics: None, mask: None },
            )
        };
        let predictor = where2act_infer::Predictor::load(&bench.path("weights").join(modality)).unwrap();
        assert_eq!(one, essence(predictor.predict(&observation, &Default::default()).unwrap()));
    }
    std::fs::create_dir(bench.path("many")).unwrap();
    for name in ["picture.png", "scan.ply"] {
        std::fs::copy(bench.path(name), bench.path("many").join(name)).unwrap();
    }
    // Others between them, so that what they leave behind in buffers would be seen.
    let other = image::RgbImage::from_fn(97, 201, |x, y| image::Rgb([y as u8, 200 - x as u8, 90]));
    for name in ["a.png", "q.png", "z.jpg"] {
        other.save(bench.path("many").join(name)).unwrap();
    }
    bench.predict(&["many", "--out", "folder", "--no-pictures", "-q"]).assert().success().stdout("");
    assert_eq!(essence(bench.prediction("folder/picture")), json(&["picture.png", "--json"]));
    assert_eq!(essence(bench.prediction("folder/scan")), json(&["scan.ply", "--json"]));
}

#[test]
fn bad_files_in_a_folder_cost_no_other_its_prediction() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("many")).unwrap();
    for name in ["depth.png", "picture.png", "scan.ply"] {
        std::fs::copy(bench.path(name), bench.path("many").join(name)).unwrap();
    }
    let whole = std::fs::read(bench.path("picture.png")).unwrap();
    for (name, bytes) in [
        ("a.png", &b""[..]),
        ("cut.png", &whole[..whole.len() / 2]),
        ("head.png", &whole[..20]),
        ("no.jpg", b"no"),
    ] {
        std::fs::write(bench.path("many").join(name), bytes).unwrap();
    }
    let run = bench.predict(&["many", "--out", "out", "--no-pictures"]).assert().failure().code(2);
    let stderr = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    let lines: Vec<&str> = stderr.trim_end().lines().collect();
    // A depth map does not say what it was seen through.
    let expected = ["a.png", "cut.png", "depth.png", "head.png", "no.jpg", "5 of 7 inputs failed"];
    assert_eq!(lines.len(), expected.len(), "{stderr}");
    for (line, word) in lines.iter().zip(expected) {
        assert!(line.starts_with("predict: ") && line.contains(word), "{line} lacks {word:?}");
    }
    let mut made: Vec<_> =
        std::fs::read_dir(bench.path("out")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    made.sort();
    assert_eq!(made, ["picture", "scan"]);
    bench.prediction("out/picture");
    bench.prediction("out/scan");
}

#[test]
fn weights_that_are_missing_cost_those_alone_who_need_them() {
    let bench = Bench::new();
    std::fs::remove_dir_all(bench.path("weights/cloud")).unwrap();
    // Its turn comes first.
    let args = ["scan.ply", "picture.png", "--weights", "weights", "--out", "out"];
    let run = bench.predict(&args).assert().failure().code(2);
    let stderr = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
    let lines: Vec<&str> = stderr.trim_end().lines().collect();
    let [scan, all] = lines[..] else { panic!("{stderr}") };
    assert!(scan.contains("scan.ply: weights: expected a folder") && all.contains("1 of 2 inputs failed"));
    bench.prediction("out/picture");
}

#[test]
fn an_npy_is_what_its_shape_says_with_a_camera_or_without() {
    let bench = Bench::new();
    let write = |name: &str, (rows, columns): (usize, usize), values: &dyn Fn(usize, &mut [f32])| {
        let mut bytes = Vec::new();
        where2act_infer::write::write_npy_grid(&mut bytes, (rows, columns), values).unwrap();
        std::fs::write(bench.path(name), bytes).unwrap();
    };
    let point = |v: usize, row: &mut [f32]| {
        row.fill(0.5);
        row[..3].copy_from_slice(&[v as f32 * 1e-2, (v * v % 97) as f32 * 1e-2, 2.0]);
    };
    let depth = |_: usize, row: &mut [f32]| row.fill(1.5);
    write("depth.npy", (60, 80), &depth);
    write("small-depth.npy", (8, 8), &depth);
    write("points.npy", (300, 3), &point);
    write("points-colours-normals.npy", (300, 9), &point);
    let kinds = |args: &[&str]| {
        let run = bench.predict(args).args(["--json", "--primitive", "pulling"]).assert().success();
        let lines = run.get_output().stdout.split(|&b| b == b'\n').filter(|line| !line.is_empty());
        let inputs = lines.map(|line| parse_line(line).input);
        inputs.map(|input| (input.kind, input.width, input.height)).collect::<Vec<_>>()
    };
    let map = |(w, h)| ("depth".to_owned(), w, h);
    let scan = ("cloud".to_owned(), 300, 1);
    assert_eq!(kinds(&["points.npy"]), std::slice::from_ref(&scan));
    assert_eq!(kinds(&["points-colours-normals.npy"]), std::slice::from_ref(&scan));
    // A camera is that of the others.
    assert_eq!(
        kinds(&["points.npy", "points-colours-normals.npy", "depth.npy", "small-depth.npy", "--fov", "40"]),
        [scan.clone(), scan, map((80, 60)), map((8, 8))]
    );
    for without_camera in ["depth.npy", "small-depth.npy"] {
        let refused = bench.predict(&[without_camera, "--json"]).assert().failure().code(2);
        let stderr = String::from_utf8_lossy(&refused.get_output().stderr).into_owned();
        assert!(stderr.contains(without_camera) && stderr.contains("--intrinsics or --fov"), "{stderr}");
    }
}

#[test]
fn a_cut_out_is_its_own_mask() {
    let bench = Bench::new();
    let picture = image::RgbaImage::from_fn(160, 120, |x, y| {
        let inside = (30..90).contains(&x) && (20..100).contains(&y);
        image::Rgba([x as u8, y as u8, 90, if inside { 255 } else { 0 }])
    });
    picture.save(bench.path("cut-out.png")).unwrap();
    for (args, columns) in [(&[][..], 30..90), (&["--box", "0,0,50,120"], 30..50)] {
        let run = bench.predict(&[&["cut-out.png", "--json"], args].concat()).assert().success();
        let prediction = parse_line(&run.get_output().stdout);
        let mut proposals = prediction.primitives.iter().flat_map(|of| &of.proposals);
        assert!(prediction.primitives.iter().all(|of| of.proposals.len() > 5));
        assert!(proposals.all(|p| columns.contains(&p.pixel.u) && (20..100).contains(&p.pixel.v)));
    }
}

#[test]
fn a_box_keeps_proposals_inside() {
    let bench = Bench::new();
    let run = bench.predict(&["picture.png", "--box", "100,-30,900,80", "--json"]).assert().success();
    let prediction = parse_line(&run.get_output().stdout);
    let proposals: Vec<_> = prediction.primitives.iter().flat_map(|of| &of.proposals).collect();
    assert!(!proposals.is_empty());
    assert!(proposals.iter().all(|p| (100..160).contains(&p.pixel.u) && p.pixel.v < 50));
}

#[test]
fn a_photo_tells_its_camera_where_the_object_is_pointed_out() {
    let bench = Bench::new();
    // TIFF, little-endian: 26 mm as on 35 mm film (0xa405), in the EXIF block's own list (0x8769).
    let exif = b"II*\0\x08\0\0\0\x01\0\x69\x87\x04\0\x01\0\0\0\x1a\0\0\0\0\0\0\0\
        \x01\0\x05\xa4\x03\0\x01\0\0\0\x1a\0\0\0\0\0\0\0";
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
    image::ImageEncoder::set_exif_metadata(&mut encoder, exif.to_vec()).unwrap();
    encoder.encode_image(&image::open(bench.path("picture.png")).unwrap().into_rgb8()).unwrap();
    std::fs::write(bench.path("photo.jpg"), bytes).unwrap();
    let focal = |args: &[&str]| {
        let run = bench.predict(&[&["photo.jpg", "--json"], args].concat()).assert().success();
        parse_line(&run.get_output().stdout).input.intrinsics.map(|camera| camera.fx.round())
    };
    assert_eq!(focal(&[]), None);
    assert_eq!(focal(&["--box", "10,10,40,40"]), Some(120.0));
    assert_eq!(focal(&["--box", "10,10,40,40", "--fov", "90"]), Some(60.0));
}

#[test]
fn numbers_that_are_seldom_meant_are_told_but_not_refused() {
    let bench = Bench::new();
    let mut bytes = Vec::new();
    let millimetres = |_: usize, row: &mut [f32]| row.fill(1500.0);
    where2act_infer::write::write_npy_grid(&mut bytes, (120, 160), millimetres).unwrap();
    std::fs::write(bench.path("millimetres.npy"), bytes).unwrap();
    // Two thirds of it are infinitely far away.
    let mut bytes = Vec::new();
    let far = |row: usize, to: &mut [f32]| to.fill(if row < 80 { 1e10 } else { 1.5 + 0.001 * row as f32 });
    where2act_infer::write::write_npy_grid(&mut bytes, (120, 160), far).unwrap();
    std::fs::write(bench.path("far.npy"), bytes).unwrap();
    image::RgbImage::from_pixel(160, 120, image::Rgb([90; 3])).save(bench.path("grey.png")).unwrap();
    for (args, words) in [
        (vec!["picture.png", "--depth", "millimetres.npy", "--fov", "40"], vec!["in metres", "1500"]),
        (vec!["depth.png", "--intrinsics", "600,600,640,360"], vec!["160 x 120", "640, 360"]),
        (vec!["depth.png", "--intrinsics", "150,150,80,60"], vec![]),
        (vec!["far.npy", "--fov", "40"], vec![]),
        (vec!["picture.png", "--fov", "40"], vec!["--fov", "--depth"]),
        (vec!["picture.png", "--box", "0,0,9,9"], vec!["thousands of pixels", "81"]),
        (vec!["grey.png"], vec!["a single colour"]),
    ] {
        let run = bench.predict(&args).args(["--json", "--primitive", "pulling"]).assert().success();
        let stderr = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(words.iter().all(|word| stderr.contains(word)), "{args:?}: {stderr}");
        assert!(!words.is_empty() || stderr.is_empty(), "{args:?}: {stderr}");
    }
}

#[test]
fn a_folder_gets_a_folder_of_results_for_each_file_however_many_there_are() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("one")).unwrap();
    std::fs::copy(bench.path("picture.png"), bench.path("one/picture.png")).unwrap();
    let args = ["--no-pictures", "--primitive", "pulling", "--out"];
    bench.predict(&["one"]).args(args).arg("out").assert().success();
    bench.prediction("out/picture");
    bench.predict(&["picture.png"]).args(args).arg("out2").assert().success();
    bench.prediction("out2");
    // What cannot be written costs no other its results.
    std::fs::copy(bench.path("picture.png"), bench.path("one/z.png")).unwrap();
    std::fs::create_dir(bench.path("out3")).unwrap();
    std::fs::write(bench.path("out3/picture"), "a file").unwrap();
    bench.predict(&["one"]).args(args).arg("out3").assert().failure().code(2);
    bench.prediction("out3/z");
}

#[test]
fn only_an_earlier_prediction_is_replaced() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("out")).unwrap();
    std::fs::write(bench.path("out/sheet.png"), b"mine").unwrap();
    let args = ["picture.png", "--out", "out", "--primitive", "pulling"];
    bench.predict(&args).arg("--no-pictures").assert().success();
    assert_eq!(std::fs::read(bench.path("out/sheet.png")).unwrap(), b"mine");
    bench.predict(&args).assert().success();
    assert!(image::open(bench.path("out/sheet.png")).is_ok());
    bench.predict(&args).arg("--no-pictures").assert().success();
    assert!(!bench.path("out/sheet.png").exists() && bench.path("out/map_pulling.npy").exists());

    // What was left of one that was broken off is removed by the next one.
    std::fs::remove_file(bench.path("out/prediction.json")).unwrap();
    std::fs::write(bench.path("out/.unfinished-prediction"), b"").unwrap();
    bench.predict(&["picture.png", "--out", "out", "--primitive", "pushing"]).assert().success();
    assert!(!bench.path("out/map_pulling.npy").exists() && bench.path("out/map_pushing.npy").exists());
    assert!(!bench.path("out/.unfinished-prediction").exists());
}

#[test]
fn a_pixel_is_answered_with_what_can_be_done_there() {
    let bench = Bench::new();
    let args = ["picture.png", "--pixel", "31,77", "--primitive", "pulling", "--top-k", "4", "--json"];
    let run = bench.predict(&args).assert().success();
    let prediction = parse_line(&run.get_output().stdout);
    let proposals = &prediction.primitives[0].proposals;
    assert_eq!((prediction.primitives.len(), proposals.len()), (1, 4));
    assert!(proposals.iter().all(|p| (p.pixel.u, p.pixel.v) == (31, 77)));
    assert!(proposals.windows(2).all(|pair| pair[0].score >= pair[1].score));
}

#[test]
fn refusals_are_one_line_that_names_the_culprit() {
    let bench = Bench::new();
    std::fs::write(bench.path("broken.jpg"), b"\xff\xd8\xff\xe0 not a picture").unwrap();
    std::fs::write(bench.path("empty.ply"), b"").unwrap();
    std::fs::write(bench.path("notes.txt"), b"hello").unwrap();
    // TIFF, little-endian, one entry: orientation (0x0112), short, 1 value, 3 = upside down.
    let exif =
        [b"II*\0\x08\0\0\0".as_slice(), &[1, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, 3, 0, 0, 0, 0, 0, 0, 0]].concat();
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut bytes);
    image::ImageEncoder::set_exif_metadata(&mut encoder, exif).unwrap();
    encoder.encode_image(&image::RgbImage::new(160, 120)).unwrap();
    std::fs::write(bench.path("turned.jpg"), bytes).unwrap();
    // Without contents on the disk, and refused without being read.
    std::fs::File::create(bench.path("huge.png")).unwrap().set_len(600 << 20).unwrap();
    std::fs::create_dir(bench.path("nothing")).unwrap();
    image::GrayImage::new(8, 8).save(bench.path("small.png")).unwrap();
    let mut bytes = Vec::new();
    where2act_infer::write::write_npy_grid(&mut bytes, (120, 160), |_, row| row.fill(1.5)).unwrap();
    std::fs::write(bench.path("depth.npy"), bytes).unwrap();
    let cases: &[(&[&str], &[&str])] = &[
        (&["missing.png"], &["missing.png", "No such file"]),
        (&["missing/"], &["missing/", "No such file"]),
        (&["depth.npy", "--depth", "depth.png", "--fov", "40"], &["--depth", "found a depth map"]),
        (&["broken.jpg"], &["broken.jpg", "expected", "found"]),
        (&["empty.ply"], &["empty.ply", "expected", "found"]),
        (&["notes.txt"], &["notes.txt", "expected a png"]),
        (&["huge.png"], &["huge.png", "at most 512 MiB", "600 MiB"]),
        (&["nothing"], &["nothing", "expected a folder"]),
        (&["depth.png"], &["depth.png", "--intrinsics or --fov"]),
        (&["picture.png", "--depth", "small.png", "--fov", "40"], &["small.png", "16-bit"]),
        (&["picture.png", "--mask", "small.png"], &["--mask small.png", "160x120", "8x8"]),
        (&["picture.png", "scan.ply", "--mask", "small.png"], &["--mask", "one input", "2"]),
        (&["picture.png", "--box", "1,2,3"], &["--box", "four numbers", "3"]),
        (&["picture.png", "--box", "160,0,9,9"], &["--box", "160 x 120", "160,0,9,9"]),
        (&["scan.ply", "--box", "0,0,9,9"], &["--box", "found a scan"]),
        (&["picture.png", "--weights", "weights/cloud"], &["where2act-cloud", "pictures", "scans"]),
        (&["picture.png", "--weights", "nowhere"], &["nowhere", "config.json"]),
        (&["picture.png", "--pixel", "160,0"], &["pixel", "below 160", "160,0"]),
        (&["picture.png", "--top-k", "0"], &["--top-k", "found 0"]),
        (&["picture.png", "--fov", "190"], &["--fov", "190"]),
        (&["picture.png", "--intrinsics", "1,2,3"], &["--intrinsics", "four numbers", "3"]),
        (&["picture.png", "--jobs", "0"], &["--jobs", "at least 1"]),
        (&["scan.ply", "--engine", "burn", "--precision", "bf16"], &["--precision", "bf16", "--engine fast"]),
        (&["scan.ply", "--device", "flex", "--precision", "bf16"], &["--precision", "bf16", "--engine fast"]),
        (&["scan.ply", "--object-scale", "-1"], &["object-scale", "-1"]),
        (&["scan.ply", "--fov", "40"], &["--fov", "found a scan"]),
        (&["turned.jpg", "--depth", "depth.png", "--fov", "40"], &["turned.jpg", "EXIF"]),
        (&["turned.jpg", "--intrinsics", "150,150,80,60"], &["turned.jpg", "EXIF"]),
    ];
    for (args, expected) in cases {
        let run = bench.predict(args).args(["--json"]).assert().failure().code(2).stdout("");
        let stderr = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert_eq!(stderr.trim_end().lines().count(), 1, "{args:?}: {stderr}");
        for word in *expected {
            assert!(stderr.contains(word), "{args:?}: {stderr} lacks {word:?}");
        }
    }
    bench.predict(&["picture.png", "--primitive", "kicking"]).assert().failure().code(2);
    bench.predict(&["picture.png", "--precision", "f64"]).assert().failure().code(2);
    bench.predict(&["picture.png", "--precision", "f32", "--json"]).assert().success();
    let bf16 = |isa: &str| {
        let run = bench
            .predict(&["picture.png", "--precision", "bf16", "--json"])
            .env("WHERE2ACT_ISA", isa)
            .output();
        let run = run.unwrap();
        (run.status.code(), String::from_utf8_lossy(&run.stderr).into_owned())
    };
    let (code, refused) = bf16("portable");
    assert!(code == Some(2) && refused.contains("expected f32, found bf16"), "{refused}");
    let (code, refused) = bf16("best");
    let expected = if where2act_kernels::Isa::bf16().is_some() { 0 } else { 2 };
    assert!(code == Some(expected), "{refused}");
    bench.predict(&["--help"]).assert().success();
}
