//! What a camera or scanner sees, wherever it comes from.

use nalgebra::Point3;

use crate::{ImageSize, Intrinsics, Pixel};

/// Coordinates beyond this many metres are no measurements: some programs write such numbers for what is infinitely far away.
const FURTHEST: f32 = 1e6;

/// Whether a depth was measured, metres: it is positive, and not beyond what any sensor sees.
#[must_use]
pub fn is_measured_depth(z: f32) -> bool {
    z > 0.0 && z < FURTHEST
}

/// Whether a point of a scan was measured: its coordinates are finite and below a million metres, and it is not (0, 0, 0), which
/// is what organised clouds have where nothing was seen.
#[must_use]
pub fn is_measured(point: &Point3<f32>) -> bool {
    point.iter().all(|x| x.abs() < FURTHEST) && *point != Point3::origin()
}

/// One view of an object: a picture, a depth map, both, or an unordered scan. Buffers are row-major.
#[derive(Clone, Debug, PartialEq)]
pub enum Observation {
    /// A picture and/or depth map on a pixel grid.
    Image {
        /// Size of every buffer below.
        size: ImageSize,
        /// Colours, sRGB, `[height * width]`.
        rgb: Option<Vec<[u8; 3]>>,
        /// Depth along the optical axis in metres, `[height * width]`; 0, negative, 1e6 and more or not finite = nothing seen.
        depth: Option<Vec<f32>>,
        /// Needed to turn depth into points; and, for a picture with a mask, to say which way directions are of an object beside the
        /// camera's axis.
        intrinsics: Option<Intrinsics>,
        /// Pixels that belong to the object, all of it, `[height * width]`; `None` = decide by depth, or take all. It also
        /// decides what of the picture some networks look at; a part alone is a region, which proposals are kept to.
        mask: Option<Vec<bool>>,
    },
    /// Points in the optical frame, metres.
    Cloud {
        /// At least one point that was [measured](is_measured); the others count as nothing and keep their index.
        points: Vec<Point3<f32>>,
    },
}

impl Observation {
    /// Depth readings of an image that lie on the object, with their points in the optical frame. Empty for an
    /// image without depth or intrinsics, and for a cloud; what a buffer is too short for was not seen.
    #[must_use]
    pub fn foreground_points(&self) -> Vec<(Pixel, Point3<f32>)> {
        let Self::Image { size, depth: Some(depth), intrinsics: Some(intrinsics), mask, .. } = self else {
            return Vec::new();
        };
        let mut points = Vec::new();
        for v in 0..size.height as u32 {
            for u in 0..size.width as u32 {
                let pixel = Pixel { u, v };
                let i = size.index(pixel);
                let Some(&z) = depth.get(i) else { return points };
                if is_measured_depth(z) && mask.as_ref().is_none_or(|m| m.get(i) == Some(&true)) {
                    points.push((pixel, intrinsics.pixel_to_point(pixel, z)));
                }
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(depth: &[f32], mask: &[bool]) -> Vec<(Pixel, Point3<f32>)> {
        let observation = Observation::Image {
            size: ImageSize { width: 2, height: 2 },
            rgb: None,
            depth: Some(depth.to_vec()),
            intrinsics: Some(Intrinsics { fx: 1.0, fy: 1.0, cx: 1.0, cy: 1.0 }),
            mask: Some(mask.to_vec()),
        };
        observation.foreground_points()
    }

    #[test]
    fn only_seen_and_masked_pixels_become_points() {
        let points = points(&[1.0, 0.0, f32::NAN, 2.0], &[false, true, true, true]);
        assert_eq!(points, vec![(Pixel { u: 1, v: 1 }, Point3::new(1.0, 1.0, 2.0))]);
    }

    #[test]
    fn short_buffers_give_fewer_points() {
        assert_eq!(points(&[1.0; 3], &[true; 4]).len(), 3);
        assert_eq!(points(&[1.0; 4], &[true; 2]).len(), 2);
    }
}
