//! NumPy arrays: scans of `[points, 3 or more]` or `[height, width, 3 or more]`, depth maps of `[height, width]`.

use nalgebra::Point3;

use super::{MAX_POINTS, Scalar};
use crate::Malformed;

pub(crate) const MAGIC: &[u8] = b"\x93NUMPY";
/// Most numbers an array may hold.
const MAX_VALUES: usize = 100_000_000;
/// Most bytes of a header.
pub(super) const MAX_HEADER: usize = 65_536;
/// A table of fewer columns than this is no depth map, whatever its height.
const NARROWEST_MAP: usize = 8;
/// Columns that a table of points may have: coordinates, colours, normals, and what else a scanner says of a point.
const MOST_COLUMNS: usize = 16;

/// Whether an array of this shape holds points and not depths: one in each row of a table, or one at each place of a grid.
/// Tables of as many columns as the narrowest depth maps are taken for tables if they are much taller than wide.
pub(super) fn holds_points(shape: &[usize]) -> bool {
    match *shape {
        [rows, columns] => {
            columns < NARROWEST_MAP || (columns <= MOST_COLUMNS && rows > columns.saturating_mul(8))
        }
        [_, _, channels] => channels != 1,
        _ => true,
    }
}

/// A dense array of numbers, row-major whatever the file's order.
#[derive(Clone, Debug, PartialEq)]
pub struct NpyArray {
    /// Sizes, slowest first.
    pub shape: Vec<usize>,
    /// Values.
    pub values: Vec<f32>,
    /// Whether the file holds integers.
    pub integers: bool,
}

impl NpyArray {
    /// The first three numbers of every row as points.
    ///
    /// # Errors
    /// If the rows are shorter or longer than those of points, the shape is that of a depth map, or there are too many.
    pub fn into_points(self) -> Result<Vec<Point3<f32>>, Malformed> {
        let columns = self.shape.last().copied().unwrap_or(0);
        let wrong = !(2..=3).contains(&self.shape.len())
            || !(3..=MOST_COLUMNS).contains(&columns)
            || !holds_points(&self.shape);
        if wrong || self.values.len() / columns.max(1) > MAX_POINTS {
            let expected = format!("an array [points, 3], of at most {MAX_POINTS} points");
            return Err(Malformed::new(expected, format!("shape {:?}", self.shape)));
        }
        let point = |row: &[f32]| match row {
            [x, y, z, ..] => Point3::new(*x, *y, *z),
            _ => Point3::new(f32::NAN, f32::NAN, f32::NAN),
        };
        Ok(self.values.chunks_exact(columns).map(point).collect())
    }
}

/// What an npy file says of its array before the numbers.
pub(super) struct Header {
    pub(super) shape: Vec<usize>,
    fortran: bool,
    scalar: Scalar,
    big_endian: bool,
}

/// The header of an npy file, and what follows it.
///
/// # Errors
/// If the bytes do not begin with one.
pub(super) fn parse_header(bytes: &[u8]) -> Result<(Header, &[u8]), Malformed> {
    let wrong = |found: &str| Malformed::new("an npy header", found);
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| wrong("other bytes"))?;
    let (length, at) = match rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([*a, *b])), 4),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([*a, *b, *c, *d]) as usize, 6),
        _ => return Err(wrong("an unknown version")),
    };
    let end = length.saturating_add(at);
    let text =
        rest.get(at..end).filter(|_| length <= MAX_HEADER).ok_or_else(|| wrong("the end of the file"))?;
    let text = std::str::from_utf8(text).map_err(|_| wrong("other bytes"))?;
    let descr =
        quoted(after(text, "descr").ok_or_else(|| wrong("no descr"))?).ok_or_else(|| wrong("no descr"))?;
    let fortran = after(text, "fortran_order").is_some_and(|t| t.trim_start().starts_with("True"));
    let shape = shape(after(text, "shape").unwrap_or_default()).ok_or_else(|| wrong("no shape"))?;
    let (scalar, big_endian) =
        scalar(descr).ok_or_else(|| Malformed::new("numbers", format!("type {descr:.32?}")))?;
    Ok((Header { shape, fortran, scalar, big_endian }, rest.get(end..).unwrap_or_default()))
}

/// Reads an array of numbers.
///
/// # Errors
/// If the bytes are not an npy file with as many numbers as its header says.
pub fn parse_npy(bytes: &[u8]) -> Result<NpyArray, Malformed> {
    let (Header { shape, fortran, scalar, big_endian }, body) = parse_header(bytes)?;
    let values = shape.iter().try_fold(1usize, |n, &d| n.checked_mul(d)).filter(|n| *n <= MAX_VALUES);
    let too_many = || Malformed::new(format!("at most {MAX_VALUES} numbers"), format!("shape {shape:?}"));
    let n = values.ok_or_else(too_many)?;
    let short = || Malformed::new(format!("{n} numbers"), format!("{}", body.len() / scalar.bytes()));
    let body = body.get(..n * scalar.bytes()).ok_or_else(short)?;
    let read = |chunk: &[u8]| scalar.read(chunk, big_endian).unwrap_or(f64::NAN) as f32;
    let mut values: Vec<f32> = body.chunks_exact(scalar.bytes()).map(read).collect();
    if fortran {
        values = row_major(&values, &shape);
    }
    let integers = !matches!(scalar, Scalar::F16 | Scalar::F32 | Scalar::F64);
    Ok(NpyArray { shape, values, integers })
}

/// What follows `'key':`.
fn after<'a>(text: &'a str, key: &str) -> Option<&'a str> {
    let at = text.find(&format!("'{key}'"))?;
    text.get(at + key.len() + 2..)?.trim_start().strip_prefix(':')
}

fn quoted(text: &str) -> Option<&str> {
    text.trim_start().strip_prefix('\'')?.split_once('\'').map(|(inner, _)| inner)
}

fn shape(text: &str) -> Option<Vec<usize>> {
    let (inner, _) = text.trim_start().strip_prefix('(')?.split_once(')')?;
    let sizes = inner.split(',').map(str::trim).filter(|s| !s.is_empty());
    let shape: Option<Vec<usize>> = sizes.map(|s| s.parse().ok()).collect();
    shape.filter(|s| s.len() <= 8)
}

fn scalar(descr: &str) -> Option<(Scalar, bool)> {
    let mut chars = descr.chars();
    let big_endian = match chars.next()? {
        '<' | '|' => false,
        '>' => true,
        _ => return None,
    };
    let scalar = match chars.as_str() {
        "f2" => Scalar::F16,
        "f4" => Scalar::F32,
        "f8" => Scalar::F64,
        "i1" => Scalar::I8,
        "u1" => Scalar::U8,
        "i2" => Scalar::I16,
        "u2" => Scalar::U16,
        "i4" => Scalar::I32,
        "u4" => Scalar::U32,
        "i8" => Scalar::I64,
        "u8" => Scalar::U64,
        _ => return None,
    };
    Some((scalar, big_endian))
}

/// Column-major values in row-major order.
fn row_major(values: &[f32], shape: &[usize]) -> Vec<f32> {
    let strides: Vec<usize> = shape
        .iter()
        .scan(1, |stride, &size| {
            let this = *stride;
            *stride *= size;
            Some(this)
        })
        .collect();
    let mut index = vec![0usize; shape.len()];
    let mut sorted = Vec::with_capacity(values.len());
    for _ in 0..values.len() {
        let at: usize = index.iter().zip(&strides).map(|(i, s)| i * s).sum();
        sorted.push(values.get(at).copied().unwrap_or(f32::NAN));
        for (i, &size) in index.iter_mut().zip(shape).rev() {
            *i += 1;
            if *i < size {
                break;
            }
            *i = 0;
        }
    }
    sorted
}
