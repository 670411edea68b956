//! A scene: one view of one settled object, and the trials made on it.

use nalgebra::{Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use super::{DEPTH_SIDE, DEPTH_UNIT};
use crate::{Camera, Category, Pixel, Seed, Trial};

/// Who a scene is, for splitting and for repeating it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneInfo {
    /// Number of the scene in its data set.
    pub index: u64,
    /// Seed of the scene: everything random in it derives from it.
    pub seed: Seed,
    /// Name of the object, unique in the data set; splits go by it.
    pub object: String,
    /// Category of the object, if known.
    pub category: Option<Category>,
    /// Settled joint positions, one per movable link.
    pub q: Vec<f32>,
    /// How each movable link can move from there; empty in data that was collected before this was written down.
    #[serde(default)]
    pub freedoms: Vec<Freedom>,
}

/// How a movable link can move from where it stands, seen from the scene's camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Freedom {
    /// Whether it turns about its axis or slides along it.
    pub turns: bool,
    /// Axis of its joint, camera frame.
    pub axis: Unit<Vector3<f32>>,
    /// A point on the axis, camera frame, metres.
    pub point: Point3<f32>,
    /// How far its position can fall and rise, radians or metres.
    pub room: [f32; 2],
}

impl Freedom {
    /// How fast a point of the link moves when its joint's position rises by 1 rad or 1 m a second: metres a second,
    /// camera frame.
    #[must_use]
    pub fn velocity(&self, point: &Point3<f32>) -> Vector3<f32> {
        if self.turns { self.axis.cross(&(point - self.point)) } else { self.axis.into_inner() }
    }
}

/// One view of one settled object and its trials.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneRecord {
    /// Who it is.
    pub info: SceneInfo,
    /// The camera of the 448 picture.
    pub camera: Camera,
    /// Colours, sRGB, of a square picture: see [`Self::rgb_side`].
    pub rgb: Vec<[u8; 3]>,
    /// Depth at 448x448 in [`DEPTH_UNIT`]; 0 = background.
    pub depth: Vec<u16>,
    /// Link ids at 448x448: 0 = background, else 1 + index of the link.
    pub link: Vec<u8>,
    /// Trials on this view.
    pub trials: Vec<Trial>,
}

impl SceneRecord {
    /// Pixels of the depth map that show the object, row by row, with their points in the camera frame.
    #[must_use]
    pub fn foreground(&self) -> Vec<(Pixel, Point3<f32>)> {
        foreground(&self.camera, &self.depth)
    }

    /// Width and height of the picture.
    #[must_use]
    pub fn rgb_side(&self) -> usize {
        self.rgb.len().isqrt()
    }

    /// Metres to stored units; anything not representable becomes background.
    #[must_use]
    pub fn quantise_depth(metres: f32) -> u16 {
        let units = (metres / DEPTH_UNIT).round();
        if units >= 1.0 && units <= f32::from(u16::MAX) { units as u16 } else { 0 }
    }
}

/// Refuses pictures whose pixels do not each show as many whole ones of the depth map.
pub(super) fn check_rgb_side(side: usize) -> Result<(), String> {
    if side > 0 && DEPTH_SIDE.is_multiple_of(side) {
        Ok(())
    } else {
        Err(format!("pictures of {side} pixels a side, expected {DEPTH_SIDE} or what divides it"))
    }
}

/// Refuses a camera that no scene has.
pub(super) fn check_camera(camera: &Camera) -> Result<(), String> {
    let pose = &camera.world_from_camera;
    let somewhere = pose.translation.vector.iter().all(|x| x.is_finite());
    let turned = (pose.rotation.quaternion().norm() - 1.0).abs() < 1e-3;
    if camera.intrinsics.is_sound() && somewhere && turned {
        Ok(())
    } else {
        Err(format!("{camera:?}, expected finite numbers, positive focal lengths and a rotation"))
    }
}

/// Pixels that show the object, row by row, with their points in the camera frame.
pub(super) fn foreground(camera: &Camera, depth: &[u16]) -> Vec<(Pixel, Point3<f32>)> {
    let seen = depth.iter().enumerate().filter(|(_, depth)| **depth > 0);
    seen.map(|(i, depth)| {
        let pixel = Pixel { u: (i % DEPTH_SIDE) as u32, v: (i / DEPTH_SIDE) as u32 };
        (pixel, camera.intrinsics.pixel_to_point(pixel, f32::from(*depth) * DEPTH_UNIT))
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_door_moves_across_its_radius_and_a_drawer_along_its_axis() {
        let axis = Vector3::z_axis();
        let door = Freedom { turns: true, axis, point: Point3::new(1.0, 0.0, 5.0), room: [0.0, 1.5] };
        assert_eq!(door.velocity(&Point3::new(1.5, 0.0, 0.0)), Vector3::new(0.0, 0.5, 0.0));
        let drawer = Freedom { turns: false, ..door };
        assert_eq!(drawer.velocity(&Point3::new(1.5, 0.0, 0.0)), Vector3::z());
    }
}
