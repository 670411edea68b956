//! Which triangle is seen where: homogeneous rasterisation (Olano and Greer, 1997) into a grid of samples.
//!
//! An edge through camera-frame corners p and q, seen from the camera, is the plane with normal p x q: its dot product
//! with a viewing ray is a linear function of the picture coordinates, and so is 1 / depth. Triangles that cross
//! the camera plane need no clipping into polygons; samples nearer than the near plane are left out one by one.

use nalgebra::{Point3, Vector3};
use where2act_core::Camera;

/// Marks a sample where nothing was drawn.
pub(super) const NOTHING: u32 = u32::MAX;

/// Rows of a triangle that are looked at together: what a vector register holds.
const ROWS: usize = 4;

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
        Self {
            left: self.left.max(min.0.ceil().max(0.0) as usize),
            top: self.top.max(min.1.ceil().max(0.0) as usize),
            right: self.right.min((max.0.floor() + 1.0).max(0.0) as usize),
            bottom: self.bottom.min((max.1.floor() + 1.0).max(0.0) as usize),
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
    /// 1 / depth; 0 where nothing was drawn.
    nearness: Vec<f32>,
    triangle: Vec<u32>,
}

impl Buffer {
    /// Of no samples.
    pub(super) fn new(grid: Grid) -> Self {
        let region = Region { left: 0, top: 0, right: 0, bottom: 0 };
        Self { grid, region, nearness: Vec::new(), triangle: Vec::new() }
    }

    /// Makes it an empty buffer of other samples, in the same memory.
    pub(super) fn clear(&mut self, grid: Grid, region: Region) {
        let samples = region.width() * region.height();
        (self.grid, self.region) = (grid, region);
        self.nearness.clear();
        self.nearness.resize(samples, 0.0);
        self.triangle.clear();
        self.triangle.resize(samples, NOTHING);
    }

    /// The triangles at the samples of a row of the region, or [`NOTHING`].
    pub(super) fn row(&self, j: usize) -> &[u32] {
        let width = self.region.width();
        &self.triangle[(j - self.region.top) * width..][..width]
    }

    /// Triangle and depth at a sample; `None` outside the region and where nothing was drawn.
    pub(super) fn get(&self, i: usize, j: usize) -> Option<(u32, f32)> {
        let r = &self.region;
        if i < r.left || i >= r.right || j < r.top || j >= r.bottom {
            return None;
        }
        let at = (j - r.top) * r.width() + (i - r.left);
        let triangle = self.triangle[at];
        (triangle != NOTHING).then(|| (triangle, 1.0 / self.nearness[at]))
    }

    /// Draws a triangle given in the camera frame into the samples of `bounds`; both sides are visible.
    pub(super) fn draw(&mut self, corners: [&Point3<f32>; 3], bounds: Region, id: u32) {
        let [a, b, c] = [corners[0].coords, corners[1].coords, corners[2].coords];
        let normal = (b - a).cross(&(c - a));
        let volume = normal.dot(&a);
        if volume == 0.0 || !volume.is_finite() {
            return;
        }
        let side = volume.signum();
        let edge = |p, q| self.row_function(edge_plane(p, q) * side);
        let edges = [edge(&a, &b), edge(&b, &c), edge(&c, &a)];
        let nearness = self.row_function(normal / volume);
        // Seen edge-on, the plane's equation is badly conditioned; the corners bound what it can say.
        let (low, high) = nearness_range([a.z, b.z, c.z]);
        for top in (bounds.top..bounds.bottom).step_by(ROWS) {
            let rows: [f32; ROWS] = std::array::from_fn(|k| (top + k) as i32 as f32);
            let mut first = [bounds.left as f32; ROWS];
            let mut last = [bounds.right as f32 - 1.0; ROWS];
            for edge in &edges {
                for k in 0..ROWS {
                    let at_zero = edge.origin + edge.row_slope * rows[k];
                    let zero = -at_zero / edge.slope;
                    let from = if edge.slope > 0.0 { zero } else { f32::NEG_INFINITY };
                    let to = if edge.slope < 0.0 { zero } else { f32::INFINITY };
                    let to = if edge.slope == 0.0 && at_zero < 0.0 { -1.0 } else { to };
                    first[k] = if from > first[k] { from } else { first[k] };
                    last[k] = if to < last[k] { to } else { last[k] };
                }
            }
            for (k, j) in (top..bounds.bottom.min(top + ROWS)).enumerate() {
                // Not empty: then both are between the ends of the row.
                if first[k] > last[k] {
                    continue;
                }
                let (first, end) = (ceil(first[k]), last[k] as i32 as usize + 1);
                if first >= end {
                    continue;
                }
                let row = (j - self.region.top) * self.region.width();
                let span = row + first - self.region.left..row + end - self.region.left;
                let at_zero = nearness.origin + nearness.row_slope * rows[k];
                let samples = self.nearness[span.clone()].iter_mut().zip(&mut self.triangle[span]);
                for (i, (best, triangle)) in (first as i32..).zip(samples) {
                    let w = at_zero + nearness.slope * i as f32;
                    let w = if w < low { low } else { w };
                    let w = if w > high { high } else { w };
                    let nearer = w > *best && w < 1.0 / Camera::NEAR;
                    *best = if nearer { w } else { *best };
                    *triangle = if nearer { id } else { *triangle };
                }
            }
        }
    }

    /// The dot product of `plane` with the ray through sample (i, j), as a function of i and j.
    fn row_function(&self, plane: Vector3<f32>) -> Linear {
        let Grid { step, start } = self.grid;
        Linear {
            slope: plane.x * step.0,
            row_slope: plane.y * step.1,
            origin: plane.x * start.0 + plane.y * start.1 + plane.z,
        }
    }
}

/// A function of sample coordinates (i, j): origin + slope * i + row_slope * j.
struct Linear {
    slope: f32,
    row_slope: f32,
    origin: f32,
}

/// The least integer not below `x`, which is not negative. Without SSE 4.1 the general function is a call.
fn ceil(x: f32) -> usize {
    let below = x as i32;
    below as usize + usize::from((below as f32) < x)
}

/// p x q, as p x (q - p), which keeps its precision for short edges. Corners are taken in a fixed order so that the
/// two triangles of a shared edge get planes that are opposite to the last bit: no gap between them.
fn edge_plane(p: &Vector3<f32>, q: &Vector3<f32>) -> Vector3<f32> {
    let in_order = p.x < q.x || (p.x == q.x && (p.y < q.y || (p.y == q.y && p.z < q.z)));
    let (from, to, sign) = if in_order { (*p, *q, 1.0) } else { (*q, *p, -1.0) };
    from.cross(&(to - from)) * sign
}

/// Least and largest 1 / depth of a triangle; from 0 to infinity if it reaches the camera plane.
fn nearness_range(z: [f32; 3]) -> (f32, f32) {
    let (min, max) = (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]));
    (if max > 0.0 { 1.0 / max } else { 0.0 }, if min > 0.0 { 1.0 / min } else { f32::INFINITY })
}
