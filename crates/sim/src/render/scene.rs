//! The triangles of a picture, placed before the camera, and the light on them.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Vector3};
use rayon::prelude::*;
use where2act_core::{Camera, ImageSize};

use super::Extra;
use super::look::Look;
use super::paint::Paint;
use super::raster::{Grid, Region};
use crate::object::{Mesh, Object};

/// Vertices or triangles that one task prepares: some tens of microseconds of work.
const PREPARED_TOGETHER: usize = 4096;

/// A mesh placed before the camera.
pub(super) struct Instance<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) camera_from_mesh: Isometry3<f32>,
    /// The same rotation as a matrix.
    pub(super) rotation: Matrix3<f32>,
    corners: Vec<Corner>,
    /// Index of its paint, and whether that hides all behind it and has one colour.
    pub(super) paint: usize,
    pub(super) is_glass: bool,
    pub(super) is_even: bool,
    /// As in [`super::View::link`].
    pub(super) link: u8,
}

/// A vertex in the camera frame and in the picture.
struct Corner {
    point: Point3<f32>,
    /// In samples; `None` if it is nearer than the near plane.
    screen: Option<(f32, f32)>,
}

/// A triangle that may be seen.
#[derive(Clone, Copy)]
pub(super) struct Drawn {
    pub(super) instance: u32,
    pub(super) face: u32,
    /// The samples around it: left, top, right, bottom.
    bounds: [u32; 4],
}

impl Drawn {
    /// The samples it may be seen at.
    pub(super) fn bounds(&self) -> Region {
        let [left, top, right, bottom] = self.bounds;
        Region { left: left as usize, top: top as usize, right: right as usize, bottom: bottom as usize }
    }

    /// Whether it may be seen in the rows of a region.
    pub(super) fn reaches(&self, region: &Region) -> bool {
        (self.bounds[1] as usize) < region.bottom && (self.bounds[3] as usize) > region.top
    }
}

/// Everything in a picture.
pub(super) struct Scene<'a> {
    pub(super) camera: Camera,
    pub(super) world_from_camera: Rotation3<f32>,
    pub(super) grid: Grid,
    /// The samples that can show anything.
    pub(super) region: Region,
    pub(super) paints: Vec<Paint>,
    pub(super) instances: Vec<Instance<'a>>,
    /// Of equally near triangles the first is seen.
    pub(super) drawn: Vec<Drawn>,
    /// Whether there are surfaces that let light through.
    pub(super) has_glass: bool,
    pub(super) ambient: f32,
    /// The world's z axis in the camera frame.
    pub(super) up: Vector3<f32>,
    /// Positions in the camera frame and colours.
    pub(super) lights: Vec<(Vector3<f32>, Vector3<f32>)>,
}

impl<'a> Scene<'a> {
    pub(super) fn new(
        object: &'a Object,
        world_from_links: &[Isometry3<f32>],
        extras: &[Extra<'a>],
        camera: &Camera,
        look: &Look,
    ) -> Self {
        let mut paints: Vec<Paint> = match look.paint {
            None => object.materials.iter().map(Paint::new).collect(),
            Some(seed) => (0u64..)
                .zip(&object.materials)
                .map(|(i, material)| Paint::repainted(material, seed.child("material", i)))
                .collect(),
        };
        let camera_from_world = camera.camera_from_world();
        let mut placed = Vec::new();
        for (index, (link, world_from_link)) in object.links.iter().zip(world_from_links).enumerate() {
            for visual in link.visuals.iter().filter(|v| v.material < object.materials.len()) {
                let link = u8::try_from(index + 1).unwrap_or(u8::MAX);
                placed.push((&*visual.mesh, camera_from_world * world_from_link, visual.material, link));
            }
        }
        for extra in extras {
            placed.push((extra.mesh, camera_from_world * extra.world_from_mesh, paints.len(), 0));
            paints.push(Paint::new(extra.material));
        }
        let grid = Grid::new(camera);
        let place =
            |(mesh, pose, paint, link)| Instance::new(mesh, pose, (paint, &paints[paint]), link, &grid);
        let instances: Vec<Instance<'a>> = placed.into_par_iter().map(place).collect();
        let region = covered(&instances, camera.size);
        Self {
            camera: *camera,
            world_from_camera: camera.world_from_camera.rotation.to_rotation_matrix(),
            grid,
            region,
            drawn: drawn(&instances, region),
            has_glass: instances.iter().any(|i| i.is_glass),
            paints,
            instances,
            ambient: look.ambient,
            up: camera_from_world * Vector3::z(),
            lights: look
                .lights
                .iter()
                .map(|l| ((camera_from_world * Point3::from(l.position)).coords, Vector3::from(l.colour)))
                .collect(),
        }
    }

    /// The corners of a triangle in the camera frame.
    pub(super) fn corners(&self, drawn: &Drawn) -> [&Point3<f32>; 3] {
        let instance = &self.instances[drawn.instance as usize];
        let [a, b, c] = instance.mesh.triangles[drawn.face as usize];
        let point = |c: u32| &instance.corners[c as usize].point;
        [point(a), point(b), point(c)]
    }
}

impl<'a> Instance<'a> {
    fn new(
        mesh: &'a Mesh,
        camera_from_mesh: Isometry3<f32>,
        (paint, of): (usize, &Paint),
        link: u8,
        grid: &Grid,
    ) -> Self {
        let rotation = camera_from_mesh.rotation.to_rotation_matrix();
        let translation = camera_from_mesh.translation.vector;
        let corner = |p: &Point3<f32>| {
            let point = rotation * p + translation;
            Corner { point, screen: grid.project(&point) }
        };
        Self {
            mesh,
            camera_from_mesh,
            rotation: *rotation.matrix(),
            corners: mesh.positions.par_iter().with_min_len(PREPARED_TOGETHER).map(corner).collect(),
            paint,
            is_glass: of.opacity < 1.0,
            is_even: of.is_even(),
            link,
        }
    }

    /// The triangles of a range that some samples of a region may show.
    fn drawn(&self, index: usize, faces: std::ops::Range<usize>, region: Region) -> Vec<Drawn> {
        let mut drawn = Vec::with_capacity(faces.len());
        for (face, corners) in faces.clone().zip(&self.mesh.triangles[faces]) {
            let [a, b, c] = *corners;
            let screen = |c: u32| self.corners[c as usize].screen;
            let bounds = match [screen(a), screen(b), screen(c)] {
                [Some(a), Some(b), Some(c)] => region.clip(
                    (a.0.min(b.0).min(c.0), a.1.min(b.1).min(c.1)),
                    (a.0.max(b.0).max(c.0), a.1.max(b.1).max(c.1)),
                ),
                [None, None, None] => continue,
                // Reaches behind the near plane: may be anywhere.
                _ => region,
            };
            if !bounds.is_empty() {
                let Region { left, top, right, bottom } = bounds;
                let bounds = [left as u32, top as u32, right as u32, bottom as u32];
                drawn.push(Drawn { instance: index as u32, face: face as u32, bounds });
            }
        }
        drawn
    }
}

/// The triangles of all instances that some samples of a region may show, in order.
fn drawn(instances: &[Instance<'_>], region: Region) -> Vec<Drawn> {
    let mut tasks = Vec::new();
    for (index, instance) in instances.iter().enumerate() {
        let faces = instance.mesh.triangles.len();
        tasks.extend(
            (0..faces).step_by(PREPARED_TOGETHER).map(|f| (index, f..faces.min(f + PREPARED_TOGETHER))),
        );
    }
    let drawn = tasks.into_par_iter().map(|(index, faces)| instances[index].drawn(index, faces, region));
    drawn.collect::<Vec<_>>().concat()
}

/// The samples of a picture that projected vertices span; all if one is too near to be projected.
fn covered(instances: &[Instance<'_>], size: ImageSize) -> Region {
    let whole = Region { left: 0, top: 0, right: 2 * size.width + 1, bottom: 2 * size.height + 1 };
    let mut min = (f32::INFINITY, f32::INFINITY);
    let mut max = (f32::NEG_INFINITY, f32::NEG_INFINITY);
    for corner in instances.iter().flat_map(|i| &i.corners) {
        let Some((x, y)) = corner.screen else { return whole };
        min = (min.0.min(x), min.1.min(y));
        max = (max.0.max(x), max.1.max(y));
    }
    whole.clip(min, max)
}
