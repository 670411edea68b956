//! What the seen points say about the surface: where it is at a pixel and which way it faces.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use where2act_core::{ImageSize, Intrinsics, Pixel};

/// Fewest points that span a plane worth believing.
const MIN_POINTS: usize = 6;
/// Largest difference in depth between neighbours on one surface, as a share of the depth.
const SAME_SURFACE: f32 = 0.02;
/// How far from a pixel without depth a contact point is looked for, pixels.
const HOLE: i64 = 4;

/// A depth map with its camera.
#[derive(Clone, Copy)]
pub(crate) struct DepthView<'a> {
    pub(crate) size: ImageSize,
    pub(crate) depth: &'a [f32],
    pub(crate) intrinsics: Intrinsics,
}

/// Pixels of a depth map that are looked at for what is in a hand's way, at most.
const LOOKED_AT: usize = 16_384;

impl DepthView<'_> {
    /// The points seen at a grid of pixels, wherever there is depth.
    pub(crate) fn points(&self) -> Vec<Point3<f32>> {
        let step = (self.size.pixels() as f32 / LOOKED_AT as f32).sqrt().ceil().max(1.0) as usize;
        let pixels = (0..self.size.height).step_by(step);
        let pixels = pixels.flat_map(|v| (0..self.size.width).step_by(step).map(move |u| (u, v)));
        let point = |(u, v): (usize, usize)| {
            let z = self.depth_at(u as i64, v as i64)?;
            Some(self.intrinsics.pixel_to_point(Pixel { u: u as u32, v: v as u32 }, z))
        };
        pixels.filter_map(point).collect()
    }

    /// The point seen at a pixel, or at the nearest pixel with depth a few pixels around it.
    pub(crate) fn contact(&self, pixel: Pixel) -> Option<Point3<f32>> {
        if let Some(z) = self.depth_at(i64::from(pixel.u), i64::from(pixel.v)) {
            return Some(self.intrinsics.pixel_to_point(pixel, z));
        }
        let mut nearest: Option<(i64, Pixel, f32)> = None;
        self.around(pixel, HOLE, |near, z| {
            let (du, dv) = (i64::from(near.u) - i64::from(pixel.u), i64::from(near.v) - i64::from(pixel.v));
            let d = du * du + dv * dv;
            if nearest.is_none_or(|n| d < n.0) {
                nearest = Some((d, near, z));
            }
        });
        nearest.map(|(_, near, z)| self.intrinsics.pixel_to_point(near, z))
    }

    /// The normal of the surface around a pixel, towards the camera: of 5 x 5 pixels in a depth map of 448. Twice as far to
    /// each side, fewer of the hands that come from behind were found (at handles), and more others were taken for such.
    pub(crate) fn normal(&self, pixel: Pixel, contact: &Point3<f32>) -> Option<Vector3<f32>> {
        let reach = (self.size.width.max(self.size.height) as i64 / 200).clamp(2, 6);
        let mut points = Vec::new();
        self.around(pixel, reach, |near, z| {
            if (z - contact.z).abs() < SAME_SURFACE * contact.z {
                points.push(self.intrinsics.pixel_to_point(near, z));
            }
        });
        normal(&points)
    }

    fn depth_at(&self, u: i64, v: i64) -> Option<f32> {
        let inside = (0..self.size.width as i64).contains(&u) && (0..self.size.height as i64).contains(&v);
        let z = inside.then(|| self.depth.get(v as usize * self.size.width + u as usize)).flatten()?;
        (*z > 0.0 && z.is_finite()).then_some(*z)
    }

    fn around(&self, pixel: Pixel, reach: i64, mut visit: impl FnMut(Pixel, f32)) {
        for v in i64::from(pixel.v) - reach..=i64::from(pixel.v) + reach {
            for u in i64::from(pixel.u) - reach..=i64::from(pixel.u) + reach {
                if let Some(z) = self.depth_at(u, v) {
                    visit(Pixel { u: u as u32, v: v as u32 }, z);
                }
            }
        }
    }
}

/// The normal of the plane nearest to some points in the optical frame, towards the camera at its origin.
pub(crate) fn normal(points: &[Point3<f32>]) -> Option<Vector3<f32>> {
    if points.len() < MIN_POINTS {
        return None;
    }
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f32>>() / points.len() as f32;
    let spread: Matrix3<f32> = points.iter().map(|p| (p.coords - mean) * (p.coords - mean).transpose()).sum();
    let eigen = SymmetricEigen::try_new(spread, f32::EPSILON, 100)?;
    let (least, _) = eigen.eigenvalues.argmin();
    let normal: Vector3<f32> = eigen.eigenvectors.column(least).into();
    // A line of points has a whole circle of normals.
    let middle = eigen.eigenvalues.sum() - eigen.eigenvalues.max() - eigen.eigenvalues.min();
    if middle <= 1e-3 * eigen.eigenvalues.max() || !normal.iter().all(|x| x.is_finite()) {
        return None;
    }
    Some(if normal.dot(&mean) > 0.0 { -normal } else { normal })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_faces_the_camera_and_a_hole_takes_its_neighbours_depth() {
        let size = ImageSize::square(64);
        let intrinsics = Intrinsics::from_fov(size, 0.6);
        // The plane z = 2 + 0.5 x, whose normal is (0.5, 0, -1) / |..|.
        let mut depth: Vec<f32> = (0..size.pixels())
            .map(|i| {
                let x = ((i % 64) as f32 + 0.5 - intrinsics.cx) / intrinsics.fx;
                2.0 / (1.0 - 0.5 * x)
            })
            .collect();
        let pixel = Pixel { u: 30, v: 40 };
        depth[size.index(pixel)] = f32::NAN;
        let view = DepthView { size, depth: &depth, intrinsics };
        let contact = view.contact(pixel).unwrap();
        assert!((contact.z - 2.0 - 0.5 * contact.x).abs() < 1e-4);
        let normal = view.normal(pixel, &contact).unwrap();
        assert!((normal - Vector3::new(0.5, 0.0, -1.0).normalize()).norm() < 1e-2, "{normal}");
        let nothing = vec![0.0; size.pixels()];
        assert!(DepthView { size, depth: &nothing, intrinsics }.contact(pixel).is_none());
    }

    #[test]
    fn lines_and_single_points_have_no_normal() {
        let line: Vec<_> = (0..20).map(|i| Point3::new(i as f32, 0.0, 2.0)).collect();
        assert!(normal(&line).is_none());
        assert!(normal(&[Point3::new(0.0, 0.0, 1.0); 20]).is_none());
    }
}
