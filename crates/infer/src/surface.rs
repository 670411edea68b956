//! What the seen points say about the surface: where it is at a pixel and which way it faces.

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use where2act_core::{ImageSize, Intrinsics, Observation, Pixel, is_measured_depth};

/// Fewest points that span a plane worth believing.
const MIN_POINTS: usize = 6;
/// Largest difference in depth between neighbours on one surface, as a share of the depth.
const SAME_SURFACE: f32 = 0.02;
/// How far from a pixel without depth a contact point is looked for, pixels.
const HOLE: i64 = 4;
/// Half the side of the piece of surface whose normal is wanted, metres: 2 pixels in the published view. With 4, fewer of the
/// hands that come from behind were found, at handles, and more others were taken for such.
const PATCH: f32 = 0.014;
/// Pixels in each direction that are looked at for what is around a point: so many or, as steps are whole, up to twice as many.
const LOOKED_AT: usize = 32;

/// A depth map with its camera.
#[derive(Clone, Copy)]
pub(crate) struct DepthView<'a> {
    pub(crate) size: ImageSize,
    pub(crate) depth: &'a [f32],
    pub(crate) intrinsics: Intrinsics,
    /// What is the object: the only thing to touch, but not the only one in a hand's way.
    pub(crate) mask: Option<&'a [bool]>,
}

impl DepthView<'_> {
    /// The depth map of an observation that has one, and its camera.
    pub(crate) fn of(observation: &Observation) -> Option<DepthView<'_>> {
        match observation {
            Observation::Image { size, depth: Some(depth), intrinsics: Some(intrinsics), mask, .. } => {
                Some(DepthView { size: *size, depth, intrinsics: *intrinsics, mask: mask.as_deref() })
            }
            _ => None,
        }
    }

    /// What is seen at a grid of pixels that holds all points up to `reach` metres from this one, and some beyond.
    pub(crate) fn around_point(&self, point: &Point3<f32>, reach: f32) -> Vec<Point3<f32>> {
        let Some((u, v)) = self.intrinsics.project(point) else { return Vec::new() };
        // Nearer points spread over more pixels, and away from the axis depth moves a point too.
        let nearest = (point.z - reach).max(0.1 * point.z);
        // There is nothing beyond the picture: close to the camera, steps for all of that would miss what is near.
        let half = |f: f32, x: f32, side: usize| {
            (f * reach * (1.0 + (x / point.z).abs()) / nearest).min(side as f32) as i64 + 1
        };
        let half = (
            half(self.intrinsics.fx, point.x, self.size.width),
            half(self.intrinsics.fy, point.y, self.size.height),
        );
        let (u, v) = (u as i64, v as i64);
        let columns = within(u, half.0, self.size.width);
        let rows = within(v, half.1, self.size.height);
        let step = (columns.count().max(rows.count()) / LOOKED_AT).max(1);
        let mut seen = Vec::new();
        self.around((u, v), half, step, |pixel, z| {
            seen.push(self.intrinsics.pixel_to_point(pixel, z));
        });
        seen
    }

    /// The point seen at a pixel, or at the nearest pixel of the object with depth a few pixels around it.
    pub(crate) fn contact(&self, pixel: Pixel) -> Option<Point3<f32>> {
        if let Some(z) = self.depth_at(i64::from(pixel.u), i64::from(pixel.v)) {
            return Some(self.intrinsics.pixel_to_point(pixel, z));
        }
        let mut nearest: Option<(i64, Pixel, f32)> = None;
        let centre = (i64::from(pixel.u), i64::from(pixel.v));
        self.around(centre, (HOLE, HOLE), 1, |near, z| {
            let (du, dv) = (i64::from(near.u) - i64::from(pixel.u), i64::from(near.v) - i64::from(pixel.v));
            let d = du * du + dv * dv;
            if self.on_object(near) && nearest.is_none_or(|n| d < n.0) {
                nearest = Some((d, near, z));
            }
        });
        nearest.map(|(_, near, z)| self.intrinsics.pixel_to_point(near, z))
    }

    /// Whether there surely is a [`Self::contact`]: something is seen at the pixel, or at one of sixteen in the square around
    /// it where that is looked for. Looking at all 81 took a fifth of a prediction for an object in front of nothing.
    pub(crate) fn has_contact(&self, pixel: Pixel) -> bool {
        const RING: [(i64, i64); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];
        let (u, v) = (i64::from(pixel.u), i64::from(pixel.v));
        let seen = |u: i64, v: i64| {
            self.depth_at(u, v).is_some() && self.on_object(Pixel { u: u as u32, v: v as u32 })
        };
        let on_ring = |far: i64| RING.iter().any(|(du, dv)| seen(u + du * far, v + dv * far));
        self.depth_at(u, v).is_some() || on_ring(HOLE) || on_ring(HOLE / 2)
    }

    /// The normal of the surface around a pixel, towards the camera.
    pub(crate) fn normal(&self, pixel: Pixel, contact: &Point3<f32>) -> Option<Vector3<f32>> {
        let reach = ((PATCH * self.intrinsics.fx / contact.z).round() as i64).clamp(2, 12);
        let mut points = Vec::new();
        self.around((i64::from(pixel.u), i64::from(pixel.v)), (reach, reach), 1, |near, z| {
            if (z - contact.z).abs() < SAME_SURFACE * contact.z {
                points.push(self.intrinsics.pixel_to_point(near, z));
            }
        });
        normal(&points)
    }

    fn on_object(&self, pixel: Pixel) -> bool {
        self.mask.is_none_or(|mask| mask.get(self.size.index(pixel)).copied().unwrap_or(false))
    }

    pub(crate) fn depth_at(&self, u: i64, v: i64) -> Option<f32> {
        let inside = (0..self.size.width as i64).contains(&u) && (0..self.size.height as i64).contains(&v);
        let z = inside.then(|| self.depth.get(v as usize * self.size.width + u as usize)).flatten()?;
        is_measured_depth(*z).then_some(*z)
    }

    /// Visits pixels with depth, every `step`-th in each direction, up to `half` from one (columns, rows).
    fn around(&self, (u, v): (i64, i64), half: (i64, i64), step: usize, mut visit: impl FnMut(Pixel, f32)) {
        for v in within(v, half.1, self.size.height).step_by(step) {
            for u in within(u, half.0, self.size.width).step_by(step) {
                if let Some(z) = self.depth_at(u, v) {
                    visit(Pixel { u: u as u32, v: v as u32 }, z);
                }
            }
        }
    }
}

/// Up to `half` from `x` to either side, of `0..side`.
fn within(x: i64, half: i64, side: usize) -> std::ops::Range<i64> {
    x.saturating_sub(half).max(0)..x.saturating_add(half + 1).min(side as i64)
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
        let view = DepthView { size, depth: &depth, intrinsics, mask: None };
        let contact = view.contact(pixel).unwrap();
        assert!((contact.z - 2.0 - 0.5 * contact.x).abs() < 1e-4);
        let normal = view.normal(pixel, &contact).unwrap();
        assert!((normal - Vector3::new(0.5, 0.0, -1.0).normalize()).norm() < 1e-2, "{normal}");
        let nothing = vec![0.0; size.pixels()];
        assert!(DepthView { depth: &nothing, ..view }.contact(pixel).is_none());
    }

    #[test]
    fn a_hole_at_the_edge_of_the_object_takes_none_of_what_is_behind() {
        // A door on the left of column 20, 1 m before a wall; its last two columns have no depth.
        let size = ImageSize::square(32);
        let intrinsics = Intrinsics::from_fov(size, 0.6);
        let of_column = |u: usize| [2.0, 0.0, 3.0][usize::from(u >= 18) + usize::from(u >= 20)];
        let depth: Vec<f32> = (0..size.pixels()).map(|i| of_column(i % 32)).collect();
        let mask: Vec<bool> = (0..size.pixels()).map(|i| i % 32 < 20).collect();
        let edge = Pixel { u: 19, v: 16 };
        let seen = |mask| DepthView { size, depth: &depth, intrinsics, mask }.contact(edge).unwrap();
        assert_eq!((seen(None).z, seen(Some(&mask)).z), (3.0, 2.0));
        // All that is seen is in the way, whatever it belongs to.
        let view = DepthView { size, depth: &depth, intrinsics, mask: Some(&mask) };
        assert!(view.around_point(&seen(Some(&mask)), 1.5).iter().any(|p| p.z > 2.5));
    }

    #[test]
    fn all_that_is_near_a_point_is_found_and_not_much_more() {
        // A wall 2 m away with a ledge in front of it, once coarse and once at many pixels a centimetre.
        for (side, field) in [(64, 0.6), (2000, 0.6)] {
            let size = ImageSize { width: side, height: side / 2 };
            let intrinsics = Intrinsics::from_fov(size, field);
            let ledge = |i: usize| i / side > side / 4;
            let mut depth: Vec<f32> = (0..size.pixels()).map(|i| if ledge(i) { 1.85 } else { 2.0 }).collect();
            (depth[0], depth[1], depth[2]) = (0.0, f32::NAN, 1e30);
            let view = DepthView { size, depth: &depth, intrinsics, mask: None };
            let contact = Point3::new(0.3, -0.01, 2.0);
            let near = |p: &&Point3<f32>| (*p - contact).norm() < 0.2;
            let found = view.around_point(&contact, 0.2);
            let found_near = found.iter().filter(near).count();
            assert!(
                found.len() < 6000 && found_near * 4 > found.len(),
                "{side}: {found_near} of {}",
                found.len()
            );
            let pixels = (0..size.pixels()).filter(|i| depth[*i] > 1.0 && depth[*i] < 3.0);
            let all: Vec<_> = pixels
                .map(|i| {
                    intrinsics.pixel_to_point(Pixel { u: (i % side) as u32, v: (i / side) as u32 }, depth[i])
                })
                .filter(|p| near(&p))
                .collect();
            let gap = |p: &Point3<f32>| found.iter().map(|q| (p - q).norm()).fold(f32::MAX, f32::min);
            let widest = all.iter().step_by(all.len() / 200 + 1).map(gap).fold(0.0, f32::max);
            assert!(widest < if side == 64 { 1e-6 } else { 0.02 }, "{side}: {widest}");
        }
    }

    #[test]
    fn a_camera_in_the_hand_sees_what_is_near_too() {
        let size = ImageSize { width: 640, height: 480 };
        let intrinsics = Intrinsics { fx: 525.0, fy: 525.0, cx: 320.0, cy: 240.0 };
        for (distance, finest) in [(0.2, 0.008), (0.3, 0.012)] {
            let depth = vec![distance; size.pixels()];
            let view = DepthView { size, depth: &depth, intrinsics, mask: None };
            let found = view.around_point(&Point3::new(0.0, 0.0, distance), 0.2);
            assert!((500..4000).contains(&found.len()), "{distance}: {}", found.len());
            let [a, b] = [found[0], found[1]];
            assert!((a - b).norm() < finest, "{distance}: {}", (a - b).norm());
        }
        // However close and whatever the focal length, nothing overflows.
        let depth = vec![1e-30; size.pixels()];
        let intrinsics = Intrinsics { fx: 1e30, ..intrinsics };
        let view = DepthView { size, depth: &depth, intrinsics, mask: None };
        assert!(!view.around_point(&Point3::new(0.0, 0.0, 1e-30), 0.2).is_empty());
    }

    #[test]
    fn a_noisy_wall_keeps_its_normal() {
        // 640 x 480 at 0.7 m with 2 mm of noise: pixels are 1.3 mm apart.
        let size = ImageSize { width: 640, height: 480 };
        let intrinsics = Intrinsics { fx: 525.0, fy: 525.0, cx: 320.0, cy: 240.0 };
        let noise = |i: usize| ((i * 2_654_435_761) % 1000) as f32 / 1000.0 - 0.5;
        let depth: Vec<f32> = (0..size.pixels()).map(|i| 0.7 + 0.004 * noise(i)).collect();
        let view = DepthView { size, depth: &depth, intrinsics, mask: None };
        let pixel = Pixel { u: 300, v: 200 };
        let normal = view.normal(pixel, &view.contact(pixel).unwrap()).unwrap();
        assert!(normal.dot(&-Vector3::z()) > 0.99, "{normal}");
    }

    #[test]
    fn lines_and_single_points_have_no_normal() {
        let line: Vec<_> = (0..20).map(|i| Point3::new(i as f32, 0.0, 2.0)).collect();
        assert!(normal(&line).is_none());
        assert!(normal(&[Point3::new(0.0, 0.0, 1.0); 20]).is_none());
    }
}
