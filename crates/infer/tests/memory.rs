//! How much memory is touched: by pictures that are refused, and by batches.
#![cfg(target_os = "linux")]

use std::io::Cursor;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use image::{DynamicImage, ImageFormat};
use where2act_core::{ImageSize, Observation, Primitive, Seed};
use where2act_infer::read::{parse_depth_png, parse_mask, parse_npy, parse_picture, parse_scan};
use where2act_infer::{Backend, Options, Predictor};
use where2act_model::{Modality, ModelConfig, Network, Weights};

/// Peaks are those of the process: one measurement at a time.
static MEASURING: Mutex<()> = Mutex::new(());

/// Bytes that the resident set grows by, at its peak, while `work` runs.
fn growth<R>(work: impl FnOnce() -> R) -> (R, u64) {
    let field = |name: &str| -> u64 {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = status.lines().find_map(|l| l.strip_prefix(name)).unwrap();
        line.trim_start_matches(':').trim().trim_end_matches(" kB").parse::<u64>().unwrap() << 10
    };
    // Sets the peak back to what is resident now.
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = field("VmRSS");
    let result = work();
    (result, field("VmHWM").saturating_sub(before))
}

/// CRC-32 as png uses it, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| (c >> 1) ^ (0xedb8_8320 * (c & 1)))
    })
}

/// A small picture whose header says that it is 20,000 x 20,000.
fn enormous(format: ImageFormat) -> Vec<u8> {
    let side = 20_000u32;
    let mut bytes = Cursor::new(Vec::new());
    DynamicImage::new_rgb8(40, 40).write_to(&mut bytes, format).unwrap();
    let mut bytes = bytes.into_inner();
    match format {
        ImageFormat::Png => {
            // Signature and length, "IHDR", width, height, 5 more, check sum of all from "IHDR" on.
            bytes[16..20].copy_from_slice(&side.to_be_bytes());
            bytes[20..24].copy_from_slice(&side.to_be_bytes());
            let sum = crc(&bytes[12..29]);
            bytes[29..33].copy_from_slice(&sum.to_be_bytes());
        }
        _ => {
            // Start of frame: marker, length, bits, height, width.
            let frame = bytes.windows(2).position(|m| m == [0xff, 0xc0]).unwrap();
            bytes[frame + 5..frame + 7].copy_from_slice(&(side as u16).to_be_bytes());
            bytes[frame + 7..frame + 9].copy_from_slice(&(side as u16).to_be_bytes());
        }
    }
    bytes
}

#[test]
fn enormous_pictures_are_refused_by_their_header() {
    let _alone = MEASURING.lock();
    for format in [ImageFormat::Png, ImageFormat::Jpeg] {
        let bytes = enormous(format);
        let start = Instant::now();
        let (messages, growth) = growth(|| {
            [
                parse_picture(&bytes).unwrap_err().to_string(),
                parse_mask(&bytes).unwrap_err().to_string(),
                parse_depth_png(&bytes, 0.001).unwrap_err().to_string(),
            ]
        });
        for message in messages {
            assert_eq!(message, "expected at most 100 million pixels, found 20000 x 20000", "{format:?}");
        }
        // Decoded it would take 1.2 GB.
        assert!(growth < 8 << 20, "{format:?}: {growth} bytes");
        assert!(start.elapsed() < Duration::from_secs(2), "{format:?}: {:?}", start.elapsed());
    }
    let mut npy = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    npy.extend(
        format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': False, 'shape': (20000, 20000), }").bytes(),
    );
    let (message, growth) = growth(|| parse_npy(&npy).unwrap_err().to_string());
    assert!(message.contains("expected") && growth < 8 << 20, "{message}, {growth} bytes");
}

#[test]
fn headers_that_lie_allocate_nothing() {
    let _alone = MEASURING.lock();
    let huge = "18446744073709551615";
    for lie in [
        format!(
            "ply\nformat ascii 1.0\nelement vertex {huge}\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
        ),
        format!(
            "ply\nformat binary_little_endian 1.0\nelement empty {huge}\nelement vertex 19999999\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        ),
        format!(
            "ply\nformat binary_big_endian 1.0\nelement face {huge}\nproperty list uint double l\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n\u{7f}\u{7f}\u{7f}\u{7f}"
        ),
        format!("FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT {huge} 1 1\nPOINTS 19999999\nDATA binary\n"),
        "FIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nPOINTS 19999999\nDATA binary_compressed\n\u{1}\0\0\0"
            .to_owned(),
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 4294967296\nHEIGHT 4294967296\nDATA ascii\n".to_owned(),
    ] {
        let (result, growth) = growth(|| parse_scan(lie.as_bytes()));
        assert!(result.is_err() && growth < 8 << 20, "{lie}: {growth} bytes");
    }
}

#[test]
fn a_batch_of_64_takes_the_memory_of_one() {
    let _alone = MEASURING.lock();
    for (modality, observation) in [
        (Modality::Rgb, {
            let size = ImageSize::square(224);
            let rgb =
                (0..size.pixels()).map(|i| [(i % 251) as u8, (i / 224) as u8, (i % 13) as u8]).collect();
            Observation::Image { size, rgb: Some(rgb), depth: None, intrinsics: None, mask: None }
        }),
        (Modality::Cloud, {
            let point = |i: usize| {
                let (a, h) = (i as f32 * 2.399_963, (i as f32 + 0.5) / 20_000.0);
                let s = (1.0 - h * h).sqrt();
                nalgebra::Point3::new(0.5 * s * a.cos(), 0.5 * s * a.sin(), 2.0 - 0.5 * h)
            };
            Observation::Cloud { points: (0..20_000).map(point).collect() }
        }),
    ] {
        let config = ModelConfig::new(modality, &Primitive::ALL).with_width(0.125).with_points(2048);
        let network = Network::new(&config, Seed(7), &burn::tensor::Device::flex());
        let weights = Weights { network, sha256: "0".repeat(64) };
        let predictor = Predictor::from_weights(weights, Backend::Fast).unwrap();
        let batch = vec![observation; 64];
        let options = Options { samples: 20, ..Options::default() };
        let mut run = |n: usize| {
            let (answers, growth) = growth(|| predictor.predict_batch(&batch[..n], &options));
            assert!(answers.len() == n && answers.iter().all(Result::is_ok));
            growth
        };
        // The first fills the pools that later ones take from.
        let one = run(1);
        let grown: Vec<u64> = [1, 8, 32, 64].into_iter().map(&mut run).collect();
        println!("{modality:?}: {one} bytes for the first, then {grown:?} for 1, 8, 32 and 64");
        // Features of 64 pictures at once would be 200 MB at this width; results are a MB.
        assert!(grown[3] < 24 << 20, "{modality:?}: {grown:?} bytes for 1, 8, 32 and 64");
    }
}
