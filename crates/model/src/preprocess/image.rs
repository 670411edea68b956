//! Pictures of any size to the square that the U-Net sees, and back.

use burn::tensor::{Device, Tensor, TensorData};
use where2act_core::{ImageSize, Pixel};

use super::PreprocessError;
use super::resize::resize;
use crate::config::Preprocessing;

/// How a picture lies in the network's square: scaled to fit, centred, bars on two sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Letterbox {
    /// Size of the picture.
    pub source: ImageSize,
    /// Side of the square.
    pub side: usize,
    /// Size of the picture inside the square.
    pub inner: ImageSize,
    /// Column and row of the square where the picture begins.
    pub offset: (usize, usize),
}

impl Letterbox {
    /// The largest centred fit that keeps the proportions, rounded to whole pixels.
    ///
    /// # Errors
    /// [`PreprocessError::EmptyImage`].
    pub fn new(source: ImageSize, side: usize) -> Result<Self, PreprocessError> {
        if source.pixels() == 0 || side == 0 {
            return Err(PreprocessError::EmptyImage);
        }
        let longer = source.width.max(source.height) as f64;
        let fit = |length: usize| ((length as f64 * side as f64 / longer).round() as usize).clamp(1, side);
        let inner = ImageSize { width: fit(source.width), height: fit(source.height) };
        Ok(Self { source, side, inner, offset: ((side - inner.width) / 2, (side - inner.height) / 2) })
    }

    /// Where a pixel of the picture lies in the square.
    #[must_use]
    pub fn to_network(&self, pixel: Pixel) -> Pixel {
        let along = |p: u32, from: usize, to: usize, offset: usize| {
            let inside = ((f64::from(p) + 0.5) * to as f64 / from as f64) as usize;
            (offset + inside.min(to - 1)) as u32
        };
        Pixel {
            u: along(pixel.u, self.source.width, self.inner.width, self.offset.0),
            v: along(pixel.v, self.source.height, self.inner.height, self.offset.1),
        }
    }

    /// The pixel of the picture in the middle of a pixel of the square; `None` on the bars.
    #[must_use]
    pub fn to_source(&self, pixel: Pixel) -> Option<Pixel> {
        let along = |p: u32, from: usize, to: usize, offset: usize| {
            let inside = (p as usize).checked_sub(offset).filter(|i| *i < to)?;
            Some((((inside as f64 + 0.5) * from as f64 / to as f64) as usize).min(from - 1) as u32)
        };
        Some(Pixel {
            u: along(pixel.u, self.source.width, self.inner.width, self.offset.0)?,
            v: along(pixel.v, self.source.height, self.inner.height, self.offset.1)?,
        })
    }

    /// Row-major index in the square of [`Self::to_network`]: what queries of the U-Net's features are made of.
    #[must_use]
    pub fn network_index(&self, pixel: Pixel) -> usize {
        ImageSize::square(self.side).index(self.to_network(pixel))
    }

    /// A map over the square, `[side * side]`, looked up for every pixel of the picture, `[height * width]`.
    #[must_use]
    pub fn map_to_source(&self, map: &[f32]) -> Vec<f32> {
        let (w, h) = (self.source.width as u32, self.source.height as u32);
        let columns: Vec<_> = (0..w).map(|u| self.to_network(Pixel { u, v: 0 }).u as usize).collect();
        let rows = (0..h).map(|v| self.to_network(Pixel { u: 0, v }).v as usize);
        rows.flat_map(|row| columns.iter().map(move |column| map[row * self.side + column])).collect()
    }
}

/// A picture as the U-Net sees it.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageInput {
    /// Normalised colours, `[3, side, side]`.
    pub values: Vec<f32>,
    /// Where the picture lies in them.
    pub letterbox: Letterbox,
}

impl ImageInput {
    /// Prepares sRGB colours `[height * width]`; a mask says which pixels belong to the object.
    ///
    /// # Errors
    /// [`PreprocessError::EmptyImage`], [`PreprocessError::Size`].
    pub fn new(
        size: ImageSize,
        rgb: &[[u8; 3]],
        mask: Option<&[bool]>,
        with: &Preprocessing,
    ) -> Result<Self, PreprocessError> {
        let letterbox = Letterbox::new(size, with.image_side)?;
        PreprocessError::check_size("the colour buffer", size, rgb.len())?;
        if let Some(mask) = mask {
            PreprocessError::check_size("the mask", size, mask.len())?;
        }
        let mask = mask.filter(|_| with.white_background);
        let background = if with.white_background { 1.0 } else { 0.0 };
        let (side, inner) = (with.image_side, letterbox.inner);
        let mut values = Vec::with_capacity(3 * side * side);
        for (channel, (mean, std)) in with.image_mean.iter().zip(with.image_std).enumerate() {
            let colour = |i: usize| match mask {
                Some(mask) if !mask[i] => 1.0,
                _ => f32::from(rgb[i][channel]) / 255.0,
            };
            let plane: Vec<f32> = (0..size.pixels()).map(colour).collect();
            let small = resize(&plane, size, inner);
            let normal = |x: f32| (x - mean) / std;
            let start = values.len();
            values.resize(start + side * side, normal(background));
            for (row, line) in small.chunks_exact(inner.width).enumerate() {
                let first = start + (letterbox.offset.1 + row) * side + letterbox.offset.0;
                for (x, to) in line.iter().zip(&mut values[first..first + inner.width]) {
                    *to = normal(*x);
                }
            }
        }
        Ok(Self { values, letterbox })
    }

    /// A batch.
    ///
    /// # Shapes
    /// b inputs -> `[b, 3, side, side]`
    #[must_use]
    pub fn batch(inputs: &[Self], device: &Device) -> Tensor<4> {
        let side = inputs.first().map_or(0, |input| input.letterbox.side);
        let values: Vec<f32> = inputs.iter().flat_map(|input| input.values.iter().copied()).collect();
        Tensor::from_data(TensorData::new(values, [inputs.len(), 3, side, side]), device)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn every_pixel_of_the_square_comes_from_where_it_goes(w in 1usize..700, h in 1usize..700, s in 1usize..8) {
            let letterbox = Letterbox::new(ImageSize { width: w, height: h }, 32 * s).unwrap();
            for v in 0..letterbox.side as u32 {
                for u in [0, letterbox.side as u32 / 2, letterbox.side as u32 - 1] {
                    let Some(source) = letterbox.to_source(Pixel { u, v }) else { continue };
                    prop_assert!((source.u as usize) < w && (source.v as usize) < h);
                    let back = letterbox.to_network(source);
                    // Where the picture is enlarged several pixels of the square share one of the picture.
                    let off = (32 * s) as f32 / w.max(h) as f32;
                    prop_assert!((back.u as f32 - u as f32).abs() <= off && (back.v as f32 - v as f32).abs() <= off);
                }
            }
        }
    }

    #[test]
    fn a_wide_picture_has_white_bars_and_keeps_its_colours() {
        let size = ImageSize { width: 8, height: 4 };
        let rgb: Vec<[u8; 3]> = (0..32).map(|i| if i % 8 < 4 { [255, 0, 0] } else { [0, 0, 255] }).collect();
        let plain =
            Preprocessing { image_side: 32, image_mean: [0.0; 3], image_std: [1.0; 3], ..Default::default() };
        let input = ImageInput::new(size, &rgb, None, &plain).unwrap();
        let at = |c: usize, u: usize, v: usize| input.values[c * 1024 + v * 32 + u];
        assert_eq!([at(0, 3, 2), at(1, 3, 2), at(2, 3, 2)], [1.0, 1.0, 1.0]);
        assert_eq!([at(0, 3, 16), at(1, 3, 16), at(2, 3, 16)], [1.0, 0.0, 0.0]);
        assert_eq!([at(0, 30, 16), at(1, 30, 16), at(2, 30, 16)], [0.0, 0.0, 1.0]);
        let masked = ImageInput::new(size, &rgb, Some(&[false; 32]), &plain).unwrap();
        assert!(masked.values.iter().all(|x| *x == 1.0));
        let map: Vec<f32> = (0..1024).map(|i| (i % 32) as f32).collect();
        assert_eq!(input.letterbox.map_to_source(&map)[..8], [2.0, 6.0, 10.0, 14.0, 18.0, 22.0, 26.0, 30.0]);
    }

    #[test]
    fn buffers_of_the_wrong_size_are_named() {
        let size = ImageSize { width: 8, height: 4 };
        let error = ImageInput::new(size, &[[0; 3]; 31], None, &Preprocessing::default()).unwrap_err();
        assert_eq!(error.to_string(), "the colour buffer holds 31 pixels, expected 32 (width times height)");
        let empty = ImageSize { width: 0, height: 4 };
        assert_eq!(
            ImageInput::new(empty, &[], None, &Preprocessing::default()),
            Err(PreprocessError::EmptyImage)
        );
    }
}
