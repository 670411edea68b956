//! Boxes, cylinders, spheres and capsules as triangles, in URDF's conventions: centred, axis along z.

use std::f32::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Point3, Vector3};

use super::Mesh;
use super::normals::with_normals;

/// Segments around an axis: corners of a 32-gon are within 0.5 % of the radius of the circle.
const SEGMENTS: u32 = 32;
/// Segments from equator to pole.
const RINGS: u32 = 8;

/// An axis-aligned box with these edge lengths.
pub(super) fn cuboid(size: Vector3<f32>) -> Mesh {
    let corner = |i: u32| {
        let side = |bit: u32| if i >> bit & 1 == 0 { -0.5 } else { 0.5 };
        Point3::new(size.x * side(0), size.y * side(1), size.z * side(2))
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    with_normals((0..8).map(corner).collect(), vec![[0.0; 2]; 8], triangles)
}

/// A cylinder along z.
pub(super) fn cylinder(radius: f32, length: f32) -> Mesh {
    let half = length / 2.0;
    revolve(&[[0.0, -half], [radius, -half], [radius, half], [0.0, half]])
}

/// A ball.
pub(super) fn sphere(radius: f32) -> Mesh {
    capsule(radius, 0.0)
}

/// A cylinder along z of this length between two half balls.
pub(super) fn capsule(radius: f32, length: f32) -> Mesh {
    let arc = |from: f32, shift: f32| {
        (0..=RINGS).map(move |i| {
            let latitude = from + FRAC_PI_2 * i as f32 / RINGS as f32;
            [radius * latitude.cos(), radius * latitude.sin() + shift]
        })
    };
    let mut profile: Vec<[f32; 2]> = arc(-FRAC_PI_2, -length / 2.0).collect();
    profile.extend(arc(0.0, length / 2.0).skip(usize::from(length == 0.0)));
    // The cosine of a right angle is not exactly zero in f32.
    profile[0][0] = 0.0;
    if let Some(pole) = profile.last_mut() {
        pole[0] = 0.0;
    }
    revolve(&profile)
}

/// Turns a profile of (radius, z), from bottom to top and ending on the axis, around z.
fn revolve(profile: &[[f32; 2]]) -> Mesh {
    let mut positions = Vec::new();
    let mut uvs = Vec::new();
    for (row, &[r, z]) in profile.iter().enumerate() {
        for s in 0..=SEGMENTS {
            let turn = s as f32 / SEGMENTS as f32;
            // The seam's two ends must be the same point for their normals to be averaged.
            let angle = if s == SEGMENTS { 0.0 } else { TAU * turn - PI };
            let (sin, cos) = if s == SEGMENTS { (-PI).sin_cos() } else { angle.sin_cos() };
            positions.push(Point3::new(r * cos, r * sin, z));
            uvs.push([turn, row as f32 / (profile.len() - 1) as f32]);
        }
    }
    let stride = SEGMENTS + 1;
    let mut triangles = Vec::new();
    for row in 0..profile.len() as u32 - 1 {
        for s in 0..SEGMENTS {
            let (a, b) = (row * stride + s, row * stride + s + 1);
            let (c, d) = (a + stride, b + stride);
            if profile[row as usize][0] > 0.0 {
                triangles.push([a, b, d]);
            }
            if profile[row as usize + 1][0] > 0.0 {
                triangles.push([a, d, c]);
            }
        }
    }
    with_normals(positions, uvs, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Signed volume; positive only if every face looks outward.
    fn volume(mesh: &Mesh) -> f32 {
        let corner = |i: u32| mesh.positions[i as usize].coords;
        mesh.triangles.iter().map(|t| corner(t[0]).cross(&corner(t[1])).dot(&corner(t[2])) / 6.0).sum()
    }

    #[test]
    fn volumes_are_those_of_the_solids() {
        let solids = [
            (cuboid(Vector3::new(1.0, 2.0, 3.0)), 6.0),
            (cylinder(0.5, 2.0), PI * 0.25 * 2.0),
            (sphere(0.5), PI / 6.0),
            (capsule(0.5, 1.0), PI / 6.0 + PI * 0.25),
        ];
        for (mesh, exact) in solids {
            let found = volume(&mesh);
            assert!(found <= exact * 1.0001 && found > exact * 0.97, "{found} of {exact}");
        }
    }

    #[test]
    fn normals_of_a_ball_point_away_from_its_centre() {
        let ball = sphere(2.0);
        for (p, n) in ball.positions.iter().zip(&ball.normals) {
            assert!(p.coords.normalize().dot(n) > 0.98, "{p} {n}");
        }
    }
}
