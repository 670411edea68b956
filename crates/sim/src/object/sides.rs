//! Sheets with two faces.
//!
//! PartNet-Mobility has most triangles twice, wound both ways, and where inside and outside differ in colour so do
//! the two. Drawn from both sides in one place, such a pair would show a random mix.

use std::collections::HashMap;

use nalgebra::Point3;

use super::Mesh;
use super::normals::face_normal;

/// How far the faces of a sheet are moved apart, metres: far above the resolution of depth, far below a pixel.
const LIFT: f32 = 0.0001;

/// The bits of the coordinates of three corners, in ascending order.
type Place = [[u32; 3]; 3];

/// Of triangles in the same place, keeps one for each side; one in all where both have the same material. Sides that
/// differ are lifted off each other: the one that faces the middle of everything moves, along the normal of its
/// winding, because the other way round there would be gaps along outer edges.
pub(super) fn separate(parts: &mut [(Mesh, usize)]) {
    let mut places: HashMap<Place, [Option<(usize, usize)>; 2]> = HashMap::new();
    let mut dropped: Vec<Vec<bool>> =
        parts.iter().map(|(mesh, _)| vec![false; mesh.triangles.len()]).collect();
    for (p, (mesh, material)) in parts.iter().enumerate() {
        for (t, triangle) in mesh.triangles.iter().enumerate() {
            let (place, side) = placed(&mesh.positions, triangle);
            let sides = places.entry(place).or_default();
            let same = |other: &(usize, usize)| parts[other.0].1 == *material;
            if sides[side].is_some() || sides[1 - side].as_ref().is_some_and(same) {
                dropped[p][t] = true;
            } else {
                sides[side] = Some((p, t));
            }
        }
    }
    let middle = middle(parts);
    let facing_in = |&(p, t): &(usize, usize)| {
        let mesh: &Mesh = &parts[p].0;
        let corners = mesh.triangles[t];
        let normal = face_normal(&mesh.positions, &corners).unwrap_or_default();
        normal.dot(&(middle - mesh.positions[corners[0] as usize])) > 0.0
    };
    let pairs = places.values().filter_map(|s| Some([s[0]?, s[1]?]));
    let mut lifted: Vec<_> = pairs.map(|[a, b]| if facing_in(&a) { a } else { b }).collect();
    lifted.sort_unstable();
    for (p, t) in lifted {
        lift(&mut parts[p].0, t);
    }
    for ((mesh, _), dropped) in parts.iter_mut().zip(dropped) {
        let mut gone = dropped.into_iter();
        mesh.triangles.retain(|_| !gone.next().unwrap_or(false));
    }
}

/// The centre of the box around all meshes.
fn middle(parts: &[(Mesh, usize)]) -> Point3<f32> {
    let points = || parts.iter().flat_map(|(mesh, _)| &mesh.positions);
    let start = points().next().copied().unwrap_or_default();
    let (min, max) = points().fold((start, start), |(min, max), p| (min.inf(p), max.sup(p)));
    nalgebra::center(&min, &max)
}

/// The corners of a triangle in an order of their own, and whether that turns the winding over.
fn placed(positions: &[Point3<f32>], triangle: &[u32; 3]) -> (Place, usize) {
    // Adding zero turns -0 into 0.
    let corners = triangle.map(|i| positions[i as usize].coords.map(|c| (c + 0.0).to_bits()).into());
    let mut sorted: Place = corners;
    sorted.sort_unstable();
    let first = corners.iter().position(|c| *c == sorted[0]).unwrap_or(0);
    (sorted, usize::from(corners[(first + 1) % 3] != sorted[1]))
}

fn lift(mesh: &mut Mesh, triangle: usize) {
    let corners = mesh.triangles[triangle];
    let Some(normal) = face_normal(&mesh.positions, &corners) else { return };
    mesh.triangles[triangle] = corners.map(|i| {
        let i = i as usize;
        mesh.positions.push(mesh.positions[i] + normal * LIFT);
        mesh.normals.push(mesh.normals[i]);
        mesh.uvs.push(mesh.uvs[i]);
        mesh.positions.len() as u32 - 1
    });
}

#[cfg(test)]
mod tests {
    use super::super::shapes::cuboid;
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn equal_sides_become_one_and_different_sides_move_apart() {
        let outside = cuboid(Vector3::repeat(1.0));
        let mut inside = outside.clone();
        inside.triangles.iter_mut().for_each(|t| t.reverse());

        let mut same = [(outside.clone(), 0), (inside.clone(), 0), (outside.clone(), 1)];
        separate(&mut same);
        assert_eq!(same.map(|(mesh, _)| mesh.triangles.len()), [12, 0, 0]);

        let mut different = [(outside, 0), (inside, 1)];
        separate(&mut different);
        for ((mesh, _), distance) in different.iter().zip([0.5, 0.5 - LIFT]) {
            assert_eq!(mesh.triangles.len(), 12);
            for t in &mesh.triangles {
                let plane =
                    face_normal(&mesh.positions, t).unwrap().dot(&mesh.positions[t[0] as usize].coords);
                assert!((plane.abs() - distance).abs() < 1e-6);
            }
        }
    }
}
