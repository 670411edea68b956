//! Which triangle is seen where: homogeneous rasterisation (Olano and Greer, 1997) into a grid of samples.
//!
//! An edge through camera-frame corners p and q, seen from the camera, is the plane with normal p x q: its dot product
//! with a viewing ray is a linear function of the picture coordinates, and so is 1 / depth. Triangles that cross
//! the camera plane need no clipping into polygons; samples nearer than the near plane are left out one by one.

use nalgebra::{Point3, Vector3};
use where2act_core::Camera;
use wide::bytemuck::cast;
use wide::{f32x4, u32x4};

use super::tiles::{self, Tiles};

/// Rows of a triangle, and samples of a row, that are looked at together: what a vector register holds.
const LANES: usize = 4;

/// Where the samples of a picture lie: sample (i, j) is at picture coordinates (i / 2, j / 2), so odd i and j are pixel
/// centres and even ones the corners and edges between pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// Ray direction of sample i: x = i * step.0 + start.0; likewise y.
    step: (f32, f32),
    start: (f32, f32),
}

impl Grid {
    pub(super) fn new(camera: &Camera) -> Self {
        let k = camera.intrinsics;
        Self { step: (0.5 / k.fx, 0.5 / k.fy), start: (-k.cx / k.fx, -k.cy / k.fy) }
    }

    /// Direction from the camera to a sample, with z = 1.
    pub(super) fn ray(&self, i: usize, j: usize) -> Vector3<f32> {
        Vector3::new(self.step.0 * i as f32 + self.start.0, self.step.1 * j as f32 + self.start.1, 1.0)
    }

    /// The dot products of planes with the ray through sample (i, j), as functions of i and j.
    fn planes(&self, mut edges: [f32x4; 3], plane: &Vector3<f32>) -> Planes {
        for (edges, plane) in edges.iter_mut().zip(plane) {
            edges.as_mut_array()[PLANE] = *plane;
        }
        let [x, y, z] = edges;
        let (step, start) = (self.step, self.start);
        Planes {
            // Not minus zero.
            slope: (x * f32x4::splat(step.0) + f32x4::ZERO).to_array(),
            row_slope: (y * f32x4::splat(step.1)).to_array(),
            origin: (x * f32x4::splat(start.0) + y * f32x4::splat(start.1) + z).to_array(),
        }
    }

    /// Sample coordinates of a point in the camera frame; `None` if it is nearer than the near plane.
    pub(super) fn project(&self, p: &Point3<f32>) -> Option<(f32, f32)> {
        (p.z > Camera::NEAR)
            .then(|| ((p.x / p.z - self.start.0) / self.step.0, (p.y / p.z - self.start.1) / self.step.1))
    }
}

/// A rectangle of samples, ends excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Region {
    pub(super) left: usize,
    pub(super) top: usize,
    pub(super) right: usize,
    pub(super) bottom: usize,
}

impl Region {
    pub(super) fn width(&self) -> usize {
        self.right.saturating_sub(self.left)
    }

    pub(super) fn height(&self) -> usize {
        self.bottom.saturating_sub(self.top)
    }

    /// The samples of `self` that a box of sample coordinates can contain.
    pub(super) fn clip(&self, min: (f32, f32), max: (f32, f32)) -> Self {
        // `as` saturates, and turns NaN into 0.
        let end = |x: f32| if x >= 0.0 { x as i32 as usize + 1 } else { 0 };
        Self {
            left: self.left.max(ceil(min.0.max(0.0))),
            top: self.top.max(ceil(min.1.max(0.0))),
            right: self.right.min(end(max.0)),
            bottom: self.bottom.min(end(max.1)),
        }
    }

    /// The rows that both have.
    pub(super) fn rows(&self, top: usize, bottom: usize) -> Self {
        Self { top: self.top.max(top), bottom: self.bottom.min(bottom), ..*self }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.left >= self.right || self.top >= self.bottom
    }
}

/// The nearest triangle at every sample of a region.
pub(super) struct Buffer {
    pub(super) grid: Grid,
    pub(super) region: Region,
    /// 1 / depth; 0 where nothing was drawn. [`tiles::SIDE`] infinite ones follow, so that samples that are looked at
    /// together always exist.
    nearness: Vec<f32>,
    /// 1 + index of the triangle; 0 where nothing was drawn.
    number: Vec<u32>,
    tiles: Tiles,
}

impl Buffer {
    /// Of no samples.
    pub(super) fn new(grid: Grid) -> Self {
        let region = Region { left: 0, top: 0, right: 0, bottom: 0 };
        Self { grid, region, nearness: Vec::new(), number: Vec::new(), tiles: Tiles::default() }
    }

    /// Makes it an empty buffer of other samples, in the same memory.
    pub(super) fn clear(&mut self, grid: Grid, region: Region) {
        let samples = region.width() * region.height();
        (self.grid, self.region) = (grid, region);
        self.nearness.clear();
        self.nearness.resize(samples, 0.0);
        self.nearness.resize(samples + tiles::SIDE, f32::INFINITY);
        self.number.clear();
        self.number.resize(samples + tiles::SIDE, 0);
        self.tiles.clear(&region);
    }

    /// For the samples of a row of the region 1 + index of the triangle; 0 where nothing was drawn.
    pub(super) fn row(&self, j: usize) -> &[u32] {
        let width = self.region.width();
        &self.number[(j - self.region.top) * width..][..width]
    }

    /// Triangle and depth at a sample; `None` outside the region and where nothing was drawn.
    pub(super) fn get(&self, i: usize, j: usize) -> Option<(u32, f32)> {
        let r = &self.region;
        if i < r.left || i >= r.right || j < r.top || j >= r.bottom {
            return None;
        }
        let at = (j - r.top) * r.width() + (i - r.left);
        self.number[at].checked_sub(1).map(|triangle| (triangle, 1.0 / self.nearness[at]))
    }

    /// Whether nothing of a nearness can be seen at the samples of `bounds`, as of the last [`Self::look_again`].
    pub(super) fn hides(&self, bounds: &Region, nearness: f32) -> bool {
        self.tiles.hide(bounds, nearness)
    }

    /// Finds what is hidden by what was drawn.
    pub(super) fn look_again(&mut self) {
        self.tiles.update(&self.nearness, self.region.width());
    }

    /// Draws a triangle given in the camera frame into the samples of `bounds`; both sides are visible. Of equally near
    /// triangles that with the least index is seen, in whatever order they are drawn.
    pub(super) fn draw(&mut self, corners: [&Point3<f32>; 3], bounds: Region, index: u32) {
        let [a, b, c] = corners;
        let normal = (b - a).cross(&(c - a));
        let volume = normal.dot(&a.coords);
        if volume == 0.0 || !volume.is_finite() {
            return;
        }
        let planes = self.grid.planes(edges(corners, volume.signum()), &(normal / volume));
        // Seen edge-on, the plane's equation is badly conditioned; the corners bound what it can say.
        let (low, high) = nearness_range([a.z, b.z, c.z]);
        let range = (f32x4::splat(low), f32x4::splat(high));
        let number = u32x4::splat(index + 1);
        let width = self.region.width();
        self.tiles.change(&bounds);
        for top in (bounds.top..bounds.bottom).step_by(LANES) {
            let rows = counted(top);
            let (first, last) = planes.span(rows, &bounds);
            let (first, last, at_zero) =
                (first.to_array(), last.to_array(), planes.at_zero(PLANE, rows).to_array());
            let left = first.into_iter().fold(f32::INFINITY, |a, b| if b < a { b } else { a });
            let right = last.into_iter().fold(f32::NEG_INFINITY, |a, b| if b > a { b } else { a });
            if left > right {
                continue;
            }
            let slope = f32x4::splat(planes.slope[PLANE]);
            // Not empty: then both are between the ends of the row.
            for start in (ceil(left)..right as i32 as usize + 1).step_by(LANES) {
                let columns = counted(start);
                for k in 0..LANES {
                    let row = (top + k).min(bounds.bottom - 1) - self.region.top;
                    let inside =
                        columns.simd_ge(f32x4::splat(first[k])) & columns.simd_le(f32x4::splat(last[k]));
                    let nearness = f32x4::splat(at_zero[k]) + slope * columns;
                    self.draw_samples(
                        row * width + start - self.region.left,
                        inside,
                        nearness,
                        range,
                        number,
                    );
                }
            }
        }
    }

    /// Draws the triangle with a number at those samples from `at` on that are inside of it. Its plane has a nearness
    /// there, its corners a range.
    fn draw_samples(
        &mut self,
        at: usize,
        inside: f32x4,
        nearness: f32x4,
        (low, high): (f32x4, f32x4),
        number: u32x4,
    ) {
        let nearest: Option<&mut [f32; LANES]> = self.nearness[at..].first_chunk_mut();
        let numbers: Option<&mut [u32; LANES]> = self.number[at..].first_chunk_mut();
        let (Some(nearest), Some(numbers)) = (nearest, numbers) else { return };
        let (before, others) = (f32x4::new(*nearest), u32x4::new(*numbers));
        let w = nearness.simd_lt(low).select(low, nearness);
        let w = w.simd_gt(high).select(high, w);
        let is_first: f32x4 = cast(number.simd_lt(others));
        let nearer = w.simd_gt(before) | (w.simd_eq(before) & is_first);
        let seen = inside & nearer & w.simd_lt(f32x4::splat(1.0 / Camera::NEAR));
        *nearest = seen.select(w, before).to_array();
        *numbers = seen.select(number, others).to_array();
    }
}

/// Functions of sample coordinates (i, j): origin + slope * i + row_slope * j. Those of the three edges of a triangle are
/// not negative inside, that of its [`PLANE`] is its nearness.
struct Planes {
    slope: [f32; LANES],
    row_slope: [f32; LANES],
    origin: [f32; LANES],
}

/// What comes after the edges.
const PLANE: usize = 3;

impl Planes {
    /// A function in column 0 of some rows.
    fn at_zero(&self, plane: usize, rows: f32x4) -> f32x4 {
        f32x4::splat(self.origin[plane]) + f32x4::splat(self.row_slope[plane]) * rows
    }

    /// First and last columns of `bounds` at which some rows are inside of all edges.
    fn span(&self, rows: f32x4, bounds: &Region) -> (f32x4, f32x4) {
        let [least, most] = [f32::NEG_INFINITY, f32::INFINITY].map(f32x4::splat);
        let mut first = f32x4::splat(bounds.left as i32 as f32);
        let mut last = f32x4::splat((bounds.right - 1) as i32 as f32);
        last = rows.simd_lt(f32x4::splat(bounds.bottom as i32 as f32)).select(last, least);
        for edge in 0..PLANE {
            let slope = f32x4::splat(self.slope[edge]);
            // A slope of zero gives minus or plus infinity: all of the row is inside, or none.
            let zero = -self.at_zero(edge, rows) / slope;
            let is_first = slope.simd_ge(f32x4::ZERO);
            let (from, to) = (is_first.select(zero, least), is_first.select(most, zero));
            first = from.simd_gt(first).select(from, first);
            last = to.simd_lt(last).select(to, last);
        }
        (first, last)
    }
}

/// From a number on.
fn counted(from: usize) -> f32x4 {
    f32x4::splat(from as i32 as f32) + f32x4::new([0.0, 1.0, 2.0, 3.0])
}

/// The least integer not below `x`, which is not negative. Without SSE 4.1 the general function is a call.
fn ceil(x: f32) -> usize {
    let below = x as i32;
    below as usize + usize::from((below as f32) < x)
}

/// The planes through the camera and the edges of a triangle, whose normals point to its inside if `side` is that of
/// the camera.
///
/// The normal p x q is calculated as p x (q - p) or q x (q - p), which keeps its precision for short edges. Which of them
/// depends on the corners and not on their order, so that the two triangles of a shared edge get planes that are
/// opposite to the last bit: no gap between them.
fn edges([a, b, c]: [&Point3<f32>; 3], side: f32) -> [f32x4; 3] {
    let p = |axis: usize| f32x4::new([a[axis], b[axis], c[axis], 0.0]);
    let q = |axis: usize| f32x4::new([b[axis], c[axis], a[axis], 0.0]);
    let [px, py, pz] = [p(0), p(1), p(2)];
    let [qx, qy, qz] = [q(0), q(1), q(2)];
    let later = py.simd_lt(qy) | (py.simd_eq(qy) & pz.simd_lt(qz));
    let in_order = px.simd_lt(qx) | (px.simd_eq(qx) & later);
    let [x, y, z] = [in_order.select(px, qx), in_order.select(py, qy), in_order.select(pz, qz)];
    let (dx, dy, dz) = (qx - px, qy - py, qz - pz);
    let side = f32x4::splat(side);
    [(y * dz - z * dy) * side, (z * dx - x * dz) * side, (x * dy - y * dx) * side]
}

/// Least and largest 1 / depth of a triangle; from 0 to infinity if it reaches the camera plane.
pub(super) fn nearness_range(z: [f32; 3]) -> (f32, f32) {
    let (min, max) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
    (if max > 0.0 { 1.0 / max } else { 0.0 }, if min > 0.0 { 1.0 / min } else { f32::INFINITY })
}

#[cfg(test)]
mod tests {
    use rand::RngExt;
    use where2act_core::{ImageSize, Seed};

    use super::*;

    /// What is seen of some triangles that are drawn in an order, with or without leaving out what is hidden.
    fn drawn(
        triangles: &[[Point3<f32>; 3]],
        order: &[usize],
        leave_out: bool,
    ) -> (Vec<Option<(u32, f32)>>, usize) {
        let size = ImageSize::square(40);
        let camera = Camera::look_at(Point3::origin(), Point3::new(0.0, 1.0, 0.0), size, 1.0);
        let region = Region { left: 3, top: 5, right: 2 * size.width - 3, bottom: 2 * size.height };
        let mut buffer = Buffer::new(Grid::new(&camera));
        buffer.clear(buffer.grid, region);
        let mut hidden = 0;
        for &index in order {
            let [a, b, c] = &triangles[index];
            let nearness = nearness_range([a.z, b.z, c.z]).1;
            if leave_out && buffer.hides(&region, nearness) {
                hidden += 1;
                continue;
            }
            buffer.draw([a, b, c], region, index as u32);
            buffer.look_again();
        }
        let rows = region.top..region.bottom;
        let samples = rows.flat_map(|j| (region.left..region.right).map(move |i| (i, j)));
        (samples.map(|(i, j)| buffer.get(i, j)).collect(), hidden)
    }

    #[test]
    fn neither_order_nor_what_is_hidden_changes_what_is_seen() {
        for seed in 0..20 {
            let rng = &mut Seed(seed).rng();
            let mut triangles: Vec<[Point3<f32>; 3]> = (0..60)
                .map(|_| {
                    let depth = rng.random_range(0.2..5.0f32);
                    let mut corner = || {
                        let [x, y, z] = std::array::from_fn(|_| rng.random_range(-1.0..1.0f32));
                        Point3::new(x * depth, y * depth, depth * (1.0 + 0.3 * z))
                    };
                    [corner(), corner(), corner()]
                })
                .collect();
            // Ties, some the other way round.
            for index in 0..10 {
                let [a, b, c] = triangles[index];
                triangles.push(if index % 2 == 0 { [a, b, c] } else { [c, b, a] });
            }
            // A wall in the middle of it.
            let corners = [(-9.0, -9.0), (20.0, -9.0), (-9.0, 20.0)];
            triangles.push(corners.map(|(x, y)| Point3::new(x, y, 2.0)));
            let forwards: Vec<usize> = (0..triangles.len()).collect();
            let backwards: Vec<usize> = (0..triangles.len()).rev().collect();
            let (expected, _) = drawn(&triangles, &forwards, false);
            assert_eq!(drawn(&triangles, &backwards, false).0, expected);
            let (seen, hidden) = drawn(&triangles, &backwards, true);
            assert_eq!(seen, expected);
            assert!(hidden > 5, "{hidden} of {} triangles are hidden", triangles.len());
        }
    }
}
