//! Feature maps in blocks of 16 channels.

use crate::{AlignedBuf, ShapeError};

/// A batch of feature maps `[images][channels / 16][height][width][16]`.
///
/// The 16 channels of a pixel are one cache line. Channels beyond `channels` in the last block may hold
/// anything that is a number: no result depends on them, but bf16 multiplies the one after an odd number by zero. One line of padding separates the planes, so that planes whose size is a
/// power of two do not compete for the same cache sets.
#[derive(Clone, Default)]
pub struct Blocked {
    data: AlignedBuf,
    images: usize,
    channels: usize,
    height: usize,
    width: usize,
}

impl Blocked {
    /// Maps of the given shape, all zero.
    ///
    /// # Panics
    /// As [`Self::reshape`].
    pub fn zeros(images: usize, channels: usize, height: usize, width: usize) -> Self {
        let mut maps = Self::default();
        maps.reshape(images, channels, height, width);
        maps
    }

    /// Changes the shape, keeping the memory where it suffices. The values are then unspecified.
    ///
    /// # Panics
    /// When no memory could hold so many values.
    pub fn reshape(&mut self, images: usize, channels: usize, height: usize, width: usize) {
        // Twice the values of each plane, which ends with a block that is none of its pixels.
        let sizes = [images, channels.div_ceil(16), height.max(1), width.max(1), 32];
        ShapeError::product("values of maps", &sizes).unwrap_or_else(|error| panic!("{error}"));
        (self.images, self.channels, self.height, self.width) = (images, channels, height, width);
        self.data.resize(self.images * self.image_len());
    }

    /// Maps from values `[images, channels, height, width]`.
    ///
    /// # Errors
    /// When `values` has another length.
    ///
    /// # Panics
    /// As [`Self::reshape`].
    pub fn from_nchw(
        values: &[f32],
        images: usize,
        channels: usize,
        height: usize,
        width: usize,
    ) -> Result<Self, ShapeError> {
        let count = ShapeError::product("values of the maps", &[images, channels, height, width])?;
        ShapeError::check("values of the maps", count, values.len())?;
        let mut maps = Self::zeros(images, channels, height, width);
        for (plane, values) in values.chunks_exact((height * width).max(1)).enumerate() {
            let (image, c) = (plane / channels, plane % channels);
            let at = image * maps.image_len() + c / 16 * maps.plane_len() + c % 16;
            for (pixel, value) in values.iter().enumerate() {
                maps.data[at + pixel * 16] = *value;
            }
        }
        Ok(maps)
    }

    /// The values as `[images, channels, height, width]`.
    pub fn to_nchw(&self) -> Vec<f32> {
        let mut values = Vec::with_capacity(self.images * self.channels * self.height * self.width);
        for image in 0..self.images {
            for c in 0..self.channels {
                let at = image * self.image_len() + c / 16 * self.plane_len() + c % 16;
                values.extend((0..self.height * self.width).map(|pixel| self.data[at + pixel * 16]));
            }
        }
        values
    }

    /// Number of maps in the batch.
    pub fn images(&self) -> usize {
        self.images
    }
    /// Channels of each map.
    pub fn channels(&self) -> usize {
        self.channels
    }
    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }
    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Blocks of 16 channels.
    pub(crate) fn blocks(&self) -> usize {
        self.channels.div_ceil(16)
    }
    /// Values from one block of channels to the next.
    pub(crate) fn plane_len(&self) -> usize {
        self.height * self.width * 16 + 16
    }
    /// Values from one image to the next.
    pub(crate) fn image_len(&self) -> usize {
        self.blocks() * self.plane_len()
    }
    pub(crate) fn data(&self) -> &[f32] {
        &self.data
    }
    pub(crate) fn data_mut(&mut self) -> &mut [f32] {
        &mut self.data
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nchw_round_trip() {
        let values: Vec<f32> = (0..2 * 19 * 3 * 5).map(|i| i as f32).collect();
        let maps = Blocked::from_nchw(&values, 2, 19, 3, 5).unwrap();
        assert_eq!(maps.to_nchw(), values);
        assert_eq!(maps.blocks(), 2);
        assert!(Blocked::from_nchw(&values, 2, 19, 3, 6).is_err());
    }
}
