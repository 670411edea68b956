//! Raw maps as NumPy arrays of little-endian f32.

use std::io::{self, Write};

/// Writes `[height, width]`, one row at a time as `row(v, values)` fills it: a map of a large picture is never in
/// memory as a whole.
///
/// # Errors
/// What `to` reports.
pub fn write_npy_grid(
    to: &mut impl Write,
    (height, width): (usize, usize),
    mut row: impl FnMut(usize, &mut [f32]),
) -> io::Result<()> {
    header(to, &format!("({height}, {width})"))?;
    let mut values = vec![0.0; width];
    for v in 0..height {
        row(v, &mut values);
        floats(to, &values)?;
    }
    Ok(())
}

/// Writes `[values]`.
///
/// # Errors
/// What `to` reports.
pub fn write_npy_row(to: &mut impl Write, values: &[f32]) -> io::Result<()> {
    header(to, &format!("({},)", values.len()))?;
    floats(to, values)
}

/// Version 1.0 of the format: magic, version, length of the header, the header padded so that data starts at a
/// multiple of 64.
fn header(to: &mut impl Write, shape: &str) -> io::Result<()> {
    let dict = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    let length = (10 + dict.len() + 1).next_multiple_of(64) - 10;
    to.write_all(b"\x93NUMPY\x01\x00")?;
    to.write_all(&(length as u16).to_le_bytes())?;
    writeln!(to, "{dict:<width$}", width = length - 1)
}

fn floats(to: &mut impl Write, values: &[f32]) -> io::Result<()> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    to.write_all(&bytes)
}
