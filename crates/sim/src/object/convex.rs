//! Convex pieces of meshes: what hands touch.
//!
//! A mesh becomes one hull if it nearly fills its hull, else the same is tried for each of its connected components,
//! then for each flat face of an open one, and what is left goes through V-HACD. Flat pieces get a thickness.

use std::collections::HashMap;
use std::panic::{AssertUnwindSafe, catch_unwind};

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};
use parry3d::math::Vector;
use parry3d::query::PointQuery;
use parry3d::shape::TriMesh;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use tracing::{debug, warn};

use super::hull::{Hull, convex_hull};
use super::normals::with_normals;
use super::soup::Soup;
use super::{ConvexPiece, Mesh};

/// Thickness given to flat pieces, metres (PhysX makes something of them too, but squares out of discs).
const FLAT_THICKNESS: f64 = 0.002;
/// Thinner than this is flat: thinner bodies make contact normals unreliable.
const FLAT_LIMIT: f64 = 0.0005;
/// A hull fits when none of its surface is further from the mesh than this share of its diagonal...
const HULL_GAP_SHARE: f32 = 0.03;
/// ... and this many metres, less than the thickness of a finger of the hand.
const HULL_GAP_METRES: f32 = 0.01;
/// Corners of a hull; the cost of a contact grows with them.
const MAX_CORNERS: usize = 128;
/// Meshes of more components than this are decomposed as a whole.
const MAX_COMPONENTS: usize = 64;
/// An open component of more flat faces than this is a curved sheet.
const MAX_PATCHES: usize = 16;
/// Hulls that V-HACD may make of one component.
const MAX_HULLS: u32 = 32;
/// Voxels along the longest side in V-HACD.
const RESOLUTION: u32 = 64;

/// Changes whenever the pieces of a mesh may change: part of the cache's keys.
pub(super) const RULES: &str = "where2act-convex/1";

impl ConvexPiece {
    /// Its surface as triangles of its points, counter-clockwise from outside; `None` if it has no volume.
    #[must_use]
    pub fn triangles(&self) -> Option<Vec<[u32; 3]>> {
        let points: Vec<Point3<f64>> = self.points.iter().map(|p| p.cast()).collect();
        let hull = convex_hull(&points, usize::MAX)?;
        Some(hull.triangles.iter().map(|t| t.map(|i| i as u32)).collect())
    }

    /// Its surface as a mesh; empty if it has no volume.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        let uvs = vec![[0.0; 2]; self.points.len()];
        with_normals(self.points.clone(), uvs, self.triangles().unwrap_or_default())
    }
}

/// The convex pieces of a mesh, in its frame. A mesh without area has none.
pub(super) fn decompose(mesh: &Soup) -> Vec<ConvexPiece> {
    let mesh = mesh.welded().closed();
    if let Some(piece) = one_piece(&mesh) {
        return vec![piece];
    }
    let components = mesh.components();
    match components.len() {
        0 => Vec::new(),
        1..=MAX_COMPONENTS => components.iter().flat_map(component_pieces).collect(),
        _ => voxel_pieces(&mesh),
    }
}

fn component_pieces(mesh: &Soup) -> Vec<ConvexPiece> {
    if let Some(piece) = one_piece(mesh) {
        return vec![piece];
    }
    // A few sheets, such as the lining of an opening: V-HACD would make dozens of pieces of them.
    let patches = if mesh.is_open() { mesh.patches() } else { Vec::new() };
    if (1..=MAX_PATCHES).contains(&patches.len())
        && let Some(sheets) = patches.iter().map(one_piece).collect()
    {
        return sheets;
    }
    voxel_pieces(mesh)
}

/// The mesh as one piece, if its hull fits.
fn one_piece(mesh: &Soup) -> Option<ConvexPiece> {
    let (piece, hull) = solid(&mesh.points)?;
    let corners = hull.triangles.iter().map(|t| t.map(|i| piece.points[i]));
    let (min, max) = mesh.bounds();
    let diagonal = (max - min).norm();
    let allowed = (diagonal * HULL_GAP_SHARE).min(HULL_GAP_METRES);
    fits(mesh, corners, diagonal, allowed + FLAT_THICKNESS as f32).then_some(piece)
}

/// Whether no point of these triangles is further than `allowed` from the mesh.
fn fits(mesh: &Soup, hull: impl Iterator<Item = [Point3<f32>; 3]>, diagonal: f32, allowed: f32) -> bool {
    let Ok(surface) = TriMesh::new(mesh.vectors(), mesh.triangles.clone()) else { return false };
    let spacing = (diagonal / 32.0).max(1e-6);
    for [a, b, c] in hull {
        let longest = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let n = ((longest / spacing).ceil() as usize).clamp(1, 64);
        for i in 0..=n {
            for j in 0..=n - i {
                let (u, v) = (i as f32 / n as f32, j as f32 / n as f32);
                let p = a + (b - a) * u + (c - a) * v;
                if surface.distance_to_local_point(Vector::new(p.x, p.y, p.z), false) > allowed {
                    return false;
                }
            }
        }
    }
    true
}

/// The hull of a point set, thickened if it is flat; the hull's indices refer to the piece's points.
fn solid(points: &[Point3<f32>]) -> Option<(ConvexPiece, Hull)> {
    let points: Vec<Point3<f64>> = points.iter().map(|p| p.cast()).collect();
    let points = thickened(points)?;
    let hull = convex_hull(&points, MAX_CORNERS)?;
    let place: HashMap<usize, usize> = hull.corners.iter().enumerate().map(|(k, &i)| (i, k)).collect();
    let piece = ConvexPiece { points: hull.corners.iter().map(|&i| points[i].cast()).collect() };
    let triangles = hull.triangles.iter().map(|t| t.map(|i| place[&i])).collect();
    Some((piece, Hull { corners: (0..place.len()).collect(), triangles }))
}

/// Flat sets become two parallel copies of themselves; sets along a line are nothing that can be touched.
fn thickened(points: Vec<Point3<f64>>) -> Option<Vec<Point3<f64>>> {
    let count = points.len() as f64;
    let centre = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count;
    let spread: Matrix3<f64> =
        points.iter().map(|p| (p.coords - centre) * (p.coords - centre).transpose()).sum();
    if points.len() < 3 || !spread.iter().all(|c| c.is_finite()) {
        return None;
    }
    let eigen = SymmetricEigen::new(spread);
    let mut axes: Vec<usize> = vec![0, 1, 2];
    axes.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let extent = |k: usize| {
        let axis = eigen.eigenvectors.column(axes[k]).into_owned();
        let along = points.iter().map(|p| axis.dot(&(p.coords - centre)));
        let (low, high) = along.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
        (axis, low, high)
    };
    let (normal, low, high) = extent(0);
    if high - low >= FLAT_LIMIT {
        return Some(points);
    }
    let (_, width_low, width_high) = extent(1);
    if width_high - width_low < 1e-6 {
        return None;
    }
    let middle = (low + high) / 2.0;
    let shifted = |side: f64| {
        let points = &points;
        points.iter().map(move |p| {
            let height = normal.dot(&(p.coords - centre));
            p + normal * (middle + side * FLAT_THICKNESS / 2.0 - height)
        })
    };
    Some(shifted(-1.0).chain(shifted(1.0)).collect())
}

/// V-HACD; each of its parts becomes the exact hull of the triangles inside it.
fn voxel_pieces(mesh: &Soup) -> Vec<ConvexPiece> {
    let whole = || solid(&mesh.points).map(|(piece, _)| piece).into_iter().collect();
    let parameters =
        VHACDParameters { resolution: RESOLUTION, max_convex_hulls: MAX_HULLS, ..VHACDParameters::default() };
    let points = mesh.vectors();
    // parry asserts inside; one odd mesh must not end a collection of a million trials.
    let parts = catch_unwind(AssertUnwindSafe(|| {
        let decomposition = VHACD::decompose(&parameters, &points, &mesh.triangles, true);
        decomposition.compute_primitive_intersections(&points, &mesh.triangles)
    }));
    let Ok(parts) = parts else {
        warn!("convex decomposition of {} triangles failed, one hull is used", mesh.triangles.len());
        return whole();
    };
    let hull = |part: &Vec<Vector>| {
        let points: Vec<_> = part.iter().map(|v| Point3::new(v.x, v.y, v.z)).collect();
        solid(&points).map(|(piece, _)| piece)
    };
    let pieces: Vec<_> = parts.iter().filter_map(hull).collect();
    debug!("V-HACD: {} triangles, extent {:?}: {} pieces", mesh.triangles.len(), mesh.bounds(), pieces.len());
    if pieces.is_empty() { whole() } else { pieces }
}
