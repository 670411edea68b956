//! Sharing work between threads.

use crate::AlignedBuf;
use rayon::prelude::*;
use std::cell::RefCell;

thread_local! {
    static SCRATCH: RefCell<AlignedBuf> = RefCell::default();
}

/// Runs `job(0)`, ..., `job(n - 1)` on the threads of the current rayon pool. Which thread runs which job never
/// matters: no job reads what another writes.
pub(crate) fn for_each(n: usize, job: impl Fn(usize) + Sync + Send) {
    if n <= 1 || rayon::current_num_threads() == 1 {
        (0..n).for_each(job);
    } else {
        (0..n).into_par_iter().with_max_len(1).for_each(job);
    }
}

/// Runs `f` on a thread of the current rayon pool. Its loops then share their work at once; called from outside, each
/// would wake the pool, and its caller when it is done, which costs more than a small layer.
pub(crate) fn enter<R: Send>(f: impl FnOnce() -> R + Send) -> R {
    rayon::scope(|_| f())
}

/// Lends `f` this thread's scratch of at least `len` values, aligned to 64 bytes and holding anything.
pub(crate) fn with_scratch<R>(len: usize, f: impl FnOnce(&mut [f32]) -> R) -> R {
    SCRATCH.with(|scratch| {
        let mut scratch = scratch.borrow_mut();
        scratch.resize(len);
        f(&mut scratch)
    })
}

/// A pointer into a buffer of which every job writes its own part.
#[derive(Clone, Copy)]
pub(crate) struct Shared(pub(crate) *mut f32);

// SAFETY: it is only an address; whoever dereferences it promises that no two jobs touch the same values.

unsafe impl Send for Shared {}
// SAFETY: as above.

unsafe impl Sync for Shared {}

impl Shared {
    /// The address; a method, so that closures capture the whole `Shared` and not the bare pointer in it.
    pub(crate) fn get(self) -> *mut f32 {
        self.0
    }
}
