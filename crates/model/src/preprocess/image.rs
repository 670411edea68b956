//! Pictures of any size to the square that the U-Net sees, and back.

use burn::tensor::{Device, Tensor, TensorData};
use nalgebra::Point3;
use where2act_core::{ImageSize, Intrinsics, Pixel};

use super::PreprocessError;
use super::resize::resize;
use crate::config::Preprocessing;

/// Part of a picture: the network sees nothing beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Its first column.
    pub left: usize,
    /// Its first row.
    pub top: usize,
    /// Columns and rows.
    pub size: ImageSize,
}

impl Window {
    /// All of a picture.
    #[must_use]
    pub const fn whole(size: ImageSize) -> Self {
        Self { left: 0, top: 0, size }
    }

    /// The square around a mask, `margin` times as large as the mask's larger extent, as far as the picture reaches. Up to a
    /// thousandth of the mask may lie beside it on each side: specks. All of the picture if nothing is inside the mask.
    #[must_use]
    pub fn around(mask: &[bool], picture: ImageSize, margin: f32) -> Self {
        let mut columns = vec![0; picture.width];
        let mut rows = Vec::with_capacity(picture.height);
        for row in mask.chunks_exact(picture.width.max(1)) {
            let inside = columns.iter_mut().zip(row).filter(|(_, inside)| **inside);
            rows.push(inside.map(|(column, _)| *column += 1).count());
        }
        let (Some((left, right)), Some((top, bottom))) = (span(&columns), span(&rows)) else {
            return Self::whole(picture);
        };
        let extent = (right - left).max(bottom - top) as f64;
        let side = (extent * f64::from(margin)).round();
        let along = |first: usize, end: usize, length: usize| {
            let start = (0.5 * ((first + end) as f64 - side)).round();
            let inside = |x: f64| (x.max(0.0) as usize).min(length);
            (inside(start), inside(start + side) - inside(start))
        };
        let (left, width) = along(left, right, picture.width);
        let (top, height) = along(top, bottom, picture.height);
        Self { left, top, size: ImageSize { width, height } }
    }

    /// A point on the ray through its middle, in the frame of the picture's camera.
    #[must_use]
    pub fn middle(&self, camera: &Intrinsics) -> Point3<f32> {
        let ImageSize { width, height } = self.size;
        camera.back_project(self.left as f32 + 0.5 * width as f32, self.top as f32 + 0.5 * height as f32, 1.0)
    }

    /// The picture's pixels in the window, row by row of what is seen when it is turned, as indices of its buffers.
    fn indices(self, picture: ImageSize, turns: Turns) -> impl Iterator<Item = usize> {
        let Self { left, top, size } = self;
        let (right, bottom, down) = (left + size.width - 1, top + size.height - 1, picture.width as isize);
        let (first, across, along) = match turns {
            Turns::None => ((left, top), 1, down),
            Turns::One => ((left, bottom), -down, 1),
            Turns::Two => ((right, bottom), -1, -down),
            Turns::Three => ((right, top), down, -1),
        };
        let ImageSize { width, height } = turns.size(size);
        let first = (first.1 * picture.width + first.0) as isize;
        (0..height as isize)
            .flat_map(move |v| (0..width as isize).map(move |u| (first + u * across + v * along) as usize))
    }
}

/// Quarter turns of a picture, clockwise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turns {
    /// As it is.
    #[default]
    None,
    /// What was at the left is at the top.
    One,
    /// On its head.
    Two,
    /// What was at the right is at the top.
    Three,
}

impl Turns {
    /// So many, or so many less than four times any number.
    #[must_use]
    pub const fn new(count: i32) -> Self {
        match count.rem_euclid(4) {
            0 => Self::None,
            1 => Self::One,
            2 => Self::Two,
            _ => Self::Three,
        }
    }

    /// Size of a turned picture.
    #[must_use]
    pub const fn size(self, size: ImageSize) -> ImageSize {
        match self {
            Self::None | Self::Two => size,
            Self::One | Self::Three => ImageSize { width: size.height, height: size.width },
        }
    }

    /// Where a position of a picture of this size is when it is turned.
    #[must_use]
    pub fn turn(self, [x, y]: [f64; 2], size: ImageSize) -> [f64; 2] {
        let (width, height) = (size.width as f64, size.height as f64);
        match self {
            Self::None => [x, y],
            Self::One => [height - y, x],
            Self::Two => [width - x, height - y],
            Self::Three => [y, width - x],
        }
    }

    /// As many the other way round.
    #[must_use]
    pub const fn back(self) -> Self {
        match self {
            Self::One => Self::Three,
            Self::Three => Self::One,
            same => same,
        }
    }
}

/// Where a mask with so many pixels in each row, or column, begins and ends, without specks.
fn span(counts: &[usize]) -> Option<(usize, usize)> {
    let few = counts.iter().sum::<usize>() / 1000;
    let exceeds = |left: &mut usize, count: usize| match left.checked_sub(count) {
        Some(rest) => {
            *left = rest;
            false
        }
        None => true,
    };
    let (mut before, mut after) = (few, few);
    let first = counts.iter().position(|&count| exceeds(&mut before, count))?;
    let last = counts.iter().rposition(|&count| exceeds(&mut after, count))?;
    Some((first, last + 1))
}

/// How a picture, or a window of it, lies in the network's square: turned, scaled to fit, centred, bars on two sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Letterbox {
    /// Size of the picture.
    pub source: ImageSize,
    /// What of it is shown.
    pub window: Window,
    /// How that is turned.
    pub turns: Turns,
    /// Side of the square.
    pub side: usize,
    /// Size of the turned window inside the square.
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
        Self::of_window(source, Window::whole(source), Turns::None, side)
    }

    /// The same of a window inside the picture, turned.
    fn of_window(
        source: ImageSize,
        window: Window,
        turns: Turns,
        side: usize,
    ) -> Result<Self, PreprocessError> {
        let shown = turns.size(window.size);
        if source.pixels() == 0 || shown.pixels() == 0 || side == 0 {
            return Err(PreprocessError::EmptyImage);
        }
        let longer = shown.width.max(shown.height) as f64;
        let fit = |length: usize| ((length as f64 * side as f64 / longer).round() as usize).clamp(1, side);
        let inner = ImageSize { width: fit(shown.width), height: fit(shown.height) };
        Ok(Self {
            source,
            window,
            turns,
            side,
            inner,
            offset: ((side - inner.width) / 2, (side - inner.height) / 2),
        })
    }

    /// Where a pixel of the picture lies in the square; the nearest one that is shown, if it is beside the window.
    #[must_use]
    pub fn to_network(&self, pixel: Pixel) -> Pixel {
        let Window { left, top, size } = self.window;
        let centre = [f64::from(pixel.u) + 0.5 - left as f64, f64::from(pixel.v) + 0.5 - top as f64];
        let ([x, y], from) = (self.turns.turn(centre, size), self.turns.size(size));
        let along = |x: f64, from: usize, to: usize, offset: usize| {
            let inside = (x * to as f64 / from as f64).max(0.0) as usize;
            (offset + inside.min(to - 1)) as u32
        };
        Pixel {
            u: along(x, from.width, self.inner.width, self.offset.0),
            v: along(y, from.height, self.inner.height, self.offset.1),
        }
    }

    /// The pixel of the picture in the middle of a pixel of the square; `None` on the bars.
    #[must_use]
    pub fn to_source(&self, pixel: Pixel) -> Option<Pixel> {
        let Window { left, top, size } = self.window;
        let turned = self.turns.size(size);
        let along = |p: u32, from: usize, to: usize, offset: usize| {
            let inside = (p as usize).checked_sub(offset).filter(|i| *i < to)?;
            Some((inside as f64 + 0.5) * from as f64 / to as f64)
        };
        let x = along(pixel.u, turned.width, self.inner.width, self.offset.0)?;
        let y = along(pixel.v, turned.height, self.inner.height, self.offset.1)?;
        let [x, y] = self.turns.back().turn([x, y], turned);
        let inside = |x: f64, start: usize, length: usize| (start + (x as usize).min(length - 1)) as u32;
        Some(Pixel { u: inside(x, left, size.width), v: inside(y, top, size.height) })
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
        Self::turned(size, rgb, mask, |_| Turns::None, with)
    }

    /// The same of a picture that is turned before the network sees it: `turns` says how, of the part that is shown.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn turned(
        size: ImageSize,
        rgb: &[[u8; 3]],
        mask: Option<&[bool]>,
        turns: impl FnOnce(&Window) -> Turns,
        with: &Preprocessing,
    ) -> Result<Self, PreprocessError> {
        PreprocessError::check_size("the colour buffer", size, rgb.len())?;
        if let Some(mask) = mask {
            PreprocessError::check_size("the mask", size, mask.len())?;
        }
        let window = match (mask, with.close_up) {
            (Some(mask), Some(margin)) => Window::around(mask, size, margin),
            _ => Window::whole(size),
        };
        let turns = turns(&window);
        let letterbox = Letterbox::of_window(size, window, turns, with.image_side)?;
        let mask = mask.filter(|_| with.white_background);
        let background = if with.white_background { 1.0 } else { 0.0 };
        let (side, inner) = (with.image_side, letterbox.inner);
        let mut values = Vec::with_capacity(3 * side * side);
        for (channel, (mean, std)) in with.image_mean.iter().zip(with.image_std).enumerate() {
            let colour = |i: usize| match mask {
                Some(mask) if !mask[i] => 1.0,
                _ => f32::from(rgb[i][channel]) / 255.0,
            };
            let plane: Vec<f32> = window.indices(size, turns).map(colour).collect();
            let small = resize(&plane, turns.size(window.size), inner);
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
            quarters in 0..4,
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
            let letterbox = Letterbox::of_window(size, window, Turns::new(quarters), 64).unwrap();
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

    #[test]
    fn a_picture_is_turned_as_if_somebody_had_turned_it_before() {
        let size = ImageSize { width: 50, height: 30 };
        let (rgb, mask) = masked(size, [10, 6, 31, 17]);
        let with = Preprocessing { image_side: 32, close_up: Some(1.2), ..Preprocessing::default() };
        for quarters in 0..4 {
            let turns = Turns::new(quarters);
            let turned = turns.size(size);
            // Where a pixel of the turned picture was.
            let from = |i: usize| {
                let place = [(i % turned.width) as f64 + 0.5, (i / turned.width) as f64 + 0.5];
                let [x, y] = turns.back().turn(place, turned);
                size.index(Pixel { u: x as u32, v: y as u32 })
            };
            let rgb_before: Vec<_> = (0..size.pixels()).map(|i| rgb[from(i)]).collect();
            let mask_before: Vec<_> = (0..size.pixels()).map(|i| mask[from(i)]).collect();
            for masked in [true, false] {
                let (now, before) = (masked.then_some(&mask[..]), masked.then_some(&mask_before[..]));
                let found = ImageInput::turned(size, &rgb, now, |_| turns, &with).unwrap();
                let expected = ImageInput::new(turned, &rgb_before, before, &with).unwrap();
                assert_eq!(found.values, expected.values, "{turns:?}");
                for i in 0..turned.pixels() {
                    let pixel = |i: usize, size: ImageSize| Pixel {
                        u: (i % size.width) as u32,
                        v: (i / size.width) as u32,
                    };
                    assert_eq!(
                        found.letterbox.network_index(pixel(from(i), size)),
                        expected.letterbox.network_index(pixel(i, turned)),
                    );
                }
            }
        }
        assert_eq!([Turns::new(-1), Turns::new(5), Turns::new(6)], [Turns::Three, Turns::One, Turns::Two]);
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
