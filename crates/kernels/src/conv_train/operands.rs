//! What the inner loops multiply, as the instruction set wants it. With products of f32 there is nothing to do; with those of
//! bf16 two operands lie in the place of a value, and what is packed takes the first half of its scratch.

use crate::Isa;
use crate::gemm::pair;
use crate::simd::{Kernel, Vector};

/// Input channels whose products one instruction adds up: rows of operands for so many channels.
pub(super) fn groups(isa: Isa, channels: usize) -> usize {
    channels.div_ceil(isa.operands())
}

/// The operands of a weight: those of its channel and, where there are two, of the next.
pub(super) fn weights(isa: Isa, weight: f32, next: impl FnOnce() -> f32) -> f32 {
    if isa.operands() == 1 { weight } else { pair([weight, next()]) }
}

/// Puts the values of every two channels into one row of operands: `[channels, len]` becomes `[groups, len]`, in place.
pub(super) fn pack_channels(isa: Isa, x: &mut [f32], len: usize) {
    assert!(len.is_multiple_of(16) && x.len().is_multiple_of(len), "rows of whole vectors");
    if isa.operands() > 1 {
        // SAFETY: the rows are whole vectors, which is what `Kernel::run` below relies on.
        unsafe { isa.run(Channels { x, len }) }
    }
}

struct Channels<'a> {
    x: &'a mut [f32],
    len: usize,
}

impl Kernel for Channels<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let Self { x, len } = self;
        let (rows, x) = (x.len() / len, x.as_mut_ptr());
        for (group, first) in (0..rows).step_by(V::OPERANDS).enumerate() {
            for at in (0..len).step_by(V::LANES) {
                // SAFETY: both rows, where there is a second one, and the place of their group are rows of `x`. A vector is
                // written where all that lay there has been read.
                unsafe {
                    let one = V::load(x.add(first * len + at));
                    let next =
                        if first + 1 < rows { V::load(x.add((first + 1) * len + at)) } else { one.same(0.0) };
                    one.with_next(next).store(x.add(group * len + at));
                }
            }
        }
    }
}

/// Puts values that lie one after the other into operands that do, in place.
pub(super) fn pack_positions(isa: Isa, x: &mut [f32]) {
    assert!(x.len().is_multiple_of(16), "whole vectors");
    if isa.operands() > 1 {
        // SAFETY: `x` is whole vectors, which is what `Kernel::run` below relies on.
        unsafe { isa.run(Positions { x }) }
    }
}

struct Positions<'a> {
    x: &'a mut [f32],
}

impl Kernel for Positions<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (len, x) = (self.x.len(), self.x.as_mut_ptr());
        for at in (0..len).step_by(V::LANES) {
            // SAFETY: a vector lies below `len`, and its operands where all has been read.
            unsafe { V::load(x.add(at)).store_operands(x.add(at / V::OPERANDS)) }
        }
    }
}
