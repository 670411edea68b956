//! Scans as pictures: every point a small disc, nearest in front, lit along the view.

use nalgebra::{Point3, Vector3};
use where2act_core::{ImageSize, Intrinsics, is_measured};

/// No point is seen in a pixel.
pub(crate) const NOTHING: u32 = u32::MAX;
/// Share of the picture's side that the scan fills.
const FILL: f32 = 0.8;
/// Projections farther out than so many pixels are not drawn: those of points beside the camera have no bounds.
const FARTHEST: f32 = 1e6;

/// What is seen in a pixel.
#[derive(Clone, Copy)]
pub(crate) struct Seen {
    /// Index of the point, or [`NOTHING`].
    pub(crate) point: u32,
    /// How much light the surface there sends to the camera, in [0, 1].
    pub(crate) light: f32,
}

/// Renders points (optical frame) through a camera at the frame's origin whose picture they fill. Points behind the
/// camera are not seen; a scan around its origin is moved in front of the camera by nobody, so its near half is cut.
pub(crate) fn splat(points: &[Point3<f32>], size: ImageSize) -> (Intrinsics, Vec<Seen>) {
    let intrinsics = framing(points, size);
    let mut nearest = vec![f32::INFINITY; size.pixels()];
    let mut seen = vec![Seen { point: NOTHING, light: 1.0 }; size.pixels()];
    // So large that of a surface that fills half the picture, its points spread at random, five discs cover a pixel on
    // average and less than a hundredth of it shows through.
    let per_point = size.pixels() as f32 * 0.5 / points.len().max(1) as f32;
    let radius = (5.0 * per_point / std::f32::consts::PI).sqrt().clamp(1.0, 8.0);
    let reach = radius as i64;
    for (index, point) in points.iter().enumerate().filter(|(_, point)| is_measured(point)) {
        let Some((x, y)) =
            intrinsics.project(point).filter(|(x, y)| x.abs() < FARTHEST && y.abs() < FARTHEST)
        else {
            continue;
        };
        let (x, y) = (x.floor() as i64, y.floor() as i64);
        for v in (y - reach).max(0)..=(y + reach).min(size.height as i64 - 1) {
            for u in (x - reach).max(0)..=(x + reach).min(size.width as i64 - 1) {
                if ((u - x).pow(2) + (v - y).pow(2)) as f32 > radius * radius {
                    continue;
                }
                let at = v as usize * size.width + u as usize;
                if let (Some(z), Some(pixel)) = (nearest.get_mut(at), seen.get_mut(at))
                    && point.z < *z
                {
                    *z = point.z;
                    pixel.point = index as u32;
                }
            }
        }
    }
    light(points, size, &mut seen);
    (intrinsics, seen)
}

/// Intrinsics that put the middle of the scan in the middle of the picture.
fn framing(points: &[Point3<f32>], size: ImageSize) -> Intrinsics {
    let rays: Vec<(f32, f32)> =
        points.iter().filter(|p| is_measured(p) && p.z > 0.0).map(|p| (p.x / p.z, p.y / p.z)).collect();
    // A few stray points must not make the object small: the outermost half a percent may leave the picture.
    let span = |of: fn(&(f32, f32)) -> f32| {
        let mut sorted: Vec<f32> = rays.iter().map(of).collect();
        sorted.sort_by(f32::total_cmp);
        let cut = sorted.len() / 200;
        let low = sorted.get(cut).copied().unwrap_or(-0.5);
        let high = sorted.len().checked_sub(cut + 1).and_then(|i| sorted.get(i)).copied().unwrap_or(0.5);
        (low, high)
    };
    let ((x0, x1), (y0, y1)) = (span(|r| r.0), span(|r| r.1));
    let extent = (x1 - x0).max(y1 - y0).max(1e-3);
    let (width, height) = (size.width as f32, size.height as f32);
    let f = FILL * width.min(height) / extent;
    Intrinsics { fx: f, fy: f, cx: 0.5 * width - f * 0.5 * (x0 + x1), cy: 0.5 * height - f * 0.5 * (y0 + y1) }
}

/// Shades every pixel by the normal of the surface that its neighbours span.
fn light(points: &[Point3<f32>], size: ImageSize, seen: &mut [Seen]) {
    const REACH: usize = 6;
    let at = |seen: &[Seen], x: usize, y: usize| -> Option<Point3<f32>> {
        points.get(seen.get(y * size.width + x)?.point as usize).copied()
    };
    let lights: Vec<f32> = (0..size.pixels())
        .map(|i| {
            let (x, y) = (i % size.width, i / size.width);
            let far = |n: usize, side: usize| (n.saturating_sub(REACH), (n + REACH).min(side - 1));
            let ((x0, x1), (y0, y1)) = (far(x, size.width), far(y, size.height));
            let edges = (at(seen, x0, y), at(seen, x1, y), at(seen, x, y0), at(seen, x, y1), at(seen, x, y));
            let (Some(l), Some(r), Some(t), Some(b), Some(p)) = edges else { return 0.8 };
            let normal = (r - l).cross(&(b - t)).try_normalize(1e-12).unwrap_or(Vector3::z());
            let ray = p.coords.try_normalize(1e-12).unwrap_or(Vector3::z());
            0.45 + 0.55 * normal.dot(&ray).abs()
        })
        .collect();
    for (pixel, light) in seen.iter_mut().zip(lights) {
        pixel.light = light;
    }
}
