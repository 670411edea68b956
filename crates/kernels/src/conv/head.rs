//! A convolution followed by a 1x1 layer whose result is written pixel by pixel.

use super::scatter::Place;
use super::{Conv, layout, parallel};
use crate::gemm::{Gemm, Panels, Rows};
use crate::parallel::Shared;
use crate::simd::{Kernel, Vector};
use crate::{AlignedBuf, Blocked, Form, Isa, ShapeError};

/// A linear layer on every pixel.
///
/// It is computed from the tiles of the convolution before it while they are in the cache: the maps in between
/// are never stored.
#[derive(Clone)]
pub struct Head {
    weights: Panels,
    bias: AlignedBuf,
    inputs: usize,
}

/// Tiles of the convolution that go through the head together: 64 pixels, whose results fit a first-level
/// cache.
const TILES: usize = 4;

impl Head {
    /// Packs weights `[outputs, inputs]` and a bias `[outputs]`; `outputs` is a multiple of 16.
    ///
    /// # Errors
    /// When the sizes disagree.
    pub fn new(isa: Isa, weights: &[f32], bias: &[f32], inputs: usize) -> Result<Self, ShapeError> {
        let outputs = bias.len();
        ShapeError::check("outputs of a head beyond a multiple of 16", 0, outputs % 16)?;
        ShapeError::check("weights of a head", outputs * inputs, weights.len())?;
        let valid = super::pack::valid_blocks(&[super::Source::Plain(inputs)]);
        let panels = Panels::pack(isa, 1, valid, outputs, |_, k, n| weights[n * inputs + k]);
        let mut padded = AlignedBuf::zeros(outputs);
        padded.copy_from_slice(bias);
        Ok(Self { weights: panels, bias: padded, inputs })
    }

    /// Values per pixel.
    pub fn outputs(&self) -> usize {
        self.bias.len()
    }
}

impl Conv {
    /// Computes `head(max(conv(inputs), 0))` into `[images, height x width, head outputs]`.
    ///
    /// # Errors
    /// When the shapes disagree, or the form is one of the upsampling ones.
    pub fn run_with_head(
        &self,
        inputs: &[&Blocked],
        head: &Head,
        output: &mut [f32],
    ) -> Result<(), ShapeError> {
        let (images, height, width) = self.check(inputs)?;
        let up = matches!(self.form, Form::UpDirect | Form::UpWinograd);
        ShapeError::check("upsampling before a head", 0, usize::from(up))?;
        ShapeError::check("inputs of a head", self.outputs(), head.inputs)?;
        let other = usize::from(head.weights.isa() != self.weights.isa());
        ShapeError::check("heads compiled for another instruction set", 0, other)?;
        let (height, width) = self.form.output_size((height, width));
        ShapeError::check("values of a head", images * height * width * head.outputs(), output.len())?;
        let run = self.prepare(inputs, Place::Tiles { at: std::ptr::null_mut(), plane: 0 }, true);
        let isa = self.weights.isa();
        let stream = (output.as_ptr() as usize).is_multiple_of(64);
        let output = Shared(output.as_mut_ptr());

        let blocks = run.block_count();
        let most = run.tiles.div_ceil(blocks.max(1));
        let area = self.form.tile() * self.form.tile();
        let channels = self.bias.len() / 16;
        let (products_len, pixels_len) = (run.scratch_len(most), channels * most * area * 16);
        let values_len = head.outputs() * TILES * area;
        parallel::for_each(blocks, |block| {
            let tiles = run.tiles_of(block, blocks);
            parallel::with_scratch(products_len + pixels_len + values_len, |scratch| {
                let (scratch, rest) = scratch.split_at_mut(products_len);
                let (pixels, values) = rest.split_at_mut(pixels_len);
                let products = run.products(tiles.clone(), scratch);
                let plane = tiles.len() * area * 16;
                let place = Place::Tiles { at: pixels.as_mut_ptr(), plane };
                // SAFETY: `pixels` holds all pixels of at most `most` tiles, `values` the results of `TILES`
                // tiles; each job writes the pixels of its own tiles.
                unsafe {
                    let mut scatter = run.scatter(tiles.clone(), 0..channels, products);
                    scatter.place = place;
                    isa.run(scatter);
                    for first in (0..tiles.len()).step_by(TILES) {
                        let count = TILES.min(tiles.len() - first);
                        let rows = count * area;
                        let from = pixels.as_ptr().add(first * area * 16);
                        let to = layout(values.as_mut_ptr(), head.outputs() / 16, rows);
                        isa.run(Gemm {
                            weights: &head.weights,
                            panels: 0..head.weights.count(),
                            rows,
                            input: Rows { at: from, plane: 0, block: plane },
                            output: to,
                            bias: Some(head.bias.as_ptr()),
                            relu: false,
                        });
                        isa.run(Pixels {
                            from: to.as_const(),
                            to: output.get(),
                            blocks: head.outputs() / 16,
                            first: tiles.start + first,
                            tiles: count,
                            side: self.form.tile(),
                            grid: run.grid,
                            size: (height, width),
                            stream,
                        });
                    }
                }
            });
        });
        Ok(())
    }
}

/// Writes rows `[block][tile][pixel][16]` to the pixels' places in `[pixel][block][16]`.
struct Pixels {
    from: Rows<*const f32>,
    to: *mut f32,
    blocks: usize,
    first: usize,
    tiles: usize,
    side: usize,
    grid: (usize, usize),
    size: (usize, usize),
    /// Whether to write past the caches; `to` is then aligned to 64 bytes.
    stream: bool,
}

impl Kernel for Pixels {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (height, width) = self.size;
        let (rows, columns) = self.grid;
        // SAFETY: only pixels inside the picture are written.
        unsafe {
            for tile in 0..self.tiles {
                let index = self.first + tile;
                let (image, ty, tx) = (index / (rows * columns), index / columns % rows, index % columns);
                for pixel in 0..self.side * self.side {
                    let (y, x) = (ty * self.side + pixel / self.side, tx * self.side + pixel % self.side);
                    if y >= height || x >= width {
                        continue;
                    }
                    let from = self.from.at.add((tile * self.side * self.side + pixel) * 16);
                    let to = self.to.add(((image * height + y) * width + x) * self.blocks * 16);
                    for lane in (0..self.blocks * 16).step_by(V::LANES) {
                        let value = V::load(from.add(lane / 16 * self.from.block + lane % 16));
                        if self.stream {
                            value.stream(to.add(lane));
                        } else {
                            value.store(to.add(lane));
                        }
                    }
                }
            }
            if self.stream {
                V::splat(0.0).fence();
            }
        }
    }
}
