//! The two inner loops. Theirs, that of `operands` and that of `sweep`, which writes what they give, is the only pointer arithmetic
//! of the training convolutions.

use super::CHANNELS;
use crate::Isa;
use crate::simd::{Kernel, Vector};

/// Computes [`CHANNELS`] output channels at `positions` positions:
/// `out[o][p] = bias[o] + sum over k of weights[k][o] * x[p + offsets[k]]`, where `x` and `weights` hold as many operands in the
/// place of a value as the instruction set multiplies at once (see `operands`).
pub(super) struct Correlate<'a> {
    pub(super) x: &'a [f32],
    pub(super) offsets: &'a [u32],
    /// `[offsets.len(), CHANNELS]`
    pub(super) weights: &'a [f32],
    pub(super) bias: [f32; CHANNELS],
    /// `[CHANNELS, pitch]`; the pitch is `positions` rounded up to 16, or more.
    pub(super) out: &'a mut [f32],
    pub(super) positions: usize,
}

impl Correlate<'_> {
    pub(super) fn run_on(self, isa: Isa) {
        let rounded = self.positions.next_multiple_of(16);
        let furthest = self.offsets.iter().max().map_or(0, |&offset| offset as usize);
        assert!(furthest + rounded <= self.x.len(), "windows stay in the scratch");
        assert_eq!(self.weights.len(), CHANNELS * self.offsets.len());
        assert!(self.out.len() / CHANNELS >= rounded, "room for whole vectors of positions");
        // SAFETY: the checks above are what `Kernel::run` below relies on.
        unsafe { isa.run(self) }
    }
}

impl Kernel for Correlate<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let pitch = self.out.len() / CHANNELS;
        let vectors = self.positions.div_ceil(V::LANES);
        let mut done = 0;
        while done < vectors {
            let at = done * V::LANES;
            let count = (vectors - done).min(if V::LANES == 16 { 3 } else { 1 });
            // SAFETY: positions at..at + count * LANES lie below `positions` rounded up to 16, for which `run_on` has
            // checked the scratch at every offset and the rows of `out`; weights hold CHANNELS values per offset.
            unsafe {
                let (x, out) = (self.x.as_ptr().add(at), self.out.as_mut_ptr().add(at));
                match count {
                    3 => correlate::<V, 3>(x, self.offsets, self.weights.as_ptr(), &self.bias, out, pitch),
                    2 => correlate::<V, 2>(x, self.offsets, self.weights.as_ptr(), &self.bias, out, pitch),
                    _ => correlate::<V, 1>(x, self.offsets, self.weights.as_ptr(), &self.bias, out, pitch),
                }
            }
            done += count;
        }
    }
}

/// # Safety
/// Readable: `N` vectors at every offset of `x`, `CHANNELS` weights per offset. Writable: `N` vectors at each of
/// `CHANNELS` rows of `out`, `pitch` apart.
#[inline(always)]
unsafe fn correlate<V: Vector, const N: usize>(
    x: *const f32,
    offsets: &[u32],
    mut weights: *const f32,
    bias: &[f32; CHANNELS],
    out: *mut f32,
    pitch: usize,
) {
    // SAFETY: as promised by the caller.
    unsafe {
        let mut sums = bias.map(|bias| [V::splat(bias); N]);
        for &offset in offsets {
            let x = x.add(offset as usize);
            let x: [V; N] = std::array::from_fn(|v| V::load(x.add(v * V::LANES)));
            for (o, sums) in sums.iter_mut().enumerate() {
                let weight = V::splat(*weights.add(o));
                for (sum, x) in sums.iter_mut().zip(x) {
                    *sum = x.multiply_add(weight, *sum);
                }
            }
            weights = weights.add(CHANNELS);
        }
        for (o, sums) in sums.into_iter().enumerate() {
            for (v, sum) in sums.into_iter().enumerate() {
                sum.store(out.add(o * pitch + v * V::LANES));
            }
        }
    }
}

/// Adds to the weight gradient of up to [`CHANNELS`] output channels:
/// `gradient[o][k] += sum over p of dy[o][p] * x[p + offsets[k]]`, where `x` and `dy` are operands one after the other.
pub(super) struct Accumulate<'a> {
    pub(super) x: &'a [f32],
    pub(super) offsets: &'a [u32],
    /// `[CHANNELS, positions]`, whole vectors of operands, zero where a position is no output.
    pub(super) dy: &'a [f32],
    pub(super) positions: usize,
    /// `[at most CHANNELS, offsets.len()]`
    pub(super) gradient: &'a mut [f32],
}

impl Accumulate<'_> {
    pub(super) fn run_on(self, isa: Isa) {
        let furthest = self.offsets.iter().max().map_or(0, |&offset| offset as usize);
        assert!(self.positions.is_multiple_of(16 * isa.operands()), "whole vectors of positions");
        assert!(CHANNELS * self.positions <= self.dy.len() * isa.operands(), "rows of all channels");
        assert!(furthest + self.positions <= self.x.len() * isa.operands(), "windows stay in the scratch");
        assert!(self.gradient.len() <= CHANNELS * self.offsets.len());
        // SAFETY: the checks above are what `Kernel::run` below relies on.
        unsafe { isa.run(self) }
    }
}

impl Kernel for Accumulate<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (taps, positions) = (self.offsets.len(), self.positions);
        let together = if V::LANES == 16 { 3 } else { 1 };
        let mut k = 0;
        while k < taps {
            let count = if taps - k >= together { together } else { 1 };
            let mut add = |tap: usize, sums: [f32; CHANNELS]| {
                for (row, sum) in self.gradient.chunks_exact_mut(taps).zip(sums) {
                    row[k + tap] += sum;
                }
            };
            // SAFETY: `run_on` has checked the scratch for `positions` values at every offset; dy holds CHANNELS rows.
            unsafe {
                if count == 3 {
                    let offsets = [self.offsets[k], self.offsets[k + 1], self.offsets[k + 2]];
                    let sums = dot::<V, 3>(self.dy.as_ptr(), self.x.as_ptr(), offsets, positions);
                    sums.into_iter().enumerate().for_each(|(tap, sums)| add(tap, sums));
                } else {
                    let [sums] = dot::<V, 1>(self.dy.as_ptr(), self.x.as_ptr(), [self.offsets[k]], positions);
                    add(0, sums);
                }
            }
            k += count;
        }
    }
}

/// Dot products of [`CHANNELS`] rows of `dy` with `x` at `N` offsets.
///
/// # Safety
/// Readable: `positions` operands (whole vectors) at every offset of `x` and in each row of `dy`.
#[inline(always)]
unsafe fn dot<V: Vector, const N: usize>(
    dy: *const f32,
    x: *const f32,
    offsets: [u32; N],
    positions: usize,
) -> [[f32; CHANNELS]; N] {
    // SAFETY: as promised by the caller.
    unsafe {
        let mut sums = [[V::splat(0.0); N]; CHANNELS];
        for at in (0..positions).step_by(V::LANES * V::OPERANDS) {
            let x = offsets.map(|offset| V::load_operands(x, offset as usize + at));
            for (o, sums) in sums.iter_mut().enumerate() {
                let dy = V::load_operands(dy, o * positions + at);
                for (sum, x) in sums.iter_mut().zip(x) {
                    *sum = x.multiply_add(dy, *sum);
                }
            }
        }
        std::array::from_fn(|tap| std::array::from_fn(|o| sums[o][tap].sum()))
    }
}
