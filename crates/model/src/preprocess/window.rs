//! The part of a picture that a network sees.

use nalgebra::Point3;
use where2act_core::{ImageSize, Intrinsics};

use super::Roll;
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

    /// What a network sees of an upright picture, whose mask is of its size.
    #[must_use]
    pub fn shown(picture: ImageSize, mask: Option<&[bool]>, with: &Preprocessing) -> Self {
        match (mask, with.close_up) {
            (Some(mask), Some(margin)) => Self::around(mask, picture, margin),
            _ => Self::whole(picture),
        }
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
        Self::around_counts(&columns, &rows, picture, margin)
    }

    /// The same in a picture that is turned back.
    pub(super) fn around_rolled(mask: &[bool], picture: ImageSize, roll: Roll, margin: f32) -> Self {
        let turned = roll.size(picture);
        let (mut columns, mut rows) = (vec![0; turned.width], vec![0; turned.height]);
        for at in (0..picture.pixels()).filter(|&at| mask[at]) {
            let place = [(at % picture.width) as f64 + 0.5, (at / picture.width) as f64 + 0.5];
            let [x, y] = roll.turn_back(place, picture);
            columns[(x.max(0.0) as usize).min(turned.width - 1)] += 1;
            rows[(y.max(0.0) as usize).min(turned.height - 1)] += 1;
        }
        Self::around_counts(&columns, &rows, turned, margin)
    }

    /// Around what has so many pixels in each column and row.
    fn around_counts(columns: &[usize], rows: &[usize], picture: ImageSize, margin: f32) -> Self {
        let (Some((left, right)), Some((top, bottom))) = (span(columns), span(rows)) else {
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

    /// The picture's pixels in the window, row by row, as indices of its buffers.
    pub(super) fn indices(self, picture: ImageSize) -> impl Iterator<Item = usize> {
        let Self { left, top, size } = self;
        (top..top + size.height)
            .flat_map(move |row| (left..left + size.width).map(move |u| row * picture.width + u))
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
