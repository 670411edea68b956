//! Vectors of f32 behind one trait.
//!
//! An algorithm is written once, against [`Vector`], inside the `run` of a [`Kernel`]. [`Isa::run`] compiles
//! it for AVX-512, once more with products of bf16, for AVX2 with FMA, and for any CPU. Everything between `run` and the vector
//! operations must be `#[inline(always)]`: only code inlined into the function that carries
//! `#[target_feature]` is compiled with those features.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "x86_64")]
mod bf16;
mod portable;

use crate::isa::{Isa, Level};

/// One vector of f32 lanes.
///
/// A value can only come from the `unsafe` constructors, whose caller vouches for the CPU; so a value proves
/// that the CPU has the instructions, and arithmetic on it is safe.
pub(crate) trait Vector: Copy {
    /// Lanes of the vector; divides 16.
    const LANES: usize;
    /// Operands of a product in a lane.
    const OPERANDS: usize = 1;
    /// Rows of the matrix-product micro-kernel: rows x 2 vectors of accumulators fill the registers.
    const ROWS: usize;

    /// # Safety
    /// The CPU must have the instructions of this type.
    unsafe fn splat(x: f32) -> Self;
    /// # Safety
    /// As [`Vector::splat`]; `from` is valid for reading `LANES` values.
    unsafe fn load(from: *const f32) -> Self;
    /// # Safety
    /// `to` is valid for writing `LANES` values.
    unsafe fn store(self, to: *mut f32);
    /// Stores past the caches, for results that are not read again soon.
    ///
    /// # Safety
    /// As [`Vector::store`], and `to` is aligned to the vector's size. Call [`fence`](Vector::fence) before
    /// another thread reads it.
    unsafe fn stream(self, to: *mut f32);
    /// Stores channels of a row as operands of a matrix product. Vectors of bf16 hold all 16 channels of a block, and
    /// their operands take the first half of the block's place.
    ///
    /// # Safety
    /// As [`Vector::store`].
    #[inline(always)]
    unsafe fn store_operands(self, to: *mut f32) {
        // SAFETY: the caller's promise.
        unsafe { self.store(to) }
    }
    /// Loads operands that lie one after the other, from number `first` on.
    ///
    /// # Safety
    /// As [`Vector::load`], for `LANES * OPERANDS` of them.
    #[inline(always)]
    unsafe fn load_operands(from: *const f32, first: usize) -> Self {
        // SAFETY: the caller's promise.
        unsafe { Self::load(from.add(first)) }
    }
    /// The operands of each lane: of `self` and, where a lane has two, of `next`.
    #[inline(always)]
    fn with_next(self, _next: Self) -> Self {
        self
    }
    /// `c` plus the products of the operands in each lane.
    #[inline(always)]
    fn multiply_add(self, b: Self, c: Self) -> Self {
        self.fma(b, c)
    }
    /// Makes streamed values visible to other threads in order.
    fn fence(self);
    fn add(self, b: Self) -> Self;
    fn sub(self, b: Self) -> Self;
    fn mul(self, b: Self) -> Self;
    /// `self * b + c`.
    fn fma(self, b: Self, c: Self) -> Self;
    fn max(self, b: Self) -> Self;
    /// The sum of all lanes.
    fn sum(self) -> f32;

    /// All lanes `x`, on the CPU that `self` vouches for.
    #[inline(always)]
    fn same(self, x: f32) -> Self {
        // SAFETY: `self` exists, so the CPU has the instructions.
        unsafe { Self::splat(x) }
    }
    /// `self * k + c`.
    #[inline(always)]
    fn scale_add(self, k: f32, c: Self) -> Self {
        self.fma(self.same(k), c)
    }
    /// `self * k`.
    #[inline(always)]
    fn scale(self, k: f32) -> Self {
        self.mul(self.same(k))
    }
}

/// A computation that is compiled for every kind of vector.
pub(crate) trait Kernel {
    /// Runs on vectors of type `V`. Implementations are `#[inline(always)]`.
    ///
    /// # Safety
    /// The CPU must have the instructions of `V`; the pointers that the kernel holds must be valid as the
    /// kernel documents.
    unsafe fn run<V: Vector>(self);
}

impl Isa {
    /// Lanes of this instruction set's vectors.
    pub(crate) fn lanes(self) -> usize {
        match self.level() {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512 | Level::Bf16 => avx512::F32x16::LANES,
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => avx2::F32x8::LANES,
            Level::Portable => portable::F32x8::LANES,
        }
    }

    /// Operands of a matrix product in a lane of these vectors.
    pub(crate) fn operands(self) -> usize {
        match self.level() {
            #[cfg(target_arch = "x86_64")]
            Level::Bf16 => bf16::Bf16x32::OPERANDS,
            _ => 1,
        }
    }

    /// Runs a kernel with this instruction set's vectors.
    ///
    /// # Safety
    /// The pointers that the kernel holds must be valid as the kernel documents.
    pub(crate) unsafe fn run<K: Kernel>(self, kernel: K) {
        // SAFETY: an `Isa` exists only where the CPU has its instructions; the pointers are the caller's promise.
        unsafe {
            match self.level() {
                #[cfg(target_arch = "x86_64")]
                Level::Avx512 => avx512::run(kernel),
                #[cfg(target_arch = "x86_64")]
                Level::Bf16 => bf16::run(kernel),
                #[cfg(target_arch = "x86_64")]
                Level::Avx2 => avx2::run(kernel),
                Level::Portable => kernel.run::<portable::F32x8>(),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Axpy<'a> {
        x: &'a [f32],
        y: &'a mut [f32],
    }

    impl Kernel for Axpy<'_> {
        #[inline(always)]
        unsafe fn run<V: Vector>(self) {
            for (x, y) in self.x.chunks_exact(V::LANES).zip(self.y.chunks_exact_mut(V::LANES)) {
                // SAFETY: both chunks hold LANES values.
                unsafe {
                    let v = V::load(x.as_ptr());
                    let sum = v.scale_add(3.0, V::load(y.as_ptr())).max(v.sub(v.same(2.0)));
                    sum.add(v.scale(2.0)).mul(v.same(0.5)).store(y.as_mut_ptr());
                }
            }
        }
    }

    #[test]
    fn every_path_computes_the_same() {
        let x: Vec<f32> = (0..64).map(|i| i as f32 - 30.0).collect();
        for isa in Isa::available() {
            let mut y = vec![1.0; 64];
            // SAFETY: the kernel holds slices only.
            unsafe { isa.run(Axpy { x: &x, y: &mut y }) };
            for (x, y) in x.iter().zip(&y) {
                assert_eq!(*y, ((3.0 * x + 1.0).max(x - 2.0) + 2.0 * x) * 0.5, "{}", isa.name());
            }
        }
    }
}
