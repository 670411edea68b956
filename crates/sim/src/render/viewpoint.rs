//! Where cameras stand.

use std::f32::consts::{PI, TAU};

use nalgebra::{Isometry3, Point2, Point3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use where2act_core::{Camera, ImageSize, Intrinsics};

use crate::object::Object;

/// Radius of the sphere that holds generated and PartNet-Mobility's objects, with a margin, metres: wide cameras keep it in the
/// picture. Of larger ones they show a part.
const OBJECT_RADIUS: f32 = 1.1;

/// Side of the picture at least, and how many times that at most, if the camera zooms in: parts of the object's extent.
const LEAST_MARGIN: f32 = 1.05;
const MOST_ZOOMED_OUT: f32 = 1.7;
/// Share of the room beside the object by which it may be off the middle of the picture.
const OFF_CENTRE: f32 = 0.7;

/// How a camera is held that does not look straight at its target, degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Held {
    /// About its own axis, clockwise for who stands behind it.
    pub roll: f32,
    /// About its own y axis, to the right: so far the target is beside its axis.
    pub beside: f32,
}

impl Held {
    /// Whether it looks straight at its target, upright.
    #[must_use]
    pub fn straight(&self) -> bool {
        *self == Self::default()
    }

    /// A camera that looks at `target` upright, held like this where it is. What it shows is the part of a wider picture that has
    /// the target in the middle; beside the axis pictures are stretched, so the focal length is less.
    #[must_use]
    pub fn hold(&self, camera: &Camera, target: &Point3<f32>) -> Camera {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), self.beside.to_radians());
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.roll.to_radians());
        let mut held = *camera;
        held.world_from_camera.rotation *= turn * roll;
        let seen = held.camera_from_world() * target;
        let (stretch, Intrinsics { fx, fy, .. }) = ((seen.coords.norm() / seen.z).powi(2), camera.intrinsics);
        let (fx, fy) = (fx / stretch, fy / stretch);
        let middle = |length: usize, f: f32, off: f32| 0.5 * length as f32 - f * off / seen.z;
        let (cx, cy) = (middle(camera.size.width, fx, seen.x), middle(camera.size.height, fy, seen.y));
        Camera { intrinsics: Intrinsics { fx, fy, cx, cy }, ..held }
    }
}

/// The camera that looks at an object, with its links at `world_from_links`, from the front, turned to the object's left by
/// `azimuth` and above the horizon by `elevation`, radians: from the published distance, with the published field of view, `side`
/// pixels wide and high.
#[must_use]
pub fn front_camera(
    object: &Object,
    world_from_links: &[Isometry3<f32>],
    [azimuth, elevation]: [f32; 2],
    side: usize,
) -> Camera {
    let (min, max) = visible_bounds(object, world_from_links);
    // Objects face -x.
    let (centre, azimuth) = (nalgebra::center(&min, &max), PI + azimuth);
    let distance = Camera::PUBLISHED_DISTANCE;
    Camera::orbit(centre, distance, azimuth, elevation, ImageSize::square(side), Camera::PUBLISHED_FOV)
}

/// A random 448x448 camera that looks at `object_centre`.
///
/// Published: distance 5 m, any azimuth, elevation 30 to 60 degrees, field of view 35 degrees. With `wide`: distance
/// 3.5 to 7 m, elevation 5 to 70, field of view 25 to 60, the object inside the picture.
#[must_use]
pub fn sample_camera(object_centre: Point3<f32>, rng: &mut impl Rng, wide: bool) -> Camera {
    let degrees = PI / 180.0;
    let azimuth = rng.random_range(0.0..TAU);
    let (distance, elevation, fov) = if wide {
        let fov = rng.random_range(25.0 * degrees..60.0 * degrees);
        let nearest = (OBJECT_RADIUS / (0.5f32 * fov).sin()).max(3.5);
        (rng.random_range(nearest..7.0), rng.random_range(5.0 * degrees..70.0 * degrees), fov)
    } else {
        let elevation = rng.random_range(30.0 * degrees..60.0 * degrees);
        (Camera::PUBLISHED_DISTANCE, elevation, Camera::PUBLISHED_FOV)
    };
    let size = ImageSize::square(Camera::PUBLISHED_SIDE);
    Camera::orbit(object_centre, distance, azimuth, elevation, size, fov)
}

/// The same camera, zoomed in on an object until it fills 0.55 to 0.95 of the picture's side, mostly the latter: what a network
/// for pictures sees that knows where the object is. The object is in the middle, or beside it as far as there is room.
///
/// As it was if nothing is visible.
#[must_use]
pub fn close_up(
    camera: &Camera,
    object: &Object,
    world_from_links: &[Isometry3<f32>],
    rng: &mut impl Rng,
) -> Camera {
    let Some((min, max)) = outline(camera, object, world_from_links) else { return *camera };
    let extent = (max - min).max();
    let side = extent * LEAST_MARGIN * MOST_ZOOMED_OUT.powf(rng.random::<f32>().powi(3));
    let mut corner = |min: f32, max: f32| {
        let room = 0.5 * (side - (max - min));
        0.5 * (min + max - side) + OFF_CENTRE * room * rng.random_range(-1.0f32..1.0)
    };
    let (left, top) = (corner(min.x, max.x), corner(min.y, max.y));
    let zoom = camera.size.width as f32 / side;
    let Intrinsics { fx, fy, cx, cy } = camera.intrinsics;
    let intrinsics =
        Intrinsics { fx: fx * zoom, fy: fy * zoom, cx: (cx - left) * zoom, cy: (cy - top) * zoom };
    Camera { intrinsics, ..*camera }
}

/// Corners of the rectangle around everything visible of an object, in the camera's pixels. `None` if nothing is before it.
fn outline(
    camera: &Camera,
    object: &Object,
    world_from_links: &[Isometry3<f32>],
) -> Option<(Point2<f32>, Point2<f32>)> {
    let camera_from_world = camera.camera_from_world();
    let mut min = Point2::new(f32::INFINITY, f32::INFINITY);
    let mut max = -min;
    for (link, pose) in object.links.iter().zip(world_from_links) {
        let camera_from_link = camera_from_world * pose;
        for point in link.visuals.iter().flat_map(|v| &v.mesh.positions) {
            let Some((x, y)) = camera.intrinsics.project(&(camera_from_link * point)) else { continue };
            min = min.inf(&Point2::new(x, y));
            max = max.sup(&Point2::new(x, y));
        }
    }
    ((max - min).max() > 0.0).then_some((min, max))
}

/// Corners of the box around everything visible of an object, in the world. The origin if nothing is visible.
#[must_use]
pub fn visible_bounds(object: &Object, world_from_links: &[Isometry3<f32>]) -> (Point3<f32>, Point3<f32>) {
    let mut min = Point3::new(f32::INFINITY, f32::INFINITY, f32::INFINITY);
    let mut max = -min;
    for (link, pose) in object.links.iter().zip(world_from_links) {
        for point in link.visuals.iter().flat_map(|v| &v.mesh.positions) {
            let point = pose * point;
            min = min.inf(&point);
            max = max.sup(&point);
        }
    }
    if min.x <= max.x { (min, max) } else { (Point3::origin(), Point3::origin()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_core::Seed;

    #[test]
    fn close_ups_hold_the_whole_object_and_little_else() {
        let object = crate::object::open("Microwave:3").unwrap();
        let poses = object.world_from_links(&vec![0.0; object.links.len() - 1]);
        let mut extents = Vec::new();
        for seed in 0..50 {
            let rng = &mut Seed(seed).rng();
            let camera = sample_camera(Point3::origin(), rng, seed % 2 == 0);
            let close = close_up(&camera, &object, &poses, rng);
            assert_eq!((close.size, close.world_from_camera), (camera.size, camera.world_from_camera));
            let (min, max) = outline(&close, &object, &poses).unwrap();
            assert!(min.x > 0.0 && min.y > 0.0 && max.x < 448.0 && max.y < 448.0, "{min} {max}");
            extents.push((max - min).max() / 448.0);
        }
        extents.sort_by(f32::total_cmp);
        assert!(extents[0] > 0.55 && extents[25] > 0.8 && extents[49] < 0.953, "{extents:?}");
        assert!(extents[0] < 0.7, "{extents:?}");
    }

    #[test]
    fn however_a_camera_is_held_its_target_is_in_the_middle() {
        let target = Point3::new(0.3, -0.2, 0.4);
        let size = ImageSize::square(448);
        let straight = Camera::orbit(target, 5.0, 0.7, 0.6, size, Camera::PUBLISHED_FOV);
        for held in [Held { roll: 15.0, beside: 0.0 }, Held { roll: -8.0, beside: 30.0 }, Held::default()] {
            let camera = held.hold(&straight, &target);
            assert_eq!(
                held.straight(),
                (camera.world_from_camera.rotation == straight.world_from_camera.rotation)
            );
            assert_eq!(camera.world_from_camera.translation, straight.world_from_camera.translation);
            let seen = camera.camera_from_world() * target;
            let (x, y) = camera.intrinsics.project(&seen).unwrap();
            assert!((x - 224.0).abs() < 0.01 && (y - 224.0).abs() < 0.01, "{x} {y}");
            assert!((seen.coords.norm() - 5.0).abs() < 1e-4);
            let off = (seen.x.hypot(seen.y) / seen.z).atan().to_degrees();
            assert!((off - held.beside).abs() < 0.01, "{off}");
            // As far away as the target something is no larger than before.
            let [before, now] = [&straight, &camera].map(|camera| {
                let at = |offset| {
                    camera.intrinsics.project(&(camera.camera_from_world() * (target + offset))).unwrap()
                };
                let ((x0, y0), (x1, y1)) = (at(Vector3::z() * 0.1), at(-Vector3::z() * 0.1));
                (x1 - x0).hypot(y1 - y0)
            });
            assert!(now < 1.01 * before && now > 0.8 * before, "{now} {before}");
        }
    }

    #[test]
    fn the_object_stays_in_the_picture() {
        let mut rng = Seed(3).rng();
        for wide in [false, true] {
            for _ in 0..500 {
                let centre = Point3::new(0.1, -0.2, 0.3);
                let camera = sample_camera(centre, &mut rng, wide);
                let c = camera.camera_from_world() * centre;
                assert!(c.xy().coords.norm() < 1e-3 && (3.5..=7.0).contains(&c.z), "{c}");
                let half_fov = (0.5 * camera.size.height as f32 / camera.intrinsics.fy).atan();
                assert!((OBJECT_RADIUS / c.z).asin() <= half_fov + 1e-4);
                let up = camera.world_from_camera.translation.vector - centre.coords;
                let elevation = (up.z / up.norm()).asin().to_degrees();
                let range = if wide { 4.9..70.1 } else { 29.9..60.1 };
                assert!(range.contains(&elevation), "{elevation}");
            }
        }
    }
}
