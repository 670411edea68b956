//! Scans with colours, for any point cloud viewer.

use std::io::{self, Write};

use nalgebra::Point3;
use where2act_core::is_measured;

/// Writes points (metres, optical frame) with a colour and a value each, as binary little-endian PLY. Points that
/// were not [measured](is_measured) are left out: viewers stumble over numbers that are not finite.
///
/// # Errors
/// What `to` reports.
pub fn write_coloured_ply(
    to: &mut impl Write,
    points: &[Point3<f32>],
    values: &[f32],
    colour: impl Fn(f32) -> [u8; 3],
) -> io::Result<()> {
    let measured = || points.iter().zip(values).filter(|(p, _)| is_measured(p));
    write!(
        to,
        "ply\nformat binary_little_endian 1.0\ncomment camera_optical, metres\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float actionability\nend_header\n",
        measured().count()
    )?;
    for (point, &value) in measured() {
        let mut record = [0u8; 19];
        let floats = [point.x, point.y, point.z].map(f32::to_le_bytes).concat();
        let bytes = floats.into_iter().chain(colour(value)).chain(value.to_le_bytes());
        for (slot, byte) in record.iter_mut().zip(bytes) {
            *slot = byte;
        }
        to.write_all(&record)?;
    }
    Ok(())
}
