//! What a rendered view holds.

use image::{Rgb, RgbImage, imageops};
use nalgebra::{Point3, Vector3};
use where2act_core::{Camera, Observation, Pixel};

/// A picture with everything known about it. Buffers are row-major, `[height * width]`.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Who sees it.
    pub camera: Camera,
    /// Colours, sRGB, anti-aliased.
    pub rgb: Vec<[u8; 3]>,
    /// Depth along the optical axis at pixel centres, metres; 0 = background.
    pub depth: Vec<f32>,
    /// Unit normals of the triangles at pixel centres, in the world, on the camera's side; zero = background.
    pub normals_in_world: Vec<Vector3<f32>>,
    /// Link ids at pixel centres: 0 = background, else 1 + index of the link.
    pub link: Vec<u8>,
}

impl View {
    /// A view of nothing in one colour; without pixels of colour if there is none, which is for the caller to fill in.
    pub(super) fn empty(camera: Camera, colour: Option<[u8; 3]>) -> Self {
        let pixels = camera.size.pixels();
        Self {
            camera,
            rgb: colour.map_or(Vec::new(), |colour| vec![colour; pixels]),
            depth: vec![0.0; pixels],
            normals_in_world: vec![Vector3::zeros(); pixels],
            link: vec![0; pixels],
        }
    }

    /// Row-major index of a pixel; `None` outside of the picture.
    fn index(&self, pixel: Pixel) -> Option<usize> {
        let size = self.camera.size;
        let inside = (pixel.u as usize) < size.width && (pixel.v as usize) < size.height;
        inside.then(|| size.index(pixel))
    }

    /// The point in the world seen at the centre of a pixel; `None` for background and outside of the picture.
    #[must_use]
    pub fn point_in_world(&self, pixel: Pixel) -> Option<Point3<f32>> {
        let depth = *self.depth.get(self.index(pixel)?)?;
        let point = self.camera.intrinsics.pixel_to_point(pixel, depth);
        (depth > 0.0).then(|| self.camera.world_from_camera * point)
    }

    /// The point in the camera frame seen at the centre of pixel (u, v); `None` for background and outside of the picture.
    pub(super) fn point_in_camera(&self, u: isize, v: isize) -> Option<Point3<f32>> {
        let pixel = Pixel { u: u.try_into().ok()?, v: v.try_into().ok()? };
        let depth = self.depth[self.index(pixel)?];
        (depth > 0.0).then(|| self.camera.intrinsics.pixel_to_point(pixel, depth))
    }

    /// Whether a point in the world is more than `by` metres of depth behind what is seen before it.
    #[must_use]
    pub fn hides(&self, point_in_world: &Point3<f32>, by: f32) -> bool {
        let Camera { size, intrinsics, world_from_camera } = &self.camera;
        let point = world_from_camera.inverse_transform_point(point_in_world);
        let Some((x, y)) = intrinsics.project(&point) else { return false };
        if !(0.0..size.width as f32).contains(&x) || !(0.0..size.height as f32).contains(&y) {
            return false;
        }
        let depth = self.depth[size.index(Pixel { u: x as u32, v: y as u32 })];
        depth > 0.0 && point.z > depth + by
    }

    /// Unit normal of the surface seen at the centre of a pixel, on the camera's side; `None` for background and
    /// outside of the picture.
    #[must_use]
    pub fn normal_in_world(&self, pixel: Pixel) -> Option<Vector3<f32>> {
        let normal = *self.normals_in_world.get(self.index(pixel)?)?;
        (normal != Vector3::zeros()).then_some(normal)
    }

    /// Index of the link seen at the centre of a pixel; `None` for background and outside of the picture.
    #[must_use]
    pub fn link_at(&self, pixel: Pixel) -> Option<usize> {
        self.link.get(self.index(pixel)?)?.checked_sub(1).map(usize::from)
    }

    /// Pixels that show a movable link, in row-major order.
    #[must_use]
    pub fn movable_pixels(&self) -> Vec<Pixel> {
        let width = self.camera.size.width;
        let pixel = |i: usize| Pixel { u: (i % width) as u32, v: (i / width) as u32 };
        (0..self.link.len()).filter(|&i| self.link[i] > 1).map(pixel).collect()
    }

    /// What a network may see: colours, depth, and the object as mask.
    #[must_use]
    pub fn observation(&self) -> Observation {
        Observation::Image {
            size: self.camera.size,
            rgb: Some(self.rgb.clone()),
            depth: Some(self.depth.clone()),
            intrinsics: Some(self.camera.intrinsics),
            mask: Some(self.link.iter().map(|&l| l > 0).collect()),
        }
    }

    /// The colours as a picture.
    #[must_use]
    pub fn to_image(&self) -> RgbImage {
        let size = self.camera.size;
        RgbImage::from_fn(size.width as u32, size.height as u32, |u, v| {
            Rgb(self.rgb[size.index(Pixel { u, v })])
        })
    }

    /// The colours of a picture of `side` x `side` pixels: the mean of the pixels that fall on each where `side`
    /// divides the size, else filtered with a tent.
    #[must_use]
    pub fn rgb_at(&self, side: usize) -> Vec<[u8; 3]> {
        let size = self.camera.size;
        let n = size.width / side.max(1);
        if (size.width, size.height) == (n * side, n * side) && n > 0 {
            let count = (n * n) as u32;
            let mean = |i: usize| {
                let (left, top) = (i % side * n, i / side * n);
                let mut sum = [count / 2; 3];
                for row in top..top + n {
                    for pixel in &self.rgb[row * size.width + left..][..n] {
                        sum.iter_mut().zip(pixel).for_each(|(s, c)| *s += u32::from(*c));
                    }
                }
                sum.map(|s| (s / count) as u8)
            };
            return (0..side * side).map(mean).collect();
        }
        let resized =
            imageops::resize(&self.to_image(), side as u32, side as u32, imageops::FilterType::Triangle);
        resized.pixels().map(|p| p.0).collect()
    }
}
