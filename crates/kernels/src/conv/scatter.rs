//! From the matrix product back to pixels: Winograd's A^T, bias, residual, ReLU.

use super::form::Form;
use crate::gemm::Rows;
use crate::simd::{Kernel, Vector};
use crate::winograd::{F23, F32, F43, MAX_TILE, Winograd};
use std::ops::Range;

/// Where the results go.
#[derive(Clone, Copy)]
pub(super) enum Place {
    /// Into maps of the form's output size.
    Map {
        at: *mut f32,
        /// Added before the ReLU: maps of the same shape, possibly the same memory.
        add: Option<*const f32>,
        /// Values from image to image.
        image: usize,
        /// Values from block to block of channels.
        plane: usize,
        height: usize,
        width: usize,
    },
    /// Into a small buffer `[block][tile][pixel of the tile][16]`, pixels outside the picture included, as operands of the
    /// next matrix product.
    Tiles { at: *mut f32, plane: usize },
}

/// Turns rows `0..tiles.len()` of the products into pixels.
///
/// `from` must be valid for reading these rows of every plane and of `blocks.len()` blocks, the first being
/// that of `blocks.start`; the place for writing the tiles of these blocks; `bias` for all output channels.
pub(super) struct Scatter {
    pub(super) form: Form,
    /// Rows and columns of tiles of an image.
    pub(super) grid: (usize, usize),
    pub(super) tiles: Range<usize>,
    /// Blocks of 16 of the product's channels: phases x output channels.
    pub(super) blocks: Range<usize>,
    /// Blocks of output channels.
    pub(super) output_blocks: usize,
    pub(super) from: Rows<*const f32>,
    pub(super) bias: *const f32,
    pub(super) relu: bool,
    pub(super) place: Place,
}

/// Where one tile goes. Addresses of pixels outside the picture are never formed into accesses.
#[derive(Clone, Copy)]
struct Spot {
    at: *mut f32,
    add: Option<*const f32>,
    /// Whether the pixels are stored as operands.
    operands: bool,
    row: usize,
    pixel: usize,
    /// First and past-the-last row and column of the tile inside the picture.
    rows: (usize, usize),
    columns: (usize, usize),
}

// SAFETY of what follows: reads are of rows below `tiles.len()`, writes of pixels inside the picture.
impl Kernel for Scatter {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        unsafe {
            for (b, block) in self.blocks.clone().enumerate() {
                let from = self.from.at.add(b * self.from.block);
                match self.form {
                    Form::Direct { .. } => self.block::<V>(from, block, 0, |from, _| [[V::load(from); 4]; 4]),
                    Form::UpDirect => {
                        for phase in 0..4 {
                            let from = from.add(phase * self.from.plane);
                            self.block::<V>(from, block, phase, |from, _| [[V::load(from); 4]; 4]);
                        }
                    }
                    Form::Winograd2 => self.block::<V>(from, block, 0, |from, p| tile::<V, F23>(from, p)),
                    Form::Winograd4 => self.block::<V>(from, block, 0, |from, p| tile::<V, F43>(from, p)),
                    Form::UpWinograd => {
                        let (phase, block) = (block / self.output_blocks, block % self.output_blocks);
                        self.block::<V>(from, block, phase, |from, p| tile::<V, F32>(from, p));
                    }
                }
            }
        }
    }
}

impl Scatter {
    /// All tiles of one block of output channels; `tile` makes the pixels from the product's rows.
    #[inline(always)]
    unsafe fn block<V: Vector>(
        &self,
        from: *const f32,
        block: usize,
        phase: usize,
        tile: impl Fn(*const f32, usize) -> [[V; 4]; 4],
    ) {
        unsafe {
            let low = V::splat(if self.relu { 0.0 } else { f32::NEG_INFINITY });
            for (row, index) in self.tiles.clone().enumerate() {
                let spot = self.spot(row, index, block, phase);
                for lane in (0..16).step_by(V::LANES) {
                    let bias = V::load(self.bias.add(block * 16 + lane));
                    let pixels = tile(from.add(row * 16 + lane), self.from.plane);
                    let side = self.form.tile();
                    if spot.rows == (0, side) && spot.columns == (0, side) {
                        write(&pixels, spot, lane, bias, low, (0, side), (0, side));
                    } else {
                        write(&pixels, spot, lane, bias, low, spot.rows, spot.columns);
                    }
                }
            }
        }
    }

    #[inline(always)]
    fn spot(&self, row: usize, tile: usize, block: usize, phase: usize) -> Spot {
        let side = self.form.tile();
        match self.place {
            Place::Tiles { at, plane } => Spot {
                at: at.wrapping_add(block * plane + row * side * side * 16),
                add: None,
                operands: true,
                row: side * 16,
                pixel: 16,
                rows: (0, side),
                columns: (0, side),
            },
            Place::Map { at, add, image, plane, height, width } => {
                let (grid_rows, grid_columns) = self.grid;
                let (index, ty, tx) =
                    (tile / (grid_rows * grid_columns), tile / grid_columns % grid_rows, tile % grid_columns);
                // A tile's pixels are `step` apart and start at step * side * t + shift.
                let (step, shift) = match self.form {
                    Form::UpDirect => (2, (phase as isize / 2, phase as isize % 2)),
                    Form::UpWinograd => (2, (-(phase as isize / 2), -(phase as isize % 2))),
                    _ => (1, (0, 0)),
                };
                let (y, x) = ((step * side * ty) as isize + shift.0, (step * side * tx) as isize + shift.1);
                let range = |start: isize, size: usize| {
                    let first = usize::from(start < 0);
                    let end = (size as isize - start).max(0) as usize;
                    (first, end.div_ceil(step).min(side))
                };
                let offset = (index * image + block * plane) as isize + (y * width as isize + x) * 16;
                Spot {
                    at: at.wrapping_offset(offset),
                    add: add.map(|add| add.wrapping_offset(offset)),
                    operands: false,
                    row: step * width * 16,
                    pixel: step * 16,
                    rows: range(y, height),
                    columns: range(x, width),
                }
            }
        }
    }
}

/// A^T m A of one tile.
#[inline(always)]
unsafe fn tile<V: Vector, W: Winograd>(from: *const f32, plane: usize) -> [[V; 4]; 4] {
    unsafe {
        let zero = V::splat(0.0);
        let mut half = [[zero; MAX_TILE]; 4];
        for x in 0..W::N {
            let mut column = [zero; MAX_TILE];
            for (y, value) in column.iter_mut().enumerate().take(W::N) {
                *value = V::load(from.add((y * W::N + x) * plane));
            }
            for (row, value) in half.iter_mut().zip(W::output(column)) {
                row[x] = value;
            }
        }
        // A loop, not `map`: what the library does not inline is compiled without the vector instructions.
        let mut pixels = [[zero; 4]; 4];
        for (pixels, row) in pixels.iter_mut().zip(half).take(W::M) {
            *pixels = W::output(row);
        }
        pixels
    }
}

/// Writes the pixels of a tile that lie in the given rows and columns.
#[inline(always)]
unsafe fn write<V: Vector>(
    pixels: &[[V; 4]; 4],
    spot: Spot,
    lane: usize,
    bias: V,
    low: V,
    rows: (usize, usize),
    columns: (usize, usize),
) {
    unsafe {
        for (y, row) in pixels.iter().enumerate().take(rows.1).skip(rows.0) {
            for (x, value) in row.iter().enumerate().take(columns.1).skip(columns.0) {
                let at = y * spot.row + x * spot.pixel + lane;
                let mut value = value.add(bias);
                if let Some(add) = spot.add {
                    value = value.add(V::load(add.wrapping_add(at)));
                }
                let (value, to) = (value.max(low), spot.at.wrapping_add(at));
                if spot.operands {
                    value.store_operands(to);
                } else {
                    value.store(to);
                }
            }
        }
    }
}
