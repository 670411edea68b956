//! Triangles without attributes, and what their connectivity says.

use std::collections::{HashMap, HashSet};

use nalgebra::{Point3, Vector3};
use parry3d::math::Vector;

use super::normals::{face_normal, weld};

/// Holes at most this wide are closed, metres: boards often lack the edges that nobody sees, and no hand fits in.
const NARROW: f32 = 0.05;
/// Rims of more points are left as they are: narrow holes have few.
const MAX_RIM: usize = 512;
/// Faces within half a degree of each other lie in one plane.
const COPLANAR_COS: f32 = 0.99996;

/// Triangles without attributes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Soup {
    pub(super) points: Vec<Point3<f32>>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Soup {
    /// With every place and every triangle only once, and only the points that triangles use, in their order.
    /// PartNet-Mobility has most triangles twice, once for each side.
    pub(super) fn welded(&self) -> Self {
        let first = weld(&self.points);
        let places = self.triangles.iter().map(|t| t.map(|i| first[i as usize]));
        let mut seen = HashSet::new();
        let mut is_new = |t: &[u32; 3]| {
            let mut key = *t;
            key.sort_unstable();
            key[0] != key[1] && key[1] != key[2] && seen.insert(key)
        };
        let triangles: Vec<_> = places.filter(|t| is_new(t)).collect();
        let mut index = vec![u32::MAX; self.points.len()];
        for &i in triangles.iter().flatten() {
            index[i as usize] = 0;
        }
        let mut points = Vec::new();
        for (i, slot) in index.iter_mut().enumerate().filter(|(_, slot)| **slot == 0) {
            *slot = points.len() as u32;
            points.push(self.points[i]);
        }
        Self { points, triangles: triangles.iter().map(|t| t.map(|i| index[i as usize])).collect() }
    }

    /// Welded sets of triangles that share points.
    pub(super) fn components(&self) -> Vec<Self> {
        let mut sets = Union::new(self.points.len());
        for t in &self.triangles {
            sets.join(t[0], t[1]);
            sets.join(t[1], t[2]);
        }
        self.split(|t| sets.root(self.triangles[t][0]))
    }

    /// Welded sets of triangles that share edges and a plane.
    pub(super) fn patches(&self) -> Vec<Self> {
        let normals: Vec<_> = self
            .triangles
            .iter()
            .map(|t| face_normal(&self.points, t).unwrap_or_else(Vector3::zeros))
            .collect();
        let mut sets = Union::new(self.triangles.len());
        for pair in self.edges().windows(2).filter(|pair| pair[0].0 == pair[1].0) {
            let (a, b) = (pair[0].1, pair[1].1);
            // Faces of careless winding have opposite normals in one plane.
            if normals[a as usize].dot(&normals[b as usize]).abs() > COPLANAR_COS {
                sets.join(a, b);
            }
        }
        self.split(|t| sets.root(t as u32))
    }

    fn split(&self, mut set_of: impl FnMut(usize) -> u32) -> Vec<Self> {
        let mut order = HashMap::new();
        let mut sets: Vec<Vec<[u32; 3]>> = Vec::new();
        for (i, t) in self.triangles.iter().enumerate() {
            let set = *order.entry(set_of(i)).or_insert_with(|| {
                sets.push(Vec::new());
                sets.len() - 1
            });
            sets[set].push(*t);
        }
        sets.into_iter().map(|triangles| Self { points: self.points.clone(), triangles }.welded()).collect()
    }

    /// Every edge of every triangle, equal ones side by side.
    fn edges(&self) -> Vec<([u32; 2], u32)> {
        let mut edges = Vec::with_capacity(3 * self.triangles.len());
        for (i, t) in self.triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                edges.push(([a.min(b), a.max(b)], i as u32));
            }
        }
        edges.sort_unstable();
        edges
    }

    /// Edges of one triangle only.
    fn boundary(&self) -> Vec<[u32; 2]> {
        let edges = self.edges();
        edges.chunk_by(|x, y| x.0 == y.0).filter(|same| same.len() == 1).map(|same| same[0].0).collect()
    }

    /// Whether any edge has only one triangle.
    pub(super) fn is_open(&self) -> bool {
        !self.boundary().is_empty()
    }

    /// With every narrow hole filled by a fan of triangles.
    pub(super) fn closed(mut self) -> Self {
        let mut around: HashMap<u32, Vec<u32>> = HashMap::new();
        for [a, b] in self.boundary() {
            around.entry(a).or_default().push(b);
            around.entry(b).or_default().push(a);
        }
        let mut starts: Vec<u32> = around.keys().copied().collect();
        starts.sort_unstable();
        let mut visited = HashSet::new();
        for start in starts {
            let Some(rim) = rim(start, &around, &mut visited) else { continue };
            let corners: Vec<_> = rim.iter().map(|&i| self.points[i as usize]).collect();
            if width(&corners) <= NARROW {
                let centre = self.points.len() as u32;
                let sum: Vector3<f32> = corners.iter().map(|p| p.coords).sum();
                self.points.push(Point3::from(sum / corners.len() as f32));
                let next = rim.iter().cycle().skip(1);
                self.triangles.extend(rim.iter().zip(next).map(|(&a, &b)| [a, b, centre]));
            }
        }
        self
    }

    pub(super) fn bounds(&self) -> (Point3<f32>, Point3<f32>) {
        let start = self.points.first().copied().unwrap_or_default();
        self.points.iter().fold((start, start), |(min, max), p| (min.inf(p), max.sup(p)))
    }

    pub(super) fn vectors(&self) -> Vec<Vector> {
        self.points.iter().map(|p| Vector::new(p.x, p.y, p.z)).collect()
    }
}

/// The closed chain of boundary edges through `start`, if every point of it has exactly two.
fn rim(start: u32, around: &HashMap<u32, Vec<u32>>, visited: &mut HashSet<u32>) -> Option<Vec<u32>> {
    let mut rim = Vec::new();
    let mut at = start;
    while visited.insert(at) {
        rim.push(at);
        let [a, b] = around[&at][..] else { return None };
        // The start may go either way.
        at = if !visited.contains(&a) || (a == start && rim.len() > 2) { a } else { b };
    }
    (at == start && rim.len() > 2).then_some(rim)
}

/// The distance between two parallels that hold a rim, one of them along an edge: for a convex rim, its width.
fn width(rim: &[Point3<f32>]) -> f32 {
    if rim.len() > MAX_RIM {
        return f32::INFINITY;
    }
    let edges = rim.iter().zip(rim.iter().cycle().skip(1));
    let along = edges.filter_map(|(a, b)| Some((a, (b - a).try_normalize(1e-9)?)));
    let height = |(a, line): (&Point3<f32>, Vector3<f32>)| {
        rim.iter().map(|p| (p - a).cross(&line).norm()).fold(0.0, f32::max)
    };
    along.map(height).fold(f32::INFINITY, f32::min)
}

/// Disjoint sets.
struct Union(Vec<u32>);

impl Union {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn root(&mut self, mut i: u32) -> u32 {
        while self.0[i as usize] != i {
            self.0[i as usize] = self.0[self.0[i as usize] as usize];
            i = self.0[i as usize];
        }
        i
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box as PartNet-Mobility has them, every triangle twice, with some of its six sides left out.
    fn board(size: Vector3<f32>, sides: std::ops::Range<usize>) -> Soup {
        let mesh = super::super::shapes::cuboid(size);
        let mut triangles = mesh.triangles[2 * sides.start..2 * sides.end].to_vec();
        triangles.extend(triangles.clone().iter().map(|&[a, b, c]| [c, b, a]));
        Soup { points: mesh.positions, triangles }.welded()
    }

    #[test]
    fn a_missing_edge_of_a_board_is_closed_and_a_missing_lid_is_not() {
        // The last side is the one at +x.
        let thin = board(Vector3::new(1.0, 1.0, 0.04), 0..5);
        assert!(thin.is_open());
        assert!(!thin.closed().is_open());
        let wide = board(Vector3::new(1.0, 1.0, 1.0), 0..5);
        assert!(wide.closed().is_open());
        assert!(!board(Vector3::new(1.0, 1.0, 1.0), 0..6).is_open());
    }

    #[test]
    fn patches_are_faces_and_components_are_bodies() {
        let cube = board(Vector3::repeat(1.0), 0..6);
        assert_eq!(cube.patches().len(), 6);
        assert_eq!(cube.components().len(), 1);
        let mut two = cube.clone();
        two.points.extend(cube.points.iter().map(|p| p + Vector3::new(3.0, 0.0, 0.0)));
        two.triangles.extend(cube.triangles.iter().map(|t| t.map(|i| i + 8)));
        assert_eq!(two.components().len(), 2);
    }
}
