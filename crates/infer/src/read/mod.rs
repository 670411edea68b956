//! Files become observations. Every reader takes bytes, allocates in proportion to what is really there, and
//! answers anything unsound with [`Malformed`].

mod lzf;
mod npy;
mod pcd;
mod picture;
mod ply;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use nalgebra::Point3;
use where2act_core::is_measured;

pub use npy::{NpyArray, parse_npy};
pub use pcd::parse_pcd;
pub use picture::{DepthMap, MAX_PIXELS, Picture, parse_depth_png, parse_mask, parse_picture};
pub use ply::parse_ply;

use crate::{Malformed, ReadError};

/// Largest file that is read, in bytes. A 16-bit depth map or an 8-bit picture of [`MAX_PIXELS`] fits, and so do
/// [`MAX_POINTS`] of three doubles each; with 16 bits a colour or more fields a point, files of fewer can be too large.
pub const MAX_FILE_BYTES: u64 = 512 << 20;
/// Largest number of points of a scan.
pub const MAX_POINTS: usize = 20_000_000;

/// What kind of input a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A colour picture: png, jpg, webp.
    Picture,
    /// Depth: a 16-bit greyscale png, or an npy of `[height, width]`.
    Depth,
    /// Points: ply, pcd, or an npy of `[points, 3 or more]` or `[height, width, 3 or more]`.
    Scan,
}

/// The kind of a file by its extension and, for png and npy, its header; `None` for files that are no input. An npy of two axes
/// is a table of points if it has less than 8 columns, or at most 16 and more than eight times as many rows.
///
/// # Errors
/// If the file cannot be opened.
pub fn file_kind(path: &Path) -> Result<Option<FileKind>, ReadError> {
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    Ok(match extension.as_deref() {
        Some("ply" | "pcd") => Some(FileKind::Scan),
        Some("npy") => {
            let mut head = Vec::new();
            let file = File::open(path).map_err(io(path))?;
            file.take(npy::MAX_HEADER as u64 + 16).read_to_end(&mut head).map_err(io(path))?;
            // Whoever reads it as points says what is wrong with it.
            let points =
                npy::parse_header(&head).map_or(true, |(header, _)| npy::holds_points(&header.shape));
            Some(if points { FileKind::Scan } else { FileKind::Depth })
        }
        Some("jpg" | "jpeg" | "webp") => Some(FileKind::Picture),
        Some("png") => {
            // Signature, length, "IHDR", width, height, then bit depth and colour type.
            let mut head = [0; 26];
            let mut file = File::open(path).map_err(io(path))?;
            let depth = file.read_exact(&mut head).is_ok() && head.get(24..26) == Some(&[16, 0]);
            Some(if depth { FileKind::Depth } else { FileKind::Picture })
        }
        _ => None,
    })
}

/// Reads a whole file of at most [`MAX_FILE_BYTES`].
///
/// # Errors
/// If the file system says no or the file is larger.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, ReadError> {
    let file = File::open(path).map_err(io(path))?;
    let too_large = |found: String| {
        malformed(path)(Malformed::new(format!("at most {} MiB", MAX_FILE_BYTES >> 20), found))
    };
    // The length is a hint: a pipe or a growing file has none that holds.
    let length = file.metadata().map_or(0, |m| m.len());
    if length > MAX_FILE_BYTES {
        return Err(too_large(format!("{} MiB", length >> 20)));
    }
    let mut bytes = Vec::with_capacity(length as usize + 1);
    file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(io(path))?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        return Err(too_large("a larger file".to_owned()));
    }
    Ok(bytes)
}

/// Reads a colour picture; 16-bit, grey, CMYK and transparent ones become 8-bit RGB over white, turned upright.
///
/// # Errors
/// As [`read_bytes`], and if it is not a picture of reasonable size.
pub fn read_picture(path: &Path) -> Result<Picture, ReadError> {
    parse_picture(&read_bytes(path)?).map_err(malformed(path))
}

/// Reads a depth map, in which 0 and, of integers, 65,535 are no measurement: a 16-bit grey png in units of
/// `metres_per_unit`, or an npy of `[height, width]` (floating point: metres, whatever the unit; integers: units).
///
/// # Errors
/// As [`read_bytes`], and if it is not a depth map.
pub fn read_depth(path: &Path, metres_per_unit: f32) -> Result<DepthMap, ReadError> {
    let bytes = read_bytes(path)?;
    let npy = bytes.starts_with(npy::MAGIC);
    let parsed = if npy {
        DepthMap::from_npy(&bytes, metres_per_unit)
    } else {
        parse_depth_png(&bytes, metres_per_unit)
    };
    parsed.map_err(malformed(path))
}

/// Reads a mask: the pixels of a picture that are brighter than half and not transparent.
///
/// # Errors
/// As [`read_picture`].
pub fn read_mask(path: &Path) -> Result<(where2act_core::ImageSize, Vec<bool>), ReadError> {
    parse_mask(&read_bytes(path)?).map_err(malformed(path))
}

/// Reads the points of a ply, pcd or npy file, told apart by their first bytes. Points that are not finite, or at (0, 0, 0),
/// keep their place, so that an index means the same here and in the file.
///
/// # Errors
/// As [`read_bytes`], and if it is not a scan with at least one measured point.
pub fn read_scan(path: &Path) -> Result<Vec<Point3<f32>>, ReadError> {
    parse_scan(&read_bytes(path)?).map_err(malformed(path))
}

/// As [`read_scan`], from bytes.
///
/// # Errors
/// If it is not a scan with at least one measured point: finite, and not (0, 0, 0).
pub fn parse_scan(bytes: &[u8]) -> Result<Vec<Point3<f32>>, Malformed> {
    let points = if bytes.starts_with(b"ply") {
        parse_ply(bytes)?
    } else if bytes.starts_with(npy::MAGIC) {
        parse_npy(bytes)?.into_points()?
    } else {
        parse_pcd(bytes)?
    };
    if !points.iter().any(is_measured) {
        return Err(Malformed::new(
            "at least one finite point that is not (0, 0, 0)",
            format!("{} points, none of them such", points.len()),
        ));
    }
    Ok(points)
}

fn io(path: &Path) -> impl Fn(std::io::Error) -> ReadError + '_ {
    |source| ReadError::Io { path: path.to_owned(), source }
}

fn malformed(path: &Path) -> impl Fn(Malformed) -> ReadError + '_ {
    |source| ReadError::Malformed { path: path.to_owned(), source }
}

/// Numbers as the scan formats store them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F16,
    F32,
    F64,
}

impl Scalar {
    pub(crate) const fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// The number at the start of `bytes`; `None` if they end too early.
    pub(crate) fn read(self, bytes: &[u8], big_endian: bool) -> Option<f64> {
        let mut raw = [0u8; 8];
        let n = self.bytes();
        let source = bytes.get(..n)?;
        let target = raw.get_mut(..n)?;
        target.copy_from_slice(source);
        if big_endian {
            target.reverse();
        }
        let word = u64::from_le_bytes(raw);
        Some(match self {
            Self::I8 => f64::from(word as i8),
            Self::U8 => f64::from(word as u8),
            Self::I16 => f64::from(word as i16),
            Self::U16 => f64::from(word as u16),
            Self::I32 => f64::from(word as i32),
            Self::U32 => f64::from(word as u32),
            Self::I64 => word as i64 as f64,
            Self::U64 => word as f64,
            Self::F16 => f64::from(half::f16::from_bits(word as u16)),
            Self::F32 => f64::from(f32::from_bits(word as u32)),
            Self::F64 => f64::from_bits(word),
        })
    }
}
