//! Scans with colours, for any point cloud viewer.

use std::io::{self, Write};

use nalgebra::Point3;

/// Writes points (metres, optical frame) with a colour and a value each, as binary little-endian PLY. Points that are
/// not finite are left out; viewers stumble over them.
///
/// # Errors
/// What `to` reports.
pub fn write_coloured_ply(
    to: &mut impl Write,
    points: &[Point3<f32>],
    values: &[f32],
    colour: impl Fn(f32) -> [u8; 3],
) -> io::Result<()> {
    let finite = || points.iter().zip(values).filter(|(p, _)| p.iter().all(|x| x.is_finite()));
    write!(
        to,
        "ply\nformat binary_little_endian 1.0\ncomment camera_optical, metres\nelement vertex {}\n\
         property float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float actionability\nend_header\n",
        finite().count()
    )?;
    for (point, &value) in finite() {
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
