//! Vertex normals for meshes that come without.

use std::collections::HashMap;

use nalgebra::{Point3, Vector3};

use super::Mesh;

/// Faces that meet at a smaller angle than 40 degrees are shaded as one curved surface.
const CREASE_COS: f32 = 0.766;
/// At a vertex with more faces than this every face keeps its own normal; comparing all pairs would be slow.
const MAX_VALENCE: usize = 64;

/// A mesh with normals averaged over neighbouring faces by angle, except across creases. Vertices at a crease are
/// split. Vertices at the same place count as one whatever their index. Triangles without area are dropped.
pub(super) fn with_normals(
    positions: Vec<Point3<f32>>,
    uvs: Vec<[f32; 2]>,
    mut triangles: Vec<[u32; 3]>,
) -> Mesh {
    triangles.retain(|t| face_normal(&positions, t).is_some());
    let faces: Vec<Vector3<f32>> =
        triangles.iter().map(|t| face_normal(&positions, t).unwrap_or_default()).collect();
    let welded = weld(&positions);
    let mut around: HashMap<u32, Vec<(usize, f32)>> = HashMap::new();
    for (f, t) in triangles.iter().enumerate() {
        for k in 0..3 {
            around.entry(welded[t[k] as usize]).or_default().push((f, corner_angle(&positions, t, k)));
        }
    }

    let mut mesh = Mesh::default();
    let mut known: HashMap<(u32, [i32; 3]), u32> = HashMap::new();
    for (f, t) in triangles.iter().enumerate() {
        let corners = t.map(|vertex| {
            let ring = &around[&welded[vertex as usize]];
            let smooth = |&&(g, _): &&(usize, f32)| faces[f].dot(&faces[g]) > CREASE_COS;
            let sum: Vector3<f32> = if ring.len() > MAX_VALENCE {
                faces[f]
            } else {
                ring.iter().filter(smooth).map(|&(g, angle)| faces[g] * angle).sum()
            };
            let normal = sum.try_normalize(1e-12).unwrap_or(faces[f]);
            let key = (vertex, [0, 1, 2].map(|k| (normal[k] * 1000.0).round() as i32));
            *known.entry(key).or_insert_with(|| {
                mesh.positions.push(positions[vertex as usize]);
                mesh.normals.push(normal);
                mesh.uvs.push(uvs[vertex as usize]);
                mesh.positions.len() as u32 - 1
            })
        });
        mesh.triangles.push(corners);
    }
    mesh
}

/// Unit normal of a triangle, if it has an area.
pub(super) fn face_normal(positions: &[Point3<f32>], triangle: &[u32; 3]) -> Option<Vector3<f32>> {
    let [a, b, c] = triangle.map(|i| positions[i as usize].cast::<f64>());
    (b - a).cross(&(c - a)).try_normalize(1e-18).map(nalgebra::Matrix::cast)
}

/// For every vertex, the first vertex at the same place.
pub(super) fn weld(positions: &[Point3<f32>]) -> Vec<u32> {
    let mut first = HashMap::with_capacity(positions.len());
    // Adding zero turns -0 into 0.
    let key = |p: &Point3<f32>| [p.x, p.y, p.z].map(|c| (c + 0.0).to_bits());
    positions.iter().enumerate().map(|(i, p)| *first.entry(key(p)).or_insert(i as u32)).collect()
}

fn corner_angle(positions: &[Point3<f32>], t: &[u32; 3], k: usize) -> f32 {
    let [a, b, c] = [k, (k + 1) % 3, (k + 2) % 3].map(|j| positions[t[j] as usize]);
    (b - a).angle(&(c - a))
}

#[cfg(test)]
mod tests {
    use super::super::shapes;
    use nalgebra::Vector3;

    #[test]
    fn a_box_keeps_its_edges_and_a_cylinder_its_roundness() {
        let cube = shapes::cuboid(Vector3::repeat(1.0));
        assert_eq!((cube.positions.len(), cube.triangles.len()), (24, 12));
        assert!(cube.normals.iter().all(|n| n.abs().max() > 0.9999));

        let cylinder = shapes::cylinder(1.0, 1.0);
        for (p, n) in cylinder.positions.iter().zip(&cylinder.normals) {
            let radial = Vector3::new(p.x, p.y, 0.0);
            let along_axis = n.z.abs() > 0.9999;
            assert!(along_axis || radial.normalize().dot(n) > 0.999, "{p} {n}");
        }
    }
}
