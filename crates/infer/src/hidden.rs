//! What is hidden from the camera: behind something that a depth map or a scan shows.

use nalgebra::Point3;
use rayon::prelude::*;
use where2act_core::GripperGeometry;

use crate::surface::DepthView;

/// How far beside the ray to a point, metres at the point's distance, something may be that hides it: points of scans are up to
/// some 2 cm apart.
const BESIDE: f32 = 0.015;
/// Points before another, or of nine places of a depth map, that are more than a flying pixel.
const ENOUGH: usize = 2;
/// Points of a scan that are looked at, at most.
const LOOKED_AT: usize = 1 << 17;
/// Cells to either side of a direction that are looked at, at most: to points much nearer to the camera than most of the scan.
const MOST_CELLS: f32 = 8.0;

/// Whether what is seen at this depth hides a point.
fn before(seen: f32, point: &Point3<f32>) -> bool {
    seen < point.z - GripperGeometry::OUT_OF_VIEW
}

impl DepthView<'_> {
    /// Whether something is seen before a point; nothing hides what is beside the picture.
    pub(crate) fn hides(&self, point: &Point3<f32>) -> bool {
        const AROUND: [f32; 3] = [-0.7 * BESIDE, 0.0, 0.7 * BESIDE];
        let places =
            AROUND.into_iter().flat_map(|y| AROUND.map(|x| Point3::new(point.x + x, point.y + y, point.z)));
        let seen = places.filter_map(|place| {
            let (u, v) = self.intrinsics.project(&place)?;
            self.depth_at(u.floor() as i64, v.floor() as i64)
        });
        seen.filter(|z| before(*z, point)).take(ENOUGH).count() == ENOUGH
    }
}

/// How far away a scan's points are, by the direction in which the camera sees them.
pub(crate) struct Directions {
    /// Side of a cell, as a tangent: half of [`BESIDE`] at the points' median distance.
    side: f32,
    /// Cells with points by row and column, and the depths of the two nearest points in each.
    cells: Vec<([i32; 2], [f32; 2])>,
}

impl Directions {
    /// Of finite points. Those beside and behind the camera hide nothing.
    pub(crate) fn new(points: &[Point3<f32>]) -> Self {
        let step = points.len().div_ceil(LOOKED_AT).max(1);
        let seen = || points.iter().step_by(step).filter(|point| point.z > 0.0);
        let mut depths: Vec<f32> = seen().map(|point| point.z).collect();
        let middle = depths.len() / 2;
        let median = match depths.get(middle) {
            Some(_) => *depths.select_nth_unstable_by(middle, f32::total_cmp).1,
            None => 1.0,
        };
        let side = 0.5 * BESIDE / median;
        let mut found: Vec<([i32; 2], f32)> = seen()
            .map(|point| ([point.y, point.x].map(|x| (x / point.z / side).floor() as i32), point.z))
            .collect();
        found.par_sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let nearest = |cell: &[([i32; 2], f32)]| {
            let depth = |i: usize| cell.get(i).map_or(f32::INFINITY, |point| point.1);
            cell.first().map(|first| (first.0, [depth(0), depth(1)]))
        };
        Self { side, cells: found.chunk_by(|a, b| a.0 == b.0).filter_map(nearest).collect() }
    }

    /// Whether points are seen before this one.
    pub(crate) fn hides(&self, point: &Point3<f32>) -> bool {
        if point.z <= GripperGeometry::OUT_OF_VIEW {
            return false;
        }
        let [row, column] = [point.y, point.x].map(|x| x / point.z / self.side);
        // At least the own cell's middle is so near.
        let reach = (BESIDE / point.z / self.side).clamp(0.71, MOST_CELLS);
        let mut nearer = 0;
        for line in (row - reach).floor() as i32..=(row + reach).floor() as i32 {
            let [first, end] = [column - reach, column + reach + 1.0].map(|x| [line, x.floor() as i32]);
            let start = self.cells.partition_point(|cell| cell.0 < first);
            let cells = self.cells.iter().skip(start).take_while(|cell| cell.0 < end);
            for ([_, at], depths) in cells {
                let (down, along) = (line as f32 + 0.5 - row, *at as f32 + 0.5 - column);
                if down * down + along * along <= reach * reach {
                    nearer += depths.iter().filter(|depth| before(**depth, point)).count();
                }
            }
            if nearer >= ENOUGH {
                return true;
            }
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_core::{ImageSize, Intrinsics, Pixel};

    /// A screen 1 m away that covers what is right of the axis, before a wall 2 m away, as a depth map and as a scan.
    fn screen(side: usize, test: impl Fn(&str, &dyn Fn(&Point3<f32>) -> bool)) {
        let size = ImageSize::square(side);
        let intrinsics = Intrinsics::from_fov(size, 0.6);
        let depth: Vec<f32> =
            (0..size.pixels()).map(|i| if i % side < side / 2 { 2.0 } else { 1.0 }).collect();
        let view = DepthView { size, depth: &depth, intrinsics, mask: None };
        let pixel = |i: usize| Pixel { u: (i % side) as u32, v: (i / side) as u32 };
        let points: Vec<_> =
            (0..size.pixels()).map(|i| intrinsics.pixel_to_point(pixel(i), depth[i])).collect();
        let scan = Directions::new(&points);
        test("map", &|point| view.hides(point));
        test("scan", &|point| scan.hides(point));
    }

    #[test]
    fn what_is_behind_something_is_hidden_however_far_behind() {
        for side in [160, 640] {
            screen(side, |kind, hides| {
                let at = |x: f32, z: f32| hides(&Point3::new(x, 0.1, z));
                for z in [1.05, 1.3, 1.9, 2.5] {
                    assert!(at(0.2, z), "{kind} {side}: {z}");
                }
                for (x, z) in [(0.2, 0.5), (0.2, 1.01), (-0.2, 1.5), (-0.2, 2.01), (-0.06, 1.9)] {
                    assert!(!at(x, z), "{kind} {side}: {x} {z}");
                }
                assert!(at(-0.2, 2.1), "{kind} {side}");
                for beside in [[9.0, 0.0, 2.0], [0.2, 0.0, -1.0], [0.0; 3], [1e30, 0.0, 1e-30]] {
                    assert!(!hides(&Point3::from(beside)), "{kind} {side}: {beside:?}");
                }
            });
        }
    }

    #[test]
    fn a_flying_pixel_hides_nothing() {
        let size = ImageSize::square(640);
        let intrinsics = Intrinsics::from_fov(size, 0.6);
        let mut depth = vec![2.0; size.pixels()];
        depth[320 * 640 + 320] = 0.5;
        let view = DepthView { size, depth: &depth, intrinsics, mask: None };
        let behind = Point3::new(0.0, 0.0, 1.0);
        assert!(!view.hides(&behind));
        let mut points =
            vec![Point3::new(0.001, 0.0, 0.5), Point3::new(0.5, 0.5, 2.0), Point3::new(0.0, 0.0, 1.5)];
        assert!(!Directions::new(&points).hides(&behind));
        points.push(Point3::new(0.0, 0.001, 0.5));
        assert!(Directions::new(&points).hides(&behind));
        assert!(!Directions::new(&[]).hides(&behind));
    }
}
