//! The hand as something to look at.

use nalgebra::{Point3, Vector3};
use where2act_core::GRIPPER;
use where2act_sim::object::{Material, Mesh};

/// Meshes of the palm, the left and the right finger, each in its own frame.
pub(crate) fn meshes() -> [Mesh; 3] {
    let ([x0, y0, z0], [x1, y1, z1]) = (GRIPPER.hand_min, GRIPPER.hand_max);
    let ring = |z: f32| [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]];
    let palm = [ring(z0), ring(z1)].concat();
    let left = GRIPPER.finger_corners();
    let right = left.map(|[x, y, z]| [-x, -y, z]);
    [stack(&palm), stack(&left), stack(&right)]
}

pub(crate) fn materials() -> [Material; 2] {
    [[0.93, 0.93, 0.95], [0.95, 0.55, 0.1]].map(|colour| Material {
        colour,
        texture: None,
        specular: 0.3,
        shininess: 20.0,
        opacity: 1.0,
    })
}

/// The solid between rings of four corners, one above the other.
fn stack(corners: &[[f32; 3]]) -> Mesh {
    let mut mesh = Mesh::default();
    let rings = corners.len() / 4;
    for ring in 1..rings {
        for side in 0..4 {
            let next = (side + 1) % 4;
            let (below, above) = (4 * (ring - 1), 4 * ring);
            quad(&mut mesh, [below + side, below + next, above + next, above + side].map(|i| corners[i]));
        }
    }
    let top = 4 * (rings - 1);
    quad(&mut mesh, [3, 2, 1, 0].map(|i| corners[i]));
    quad(&mut mesh, [0, 1, 2, 3].map(|i| corners[top + i]));
    mesh
}

fn quad(mesh: &mut Mesh, corners: [[f32; 3]; 4]) {
    let points = corners.map(Point3::from);
    let normal = (points[1] - points[0]).cross(&(points[2] - points[0]));
    let normal = normal.try_normalize(1e-12).unwrap_or(Vector3::z());
    let first = mesh.positions.len() as u32;
    mesh.positions.extend(points);
    mesh.normals.extend([normal; 4]);
    mesh.uvs.extend([[0.0; 2]; 4]);
    mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
}
