//! 16 lanes of AVX-512 whose matrix products are of bf16, two in each lane.

use super::avx512::F32x16;
use super::{Kernel, Vector};
use std::arch::x86_64::*;

/// 16 lanes.
#[derive(Clone, Copy)]
pub(super) struct Bf16x32(F32x16);

const _: () = assert!(F32x16::LANES == 16, "operands are stored a block of channels at a time");

/// Runs a kernel compiled for AVX-512 with bf16.
///
/// # Safety
/// The CPU must have the features; see [`Kernel::run`].
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx512bf16,avx2,fma")]
pub(super) unsafe fn run<K: Kernel>(kernel: K) {
    // SAFETY: the features are those of this function.
    unsafe { kernel.run::<Bf16x32>() }
}

// SAFETY of every block below: a value, or the caller of a constructor, vouches for AVX-512 with bf16 (see `Vector`);
// pointers are the caller's promise. Vectors are transmuted to others of their size, for which all bits are valid.
impl Vector for Bf16x32 {
    const LANES: usize = F32x16::LANES;
    const OPERANDS: usize = 2;
    const ROWS: usize = F32x16::ROWS;

    #[inline(always)]
    unsafe fn splat(x: f32) -> Self {
        unsafe { Self(F32x16::splat(x)) }
    }
    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self {
        unsafe { Self(F32x16::load(from)) }
    }
    #[inline(always)]
    unsafe fn store(self, to: *mut f32) {
        unsafe { self.0.store(to) }
    }
    #[inline(always)]
    unsafe fn stream(self, to: *mut f32) {
        unsafe { self.0.stream(to) }
    }
    #[inline(always)]
    unsafe fn store_operands(self, to: *mut f32) {
        unsafe {
            let halves = std::mem::transmute::<__m256bh, __m256i>(_mm512_cvtneps_pbh(self.0.0));
            _mm256_storeu_si256(to.cast(), halves);
        }
    }
    #[inline(always)]
    unsafe fn load_operands(from: *const f32, first: usize) -> Self {
        unsafe { Self::load(from.cast::<u16>().add(first).cast()) }
    }
    #[inline(always)]
    fn with_next(self, next: Self) -> Self {
        unsafe {
            let lane = |v: Self| {
                let halves = std::mem::transmute::<__m256bh, __m256i>(_mm512_cvtneps_pbh(v.0.0));
                _mm512_cvtepu16_epi32(halves)
            };
            let both = _mm512_or_si512(lane(self), _mm512_slli_epi32::<16>(lane(next)));
            Self(F32x16(_mm512_castsi512_ps(both)))
        }
    }
    #[inline(always)]
    fn multiply_add(self, b: Self, c: Self) -> Self {
        unsafe {
            let pairs = |v: Self| std::mem::transmute::<__m512, __m512bh>(v.0.0);
            Self(F32x16(_mm512_dpbf16_ps(c.0.0, pairs(self), pairs(b))))
        }
    }
    #[inline(always)]
    fn fence(self) {
        self.0.fence();
    }
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self(self.0.add(b.0))
    }
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self(self.0.sub(b.0))
    }
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self(self.0.mul(b.0))
    }
    #[inline(always)]
    fn fma(self, b: Self, c: Self) -> Self {
        Self(self.0.fma(b.0, c.0))
    }
    #[inline(always)]
    fn max(self, b: Self) -> Self {
        Self(self.0.max(b.0))
    }
    #[inline(always)]
    fn sum(self) -> f32 {
        self.0.sum()
    }
}
