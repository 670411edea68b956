//! Points of surfaces, lit several at a time.

use nalgebra::{Point3, Vector3};
use wide::f32x8;

use super::paint::Paint;
use super::scene::Scene;
use super::shade::Facet;
use super::towards_camera;

/// Points that are lit together: some vector registers full.
pub(super) const LANES: usize = 8;

/// A vector for every point.
type Vectors = [f32x8; 3];

/// Points of triangles with what is known of the triangles there, in the camera frame.
#[derive(Default)]
pub(super) struct Lit {
    point: Vectors,
    /// From the triangle's first corner.
    offset: Vectors,
    /// Gradients of the first two barycentric coordinates.
    slopes: [Vectors; 2],
    /// Perpendicular to the triangle, on the camera's side.
    face: Vectors,
    /// At the corners, in the mesh frame.
    corner_normals: [Vectors; 3],
    /// Columns of the rotation matrix.
    camera_from_mesh: [Vectors; 3],
    specular: f32x8,
    shininess: f32x8,
}

impl Lit {
    /// Puts a point of a triangle in a lane.
    pub(super) fn set(&mut self, lane: usize, point: &Vector3<f32>, facet: &Facet<'_>, paint: &Paint) {
        put(&mut self.point, lane, point);
        put(&mut self.offset, lane, &(point - facet.origin.coords));
        put(&mut self.face, lane, &towards_camera(facet.face, &Point3::from(*point)));
        for (vectors, vector) in self.slopes.iter_mut().zip(&facet.slopes) {
            put(vectors, lane, vector);
        }
        for (vectors, vector) in self.corner_normals.iter_mut().zip(&facet.normals) {
            put(vectors, lane, vector);
        }
        for (vectors, vector) in self.camera_from_mesh.iter_mut().zip(&facet.camera_from_mesh) {
            put(vectors, lane, vector);
        }
        self.specular.as_mut_array()[lane] = paint.specular;
        self.shininess.as_mut_array()[lane] = paint.shininess;
    }

    pub(super) fn point(&self, lane: usize) -> Point3<f32> {
        let [x, y, z] = &self.point;
        Point3::new(x.as_array()[lane], y.as_array()[lane], z.as_array()[lane])
    }

    /// Barycentric coordinates of the points.
    pub(super) fn weights(&self) -> Vectors {
        let [a, b] = [dot(&self.slopes[0], &self.offset), dot(&self.slopes[1], &self.offset)];
        let a = (a + f32x8::ONE).max(f32x8::ZERO).min(f32x8::ONE);
        let b = b.max(f32x8::ZERO).min(f32x8::ONE);
        [a, b, (f32x8::ONE - a - b).max(f32x8::ZERO)]
    }

    /// Unit normals of the surfaces on the camera's side.
    fn normals(&self, weights: &Vectors) -> Vectors {
        let normals = turned(&self.camera_from_mesh, &turned(&self.corner_normals, weights));
        let length = dot(&normals, &normals).sqrt();
        let away = dot(&normals, &self.face).simd_lt(f32x8::ZERO);
        let scale = away.select(-length, length);
        let mut normals = normals.map(|axis| axis / scale);
        for (lane, _) in length.to_array().iter().enumerate().filter(|(_, length)| **length <= 1e-3) {
            let [x, y, z] = self.face.map(|axis| axis.to_array()[lane]);
            put(&mut normals, lane, &Vector3::new(x, y, z).normalize());
        }
        normals
    }

    /// Light that the points send to the camera, linear RGB, if they have such barycentric coordinates and colours.
    pub(super) fn light(&self, scene: &Scene<'_>, weights: &Vectors, albedo: &Vectors) -> Vectors {
        let normals = self.normals(weights);
        // Surfaces that face the ceiling get a little more of the light from everywhere.
        let up = dot(&normals, &splat(&scene.up));
        let ambient = (up * f32x8::splat(0.15) + f32x8::splat(0.85)) * f32x8::splat(scene.ambient);
        let mut diffuse = [ambient; 3];
        let mut highlight = [f32x8::ZERO; 3];
        let to_camera = scaled(&self.point, -f32x8::ONE / dot(&self.point, &self.point).sqrt());
        let is_shiny = self.specular.simd_gt(f32x8::ZERO);
        for (position, colour) in &scene.lights {
            let [x, y, z] = splat(position);
            let offset = [x - self.point[0], y - self.point[1], z - self.point[2]];
            let to_light = scaled(&offset, f32x8::ONE / dot(&offset, &offset).sqrt());
            let facing = dot(&normals, &to_light);
            let is_lit = facing.simd_gt(f32x8::ZERO);
            let colour = splat(colour);
            add(&mut diffuse, &colour, is_lit.select(facing, f32x8::ZERO));
            let half = [0, 1, 2].map(|axis| to_light[axis] + to_camera[axis]);
            let length = dot(&half, &half).sqrt().max(f32x8::splat(1e-6));
            let cosine = dot(&normals, &half) / length;
            let shines = is_lit & is_shiny & cosine.simd_gt(f32x8::splat(0.7));
            if shines.any() {
                let mut strength = shines.select(cosine, f32x8::ZERO);
                for (strength, shininess) in strength.as_mut_array().iter_mut().zip(self.shininess.as_array())
                {
                    if *strength > 0.0 {
                        *strength = strength.powf(*shininess);
                    }
                }
                add(&mut highlight, &colour, strength);
            }
        }
        [0, 1, 2].map(|channel| albedo[channel] * diffuse[channel] + highlight[channel] * self.specular)
    }
}

/// Sets the vector of a lane.
pub(super) fn put(vectors: &mut Vectors, lane: usize, vector: &Vector3<f32>) {
    for (axis, value) in vectors.iter_mut().zip(vector) {
        axis.as_mut_array()[lane] = *value;
    }
}

/// The same vector for every point.
fn splat(vector: &Vector3<f32>) -> Vectors {
    [f32x8::splat(vector.x), f32x8::splat(vector.y), f32x8::splat(vector.z)]
}

fn dot(a: &Vectors, b: &Vectors) -> f32x8 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn scaled([x, y, z]: &Vectors, factor: f32x8) -> Vectors {
    [*x * factor, *y * factor, *z * factor]
}

fn add([x, y, z]: &mut Vectors, [a, b, c]: &Vectors, factor: f32x8) {
    (*x, *y, *z) = (*x + *a * factor, *y + *b * factor, *z + *c * factor);
}

/// Products of matrices, given by their columns, with vectors.
fn turned([a, b, c]: &[Vectors; 3], [x, y, z]: &Vectors) -> Vectors {
    [0, 1, 2].map(|axis| a[axis] * *x + b[axis] * *y + c[axis] * *z)
}
