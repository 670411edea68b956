//! Light from points of triangles.

use nalgebra::{Point3, Vector3};
use wide::f32x8;

use super::lit::{LANES, Lit, put};
use super::paint::{Paint, Texels};
use super::scene::{Instance, Scene};
use super::towards_camera;

/// What shading needs to know of a triangle, in the camera frame.
pub(super) struct Facet<'s> {
    /// Index among all triangles of the scene.
    triangle: u32,
    pub(super) instance: &'s Instance<'s>,
    /// Its first corner.
    pub(super) origin: Point3<f32>,
    /// Perpendicular to it, as long as twice its area.
    pub(super) face: Vector3<f32>,
    /// Gradients of the first two barycentric coordinates.
    pub(super) slopes: [Vector3<f32>; 2],
    /// At the corners, in the mesh frame.
    pub(super) normals: [Vector3<f32>; 3],
    /// Columns of the rotation matrix.
    pub(super) camera_from_mesh: [Vector3<f32>; 3],
    /// Zero for surfaces of one colour.
    uvs: [[f32; 2]; 3],
    /// Unit normal in the world, on the camera's side, once it was asked for.
    normal_in_world: Option<Vector3<f32>>,
}

impl<'s> Facet<'s> {
    fn new(scene: &'s Scene<'s>, triangle: u32) -> Self {
        let index = triangle as usize;
        let instance = scene.instance(index);
        let [a, b, c] = instance.corners(index);
        let vertices = instance.vertices(index);
        let face = (b - a).cross(&(c - a));
        let scale = face.norm_squared().recip();
        let uv = |vertex: u32| instance.mesh.uvs[vertex as usize];
        Self {
            triangle,
            instance,
            origin: *a,
            face,
            slopes: [face.cross(&(c - b)) * scale, face.cross(&(a - c)) * scale],
            normals: vertices.map(|vertex| instance.mesh.normals[vertex as usize]),
            camera_from_mesh: instance.rotation,
            uvs: if instance.is_even { [[0.0; 2]; 3] } else { vertices.map(uv) },
            normal_in_world: None,
        }
    }
}

/// A point that is to be lit.
struct Shown<'s> {
    place: usize,
    instance: &'s Instance<'s>,
    paint: &'s Paint,
    uvs: [[f32; 2]; 3],
}

/// Shades the triangles of a scene, some points at a time.
pub(super) struct Shader<'s> {
    scene: &'s Scene<'s>,
    /// Neighbouring samples mostly show the same triangle.
    last: Option<Facet<'s>>,
    /// Less than [`LANES`] points.
    lit: Lit,
    shown: Vec<Shown<'s>>,
}

impl<'s> Shader<'s> {
    pub(super) fn new(scene: &'s Scene<'s>) -> Self {
        Self { scene, last: None, lit: Lit::default(), shown: Vec::with_capacity(LANES) }
    }

    fn facet(&mut self, triangle: u32) -> &mut Facet<'s> {
        if self.last.as_ref().is_none_or(|last| last.triangle != triangle) {
            self.last = None;
        }
        self.last.get_or_insert_with(|| Facet::new(self.scene, triangle))
    }

    /// Unit normal of a triangle in the world, on the camera's side, and the link it belongs to.
    pub(super) fn normal(&mut self, triangle: u32) -> (Vector3<f32>, u8) {
        let world_from_camera = self.scene.world_from_camera;
        let Facet { face, origin, instance, normal_in_world, .. } = self.facet(triangle);
        let normal = || world_from_camera * towards_camera(face.normalize(), origin);
        (*normal_in_world.get_or_insert_with(normal), instance.link)
    }

    /// Shades a point of a triangle, in the camera frame, that is seen at a place of `lights`: they change now or when
    /// the shader is [flushed](Self::flush).
    pub(super) fn shade(
        &mut self,
        triangle: u32,
        point: Vector3<f32>,
        place: usize,
        lights: &mut [[f32; 3]],
    ) {
        self.facet(triangle);
        if let Some(facet) = &self.last {
            let paint = &self.scene.paints[facet.instance.paint];
            self.lit.set(self.shown.len(), &point, facet, paint);
            self.shown.push(Shown { place, instance: facet.instance, paint, uvs: facet.uvs });
        }
        if self.shown.len() == LANES {
            self.flush(lights);
        }
    }

    /// Lights what was shaded since the last time.
    pub(super) fn flush(&mut self, lights: &mut [[f32; 3]]) {
        if self.shown.is_empty() {
            return;
        }
        let Self { scene, lit, shown, .. } = self;
        let weights = lit.weights();
        let [a, b, c] = weights.map(f32x8::to_array);
        let mut texels = [Texels::default(); LANES];
        for (lane, Shown { paint, uvs, .. }) in shown.iter().enumerate() {
            let along =
                |axis: usize| uvs[0][axis] * a[lane] + uvs[1][axis] * b[lane] + uvs[2][axis] * c[lane];
            texels[lane] = paint.texels([along(0), along(1)]);
        }
        let mut albedo = [f32x8::ZERO; 3];
        for (lane, Shown { instance, paint, .. }) in shown.iter().enumerate() {
            let in_mesh = || instance.camera_from_mesh.inverse_transform_point(&lit.point(lane)).coords;
            put(&mut albedo, lane, &paint.albedo(&texels[lane], in_mesh));
        }
        let light = lit.light(scene, &weights, &albedo).map(f32x8::to_array);
        for (lane, Shown { place, paint: &Paint { opacity, .. }, .. }) in shown.drain(..).enumerate() {
            for (channel, light) in lights[place].iter_mut().zip(&light) {
                *channel = light[lane] * opacity + *channel * (1.0 - opacity);
            }
        }
    }
}
