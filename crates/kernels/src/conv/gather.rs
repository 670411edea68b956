//! From maps to the rows of the matrix product: windows are copied, or transformed by Winograd's B^T.

use super::form::Form;
use crate::gemm::Rows;
use crate::simd::{Kernel, Vector};
use crate::winograd::{F23, F32, F43, MAX_TILE, Winograd};
use std::ops::Range;

/// The maps of one source.
#[derive(Clone, Copy)]
pub(super) struct Map {
    pub(super) at: *const f32,
    /// Values from image to image.
    pub(super) image: usize,
    /// Values from block to block of channels.
    pub(super) plane: usize,
    pub(super) blocks: usize,
}

/// Fills rows `0..tiles.len()` of every plane and block with what the tiles need.
///
/// Every map must be valid for reading `height` x `width` pixels of its blocks in all images that the tiles
/// lie in; `to` for writing those rows.
pub(super) struct Gather<'a> {
    pub(super) form: Form,
    pub(super) maps: &'a [Map],
    pub(super) height: usize,
    pub(super) width: usize,
    /// Rows and columns of tiles of an image.
    pub(super) grid: (usize, usize),
    pub(super) tiles: Range<usize>,
    pub(super) to: Rows<*mut f32>,
}

// SAFETY of what follows: reads are of pixels inside the picture, checked where a window may leave it; writes
// are of rows below `tiles.len()`.
impl Kernel for Gather<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        unsafe {
            match self.form {
                Form::Direct { size, stride, pad } => {
                    for tap in 0..size * size {
                        let shift = |k: usize| k as isize - pad as isize;
                        self.copy::<V>(0, tap, stride, (shift(tap / size), shift(tap % size)));
                    }
                }
                Form::UpDirect => {
                    for phase in 0..4 {
                        for tap in 0..4 {
                            let shift = |tap: usize, parity: usize| tap as isize + parity as isize - 1;
                            self.copy::<V>(
                                phase,
                                tap,
                                1,
                                (shift(tap / 2, phase / 2), shift(tap % 2, phase % 2)),
                            );
                        }
                    }
                }
                Form::Winograd2 => self.transform::<V, F23>(),
                Form::Winograd4 => self.transform::<V, F43>(),
                Form::UpWinograd => self.transform::<V, F32>(),
            }
        }
    }
}

impl Gather<'_> {
    /// Image, row and column of a tile.
    #[inline(always)]
    fn place(&self, tile: usize) -> (usize, usize, usize) {
        let (rows, columns) = self.grid;
        (tile / (rows * columns), tile / columns % rows, tile % columns)
    }

    /// Copies, for every tile, the pixel at `stride * tile + shift` (zeros outside) as block `tap` of all
    /// channels.
    #[inline(always)]
    unsafe fn copy<V: Vector>(&self, plane: usize, tap: usize, stride: usize, shift: (isize, isize)) {
        unsafe {
            let blocks: usize = self.maps.iter().map(|map| map.blocks).sum();
            let zero = V::splat(0.0);
            let mut to = self.to.at.add(plane * self.to.plane + tap * blocks * self.to.block);
            for map in self.maps {
                for block in 0..map.blocks {
                    let (mut image, mut ty, mut tx) = self.place(self.tiles.start);
                    for row in 0..self.tiles.len() {
                        let y = (stride * ty) as isize + shift.0;
                        let x = (stride * tx) as isize + shift.1;
                        let inside =
                            (0..self.height as isize).contains(&y) && (0..self.width as isize).contains(&x);
                        let pixel = y.wrapping_mul(self.width as isize).wrapping_add(x);
                        for lane in (0..16).step_by(V::LANES) {
                            let value = if inside {
                                let at = image * map.image + block * map.plane + pixel as usize * 16 + lane;
                                V::load(map.at.add(at))
                            } else {
                                zero
                            };
                            value.store_operands(to.add(row * 16 + lane));
                        }
                        tx += 1;
                        if tx == self.grid.1 {
                            (tx, ty) = (0, ty + 1);
                            if ty == self.grid.0 {
                                (ty, image) = (0, image + 1);
                            }
                        }
                    }
                    // After the last block of the last plane there may be no memory: wrapping.
                    to = to.wrapping_add(self.to.block);
                }
            }
        }
    }

    /// Transforms the window of every tile; its first pixel is one above and left of the tile.
    #[inline(always)]
    unsafe fn transform<V: Vector, W: Winograd>(&self) {
        unsafe {
            let mut to = self.to.at;
            for map in self.maps {
                for block in 0..map.blocks {
                    for (row, tile) in self.tiles.clone().enumerate() {
                        let (image, ty, tx) = self.place(tile);
                        let (y, x) = (ty * W::M, tx * W::M);
                        let inside =
                            y > 0 && x > 0 && y - 1 + W::N <= self.height && x - 1 + W::N <= self.width;
                        let from = map.at.add(image * map.image + block * map.plane);
                        for lane in (0..16).step_by(V::LANES) {
                            let to = to.add(row * 16 + lane);
                            if inside {
                                let first = from.add(((y - 1) * self.width + x - 1) * 16 + lane);
                                self.window::<V, W>(to, |j, i| V::load(first.add((j * self.width + i) * 16)));
                            } else {
                                let zero = V::splat(0.0);
                                self.window::<V, W>(to, |j, i| {
                                    // One too large here, so that pixels before the first are below one.
                                    let (y, x) = (y + j, x + i);
                                    if y < 1 || x < 1 || y > self.height || x > self.width {
                                        zero
                                    } else {
                                        V::load(from.add(((y - 1) * self.width + x - 1) * 16 + lane))
                                    }
                                });
                            }
                        }
                    }
                    to = to.add(self.to.block);
                }
            }
        }
    }

    /// B^T d B of one window of N x N pixels, spread over the planes.
    #[inline(always)]
    unsafe fn window<V: Vector, W: Winograd>(&self, to: *mut f32, pixel: impl Fn(usize, usize) -> V) {
        unsafe {
            let zero = V::splat(0.0);
            let mut half = [[zero; MAX_TILE]; MAX_TILE];
            for x in 0..W::N {
                let mut column = [zero; MAX_TILE];
                for (y, value) in column.iter_mut().enumerate().take(W::N) {
                    *value = pixel(y, x);
                }
                for (row, value) in half.iter_mut().zip(W::input(column)) {
                    row[x] = value;
                }
            }
            for (y, row) in half.iter().enumerate().take(W::N) {
                for (x, value) in W::input(*row).iter().enumerate().take(W::N) {
                    value.store_operands(to.add((y * W::N + x) * self.to.plane));
                }
            }
        }
    }
}
