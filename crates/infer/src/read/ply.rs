//! PLY scans: ascii and both binary layouts; any properties, of which x, y, z of `vertex` are read.

use nalgebra::Point3;

use super::{MAX_POINTS, Scalar};
use crate::Malformed;

enum Property {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<(String, Property)>,
}

#[derive(Clone, Copy, PartialEq)]
enum Layout {
    Ascii,
    Binary { big_endian: bool },
}

/// The vertices of a PLY file, metres.
///
/// # Errors
/// If the file is not a PLY with as many vertices, with x, y and z, as its header says.
pub fn parse_ply(bytes: &[u8]) -> Result<Vec<Point3<f32>>, Malformed> {
    let (layout, elements, body) = header(bytes)?;
    match layout {
        Layout::Ascii => ascii(&elements, body),
        Layout::Binary { big_endian } => binary(&elements, body, big_endian),
    }
}

fn header(bytes: &[u8]) -> Result<(Layout, Vec<Element>, &[u8]), Malformed> {
    let mut layout = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut rest = bytes;
    for number in 0.. {
        let end = rest.iter().take(4096).position(|&b| b == b'\n');
        let end = end
            .ok_or_else(|| Malformed::new("a ply header up to end_header", "the end of the header's text"))?;
        let (line, after) = rest.split_at(end);
        rest = after.get(1..).unwrap_or_default();
        let line =
            std::str::from_utf8(line).map_err(|_| Malformed::new("a ply header in text", "other bytes"))?;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            ["format", "ascii", _] => layout = Some(Layout::Ascii),
            ["format", "binary_little_endian", _] => layout = Some(Layout::Binary { big_endian: false }),
            ["format", "binary_big_endian", _] => layout = Some(Layout::Binary { big_endian: true }),
            ["comment" | "obj_info", ..] | [] if number > 0 => {}
            ["element", name, count] if number > 0 => {
                let count =
                    count.parse().map_err(|_| Malformed::new("a number of elements", format!("{line:?}")))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", "list", count, item, name] => add(&mut elements, line, name, || {
                Some(Property::List { count: scalar(count)?, item: scalar(item)? })
            })?,
            ["property", kind, name] => {
                add(&mut elements, line, name, || Some(Property::Scalar(scalar(kind)?)))?;
            }
            ["end_header"] => break,
            _ => return Err(Malformed::new("a line of a ply header", format!("{line:?}"))),
        }
    }
    let layout = layout.ok_or_else(|| Malformed::new("a ply format line", "none"))?;
    Ok((layout, elements, rest))
}

fn add(
    elements: &mut [Element],
    line: &str,
    name: &str,
    property: impl Fn() -> Option<Property>,
) -> Result<(), Malformed> {
    let wrong = || Malformed::new("a property of a known type after its element", format!("{line:?}"));
    let element = elements.last_mut().ok_or_else(wrong)?;
    element.properties.push((name.to_owned(), property().ok_or_else(wrong)?));
    Ok(())
}

fn scalar(name: &str) -> Option<Scalar> {
    Some(match name {
        "char" | "int8" => Scalar::I8,
        "uchar" | "uint8" => Scalar::U8,
        "short" | "int16" => Scalar::I16,
        "ushort" | "uint16" => Scalar::U16,
        "int" | "int32" => Scalar::I32,
        "uint" | "uint32" => Scalar::U32,
        "float" | "float32" => Scalar::F32,
        "double" | "float64" => Scalar::F64,
        _ => return None,
    })
}

impl Element {
    /// Which properties are x, y and z.
    fn coordinates(&self) -> Result<[usize; 3], Malformed> {
        let find = |wanted: &str| {
            let is =
                |(name, kind): &(String, Property)| name == wanted && matches!(kind, Property::Scalar(_));
            let found = self.properties.iter().position(is);
            found.ok_or_else(|| Malformed::new(format!("a number {wanted:?} in every vertex"), "none"))
        };
        if self.count > MAX_POINTS {
            return Err(Malformed::new(format!("at most {MAX_POINTS} points"), format!("{}", self.count)));
        }
        Ok([find("x")?, find("y")?, find("z")?])
    }

    /// Bytes of one binary record; `None` if it has lists.
    fn stride(&self) -> Option<usize> {
        self.properties
            .iter()
            .map(|(_, p)| if let Property::Scalar(s) = p { Some(s.bytes()) } else { None })
            .sum()
    }
}

fn short(element: &Element, found: usize) -> Malformed {
    Malformed::new(
        format!("{} {} records", element.count, element.name),
        format!("the end of the file after {found}"),
    )
}

fn no_vertices() -> Malformed {
    Malformed::new("an element vertex", "none")
}

fn ascii(elements: &[Element], body: &[u8]) -> Result<Vec<Point3<f32>>, Malformed> {
    let text = std::str::from_utf8(body).map_err(|_| Malformed::new("numbers as text", "other bytes"))?;
    let mut lines = text.lines().filter(|line| !line.trim().is_empty());
    for element in elements {
        if element.name != "vertex" {
            // One record a line, however many numbers it has.
            for i in 0..element.count {
                lines.next().ok_or_else(|| short(element, i))?;
            }
            continue;
        }
        let coordinates = element.coordinates()?;
        let last = coordinates.into_iter().max().unwrap_or_default();
        let simple = element.stride().is_some();
        if !simple {
            return Err(Malformed::new("vertices without lists in an ascii ply", "a list"));
        }
        let mut points = Vec::with_capacity(element.count.min(body.len() / 6 + 1));
        for i in 0..element.count {
            let line = lines.next().ok_or_else(|| short(element, i))?;
            let mut point = [f32::NAN; 3];
            let mut seen = 0;
            for (column, word) in line.split_whitespace().take(last + 1).enumerate() {
                for (value, _) in point.iter_mut().zip(coordinates).filter(|(_, c)| *c == column) {
                    *value = word.parse().map_err(|_| Malformed::new("a number", format!("{word:.32?}")))?;
                }
                seen = column;
            }
            if seen < last {
                return Err(Malformed::new("x, y and z on every line", format!("{line:.64?}")));
            }
            points.push(Point3::from(point));
        }
        return Ok(points);
    }
    Err(no_vertices())
}

fn binary(elements: &[Element], mut body: &[u8], big_endian: bool) -> Result<Vec<Point3<f32>>, Malformed> {
    for element in elements {
        let wanted = if element.name == "vertex" { Some(element.coordinates()?) } else { None };
        match (element.stride(), wanted) {
            (Some(stride), None) => {
                let size = element.count.checked_mul(stride).ok_or_else(|| short(element, 0))?;
                body = body.get(size..).ok_or_else(|| short(element, body.len() / stride.max(1)))?;
            }
            (Some(stride), Some(coordinates)) => {
                let offset = |property: usize| -> usize {
                    let before = element.properties.iter().take(property);
                    before.map(|(_, p)| if let Property::Scalar(s) = p { s.bytes() } else { 0 }).sum()
                };
                let size = element.count.checked_mul(stride);
                let records =
                    size.and_then(|s| body.get(..s)).ok_or_else(|| short(element, body.len() / stride))?;
                let columns = coordinates.map(|c| (offset(c), element.properties.get(c).map(|p| &p.1)));
                let read = |record: &[u8]| {
                    Point3::from(columns.map(|(at, property)| match property {
                        Some(Property::Scalar(s)) => {
                            record.get(at..).and_then(|b| s.read(b, big_endian)).unwrap_or(f64::NAN) as f32
                        }
                        _ => f32::NAN,
                    }))
                };
                return Ok(records.chunks_exact(stride).map(read).collect());
            }
            (None, wanted) => {
                let points = with_lists(element, wanted, &mut body, big_endian)?;
                if wanted.is_some() {
                    return Ok(points);
                }
            }
        }
    }
    Err(no_vertices())
}

/// Walks over records whose size varies; collects points if `wanted` names their coordinates.
fn with_lists(
    element: &Element,
    wanted: Option<[usize; 3]>,
    body: &mut &[u8],
    big_endian: bool,
) -> Result<Vec<Point3<f32>>, Malformed> {
    let mut points = Vec::new();
    for i in 0..element.count {
        let mut point = [f32::NAN; 3];
        for (column, (_, property)) in element.properties.iter().enumerate() {
            let skip = match property {
                Property::Scalar(s) => {
                    let value = s.read(body, big_endian).ok_or_else(|| short(element, i))?;
                    if let Some(coordinates) = wanted {
                        for (target, _) in point.iter_mut().zip(coordinates).filter(|(_, c)| *c == column) {
                            *target = value as f32;
                        }
                    }
                    s.bytes()
                }
                Property::List { count, item } => {
                    let n = count.read(body, big_endian).ok_or_else(|| short(element, i))?;
                    // A negative count saturates to none; a huge one runs into the end of the file below.
                    (n as usize).saturating_mul(item.bytes()).saturating_add(count.bytes())
                }
            };
            *body = body.get(skip..).ok_or_else(|| short(element, i))?;
        }
        if wanted.is_some() {
            points.push(Point3::from(point));
        }
    }
    Ok(points)
}
