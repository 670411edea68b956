//! What is done to an observation before a network sees it: the same in training and in prediction.

mod cloud;
mod image;
mod resize;
mod roll;
mod window;

pub use cloud::{CloudInput, CloudScale};
pub use image::{ImageInput, Letterbox};
pub use roll::Roll;
pub use window::Window;

use where2act_core::ImageSize;

/// Why an observation cannot be shown to a network.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PreprocessError {
    /// A buffer has not the size of the picture.
    #[error("{buffer} holds {found} pixels, expected {expected} (width times height)")]
    Size {
        /// Which one.
        buffer: &'static str,
        /// Width times height.
        expected: usize,
        /// What is there.
        found: usize,
    },
    /// The picture has no pixels.
    #[error("the picture is empty")]
    EmptyImage,
    /// No point was [measured](where2act_core::is_measured) and, where there is a mask, is inside it.
    #[error("no finite point on the object")]
    NoPoints,
    /// All points are in one place.
    #[error("all {0} points are in one place")]
    OnePlace(usize),
}

impl PreprocessError {
    /// Compares the size of a buffer with that of the picture.
    fn check_size(buffer: &'static str, size: ImageSize, found: usize) -> Result<(), Self> {
        let expected = size.pixels();
        if found == expected { Ok(()) } else { Err(Self::Size { buffer, expected, found }) }
    }
}
