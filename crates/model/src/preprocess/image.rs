//! Pictures of any size to the square that the U-Net sees, and back.

use burn::tensor::{Device, Tensor, TensorData};
use rayon::prelude::*;
use where2act_core::{ImageSize, Pixel};

use super::resize::resize;
use super::{PreprocessError, Roll, Window};
use crate::config::Preprocessing;

/// Places along a pixel of the network, at most, that are looked up in a picture that is turned back.
const MOST_PLACES: usize = 6;

/// How a picture, or a window of it, lies in the network's square: turned back, scaled to fit, centred, bars on two sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Letterbox {
    /// Size of the picture.
    pub source: ImageSize,
    /// How far its camera is rolled.
    pub roll: Roll,
    /// What is shown of the picture that is turned back.
    pub window: Window,
    /// Side of the square.
    pub side: usize,
    /// Size of the window inside the square.
    pub inner: ImageSize,
    /// Column and row of the square where the window begins.
    pub offset: (usize, usize),
}

impl Letterbox {
    /// The largest centred fit of a whole picture that keeps the proportions, rounded to whole pixels.
    ///
    /// # Errors
    /// [`PreprocessError::EmptyImage`].
    pub fn new(source: ImageSize, side: usize) -> Result<Self, PreprocessError> {
        Self::of_window(source, Roll::NONE, Window::whole(source), side)
    }

    /// The same of a window inside the picture that is turned back.
    fn of_window(
        source: ImageSize,
        roll: Roll,
        window: Window,
        side: usize,
    ) -> Result<Self, PreprocessError> {
        let shown = window.size;
        if source.pixels() == 0 || shown.pixels() == 0 || side == 0 {
            return Err(PreprocessError::EmptyImage);
        }
        let longer = shown.width.max(shown.height) as f64;
        let fit = |length: usize| ((length as f64 * side as f64 / longer).round() as usize).clamp(1, side);
        let inner = ImageSize { width: fit(shown.width), height: fit(shown.height) };
        Ok(Self {
            source,
            roll,
            window,
            side,
            inner,
            offset: ((side - inner.width) / 2, (side - inner.height) / 2),
        })
    }

    /// Where a pixel of the picture lies in the square; the nearest one that is shown, if it is beside the window.
    #[must_use]
    pub fn to_network(&self, pixel: Pixel) -> Pixel {
        let Window { left, top, size } = self.window;
        let centre = [f64::from(pixel.u) + 0.5, f64::from(pixel.v) + 0.5];
        let [x, y] = self.roll.turn_back(centre, self.source);
        let along = |x: f64, start: usize, from: usize, to: usize, offset: usize| {
            let inside = ((x - start as f64) * to as f64 / from as f64).max(0.0) as usize;
            (offset + inside.min(to - 1)) as u32
        };
        Pixel {
            u: along(x, left, size.width, self.inner.width, self.offset.0),
            v: along(y, top, size.height, self.inner.height, self.offset.1),
        }
    }

    /// The pixel of the picture in the middle of a pixel of the square; `None` on the bars, and beside a picture that is turned back.
    #[must_use]
    pub fn to_source(&self, pixel: Pixel) -> Option<Pixel> {
        let along = |p: u32, start: usize, from: usize, to: usize, offset: usize| {
            let inside = (p as usize).checked_sub(offset).filter(|i| *i < to)?;
            Some(start as f64 + (inside as f64 + 0.5) * from as f64 / to as f64)
        };
        let Window { left, top, size } = self.window;
        let x = along(pixel.u, left, size.width, self.inner.width, self.offset.0)?;
        let y = along(pixel.v, top, size.height, self.inner.height, self.offset.1)?;
        let [x, y] = self.roll.turn([x, y], self.source);
        let ImageSize { width, height } = self.source;
        let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
        inside.then_some(Pixel { u: x as u32, v: y as u32 })
    }

    /// Row-major index in the square of [`Self::to_network`]: what queries of the U-Net's features are made of.
    #[must_use]
    pub fn network_index(&self, pixel: Pixel) -> usize {
        ImageSize::square(self.side).index(self.to_network(pixel))
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
    /// Prepares sRGB colours `[height * width]`; a mask says which pixels belong to the object, and may decide what of the
    /// picture is shown: [`Preprocessing::close_up`].
    ///
    /// # Errors
    /// [`PreprocessError::EmptyImage`], [`PreprocessError::Size`].
    pub fn new(
        size: ImageSize,
        rgb: &[[u8; 3]],
        mask: Option<&[bool]>,
        with: &Preprocessing,
    ) -> Result<Self, PreprocessError> {
        Self::rolled(size, rgb, mask, Roll::NONE, with)
    }

    /// The same of a picture whose camera is rolled.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn rolled(
        size: ImageSize,
        rgb: &[[u8; 3]],
        mask: Option<&[bool]>,
        roll: Roll,
        with: &Preprocessing,
    ) -> Result<Self, PreprocessError> {
        PreprocessError::check_size("the colour buffer", size, rgb.len())?;
        if let Some(mask) = mask {
            PreprocessError::check_size("the mask", size, mask.len())?;
        }
        let window = match (mask, with.close_up) {
            _ if roll == Roll::NONE => Window::shown(size, mask, with),
            (Some(mask), Some(margin)) => Window::around_rolled(mask, size, roll, margin),
            _ => Window::whole(roll.size(size)),
        };
        let letterbox = Letterbox::of_window(size, roll, window, with.image_side)?;
        let mask = mask.filter(|_| with.white_background);
        let background = if with.white_background { 1.0 } else { 0.0 };
        let (side, inner) = (with.image_side, letterbox.inner);
        let colour_at = |i: usize| match mask {
            Some(mask) if !mask[i] => [1.0; 3],
            _ => rgb[i].map(|code| f32::from(code) / 255.0),
        };
        let turned = (roll != Roll::NONE).then(|| turned_back(&letterbox, background, colour_at));
        let mut values = Vec::with_capacity(3 * side * side);
        for (channel, (mean, std)) in with.image_mean.iter().zip(with.image_std).enumerate() {
            // One colour at a time: with all three of each pixel upright pictures take a third longer.
            let colour = |i: usize| match mask {
                Some(mask) if !mask[i] => 1.0,
                _ => f32::from(rgb[i][channel]) / 255.0,
            };
            let small = if let Some(turned) = &turned {
                turned.iter().map(|colour| colour[channel]).collect()
            } else {
                let plane: Vec<f32> = window.indices(size).map(colour).collect();
                resize(&plane, window.size, inner)
            };
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

/// Colours of the window of a picture that is turned back, `[inner.height * inner.width]`: the mean of as many places in each pixel as
/// there are pixels of the picture, up to a few, `background` beside it. `colour` is that of an index of the picture's buffers.
fn turned_back(
    letterbox: &Letterbox,
    background: f32,
    colour: impl Fn(usize) -> [f32; 3] + Sync,
) -> Vec<[f32; 3]> {
    let Letterbox { source, roll, window, inner, .. } = *letterbox;
    let at = |x: isize, y: isize| {
        let inside = x >= 0 && y >= 0 && (x as usize) < source.width && (y as usize) < source.height;
        if inside { colour(y as usize * source.width + x as usize) } else { [background; 3] }
    };
    let mix = |a: [f32; 3], b: [f32; 3], share: f32| {
        std::array::from_fn(|channel| a[channel] * (1.0 - share) + b[channel] * share)
    };
    let between = |[x, y]: [f64; 2]| -> [f32; 3] {
        let (x, y) = (x - 0.5, y - 0.5);
        let (left, top) = (x.floor(), y.floor());
        let row = |y: isize| mix(at(left as isize, y), at(left as isize + 1, y), (x - left) as f32);
        mix(row(top as isize), row(top as isize + 1), (y - top) as f32)
    };
    let scale = window.size.width as f64 / inner.width as f64;
    let places = (scale.ceil() as usize).clamp(1, MOST_PLACES);
    let along = |i: usize, n: usize, start: usize, from: usize, to: usize| {
        start as f64 + (i as f64 + (n as f64 + 0.5) / places as f64) * from as f64 / to as f64
    };
    let pixel = |i: usize| {
        let (u, v) = (i % inner.width, i / inner.width);
        let mut sum = [0.0; 3];
        for n in 0..places * places {
            let x = along(u, n % places, window.left, window.size.width, inner.width);
            let y = along(v, n / places, window.top, window.size.height, inner.height);
            let seen = between(roll.turn([x, y], source));
            sum.iter_mut().zip(seen).for_each(|(sum, seen)| *sum += seen);
        }
        sum.map(|sum| sum / (places * places) as f32)
    };
    (0..inner.height * inner.width).into_par_iter().with_min_len(inner.width).map(pixel).collect()
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

    /// A picture whose pixels all differ, and a mask that is a rectangle.
    fn masked(size: ImageSize, [left, top, right, bottom]: [usize; 4]) -> (Vec<[u8; 3]>, Vec<bool>) {
        let rgb =
            (0..size.pixels()).map(|i| [(i % 256) as u8, (i / 7 % 256) as u8, (i / 256) as u8]).collect();
        let inside =
            |i: usize| (left..right).contains(&(i % size.width)) && (top..bottom).contains(&(i / size.width));
        (rgb, (0..size.pixels()).map(inside).collect())
    }

    proptest! {
        #[test]
        fn a_window_holds_its_mask_in_the_middle_and_every_pixel_of_it_comes_back(
            w in 1usize..300, h in 1usize..300, corners in proptest::array::uniform4(0.0f32..1.0), margin in 1.0f32..3.0,
        ) {
            let size = ImageSize { width: w, height: h };
            let at = |share: f32, length: usize| (share * length as f32) as usize;
            let [a, b, c, d] = corners;
            let (left, right) = (at(a.min(b), w), at(a.max(b), w) + 1);
            let (top, bottom) = (at(c.min(d), h), at(c.max(d), h) + 1);
            let (_, mask) = masked(size, [left, top, right, bottom]);
            let window = Window::around(&mask, size, margin);
            let (end, low) = (window.left + window.size.width, window.top + window.size.height);
            prop_assert!(window.left <= left && right <= end && end <= w);
            prop_assert!(window.top <= top && bottom <= low && low <= h);
            let side = (f64::from(margin) * (right - left).max(bottom - top) as f64).round() as usize;
            for (start, first, last, end, whole) in [(window.left, left, right, end, w), (window.top, top, bottom, low, h)]
            {
                if start == 0 || end == whole {
                    prop_assert!(end - start <= side);
                } else {
                    prop_assert!(end - start == side, "{start} {end}, not {side}");
                    prop_assert!((first - start).abs_diff(end - last) <= 2, "{start} {first} {last} {end}");
                }
            }
            let letterbox = Letterbox::of_window(size, Roll::NONE, window, 64).unwrap();
            let off = 64.0 / window.size.width.max(window.size.height) as f32;
            for (u, v) in [(0, 32), (32, 0), (32, 32), (63, 32), (32, 63)] {
                let Some(source) = letterbox.to_source(Pixel { u, v }) else { continue };
                let inside = (window.left..end).contains(&(source.u as usize))
                    && (window.top..low).contains(&(source.v as usize));
                prop_assert!(inside, "{source:?} {window:?}");
                let back = letterbox.to_network(source);
                prop_assert!((back.u as f32 - u as f32).abs() <= off && (back.v as f32 - v as f32).abs() <= off);
            }
            // What is beside the window has a place in the square all the same.
            for pixel in [Pixel { u: 0, v: 0 }, Pixel { u: w as u32 - 1, v: h as u32 - 1 }] {
                prop_assert!(letterbox.network_index(pixel) < 64 * 64);
            }
        }
    }

    #[test]
    fn a_close_up_is_the_picture_cut_out() {
        let size = ImageSize { width: 90, height: 70 };
        let (rgb, mask) = masked(size, [30, 10, 60, 50]);
        let with = Preprocessing { image_side: 32, close_up: Some(1.1), ..Preprocessing::default() };
        let window = Window::around(&mask, size, 1.1);
        assert_eq!(window, Window { left: 23, top: 8, size: ImageSize::square(44) });
        let cut = |i: usize| (window.top + i / 44) * 90 + window.left + i % 44;
        let rgb_inside: Vec<_> = (0..44 * 44).map(|i| rgb[cut(i)]).collect();
        let mask_inside: Vec<_> = (0..44 * 44).map(|i| mask[cut(i)]).collect();
        let close = ImageInput::new(size, &rgb, Some(&mask), &with).unwrap();
        let expected = ImageInput::new(
            window.size,
            &rgb_inside,
            Some(&mask_inside),
            &Preprocessing { close_up: None, ..with.clone() },
        );
        assert_eq!(close.values, expected.unwrap().values);
        // A speck changes nothing.
        let mut speckled = mask.clone();
        speckled[89] = true;
        assert_eq!(Window::around(&speckled, size, 1.1), Window::around(&mask, size, 1.1));
        // Without a mask, and with one that is empty, all of it is shown.
        let whole = |mask| ImageInput::new(size, &rgb, mask, &with).unwrap().letterbox;
        assert_eq!(whole(None), Letterbox::new(size, 32).unwrap());
        assert_eq!(whole(Some(&[false; 6300])), Letterbox::new(size, 32).unwrap());
    }

    proptest! {
        #[test]
        fn a_rolled_picture_s_mask_is_in_the_middle_of_its_window_and_every_pixel_of_it_comes_back(
            w in 1usize..200, h in 1usize..200, corners in proptest::array::uniform4(0.0f32..1.0), angle in -4.0f32..4.0,
        ) {
            let size = ImageSize { width: w, height: h };
            let at = |share: f32, length: usize| (share * length as f32) as usize;
            let [a, b, c, d] = corners;
            let rectangle = [at(a.min(b), w), at(c.min(d), h), at(a.max(b), w) + 1, at(c.max(d), h) + 1];
            let (rgb, mask) = masked(size, rectangle);
            let with = Preprocessing { image_side: 64, close_up: Some(1.5), ..Preprocessing::default() };
            let roll = Roll::new(angle);
            let letterbox = ImageInput::rolled(size, &rgb, Some(&mask), roll, &with).unwrap().letterbox;
            let turned = roll.size(size);
            let Window { left, top, size: shown } = letterbox.window;
            prop_assert!(left + shown.width <= turned.width && top + shown.height <= turned.height);
            let off = 1.0 + 2.0 * 64.0 / shown.width.max(shown.height) as f32;
            for (u, v) in [(0, 32), (32, 0), (32, 32), (63, 32), (32, 63), (20, 40)] {
                let Some(source) = letterbox.to_source(Pixel { u, v }) else { continue };
                prop_assert!((source.u as usize) < w && (source.v as usize) < h);
                let back = letterbox.to_network(source);
                prop_assert!((back.u as f32 - u as f32).abs() <= off && (back.v as f32 - v as f32).abs() <= off);
            }
            for pixel in [Pixel { u: 0, v: 0 }, Pixel { u: w as u32 - 1, v: h as u32 - 1 }] {
                prop_assert!(letterbox.network_index(pixel) < 64 * 64);
                let place = [f64::from(pixel.u), f64::from(pixel.v)];
                let [x, y] = roll.turn(roll.turn_back(place, size), size);
                prop_assert!((x - place[0]).abs() < 1e-9 && (y - place[1]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_picture_is_turned_back_as_if_somebody_had_done_it_before() {
        // As many pixels as the network has, so that none is interpolated.
        let size = ImageSize { width: 60, height: 44 };
        let (rgb, mask) = masked(size, [10, 6, 30, 26]);
        let with = Preprocessing { image_side: 32, close_up: Some(1.6), ..Preprocessing::default() };
        for quarters in 1..4 {
            let roll = Roll::new(quarters as f32 * std::f32::consts::FRAC_PI_2);
            let turned = roll.size(size);
            // Where a pixel of the turned picture was.
            let from = |i: usize| {
                let place = [(i % turned.width) as f64 + 0.5, (i / turned.width) as f64 + 0.5];
                let [x, y] = roll.turn(place, size);
                size.index(Pixel { u: x as u32, v: y as u32 })
            };
            let rgb_before: Vec<_> = (0..size.pixels()).map(|i| rgb[from(i)]).collect();
            let mask_before: Vec<_> = (0..size.pixels()).map(|i| mask[from(i)]).collect();
            let found = ImageInput::rolled(size, &rgb, Some(&mask), roll, &with).unwrap();
            let expected = ImageInput::new(turned, &rgb_before, Some(&mask_before), &with).unwrap();
            assert_eq!(found.letterbox.window, expected.letterbox.window, "{quarters}");
            for (found, expected) in found.values.iter().zip(&expected.values) {
                assert!((found - expected).abs() < 1e-4, "{quarters}: {found} {expected}");
            }
            for i in 0..turned.pixels() {
                let pixel =
                    |i: usize, of: ImageSize| Pixel { u: (i % of.width) as u32, v: (i / of.width) as u32 };
                let (found, expected) = (&found.letterbox, &expected.letterbox);
                assert_eq!(found.to_network(pixel(from(i), size)), expected.to_network(pixel(i, turned)));
            }
        }
        // All of a picture fits, with bars where there is none.
        let whole = ImageInput::rolled(size, &rgb, None, Roll::new(0.6), &with).unwrap();
        let (corner, middle) = (Pixel { u: 1, v: 1 }, Pixel { u: 16, v: 16 });
        assert_eq!(whole.letterbox.to_source(corner), None);
        let Pixel { u, v } = whole.letterbox.to_source(middle).unwrap();
        assert!(u.abs_diff(30) <= 2 && v.abs_diff(22) <= 2, "{u},{v}");
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
        let column = |u| input.letterbox.to_network(Pixel { u, v: 0 }).u;
        assert_eq!(std::array::from_fn(|u| column(u as u32)), [2, 6, 10, 14, 18, 22, 26, 30]);
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
