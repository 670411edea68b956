//! The one matrix product under every layer: rows of 16-channel blocks times packed weights.

use crate::{AlignedBuf, Isa, simd::Kernel, simd::Vector};
use half::bf16;
use rayon::prelude::*;
use std::ops::Range;

/// Weights `[k, n]` of one or several products ("planes"), packed for an instruction set.
///
/// Memory order: plane, panel of output channels, input channel, channel of the panel. A panel is two vectors
/// wide (or 16 channels, where `n` leaves no more), which is what the micro-kernel keeps in registers. With bf16, two
/// input channels of a block lie together in the place of one f32.
#[derive(Clone)]
pub(crate) struct Panels {
    isa: Isa,
    planes: usize,
    n: usize,
    /// Packed values for each output channel.
    k: usize,
    /// Values for each block of 16 input channels: its channels in use, or pairs of them.
    valid: Vec<usize>,
    data: AlignedBuf,
}

impl Panels {
    /// Packs `weight(plane, k, n)`; `k` counts the channels in use of all blocks. `n` is a multiple of 16.
    pub(crate) fn pack(
        isa: Isa,
        planes: usize,
        valid: Vec<usize>,
        n: usize,
        weight: impl Fn(usize, usize, usize) -> f32 + Sync,
    ) -> Self {
        assert!(n.is_multiple_of(16), "output channels come in blocks of 16");
        // The channels of each value.
        let (mut channels, mut start) = (Vec::new(), 0);
        for &count in &valid {
            channels.extend((start..start + count).step_by(isa.operands()).map(|k| k..start + count));
            start += count;
        }
        let k = channels.len();
        let valid = valid.into_iter().map(|count| count.div_ceil(isa.operands())).collect();
        let mut panels = Self { isa, planes, n, k, valid, data: AlignedBuf::zeros(planes * k * n) };
        let width = panels.width();
        panels.data.par_chunks_mut((k * n).max(1)).enumerate().for_each(|(plane, data)| {
            for (q, data) in data.chunks_mut((k * width).max(1)).enumerate() {
                let wide = data.len() / k;
                for (i, w) in data.iter_mut().enumerate() {
                    let mut weights =
                        channels[i / wide].clone().map(|k| weight(plane, k, q * width + i % wide));
                    *w = match isa.operands() {
                        1 => weights.next().unwrap_or(0.0),
                        _ => pair(std::array::from_fn(|_| weights.next().unwrap_or(0.0))),
                    };
                }
            }
        });
        panels
    }

    /// Output channels of a full panel.
    pub(crate) fn width(&self) -> usize {
        (2 * self.isa.lanes()).max(16)
    }
    /// Panels of a plane.
    pub(crate) fn count(&self) -> usize {
        self.n.div_ceil(self.width())
    }
    /// Blocks of input channels.
    pub(crate) fn blocks(&self) -> usize {
        self.valid.len()
    }
    pub(crate) fn planes(&self) -> usize {
        self.planes
    }
    pub(crate) fn n(&self) -> usize {
        self.n
    }
    pub(crate) fn isa(&self) -> Isa {
        self.isa
    }
}

/// Two bf16 in the place of an f32, the first in its lower half.
pub(crate) fn pair(values: [f32; 2]) -> f32 {
    let [low, high] = values.map(|x| u32::from(bf16::from_f32(x).to_bits()));
    f32::from_bits(low | high << 16)
}

/// A matrix of `[plane][block of 16 channels][row][16]`.
#[derive(Clone, Copy)]
pub(crate) struct Rows<P> {
    pub(crate) at: P,
    /// Values from plane to plane.
    pub(crate) plane: usize,
    /// Values from block to block.
    pub(crate) block: usize,
}

impl Rows<*mut f32> {
    /// The same rows, to be read.
    pub(crate) fn as_const(self) -> Rows<*const f32> {
        Rows { at: self.at.cast_const(), plane: self.plane, block: self.block }
    }
}

/// `output = max(bias + input * weights, low)` for some panels of all planes. The input was stored as operands
/// ([`Vector::store_operands`]).
///
/// `input` and `output` must be valid for `rows` rows of all blocks (for the output: those of the panels,
/// counted from the first of them) and all planes, and not overlap; `bias` for `n` values.
pub(crate) struct Gemm<'a> {
    pub(crate) weights: &'a Panels,
    pub(crate) panels: Range<usize>,
    pub(crate) rows: usize,
    pub(crate) input: Rows<*const f32>,
    pub(crate) output: Rows<*mut f32>,
    /// None is zero.
    pub(crate) bias: Option<*const f32>,
    pub(crate) relu: bool,
}

/// The operands of one call of the micro-kernel.
#[derive(Clone, Copy)]
struct Tile<'a> {
    input: *const f32,
    block: usize,
    valid: &'a [usize],
    weights: *const f32,
    bias: *const f32,
    output: *mut f32,
    output_block: usize,
    low: f32,
}

static ZEROS: [f32; 64] = [0.0; 64];

impl Kernel for Gemm<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let w = self.weights;
        let width = w.width();
        for plane in 0..w.planes {
            for q in self.panels.clone() {
                let first = q * width;
                let wide = (w.n - first).min(width);
                // SAFETY: panel q of the plane starts after q full panels; input, output and bias as promised.
                unsafe {
                    let tile = Tile {
                        input: self.input.at.add(plane * self.input.plane),
                        block: self.input.block,
                        valid: &w.valid,
                        weights: w.data.as_ptr().add((plane * w.n + first) * w.k),
                        bias: self.bias.map_or(ZEROS.as_ptr(), |bias| bias.add(first)),
                        output: self.output.at.add(
                            plane * self.output.plane
                                + (first - self.panels.start * width) / 16 * self.output.block,
                        ),
                        output_block: self.output.block,
                        low: if self.relu { 0.0 } else { f32::NEG_INFINITY },
                    };
                    if wide == 2 * V::LANES {
                        rows::<V, 2>(tile, self.rows);
                    } else {
                        rows::<V, 1>(tile, self.rows);
                    }
                }
            }
        }
    }
}

/// All rows of a panel, in near-equal portions of at most `V::ROWS`.
#[inline(always)]
unsafe fn rows<V: Vector, const WIDE: usize>(tile: Tile<'_>, rows: usize) {
    let parts = rows.div_ceil(V::ROWS);
    let mut start = 0;
    for part in 0..parts {
        let count = (rows - start).div_ceil(parts - part);
        // SAFETY: rows start..start + count lie within `rows`.
        unsafe {
            let tile =
                Tile { input: tile.input.add(start * 16), output: tile.output.add(start * 16), ..tile };
            match count {
                1 => micro::<V, 1, WIDE>(tile),
                2 => micro::<V, 2, WIDE>(tile),
                3 => micro::<V, 3, WIDE>(tile),
                4 if V::ROWS >= 4 => micro::<V, 4, WIDE>(tile),
                5 if V::ROWS >= 5 => micro::<V, 5, WIDE>(tile),
                6 if V::ROWS >= 6 => micro::<V, 6, WIDE>(tile),
                7 if V::ROWS >= 7 => micro::<V, 7, WIDE>(tile),
                8 if V::ROWS >= 8 => micro::<V, 8, WIDE>(tile),
                9 if V::ROWS >= 9 => micro::<V, 9, WIDE>(tile),
                10 if V::ROWS >= 10 => micro::<V, 10, WIDE>(tile),
                11 if V::ROWS >= 11 => micro::<V, 11, WIDE>(tile),
                12 if V::ROWS >= 12 => micro::<V, 12, WIDE>(tile),
                13 if V::ROWS >= 13 => micro::<V, 13, WIDE>(tile),
                14 if V::ROWS >= 14 => micro::<V, 14, WIDE>(tile),
                _ => unreachable!("at most ROWS rows"),
            }
        }
        start += count;
    }
}

/// `ROWS` rows x `WIDE` vectors of output, held in registers over all of `k`.
#[inline(always)]
unsafe fn micro<V: Vector, const ROWS: usize, const WIDE: usize>(tile: Tile<'_>) {
    // SAFETY: every pointer stays within the operands described at `Gemm` and `Panels`.
    unsafe {
        let start: [V; WIDE] = std::array::from_fn(|v| V::load(tile.bias.add(v * V::LANES)));
        let mut sum = [start; ROWS];
        let mut w = tile.weights;
        for (b, &valid) in tile.valid.iter().enumerate() {
            let x = tile.input.add(b * tile.block);
            for i in 0..valid {
                let weights: [V; WIDE] = std::array::from_fn(|v| V::load(w.add(v * V::LANES)));
                w = w.add(WIDE * V::LANES);
                for (row, sum) in sum.iter_mut().enumerate() {
                    let x = V::splat(*x.add(row * 16 + i));
                    for (sum, weight) in sum.iter_mut().zip(weights) {
                        *sum = x.multiply_add(weight, *sum);
                    }
                }
            }
        }
        let low = V::splat(tile.low);
        for (row, sum) in sum.iter().enumerate() {
            for (v, sum) in sum.iter().enumerate() {
                let channel = v * V::LANES;
                let to = tile.output.add(channel / 16 * tile.output_block + row * 16 + channel % 16);
                sum.max(low).store(to);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;

    /// Two planes over blocks of 16, 5 and 12 channels; every number of rows around the micro-kernels' heights.
    #[test]
    fn equals_a_naive_product() {
        let valid = vec![16, 5, 12];
        let (planes, k) = (2, 33);
        for isa in Isa::available() {
            for n in [16, 32, 48, 96] {
                let w = noise(planes * k * n, 1);
                let bias = noise(n, 2);
                let panels =
                    Panels::pack(isa, planes, valid.clone(), n, |p, k_, n_| w[(p * k + k_) * n + n_]);
                for rows in (1..=30).chain([57]) {
                    let x = noise(planes * 3 * rows * 16, 3);
                    let mut y = vec![f32::NAN; planes * n * rows];
                    let gemm = Gemm {
                        weights: &panels,
                        panels: 0..panels.count(),
                        rows,
                        input: Rows { at: x.as_ptr(), plane: 3 * rows * 16, block: rows * 16 },
                        output: Rows { at: y.as_mut_ptr(), plane: n * rows, block: rows * 16 },
                        bias: Some(bias.as_ptr()),
                        relu: true,
                    };
                    // SAFETY: x and y hold all planes and blocks of `rows` rows.
                    unsafe { isa.run(gemm) };
                    for p in 0..planes {
                        for row in 0..rows {
                            for c in 0..n {
                                let mut sum = f64::from(bias[c]);
                                let mut at = 0;
                                for (b, valid) in valid.iter().enumerate() {
                                    for i in 0..*valid {
                                        let x = x[((p * 3 + b) * rows + row) * 16 + i];
                                        sum += f64::from(x) * f64::from(w[(p * k + at) * n + c]);
                                        at += 1;
                                    }
                                }
                                let y = y[(p * n / 16 + c / 16) * rows * 16 + row * 16 + c % 16];
                                assert!(
                                    (sum.max(0.0) - f64::from(y)).abs() < 1e-5,
                                    "{} n {n} rows {rows}",
                                    isa.name()
                                );
                            }
                        }
                    }
                }
            }
        }
    }
}
