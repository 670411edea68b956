//! Pictures, depth maps and masks.

use std::io::Cursor;

use exif::{In, Tag};
use image::metadata::Orientation;
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use where2act_core::{ImageSize, Intrinsics};

use super::npy::parse_npy;
use crate::Malformed;

/// Most pixels a picture may have: 16 bits of four channels of so many take 800 MB.
pub const MAX_PIXELS: u64 = 100_000_000;
/// What a sensor writes into 16 bits where it measures nothing, or more than they hold.
const SATURATED: f32 = u16::MAX as f32;
/// Longest side of a picture, pixels.
const MAX_SIDE: u32 = 65_535;
/// Diagonal of a picture on 35 mm film, of 36 by 24 mm.
const FILM_DIAGONAL: f32 = 43.27;
/// A picture whose proportions differ by more than this share from those in its EXIF block was cut out of a larger one, or turned by
/// a program that left the block as it was.
const SAME_PROPORTIONS: f32 = 0.01;
/// Lenses that see straight lines as such are not much shorter, millimetres as for 35 mm film.
const SHORTEST: f32 = 8.0;

/// A colour picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Width and height.
    pub size: ImageSize,
    /// sRGB, row-major; over white where the picture is transparent.
    pub rgb: Vec<[u8; 3]>,
    /// Which pixels are not transparent, row-major, if some are: a cut-out says itself where its object is.
    pub opaque: Option<Vec<bool>>,
    /// Whether its EXIF block had it turned or mirrored: a depth map and the intrinsics are those of the sensor, as which the
    /// picture is not any more.
    pub turned: bool,
    /// The camera, if the EXIF block says its focal length as for 35 mm film: square pixels, the axis in the middle of the
    /// picture as it is here, upright. Some per cent off, as such numbers are.
    pub camera: Option<Intrinsics>,
}

/// Distances along the optical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthMap {
    /// Width and height.
    pub size: ImageSize,
    /// Metres, row-major; 0 = nothing seen.
    pub metres: Vec<f32>,
}

impl DepthMap {
    /// From an npy array `[height, width]` or `[height, width, 1]`: floating point in metres, integers in `metres_per_unit`,
    /// of which 65,535 is no measurement.
    ///
    /// # Errors
    /// If the bytes are not such an array.
    pub fn from_npy(bytes: &[u8], metres_per_unit: f32) -> Result<Self, Malformed> {
        let array = parse_npy(bytes)?;
        let (&[height, width] | &[height, width, 1]) = array.shape.as_slice() else {
            return Err(Malformed::new("a depth map [height, width]", format!("shape {:?}", array.shape)));
        };
        check_size(width as u64, height as u64)?;
        let metres = |&units: &f32| if array.integers { measured(units, metres_per_unit) } else { units };
        Ok(Self { size: ImageSize { width, height }, metres: array.values.iter().map(metres).collect() })
    }
}

/// Decodes a png, jpeg or webp; see [`super::read_picture`].
///
/// # Errors
/// If the bytes are not such a picture, or it is larger than [`MAX_PIXELS`].
pub fn parse_picture(bytes: &[u8]) -> Result<Picture, Malformed> {
    let Decoded { mut picture, orientation, exif } = decode(bytes)?;
    let focal_length = exif.and_then(|exif| focal_length(exif, [picture.width(), picture.height()]));
    picture.apply_orientation(orientation);
    let size = ImageSize { width: picture.width() as usize, height: picture.height() as usize };
    let (width, height) = (size.width as f32, size.height as f32);
    let camera = focal_length.map(|f| Intrinsics { fx: f, fy: f, cx: 0.5 * width, cy: 0.5 * height });
    let turned = orientation != Orientation::NoTransforms;
    let (rgb, opaque) = if picture.color().has_alpha() {
        let picture = picture.into_rgba8();
        let opaque: Vec<bool> = picture.pixels().map(|p| p.0[3] > 127).collect();
        (over_white(&picture), opaque.contains(&false).then_some(opaque))
    } else {
        (picture.into_rgb8(), None)
    };
    Ok(Picture { size, rgb: rgb.as_raw().as_chunks().0.to_vec(), opaque, turned, camera })
}

/// Metres of an integer depth.
fn measured(units: f32, metres_per_unit: f32) -> f32 {
    if units == SATURATED { 0.0 } else { units * metres_per_unit }
}

/// Decodes a 16-bit greyscale png into metres; 65,535 is no measurement.
///
/// # Errors
/// As [`parse_picture`]; 8-bit and colour pictures are no depth.
pub fn parse_depth_png(bytes: &[u8], metres_per_unit: f32) -> Result<DepthMap, Malformed> {
    let Decoded { picture, .. } = decode(bytes)?;
    let found = picture.color();
    let DynamicImage::ImageLuma16(depth) = picture else {
        return Err(Malformed::new("a 16-bit greyscale png", format!("{found:?} pixels")));
    };
    let size = ImageSize { width: depth.width() as usize, height: depth.height() as usize };
    Ok(DepthMap {
        size,
        metres: depth.as_raw().iter().map(|&d| measured(f32::from(d), metres_per_unit)).collect(),
    })
}

/// Decodes a mask; see [`super::read_mask`].
///
/// # Errors
/// As [`parse_picture`].
pub fn parse_mask(bytes: &[u8]) -> Result<(ImageSize, Vec<bool>), Malformed> {
    let Decoded { mut picture, orientation, .. } = decode(bytes)?;
    picture.apply_orientation(orientation);
    let grey = picture.into_luma_alpha8();
    let size = ImageSize { width: grey.width() as usize, height: grey.height() as usize };
    Ok((size, grey.pixels().map(|p| p.0.iter().all(|&x| x > 127)).collect()))
}

/// The focal length in pixels by an EXIF block. `None` if that says too little, or is of a picture of other sides than this one, as
/// it is stored, has.
fn focal_length(exif: Vec<u8>, sides: [u32; 2]) -> Option<f32> {
    let block = exif::Reader::new().read_raw(exif).ok()?;
    let number = |tag| Some(block.get_field(tag, In::PRIMARY)?.value.get_uint(0)? as f32);
    let [width, height] = sides.map(|side| side as f32);
    if let (Some(then_width), Some(then_height)) =
        (number(Tag::PixelXDimension), number(Tag::PixelYDimension))
    {
        let off = then_width / then_height / (width / height) - 1.0;
        let whole = off.abs() <= SAME_PROPORTIONS;
        whole.then_some(())?;
    }
    let millimetres = number(Tag::FocalLengthIn35mmFilm).filter(|f| *f >= SHORTEST)?;
    Some(millimetres / FILM_DIAGONAL * width.hypot(height))
}

/// A picture as it is stored, and what its EXIF block says.
struct Decoded {
    picture: DynamicImage,
    orientation: Orientation,
    exif: Option<Vec<u8>>,
}

fn decode(bytes: &[u8]) -> Result<Decoded, Malformed> {
    let damaged = |e: image::ImageError| Malformed::new("a sound png, jpeg or webp picture", e.to_string());
    let mut reader = ImageReader::new(Cursor::new(bytes))
        .with_guessed_format()
        .map_err(|e| Malformed::new("a png, jpeg or webp picture", e.to_string()))?;
    match reader.format() {
        Some(ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP) => {}
        other => {
            let found = other.map_or("other bytes".to_owned(), |f| format!("{f:?}"));
            return Err(Malformed::new("a png, jpeg or webp picture", found));
        }
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_PIXELS * 8);
    reader.limits(limits);
    let mut decoder = reader.into_decoder().map_err(damaged)?;
    let (width, height) = decoder.dimensions();
    check_size(u64::from(width), u64::from(height))?;
    if matches!(decoder.color_type(), ColorType::Rgb32F | ColorType::Rgba32F) {
        return Err(Malformed::new("8 or 16 bits a channel", "32"));
    }
    // A damaged EXIF block is no reason to refuse a sound picture.
    let orientation = decoder.orientation().unwrap_or(Orientation::NoTransforms);
    let exif = decoder.exif_metadata().ok().flatten();
    Ok(Decoded { picture: DynamicImage::from_decoder(decoder).map_err(damaged)?, orientation, exif })
}

fn check_size(width: u64, height: u64) -> Result<(), Malformed> {
    match width.saturating_mul(height) {
        0 => Err(Malformed::new("at least one pixel", format!("{width} x {height}"))),
        pixels if pixels > MAX_PIXELS => {
            let expected = format!("at most {} million pixels", MAX_PIXELS / 1_000_000);
            Err(Malformed::new(expected, format!("{width} x {height}")))
        }
        _ => Ok(()),
    }
}

/// What a transparent picture looks like on white paper, the background the networks are trained on.
fn over_white(picture: &image::RgbaImage) -> image::RgbImage {
    image::RgbImage::from_fn(picture.width(), picture.height(), |x, y| {
        let image::Rgba([r, g, b, a]) = *picture.get_pixel(x, y);
        let blend = |c: u8| ((u32::from(c) * u32::from(a) + 255 * (255 - u32::from(a)) + 127) / 255) as u8;
        image::Rgb([blend(r), blend(g), blend(b)])
    })
}
