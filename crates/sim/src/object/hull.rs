//! Convex hulls that never panic, with a bounded number of corners.
//!
//! Quickhull (Barber, Dobkin and Huhdanpaa, 1996) in f64, always inserting the point that is furthest outside. That
//! order makes stopping early a good simplification: what is left out is nearer to the hull than what is in.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};

/// The hull of a point set.
pub(super) struct Hull {
    /// Indices of the corners in the input, ascending.
    pub(super) corners: Vec<usize>,
    /// Triangles of input indices, counter-clockwise from outside.
    pub(super) triangles: Vec<[usize; 3]>,
}

struct Facet {
    corners: [usize; 3],
    normal: Vector3<f64>,
    offset: f64,
    /// Points above this facet that no facet before it has claimed.
    outside: Vec<usize>,
    /// Height and index of the highest of them.
    highest: Option<(f64, usize)>,
    alive: bool,
}

impl Facet {
    fn height(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.offset
    }
}

struct Builder<'a> {
    points: &'a [Point3<f64>],
    facets: Vec<Facet>,
    /// The facet on the left of a directed edge.
    left_of: HashMap<(usize, usize), usize>,
    tolerance: f64,
}

/// The hull of `points`, or `None` if they are coplanar to within one millionth of their extent. At most
/// `max_corners` corners (at least four) are kept.
pub(super) fn convex_hull(points: &[Point3<f64>], max_corners: usize) -> Option<Hull> {
    let start = first_tetrahedron(points)?;
    let extent = (points[start[1]] - points[start[0]]).norm();
    let mut hull = Builder { points, facets: Vec::new(), left_of: HashMap::new(), tolerance: extent * 1e-7 };
    let [a, b, c, d] = start;
    let mut fresh: Vec<usize> =
        [[a, b, c], [a, d, b], [b, d, c], [c, d, a]].into_iter().map(|corners| hull.push(corners)).collect();
    hull.claim(&fresh, (0..points.len()).filter(|i| !start.contains(i)));

    for _ in 4..max_corners.max(4) {
        let furthest = hull.facets.iter().filter(|f| f.alive).filter_map(|f| f.highest);
        // Ties are resolved by index so that the result depends on the points alone.
        let Some((_, apex)) = furthest.max_by(|x, y| x.0.total_cmp(&y.0).then(y.1.cmp(&x.1))) else { break };
        let orphans = hull.insert(apex, &mut fresh);
        hull.claim(&fresh, orphans.into_iter());
    }

    let triangles: Vec<_> = hull.facets.iter().filter(|f| f.alive).map(|f| f.corners).collect();
    let mut corners: Vec<usize> = triangles.iter().flatten().copied().collect();
    corners.sort_unstable();
    corners.dedup();
    Some(Hull { corners, triangles })
}

impl Builder<'_> {
    fn push(&mut self, corners: [usize; 3]) -> usize {
        let [a, b, c] = corners.map(|i| self.points[i]);
        let normal = (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default();
        let index = self.facets.len();
        self.facets.push(Facet {
            corners,
            normal,
            offset: normal.dot(&a.coords),
            outside: Vec::new(),
            highest: None,
            alive: true,
        });
        for k in 0..3 {
            self.left_of.insert((corners[k], corners[(k + 1) % 3]), index);
        }
        index
    }

    /// Hands every point that is outside to the first of these facets that sees it.
    fn claim(&mut self, facets: &[usize], candidates: impl Iterator<Item = usize>) {
        for i in candidates {
            for &f in facets {
                let facet = &mut self.facets[f];
                let height = facet.height(&self.points[i]);
                if height > self.tolerance {
                    facet.outside.push(i);
                    if facet.highest.is_none_or(|(h, _)| height > h) {
                        facet.highest = Some((height, i));
                    }
                    break;
                }
            }
        }
    }

    /// Makes `apex` a corner. Fills `fresh` with the new facets and returns the points that lost theirs.
    fn insert(&mut self, apex: usize, fresh: &mut Vec<usize>) -> Vec<usize> {
        fresh.clear();
        let Some(seen) =
            self.facets.iter().position(|f| f.alive && f.highest.is_some_and(|(_, i)| i == apex))
        else {
            return Vec::new();
        };
        let mut visible = vec![seen];
        self.facets[seen].alive = false;
        let mut horizon = Vec::new();
        let mut next = 0;
        while next < visible.len() {
            let corners = self.facets[visible[next]].corners;
            next += 1;
            for k in 0..3 {
                let (from, to) = (corners[k], corners[(k + 1) % 3]);
                let Some(&across) = self.left_of.get(&(to, from)) else { continue };
                if !self.facets[across].alive {
                    continue;
                }
                if self.facets[across].height(&self.points[apex]) > self.tolerance {
                    self.facets[across].alive = false;
                    visible.push(across);
                } else {
                    horizon.push((from, to));
                }
            }
        }
        // A facet taken late may have put one of its own edges on the horizon before.
        horizon.retain(|&(from, to)| self.left_of.get(&(to, from)).is_some_and(|&f| self.facets[f].alive));
        fresh.extend(horizon.into_iter().map(|(from, to)| self.push([from, to, apex])));
        let lost = visible.into_iter().flat_map(|f| std::mem::take(&mut self.facets[f].outside));
        lost.filter(|&i| i != apex).collect()
    }
}

/// Four points that span a volume, outward facets as `convex_hull` lists them.
fn first_tetrahedron(points: &[Point3<f64>]) -> Option<[usize; 4]> {
    let furthest = |measure: &dyn Fn(&Point3<f64>) -> f64| {
        (0..points.len())
            .map(|i| (measure(&points[i]), i))
            .max_by(|x, y| x.0.total_cmp(&y.0).then(y.1.cmp(&x.1)))
    };
    let origin = points.first()?;
    let (_, a) = furthest(&|p| (p - origin).norm_squared())?;
    let (extent, b) = furthest(&|p| (p - points[a]).norm())?;
    if extent <= 0.0 {
        return None;
    }
    let line = (points[b] - points[a]) / extent;
    let (width, c) = furthest(&|p| (p - points[a]).cross(&line).norm())?;
    if width <= extent * 1e-6 {
        return None;
    }
    let normal = (points[b] - points[a]).cross(&(points[c] - points[a])).try_normalize(0.0)?;
    let (depth, d) = furthest(&|p| normal.dot(&(p - points[a])).abs())?;
    if depth <= extent * 1e-6 {
        return None;
    }
    // The first facet must look away from the fourth point.
    let above = normal.dot(&(points[d] - points[a])) > 0.0;
    Some(if above { [a, c, b, d] } else { [a, b, c, d] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cube() -> Vec<Point3<f64>> {
        (0..8).map(|i| Point3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2 & 1) as f64)).collect()
    }

    #[test]
    fn a_cube_with_points_inside_and_on_its_faces_has_eight_corners() {
        let mut points = cube();
        points.extend([Point3::new(0.5, 0.5, 0.5), Point3::new(0.5, 0.5, 1.0), Point3::new(0.2, 0.0, 0.0)]);
        let hull = convex_hull(&points, 128).unwrap();
        assert_eq!(hull.corners, (0..8).collect::<Vec<_>>());
        assert_eq!(hull.triangles.len(), 12);
    }

    #[test]
    fn flat_and_tiny_sets_have_no_hull() {
        let flat: Vec<_> = cube().into_iter().map(|p| Point3::new(p.x, p.y, 0.3)).collect();
        assert!(convex_hull(&flat, 128).is_none());
        assert!(convex_hull(&[], 128).is_none());
        assert!(convex_hull(&[Point3::new(1.0, 2.0, 3.0); 5], 128).is_none());
    }

    proptest! {
        #[test]
        fn every_point_is_inside_and_every_edge_has_two_sides(
            // Coordinates on a coarse grid give many coplanar and collinear points, the hard case.
            raw in prop::collection::vec((0..6i8, 0..6i8, 0..6i8), 4..60)
        ) {
            let points: Vec<_> =
                raw.iter().map(|&(x, y, z)| Point3::new(f64::from(x), f64::from(y), f64::from(z))).collect();
            if let Some(hull) = convex_hull(&points, usize::MAX) {
                for t in &hull.triangles {
                    let [a, b, c] = t.map(|i| points[i]);
                    let normal = (b - a).cross(&(c - a)).normalize();
                    for p in &points {
                        prop_assert!(normal.dot(&(p - a)) < 1e-5);
                    }
                    for k in 0..3 {
                        let back = (t[(k + 1) % 3], t[k]);
                        let other = |u: &[usize; 3]| (0..3).any(|j| (u[j], u[(j + 1) % 3]) == back);
                        prop_assert_eq!(hull.triangles.iter().filter(|u| other(u)).count(), 1);
                    }
                }
            }
        }
    }
}
