//! Pinhole cameras in the optical convention.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Width and height of a picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ImageSize {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl ImageSize {
    /// A square picture.
    #[must_use]
    pub const fn square(side: usize) -> Self {
        Self { width: side, height: side }
    }

    /// Number of pixels.
    #[must_use]
    pub const fn pixels(self) -> usize {
        self.width * self.height
    }

    /// Row-major index of a pixel.
    #[must_use]
    pub const fn index(self, pixel: Pixel) -> usize {
        pixel.v as usize * self.width + pixel.u as usize
    }
}

/// A pixel: `u` counts columns from the left, `v` rows from the top; its centre is at (u + 0.5, v + 0.5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Pixel {
    /// Column.
    pub u: u32,
    /// Row.
    pub v: u32,
}

/// Focal lengths and principal point, in pixels of a picture whose corner is at (0, 0): centres of pixels are at + 0.5. In
/// OpenCV and ROS they are at whole numbers; add 0.5 to `cx` and `cy` of a camera that was calibrated there.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Horizontal focal length.
    pub fx: f32,
    /// Vertical focal length.
    pub fy: f32,
    /// Principal point, horizontal.
    pub cx: f32,
    /// Principal point, vertical.
    pub cy: f32,
}

impl Intrinsics {
    /// Square pixels, principal point in the middle, `vertical_fov` in radians.
    #[must_use]
    pub fn from_fov(size: ImageSize, vertical_fov: f32) -> Self {
        let f = 0.5 * size.height as f32 / (0.5 * vertical_fov).tan();
        Self { fx: f, fy: f, cx: 0.5 * size.width as f32, cy: 0.5 * size.height as f32 }
    }

    /// Whether these are of a camera: finite, with positive focal lengths.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let Self { fx, fy, cx, cy } = *self;
        [fx, fy, cx, cy].into_iter().all(f32::is_finite) && fx > 0.0 && fy > 0.0
    }

    /// The point in the camera frame seen at picture coordinates (x, y) with `depth` along z, in metres.
    #[must_use]
    pub fn back_project(&self, x: f32, y: f32, depth: f32) -> Point3<f32> {
        Point3::new((x - self.cx) / self.fx * depth, (y - self.cy) / self.fy * depth, depth)
    }

    /// [`Self::back_project`] for the centre of a pixel.
    #[must_use]
    pub fn pixel_to_point(&self, pixel: Pixel, depth: f32) -> Point3<f32> {
        self.back_project(pixel.u as f32 + 0.5, pixel.v as f32 + 0.5, depth)
    }

    /// Picture coordinates of a point in the camera frame; `None` behind the camera.
    #[must_use]
    pub fn project(&self, point_in_camera: &Point3<f32>) -> Option<(f32, f32)> {
        let p = point_in_camera;
        (p.z > 0.0).then(|| (self.fx * p.x / p.z + self.cx, self.fy * p.y / p.z + self.cy))
    }

    /// Intrinsics of the same picture resized by (`sx`, `sy`).
    #[must_use]
    pub fn scaled(&self, sx: f32, sy: f32) -> Self {
        Self { fx: self.fx * sx, fy: self.fy * sy, cx: self.cx * sx, cy: self.cy * sy }
    }
}

/// A camera in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Picture size.
    pub size: ImageSize,
    /// Focal lengths and principal point for that size.
    pub intrinsics: Intrinsics,
    /// Optical frame to world.
    pub world_from_camera: Isometry3<f32>,
}

impl Camera {
    /// Side of the published pictures, in pixels (supplement, section B).
    pub const PUBLISHED_SIDE: usize = 448;
    /// Published vertical field of view: 35 degrees (supplement, section B).
    pub const PUBLISHED_FOV: f32 = 35.0 * std::f32::consts::PI / 180.0;
    /// Published near plane in metres (supplement, section B).
    pub const NEAR: f32 = 0.1;
    /// Published distance to the object's centre in metres.
    pub const PUBLISHED_DISTANCE: f32 = 5.0;

    /// A camera at `eye` that looks at `target` with the world's z axis upwards in the picture.
    #[must_use]
    pub fn look_at(eye: Point3<f32>, target: Point3<f32>, size: ImageSize, vertical_fov: f32) -> Self {
        let forward = (target - eye).try_normalize(1e-9).unwrap_or(Vector3::x());
        let right = forward.cross(&Vector3::z()).try_normalize(1e-6).unwrap_or(Vector3::y());
        let down = forward.cross(&right);
        let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
        let world_from_camera =
            Isometry3::from_parts(Translation3::from(eye), UnitQuaternion::from_rotation_matrix(&rotation));
        Self { size, intrinsics: Intrinsics::from_fov(size, vertical_fov), world_from_camera }
    }

    /// A camera on a sphere around `target`: azimuth from the world's x axis, elevation above the horizon.
    #[must_use]
    pub fn orbit(
        target: Point3<f32>,
        distance: f32,
        azimuth: f32,
        elevation: f32,
        size: ImageSize,
        vertical_fov: f32,
    ) -> Self {
        let direction =
            Vector3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        Self::look_at(target + distance * direction, target, size, vertical_fov)
    }

    /// World to optical frame.
    #[must_use]
    pub fn camera_from_world(&self) -> Isometry3<f32> {
        self.world_from_camera.inverse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_is_in_the_middle_and_up_is_up() {
        let size = ImageSize::square(448);
        let camera = Camera::orbit(Point3::origin(), 5.0, 0.7, 0.5, size, Camera::PUBLISHED_FOV);
        let target = camera.camera_from_world() * Point3::origin();
        assert!((target - Point3::new(0.0, 0.0, 5.0)).norm() < 1e-5);
        let above = camera.camera_from_world() * Point3::new(0.0, 0.0, 0.5);
        let (x, y) = camera.intrinsics.project(&above).unwrap();
        assert!((x - 224.0).abs() < 1e-3 && y < 224.0);
        assert!(
            (camera.world_from_camera.rotation.to_rotation_matrix().matrix().determinant() - 1.0).abs()
                < 1e-5
        );
    }

    #[test]
    fn projection_undoes_back_projection() {
        let intrinsics = Intrinsics::from_fov(ImageSize { width: 640, height: 480 }, 0.8);
        let pixel = Pixel { u: 17, v: 301 };
        let (x, y) = intrinsics.project(&intrinsics.pixel_to_point(pixel, 2.5)).unwrap();
        assert!((x - 17.5).abs() < 1e-3 && (y - 301.5).abs() < 1e-3);
    }
}
