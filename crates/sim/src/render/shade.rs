//! Light from points of triangles.

use nalgebra::{Point3, Vector3};

use super::look::{Look, Surface};
use super::scene::{Instance, Scene};
use super::towards_camera;

/// What shading needs to know of a triangle, in the camera frame.
struct Facet<'s> {
    /// Index in [`Scene::drawn`].
    triangle: u32,
    instance: &'s Instance<'s>,
    /// Its first corner.
    origin: Point3<f32>,
    /// Perpendicular to it, as long as twice its area.
    face: Vector3<f32>,
    /// Gradients of the first two barycentric coordinates.
    slopes: [Vector3<f32>; 2],
    /// At the corners, in the mesh frame.
    normals: [Vector3<f32>; 3],
    uvs: [[f32; 2]; 3],
    /// Unit normal in the world, on the camera's side, once it was asked for.
    normal_in_world: Option<Vector3<f32>>,
}

impl<'s> Facet<'s> {
    fn new(scene: &'s Scene<'s>, triangle: u32) -> Self {
        let drawn = &scene.drawn[triangle as usize];
        let instance = &scene.instances[drawn.instance as usize];
        let [a, b, c] = scene.corners(drawn);
        let face = (b - a).cross(&(c - a));
        let scale = face.norm_squared().recip();
        let corners = instance.mesh.triangles[drawn.face as usize];
        let normal = |corner: usize| instance.mesh.normals[corners[corner] as usize];
        let uv = |corner: usize| instance.mesh.uvs[corners[corner] as usize];
        Self {
            triangle,
            instance,
            origin: *a,
            face,
            slopes: [face.cross(&(c - b)) * scale, face.cross(&(a - c)) * scale],
            normals: [normal(0), normal(1), normal(2)],
            uvs: [uv(0), uv(1), uv(2)],
            normal_in_world: None,
        }
    }
}

/// Shades the triangles of a scene. Remembers the last one: neighbouring samples mostly show the same.
pub(super) struct Shader<'s> {
    scene: &'s Scene<'s>,
    last: Option<Facet<'s>>,
}

impl<'s> Shader<'s> {
    pub(super) fn new(scene: &'s Scene<'s>) -> Self {
        Self { scene, last: None }
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

    /// Light from a point of a triangle, in the camera frame, and how much it hides.
    pub(super) fn shade(&mut self, triangle: u32, point: Vector3<f32>) -> (Vector3<f32>, f32) {
        let scene = self.scene;
        let Facet { instance, origin, face, slopes, normals, uvs, .. } = &*self.facet(triangle);
        let offset = point - origin.coords;
        let wa = (1.0 + slopes[0].dot(&offset)).clamp(0.0, 1.0);
        let wb = slopes[1].dot(&offset).clamp(0.0, 1.0);
        let weights = [wa, wb, (1.0 - wa - wb).max(0.0)];
        let mut normal = Vector3::zeros();
        let mut uv = [0.0; 2];
        for ((weight, corner_normal), corner_uv) in weights.into_iter().zip(normals).zip(uvs) {
            normal += corner_normal * weight;
            uv[0] += corner_uv[0] * weight;
            uv[1] += corner_uv[1] * weight;
        }
        let face = towards_camera(*face, &Point3::from(point));
        let normal = instance.rotation * normal;
        let normal = if normal.dot(&face) < 0.0 { -normal } else { normal };
        let normal = normal.try_normalize(1e-3).unwrap_or_else(|| face.normalize());
        let paint = &scene.paints[instance.paint];
        let in_mesh = || instance.camera_from_mesh.inverse_transform_point(&Point3::from(point)).coords;
        let surface = Surface {
            albedo: paint.albedo(uv, in_mesh),
            specular: paint.specular,
            shininess: paint.shininess,
        };
        (Look::shade(&surface, &point, &normal, (scene.ambient, &scene.up), &scene.lights), paint.opacity)
    }
}
