//! Where cameras stand.

use std::f32::consts::{PI, TAU};

use nalgebra::{Isometry3, Point3};
use rand::{Rng, RngExt};
use where2act_core::{Camera, ImageSize};

use crate::object::Object;

/// Radius of the sphere that holds every object, with a margin, metres: wide cameras keep it in the picture.
const OBJECT_RADIUS: f32 = 1.1;

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
