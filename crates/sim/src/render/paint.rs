//! Materials as shading uses them: linear colours, textures, repainting.

use std::sync::Arc;

use image::RgbImage;
use nalgebra::Vector3;
use rand::RngExt;
use where2act_core::Seed;

use super::pattern::{Grain, floor, random_colour};
use super::sensor::{decoder, linear};
use super::timber::Timber;
use crate::object::Material;

/// A [`Material`] ready for shading.
pub(super) struct Paint {
    colour: Vector3<f32>,
    texture: Option<Arc<RgbImage>>,
    grain: Option<Grain>,
    pub(super) specular: f32,
    pub(super) shininess: f32,
    pub(super) opacity: f32,
}

impl Paint {
    pub(super) fn new(material: &Material) -> Self {
        Self {
            colour: Vector3::from(material.colour.map(linear)),
            texture: material.texture.clone().filter(|t| t.width() > 0 && t.height() > 0),
            grain: None,
            specular: material.specular,
            shininess: material.shininess.max(1.0),
            opacity: material.opacity.clamp(0.0, 1.0),
        }
    }

    /// The same surface in other colours: most solid materials change, textures stay or go, some get a grain. Those of
    /// wooden objects mostly become boards.
    pub(super) fn repainted(material: &Material, timber: Option<&Timber>, seed: Seed) -> Self {
        let rng = &mut seed.rng();
        let mut paint = Self::new(material);
        if paint.opacity < 1.0 {
            return paint;
        }
        if paint.texture.is_some() {
            if rng.random_bool(0.4) {
                paint.texture = None;
                paint.colour = Vector3::from(random_colour(rng).map(linear));
            } else if rng.random_bool(0.5) {
                let tint: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.5..1.1));
                paint.colour = paint.colour.component_mul(&Vector3::from(tint));
            }
        } else if rng.random_bool(0.75) {
            paint.colour = Vector3::from(random_colour(rng).map(linear));
        }
        if paint.texture.is_none() && rng.random_bool(0.4) {
            paint.grain = Some(Grain::random(rng));
        }
        if let Some(board) = timber.and_then(|timber| timber.board(seed.child("board", 0))) {
            (paint.texture, paint.grain) = (Some(board), None);
            paint.colour = Vector3::repeat(1.0);
        }
        if rng.random_bool(0.5) {
            paint.specular = rng.random_range(0.0..0.6f32).powi(2) * 2.0;
            paint.shininess = rng.random_range(4.0..80.0);
        }
        paint
    }

    /// Whether the colour is the same everywhere.
    pub(super) fn is_even(&self) -> bool {
        self.texture.is_none() && self.grain.is_none()
    }

    /// The texture around (u, v), v upwards, repeating; nothing without a texture.
    pub(super) fn texels(&self, uv: [f32; 2]) -> Texels {
        self.texture.as_ref().map_or(Texels::default(), |texture| Texels::new(texture, uv))
    }

    /// Linear colour where the texture is `texels`, at a point in the mesh frame.
    pub(super) fn albedo(&self, texels: &Texels, point: impl FnOnce() -> Vector3<f32>) -> Vector3<f32> {
        let mut albedo = self.colour;
        if self.texture.is_some() {
            albedo.component_mul_assign(&texels.blended());
        }
        if let Some(grain) = &self.grain {
            albedo *= grain.at(&point());
        }
        albedo
    }
}

/// Four neighbours in a texture. Reading and using them apart, several at a time, hides how far memory is.
#[derive(Clone, Copy, Default)]
pub(super) struct Texels {
    /// Upper left and right, lower left and right.
    codes: [[u8; 3]; 4],
    /// Where between them the point is, from the upper left one on.
    right: f32,
    down: f32,
}

impl Texels {
    fn new(texture: &RgbImage, [u, v]: [f32; 2]) -> Self {
        let (w, h) = (texture.width() as usize, texture.height() as usize);
        let along = |t: f32, n: usize| {
            let x = (t - floor(t)) * n as f32 - 0.5;
            let low = floor(x);
            // From -1 to n - 1.
            let first = if low < 0.0 { n - 1 } else { (low as usize).min(n - 1) };
            (first, if first + 1 == n { 0 } else { first + 1 }, x - low)
        };
        let (x0, x1, right) = along(u, w);
        let (y0, y1, down) = along(1.0 - v, h);
        let (texels, _) = texture.as_raw().as_chunks();
        let codes = [texels[y0 * w + x0], texels[y0 * w + x1], texels[y1 * w + x0], texels[y1 * w + x1]];
        Self { codes, right, down }
    }

    /// Their colour at the point, in linear light.
    fn blended(&self) -> Vector3<f32> {
        let linear = decoder();
        let light = |[r, g, b]: [u8; 3]| {
            Vector3::new(linear[usize::from(r)], linear[usize::from(g)], linear[usize::from(b)])
        };
        let [a, b, c, d] = self.codes;
        let top = light(a).lerp(&light(b), self.right);
        let bottom = light(c).lerp(&light(d), self.right);
        top.lerp(&bottom, self.down)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_are_upright_repeat_and_blend() {
        let mut texture = RgbImage::new(2, 2);
        texture.put_pixel(0, 0, image::Rgb([255, 0, 0])); // top left: u = 0.25, v = 0.75
        texture.put_pixel(1, 1, image::Rgb([0, 0, 255])); // bottom right: u = 0.75, v = 0.25
        let at = |uv| Texels::new(&texture, uv).blended();
        assert_eq!(at([0.25, 0.75]), Vector3::new(1.0, 0.0, 0.0));
        assert_eq!(at([0.75, 0.25]), Vector3::new(0.0, 0.0, 1.0));
        assert_eq!(at([-2.25, 3.25]), Vector3::new(0.0, 0.0, 1.0));
        assert_eq!(at([0.5, 0.5]), Vector3::new(0.25, 0.0, 0.25));
        assert!(at([f32::NAN, f32::INFINITY]).iter().all(|c| c.is_nan() || *c >= 0.0));
    }
}
