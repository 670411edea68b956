//! The first layer: a large kernel on a picture of few channels.

use super::scatter::{Place, Scatter};
use super::{Weights, layout, parallel};
use crate::gemm::{Gemm, Panels, Rows};
use crate::parallel::Shared;
use crate::simd::{Kernel, Vector};
use crate::{AlignedBuf, Blocked, Form, Isa, ShapeError};

/// Pictures `[images][height + 2 pad][width + 2 pad][channels]` with a border of zeros.
#[derive(Default)]
pub struct Picture {
    data: AlignedBuf,
    images: usize,
    channels: usize,
    height: usize,
    width: usize,
    pad: usize,
}

impl Picture {
    /// Takes pictures `[images, channels, height, width]`, giving them a border.
    ///
    /// # Errors
    /// When `values` has another length.
    pub fn fill(&mut self, values: &[f32], shape: [usize; 4], pad: usize) -> Result<(), ShapeError> {
        let [images, channels, height, width] = shape;
        let count = ShapeError::product("values of the pictures", &shape)?;
        ShapeError::check("values of the pictures", count, values.len())?;
        let padded = |side: usize| pad.saturating_mul(2).saturating_add(side);
        let sizes = [images, padded(height), padded(width), channels.max(1), 2];
        ShapeError::product("values of the pictures with their borders", &sizes)?;
        *self = Self { data: std::mem::take(&mut self.data), images, channels, height, width, pad };
        let row = self.row();
        // One block more than the pictures: the stem reads whole blocks of 16 values.
        self.data.resize(images * self.image_len() + 16);
        self.data.fill(0.0);
        for (plane, values) in values.chunks_exact((height * width).max(1)).enumerate() {
            let (image, c) = (plane / channels, plane % channels);
            for (y, values) in values.chunks_exact(width).enumerate() {
                let at = image * (height + 2 * pad) * row + (y + pad) * row + pad * channels;
                let row = self.data[at..at + width * channels].iter_mut().skip(c).step_by(channels);
                row.zip(values).for_each(|(to, value)| *to = *value);
            }
        }
        Ok(())
    }

    /// The pixels as [`Source::Split`](crate::Source::Split) expects them: four times the channels on a
    /// quarter of the pixels. Height and width are even.
    pub fn split(&self, maps: &mut Blocked) {
        maps.reshape(self.images, 4 * self.channels, self.height / 2, self.width / 2);
        let (image_len, plane_len, width) = (maps.image_len(), maps.plane_len(), maps.width());
        let row = self.row();
        let data = maps.data_mut();
        for image in 0..self.images {
            for c in 0..4 * self.channels {
                let to = image * image_len + c / 16 * plane_len + c % 16;
                let (channel, dy, dx) = (c / 4, c / 2 % 2, c % 2);
                for y in 0..self.height / 2 {
                    let from = image * self.image_len()
                        + (2 * y + dy + self.pad) * row
                        + (dx + self.pad) * self.channels
                        + channel;
                    for x in 0..width {
                        data[to + (y * width + x) * 16] = self.data[from + 2 * x * self.channels];
                    }
                }
            }
        }
    }

    fn row(&self) -> usize {
        (self.width + 2 * self.pad) * self.channels
    }
    fn image_len(&self) -> usize {
        (self.height + 2 * self.pad) * self.row()
    }
}

/// A strided convolution of a [`Picture`], with ReLU.
#[derive(Clone)]
pub struct Stem {
    weights: Panels,
    bias: AlignedBuf,
    size: usize,
    stride: usize,
    channels: usize,
    outputs: usize,
}

/// Output pixels of a job.
const ROWS: usize = 56;

impl Stem {
    /// Packs weights `[outputs, channels, size, size]`.
    ///
    /// # Errors
    /// When the sizes disagree.
    pub fn new(
        isa: Isa,
        weights: Weights<'_>,
        channels: usize,
        size: usize,
        stride: usize,
    ) -> Result<Self, ShapeError> {
        let area = size * size;
        ShapeError::check("steps of the stem (1 is more than none)", 1, stride.min(1))?;
        ShapeError::check("weights of the stem", weights.outputs * channels * area, weights.kernel.len())?;
        let padded = weights.outputs.next_multiple_of(16);
        let mut bias = AlignedBuf::zeros(padded);
        if let Some(values) = weights.bias {
            ShapeError::check("bias of the stem", weights.outputs, values.len())?;
            bias[..values.len()].copy_from_slice(values);
        }
        // A row of the window is contiguous: size x channels values in blocks of 16, the last in part.
        let run = size * channels;
        let row: Vec<usize> = (0..run.div_ceil(16)).map(|b| (run - 16 * b).min(16)).collect();
        let panels = Panels::pack(isa, 1, row.repeat(size), padded, |_, k, n| {
            let (y, x, c) = (k / run, k % run / channels, k % channels);
            if n < weights.outputs { weights.kernel[(n * channels + c) * area + y * size + x] } else { 0.0 }
        });
        Ok(Self { weights: panels, bias, size, stride, channels, outputs: weights.outputs })
    }

    /// Computes `max(conv(picture), 0)`.
    ///
    /// # Errors
    /// When the picture has other channels.
    pub fn run(&self, picture: &Picture, output: &mut Blocked) -> Result<(), ShapeError> {
        ShapeError::check("channels of the picture", self.channels, picture.channels)?;
        let form = Form::Direct { size: self.size, stride: self.stride, pad: picture.pad };
        let (height, width) = form.output_size((picture.height, picture.width));
        output.reshape(picture.images, self.outputs, height, width);
        let (image, plane) = (output.image_len(), output.plane_len());
        let at = Shared(output.data_mut().as_mut_ptr());
        let weights = &self.weights;
        let (isa, blocks) = (weights.isa(), weights.n() / 16);
        let tiles = picture.images * height * width;
        let jobs = tiles.div_ceil(ROWS);
        parallel::for_each(jobs, |job| {
            let tiles = job * tiles / jobs..(job + 1) * tiles / jobs;
            let rows = tiles.len();
            let (input_len, output_len) =
                (layout((), weights.blocks(), rows).plane, layout((), blocks, rows).plane);
            parallel::with_scratch(input_len + output_len, |scratch| {
                let (input, products) = scratch.split_at_mut(input_len);
                let input = layout(input.as_mut_ptr(), weights.blocks(), rows);
                let products = layout(products.as_mut_ptr(), blocks, rows);
                // SAFETY: the scratch holds rows and products; each job writes its own pixels.
                unsafe {
                    isa.run(Windows {
                        picture,
                        stem: self,
                        size: (height, width),
                        first: tiles.start,
                        rows,
                        to: input,
                    });
                    isa.run(Gemm {
                        weights,
                        panels: 0..weights.count(),
                        rows,
                        input: input.as_const(),
                        output: products,
                        bias: None,
                        relu: false,
                    });
                    isa.run(Scatter {
                        form,
                        grid: (height, width),
                        tiles,
                        blocks: 0..blocks,
                        output_blocks: blocks,
                        from: products.as_const(),
                        bias: self.bias.as_ptr(),
                        relu: true,
                        place: Place::Map { at: at.get(), add: None, image, plane, height, width },
                    });
                }
            });
        });
        Ok(())
    }
}

/// Copies the rows of each output pixel's window, in blocks of 16 values. `to` must hold `rows` rows.
struct Windows<'a> {
    picture: &'a Picture,
    stem: &'a Stem,
    size: (usize, usize),
    first: usize,
    rows: usize,
    to: Rows<*mut f32>,
}

impl Kernel for Windows<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (height, width) = self.size;
        let Stem { size, stride, channels, .. } = *self.stem;
        let blocks = (size * channels).div_ceil(16);
        let row_len = self.picture.row();
        for row in 0..self.rows {
            let pixel = self.first + row;
            let (image, y, x) = (pixel / (height * width), pixel / width % height, pixel % width);
            let from = image * self.picture.image_len() + y * stride * row_len + x * stride * channels;
            for ky in 0..size {
                for block in 0..blocks {
                    let from = from + ky * row_len + block * 16;
                    // Inside the picture, or in the block behind it where a window ends at its last pixel.
                    let values = &self.picture.data[from..from + 16];
                    // SAFETY: 16 values in the picture, and a row of the scratch.
                    unsafe {
                        let to = self.to.at.add((ky * blocks + block) * self.to.block + row * 16);
                        for lane in (0..16).step_by(V::LANES) {
                            V::load(values.as_ptr().add(lane)).store_operands(to.add(lane));
                        }
                    }
                }
            }
        }
    }
}
