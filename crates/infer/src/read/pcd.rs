//! PCD scans (Point Cloud Library, version 0.7): ascii, binary and binary_compressed.

use nalgebra::Point3;

use super::lzf::decompress;
use super::{MAX_POINTS, Scalar};
use crate::Malformed;

/// A column of the table of points: where it starts in a record and how it is stored.
#[derive(Clone, Copy)]
struct Column {
    /// Bytes from the start of the record.
    offset: usize,
    /// Numbers before it in a record.
    index: usize,
    scalar: Scalar,
}

struct Header {
    xyz: [Column; 3],
    points: usize,
    /// Bytes of a record.
    stride: usize,
    data: String,
}

/// The points of a PCD file, metres, as they stand there: `VIEWPOINT` says where the sensor was in some other frame, and is not
/// applied.
///
/// # Errors
/// If the file is not a PCD with as many points, with x, y and z, as its header says.
pub fn parse_pcd(bytes: &[u8]) -> Result<Vec<Point3<f32>>, Malformed> {
    let (header, body) = parse_header(bytes)?;
    let size = header.points.saturating_mul(header.stride);
    let short =
        |found: usize| Malformed::new(format!("{} points", header.points), format!("data for {found}"));
    match header.data.as_str() {
        "ascii" => ascii(&header, body),
        "binary" => {
            let records = body.get(..size).ok_or_else(|| short(body.len() / header.stride))?;
            Ok(table(&header, |i, c| records.get(i * header.stride + c.offset..)))
        }
        "binary_compressed" => {
            let word =
                |at: usize| body.get(at..).and_then(|b| Scalar::U32.read(b, false)).map(|n| n as usize);
            let (packed, unpacked) = word(0).zip(word(4)).ok_or_else(|| short(0))?;
            if unpacked != size {
                return Err(Malformed::new(format!("{size} uncompressed bytes"), unpacked.to_string()));
            }
            let data = body.get(8..).and_then(|b| b.get(..packed)).ok_or_else(|| short(0))?;
            let wrong = || Malformed::new(format!("LZF data of {size} bytes"), "something else");
            let columns = decompress(data, size).ok_or_else(wrong)?;
            // Compressed files store one column after the other.
            let n = header.points;
            Ok(table(&header, |i, c| columns.get(c.offset * n + i * c.scalar.bytes()..)))
        }
        other => Err(Malformed::new("DATA ascii, binary or binary_compressed", format!("{other:.32?}"))),
    }
}

fn table<'a>(header: &Header, at: impl Fn(usize, &Column) -> Option<&'a [u8]>) -> Vec<Point3<f32>> {
    let value = |i, c: &Column| at(i, c).and_then(|b| c.scalar.read(b, false)).unwrap_or(f64::NAN) as f32;
    (0..header.points).map(|i| Point3::from(header.xyz.each_ref().map(|c| value(i, c)))).collect()
}

fn ascii(header: &Header, body: &[u8]) -> Result<Vec<Point3<f32>>, Malformed> {
    let text = std::str::from_utf8(body).map_err(|_| Malformed::new("numbers as text", "other bytes"))?;
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    let mut points = Vec::with_capacity(header.points.min(body.len() / 6 + 1));
    for i in 0..header.points {
        let short = || Malformed::new(format!("{} points", header.points), format!("{i}"));
        let words: Vec<&str> = lines.next().ok_or_else(short)?.split_whitespace().collect();
        let mut point = [f32::NAN; 3];
        for (value, column) in point.iter_mut().zip(header.xyz) {
            let word = words.get(column.index).copied().unwrap_or("the end of the line");
            *value = word.parse().map_err(|_| Malformed::new("a number", format!("{word:.32?}")))?;
        }
        points.push(Point3::from(point));
    }
    Ok(points)
}

fn parse_header(bytes: &[u8]) -> Result<(Header, &[u8]), Malformed> {
    let (mut fields, mut sizes, mut kinds, mut counts) = (vec![], vec![], vec![], vec![]);
    let (mut width, mut height, mut points) = (None, None, None);
    let mut rest = bytes;
    let data = loop {
        let end = rest.iter().take(65_536).position(|&b| b == b'\n');
        let end = end.ok_or_else(|| Malformed::new("a ply, pcd or npy header", "none"))?;
        let (line, after) = rest.split_at(end);
        rest = after.get(1..).unwrap_or_default();
        let line = std::str::from_utf8(line)
            .map_err(|_| Malformed::new("a ply, pcd or npy header", "other bytes"))?;
        let mut words = line.split_whitespace();
        let key = words.next().unwrap_or_default();
        let list: Vec<&str> = words.collect();
        let number = || {
            let parsed = list.first().and_then(|w| w.parse::<usize>().ok());
            parsed.ok_or_else(|| Malformed::new(format!("a number after {key}"), format!("{line:.64?}")))
        };
        match key {
            "FIELDS" => fields = list,
            "SIZE" => sizes = list,
            "TYPE" => kinds = list,
            "COUNT" => counts = list,
            "WIDTH" => width = Some(number()?),
            "HEIGHT" => height = Some(number()?),
            "POINTS" => points = Some(number()?),
            "DATA" => break list.first().copied().unwrap_or_default().to_owned(),
            "VERSION" | "VIEWPOINT" | "" => {}
            comment if comment.starts_with('#') => {}
            _ => return Err(Malformed::new("a ply, pcd or npy header", format!("{line:.64?}"))),
        }
    };
    let by_size = width.zip(height).and_then(|(w, h): (usize, usize)| w.checked_mul(h));
    let points = points.or(by_size).ok_or_else(|| Malformed::new("POINTS, or WIDTH and HEIGHT", "none"))?;
    if points > MAX_POINTS {
        return Err(Malformed::new(format!("at most {MAX_POINTS} points"), points.to_string()));
    }
    let (xyz, stride) = columns(&fields, &sizes, &kinds, &counts)?;
    Ok((Header { xyz, points, stride, data }, rest))
}

fn columns(
    fields: &[&str],
    sizes: &[&str],
    kinds: &[&str],
    counts: &[&str],
) -> Result<([Column; 3], usize), Malformed> {
    let mut xyz = [None; 3];
    let (mut offset, mut index) = (0usize, 0usize);
    for (i, field) in fields.iter().enumerate() {
        let wrong =
            || Malformed::new("SIZE, TYPE and COUNT for every field", format!("none sound for {field:.32?}"));
        let scalar = scalar(sizes.get(i), kinds.get(i)).ok_or_else(wrong)?;
        // COUNT may be left out; a record of a megabyte is nobody's point.
        let count = if counts.is_empty() {
            1
        } else {
            counts.get(i).and_then(|c| c.parse().ok()).ok_or_else(wrong)?
        };
        if let Some(axis) = ["x", "y", "z"].iter().position(|a| a == field)
            && let Some(slot) = xyz.get_mut(axis)
        {
            *slot = Some(Column { offset, index, scalar });
        }
        offset = offset.saturating_add(scalar.bytes().saturating_mul(count));
        index = index.saturating_add(count);
        if offset > 1 << 20 {
            return Err(wrong());
        }
    }
    let [Some(x), Some(y), Some(z)] = xyz else {
        return Err(Malformed::new("fields x, y and z", format!("{:.64?}", fields.join(" "))));
    };
    Ok(([x, y, z], offset))
}

fn scalar(size: Option<&&str>, kind: Option<&&str>) -> Option<Scalar> {
    Some(match (*kind?, *size?) {
        ("F", "4") => Scalar::F32,
        ("F", "8") => Scalar::F64,
        ("I", "1") => Scalar::I8,
        ("I", "2") => Scalar::I16,
        ("I", "4") => Scalar::I32,
        ("I", "8") => Scalar::I64,
        ("U", "1") => Scalar::U8,
        ("U", "2") => Scalar::U16,
        ("U", "4") => Scalar::U32,
        ("U", "8") => Scalar::U64,
        _ => return None,
    })
}
