//! The triangles of a picture, placed before the camera, and the light on them.

use std::ops::Range;

use nalgebra::{Isometry3, Point3, Rotation3, Vector3};
use rayon::prelude::*;
use where2act_core::{Camera, ImageSize};

use super::Extra;
use super::band;
use super::light::{GLASS, NOTHING};
use super::look::Look;
use super::paint::Paint;
use super::raster::{Grid, Region, nearness_range};
use super::timber::Timber;
use crate::object::{Mesh, Object};

/// Vertices or triangles that one task prepares: some tens of microseconds of work.
const PREPARED_TOGETHER: usize = 4096;

/// A mesh placed before the camera.
pub(super) struct Instance<'a> {
    pub(super) mesh: &'a Mesh,
    pub(super) camera_from_mesh: Isometry3<f32>,
    /// Columns of the matrix of the same rotation.
    pub(super) rotation: [Vector3<f32>; 3],
    corners: Vec<Corner>,
    /// Index of its first triangle among those of the scene.
    first: usize,
    /// Index of its paint, and whether that lets light through and has one colour.
    pub(super) paint: usize,
    pub(super) is_glass: bool,
    pub(super) is_even: bool,
    /// What its samples show, as in [`super::light::Planes`].
    pub(super) surface: u32,
    /// As in [`super::View::link`].
    pub(super) link: u8,
}

/// A vertex in the camera frame and in the picture.
struct Corner {
    point: Point3<f32>,
    /// In samples; `None` if it is nearer than the near plane.
    screen: Option<(f32, f32)>,
}

/// How triangles of a scene are sorted by depth before they are drawn: finely enough that most of what is hidden comes
/// after what hides it.
pub(super) const LAYERS: usize = 16;

/// A triangle that may be seen.
#[derive(Clone, Copy)]
pub(super) struct Drawn {
    /// Index among all triangles of the scene.
    pub(super) index: u32,
    pub(super) instance: u32,
    /// 1 / depth of its nearest corner.
    pub(super) nearness: f32,
    /// The samples around it: left, top, right, bottom.
    bounds: [u32; 4],
}

impl Drawn {
    /// The samples it may be seen at.
    pub(super) fn bounds(&self) -> Region {
        let [left, top, right, bottom] = self.bounds;
        Region { left: left as usize, top: top as usize, right: right as usize, bottom: bottom as usize }
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
    /// The triangles that may be seen in every band, as each task found them: `[task][band]`. Of equally near ones that
    /// with the least index is seen.
    drawn: Vec<Vec<Vec<Drawn>>>,
    /// Least and largest 1 / depth of vertices in front of the near plane.
    nearness: (f32, f32),
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
            Some(seed) => {
                let timber = Timber::random(seed.child("timber", 0));
                (0u64..)
                    .zip(&object.materials)
                    .map(|(i, material)| {
                        Paint::repainted(material, timber.as_ref(), seed.child("material", i))
                    })
                    .collect()
            }
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
        let mut instances: Vec<Instance<'a>> = placed.into_par_iter().map(place).collect();
        let mut triangles = 0;
        for (index, instance) in (0u32..).zip(&mut instances) {
            instance.surface =
                if instance.is_glass { GLASS } else { 2 * index + u32::from(!instance.is_even) };
            instance.first = triangles;
            triangles += instance.mesh.triangles.len();
        }
        let extent = instances.iter().map(Instance::extent).fold(Extent::NOTHING, Extent::and);
        let region = extent.region(camera.size);
        Self {
            camera: *camera,
            world_from_camera: camera.world_from_camera.rotation.to_rotation_matrix(),
            grid,
            region,
            drawn: drawn(&instances, region, band::count(camera.size)),
            nearness: nearness_range([extent.min[2], extent.max[2], extent.max[2]]),
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

    /// The instance with a triangle.
    pub(super) fn instance(&self, triangle: usize) -> &Instance<'a> {
        // Those without triangles begin where the next one does.
        &self.instances[self.instances.partition_point(|instance| instance.first <= triangle) - 1]
    }

    /// The triangles that may be seen in a band.
    pub(super) fn drawn(&self, band: usize) -> impl Iterator<Item = &Drawn> {
        self.drawn.iter().flat_map(move |task| &task[band])
    }

    /// Which of [`LAYERS`] something of a nearness is in, nearest first.
    pub(super) fn layer(&self, nearness: f32) -> usize {
        let (least, largest) = self.nearness;
        // `as` saturates, and turns NaN into 0.
        ((LAYERS as f32 * (largest - nearness) / (largest - least)) as usize).min(LAYERS - 1)
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
            rotation: [0, 1, 2].map(|axis| rotation.matrix().column(axis).into_owned()),
            corners: mesh.positions.par_iter().with_min_len(PREPARED_TOGETHER).map(corner).collect(),
            first: 0,
            paint,
            is_glass: of.opacity < 1.0,
            is_even: of.is_even(),
            surface: NOTHING,
            link,
        }
    }

    /// Indices of its triangles among those of the scene.
    pub(super) fn triangles(&self) -> Range<usize> {
        self.first..self.first + self.mesh.triangles.len()
    }

    /// The vertices of one of them.
    pub(super) fn vertices(&self, triangle: usize) -> [u32; 3] {
        self.mesh.triangles[triangle - self.first]
    }

    /// The corners of one of them in the camera frame.
    pub(super) fn corners(&self, triangle: usize) -> [&Point3<f32>; 3] {
        self.vertices(triangle).map(|vertex| &self.corners[vertex as usize].point)
    }

    /// What its vertices span.
    fn extent(&self) -> Extent {
        let corners = self.corners.par_iter().with_min_len(PREPARED_TOGETHER);
        corners.map(Extent::of).reduce(|| Extent::NOTHING, Extent::and)
    }

    /// The triangles of a range that some samples of a region may show, in every of some bands.
    fn drawn(&self, instance: u32, faces: Range<usize>, region: Region, bands: usize) -> Vec<Vec<Drawn>> {
        let mut drawn = vec![Vec::new(); bands];
        for (face, corners) in faces.clone().zip(&self.mesh.triangles[faces]) {
            let [a, b, c] = corners.map(|vertex| &self.corners[vertex as usize]);
            let bounds = match [a.screen, b.screen, c.screen] {
                [Some(a), Some(b), Some(c)] => region.clip(
                    (a.0.min(b.0).min(c.0), a.1.min(b.1).min(c.1)),
                    (a.0.max(b.0).max(c.0), a.1.max(b.1).max(c.1)),
                ),
                [None, None, None] => continue,
                // Reaches behind the near plane: may be anywhere.
                _ => region,
            };
            if bounds.is_empty() {
                continue;
            }
            let Region { left, top, right, bottom } = bounds;
            let triangle = Drawn {
                index: (self.first + face) as u32,
                instance,
                nearness: nearness_range([a.point.z, b.point.z, c.point.z]).1,
                bounds: [left as u32, top as u32, right as u32, bottom as u32],
            };
            for band in &mut drawn[band::reached(&bounds, bands)] {
                band.push(triangle);
            }
        }
        drawn
    }
}

/// The triangles of all instances that some samples of a region may show, as [`Scene::drawn`].
fn drawn(instances: &[Instance<'_>], region: Region, bands: usize) -> Vec<Vec<Vec<Drawn>>> {
    let mut tasks = Vec::new();
    for (index, instance) in (0u32..).zip(instances) {
        let faces = instance.mesh.triangles.len();
        let starts = (0..faces).step_by(PREPARED_TOGETHER);
        tasks.extend(starts.map(|start| (index, start..faces.min(start + PREPARED_TOGETHER))));
    }
    let task = |(index, faces)| instances[index as usize].drawn(index, faces, region, bands);
    tasks.into_par_iter().map(task).collect()
}

/// What projected vertices span: sample coordinates and depth.
#[derive(Clone, Copy)]
struct Extent {
    min: [f32; 3],
    max: [f32; 3],
    /// Whether some are too near to be projected.
    is_open: bool,
}

impl Extent {
    const NOTHING: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3], is_open: false };

    fn of(corner: &Corner) -> Self {
        match corner.screen {
            Some((x, y)) => {
                let point = [x, y, corner.point.z];
                Self { min: point, max: point, is_open: false }
            }
            None => Self { is_open: true, ..Self::NOTHING },
        }
    }

    fn and(self, other: Self) -> Self {
        Self {
            min: std::array::from_fn(|axis| self.min[axis].min(other.min[axis])),
            max: std::array::from_fn(|axis| self.max[axis].max(other.max[axis])),
            is_open: self.is_open | other.is_open,
        }
    }

    /// The samples of a picture in it.
    fn region(&self, size: ImageSize) -> Region {
        let whole = Region { left: 0, top: 0, right: 2 * size.width + 1, bottom: 2 * size.height + 1 };
        let (min, max) = (self.min, self.max);
        if self.is_open { whole } else { whole.clip((min[0], min[1]), (max[0], max[1])) }
    }
}
