//! Pictures by cameras that are not upright.

use where2act_core::ImageSize;

/// How far the camera of a picture is rolled about its axis, clockwise for who stands behind it. Such a picture is turned back by as
/// much before a network sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roll {
    sin: f64,
    cos: f64,
}

impl Roll {
    /// Of a camera that is held upright.
    pub const NONE: Self = Self { sin: 0.0, cos: 1.0 };

    /// By an angle, radians.
    #[must_use]
    pub fn new(angle: f32) -> Self {
        let (sin, cos) = f64::from(angle).sin_cos();
        Self { sin, cos }
    }

    /// Size of a picture that is turned back: all of it fits.
    #[must_use]
    pub fn size(self, size: ImageSize) -> ImageSize {
        let [sin, cos] = [self.sin, self.cos].map(f64::abs);
        let (width, height) = (size.width as f64, size.height as f64);
        let length = |x: f64| (x.round() as usize).max(1);
        ImageSize { width: length(width * cos + height * sin), height: length(width * sin + height * cos) }
    }

    /// Where a position of a picture of this size is when it is turned back.
    #[must_use]
    pub fn turn_back(self, place: [f64; 2], size: ImageSize) -> [f64; 2] {
        Self { sin: -self.sin, cos: self.cos }.about_middles(place, size, self.size(size))
    }

    /// Where a position of the picture that was turned back is in the picture of this size.
    #[must_use]
    pub fn turn(self, place: [f64; 2], size: ImageSize) -> [f64; 2] {
        self.about_middles(place, self.size(size), size)
    }

    fn about_middles(self, [x, y]: [f64; 2], from: ImageSize, to: ImageSize) -> [f64; 2] {
        let middle = |length: usize| 0.5 * length as f64;
        let (x, y) = (x - middle(from.width), y - middle(from.height));
        let Self { sin, cos } = self;
        [middle(to.width) + x * cos - y * sin, middle(to.height) + x * sin + y * cos]
    }
}
