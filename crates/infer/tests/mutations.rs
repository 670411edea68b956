//! Every reader against damaged files: no panic, no unbounded memory, an answer in time.
//!
//! `WHERE2ACT_MUTATIONS` sets the number of damaged inputs (default 4,000 in a normal run; 100,000 for a long one).

use std::io::Cursor;

use image::{DynamicImage, ImageEncoder, ImageFormat};
use rand::RngExt;
use where2act_core::Seed;
use where2act_infer::read::{
    DepthMap, parse_depth_png, parse_mask, parse_npy, parse_pcd, parse_picture, parse_ply, parse_scan,
};

/// An EXIF block: turn by a quarter, and 26 mm as on film.
const EXIF: &[u8] =
    b"II*\0\x08\0\0\0\x02\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\x69\x87\x04\0\x01\0\0\0\x26\0\0\0\0\0\0\0\
    \x01\0\x05\xa4\x03\0\x01\0\0\0\x1a\0\0\0\0\0\0\0";

/// Sound files of every kind that is read.
fn sound() -> Vec<(&'static str, Vec<u8>)> {
    let encode = |picture: &DynamicImage, format| {
        let mut bytes = Cursor::new(Vec::new());
        picture.write_to(&mut bytes, format).unwrap();
        bytes.into_inner()
    };
    let rgb = DynamicImage::ImageRgb8(image::RgbImage::from_fn(19, 13, |x, y| {
        image::Rgb([x as u8 * 9, y as u8 * 7, 99])
    }));
    let mut turned = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut turned);
    encoder.set_exif_metadata(EXIF.to_vec()).unwrap();
    rgb.write_with_encoder(encoder).unwrap();
    let depth = image::ImageBuffer::from_fn(9, 7, |x, y| image::Luma([(1000 + 30 * x + y) as u16]));
    let row = |i: usize| [i as f32 * 0.1, 1.0, 2.0 + i as f32];
    let floats = |n: usize| (0..n).flat_map(row).flat_map(f32::to_le_bytes).collect::<Vec<u8>>();
    let text = |n: usize| (0..n).map(|i| row(i).map(|x| x.to_string()).join(" ") + "\n").collect::<String>();
    let join = |header: &str, body: &[u8]| [header.as_bytes(), body].concat();
    let xyz = "property float x\nproperty float y\nproperty float z\nend_header\n";
    let list = "element face 2\nproperty list uchar int vertex_indices\nelement vertex 5\n";
    let pcd = |data: &str| {
        format!(
            "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 1\nPOINTS 5\nDATA {data}\n"
        )
    };
    // LZF of literals only.
    let columns: Vec<u8> = (0..3).flat_map(|a| (0..5).flat_map(move |i| row(i)[a].to_le_bytes())).collect();
    let packed: Vec<u8> =
        columns.chunks(32).flat_map(|c| [vec![c.len() as u8 - 1], c.to_vec()].concat()).collect();
    let sizes = [(packed.len() as u32).to_le_bytes(), 60u32.to_le_bytes()].concat();
    let mut npy = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    npy.extend(format!("{:<117}\n", "{'descr': '<f4', 'fortran_order': True, 'shape': (5, 3), }").bytes());
    npy.extend(floats(5));
    vec![
        ("png", encode(&rgb, ImageFormat::Png)),
        ("jpg", encode(&rgb, ImageFormat::Jpeg)),
        ("cmyk jpg", include_bytes!("data/cmyk.jpg").to_vec()),
        ("turned jpg", turned),
        ("webp", encode(&rgb, ImageFormat::WebP)),
        ("depth png", encode(&DynamicImage::ImageLuma16(depth), ImageFormat::Png)),
        ("ascii ply", join(&format!("ply\nformat ascii 1.0\nelement vertex 5\n{xyz}"), text(5).as_bytes())),
        (
            "binary ply",
            join(&format!("ply\nformat binary_little_endian 1.0\nelement vertex 5\n{xyz}"), &floats(5)),
        ),
        (
            "ply with lists",
            join(
                &format!("ply\nformat binary_little_endian 1.0\n{list}{xyz}"),
                &[vec![1, 0, 0, 0, 0, 0], floats(5)].concat(),
            ),
        ),
        ("ascii pcd", join(&pcd("ascii"), text(5).as_bytes())),
        ("binary pcd", join(&pcd("binary"), &floats(5))),
        ("compressed pcd", join(&pcd("binary_compressed"), &[sizes, packed].concat())),
        ("npy", npy),
    ]
}

/// Feeds bytes to every reader; their answers do not matter, only that there is one.
fn read_all(bytes: &[u8]) {
    let _ = parse_picture(bytes);
    let _ = parse_mask(bytes);
    let _ = parse_depth_png(bytes, 0.001);
    let _ = parse_scan(bytes);
    let _ = parse_ply(bytes);
    let _ = parse_pcd(bytes);
    let _ = parse_npy(bytes);
    let _ = DepthMap::from_npy(bytes, 1.0);
}

/// Damages bytes in one of the ways files are damaged, or lied about.
fn mutate(bytes: &mut Vec<u8>, rng: &mut impl RngExt) {
    for _ in 0..rng.random_range(1..5) {
        let at = rng.random_range(0..bytes.len().max(1));
        match rng.random_range(0..7) {
            0 => bytes.truncate(at),
            1 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b = rng.random()),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|b| *b ^= 1 << rng.random_range(0..8)),
            3 => bytes.iter_mut().skip(at).take(4).for_each(|b| *b = 0xff),
            4 => {
                let end = (at + rng.random_range(1..40)).min(bytes.len());
                let piece = bytes.get(at..end).unwrap_or_default().to_vec();
                bytes.splice(at..at, piece);
            }
            5 => {
                // Numbers in headers become enormous or negative.
                let digits: Vec<usize> = bytes
                    .iter()
                    .take(400)
                    .enumerate()
                    .filter(|(_, b)| b.is_ascii_digit())
                    .map(|(i, _)| i)
                    .collect();
                if !digits.is_empty() {
                    let digit = digits[rng.random_range(0..digits.len())];
                    let lies: [&[u8]; 5] = [b"99999999", b"-1", b"18446744073709551615", b"1e30", b"nan"];
                    bytes.splice(digit..=digit, lies[rng.random_range(0..5)].iter().copied());
                }
            }
            _ => bytes.iter_mut().skip(at).take(8).for_each(|b| *b = 0),
        }
    }
}

#[test]
fn sound_files_are_read() {
    for (kind, bytes) in sound() {
        if ["png", "jpg", "webp"].iter().any(|picture| kind.ends_with(picture)) {
            parse_picture(&bytes).unwrap();
        } else {
            let points = parse_scan(&bytes).unwrap_or_else(|e| panic!("{kind}: {e}"));
            assert_eq!(points.len(), 5, "{kind}");
            if kind != "npy" {
                assert_eq!(points[4], nalgebra::Point3::new(0.4, 1.0, 6.0), "{kind}");
            }
        }
    }
    let file = |wanted| sound().into_iter().find(|(kind, _)| *kind == wanted).unwrap().1;
    let photo = parse_picture(&file("turned jpg")).unwrap();
    assert_eq!((photo.size.width, photo.size.height), (13, 19));
    assert!(photo.camera.is_some());
    // The points of the scan as a depth map of 5 x 3.
    assert_eq!(DepthMap::from_npy(&file("npy"), 1.0).unwrap().metres.len(), 15);
    assert!((parse_depth_png(&file("depth png"), 0.001).unwrap().metres[10] - 1.031).abs() < 1e-6);
}

#[test]
fn damaged_files_never_panic() {
    let rounds: u64 = std::env::var("WHERE2ACT_MUTATIONS").ok().map_or(4_000, |n| n.parse().unwrap());
    let files = sound();
    for round in 0..rounds {
        let mut rng = Seed(1).child("mutation", round).rng();
        let (_, file) = &files[(round % files.len() as u64) as usize];
        let mut bytes = file.clone();
        mutate(&mut bytes, &mut rng);
        read_all(&bytes);
    }
    #[cfg(target_os = "linux")]
    {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:")).unwrap();
        let kilobytes: u64 = peak.trim().trim_end_matches(" kB").parse().unwrap();
        assert!(kilobytes < 2 << 20, "{kilobytes} kB at the peak, expected below 2 GiB");
    }
}
