//! An allocator for programs that train: large blocks are kept for the next step instead of being given back.
#![allow(unsafe_code, reason = "that is what allocators are made of")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::UnsafeCell;
use std::ptr::null_mut;
use std::sync::atomic::{AtomicBool, Ordering};

/// The system's allocator, which keeps blocks of a MiB or more when they are freed.
///
/// A training step allocates the same dozens of tensors every time. Given back to the system, each must be mapped and
/// cleared again: with an allocator that does (mimalloc 3 as it comes) a step takes twice the processor time. For binaries:
///
/// ```
/// #[global_allocator]
/// static ALLOCATOR: where2act_kernels::KeepLarge = where2act_kernels::KeepLarge::new();
/// # fn main() {}
/// ```
pub struct KeepLarge {
    locked: AtomicBool,
    bins: UnsafeCell<Bins>,
}

/// Freed blocks by size class, each the head of a list whose links are in the blocks themselves.
struct Bins {
    heads: [*mut u8; CLASSES],
    bytes: usize,
}

/// Blocks from this size on are kept.
const SMALLEST: u32 = 20;
/// Sizes between a power of two and the next, as a power of two: a block is at most an eighth larger than asked for.
const STEPS: u32 = 3;
/// Up to a TiB.
const CLASSES: usize = 20 << STEPS;
/// Alignment of every large block: a page.
const ALIGN: usize = 4096;
/// More than this is given back after all.
const MOST: usize = 12 << 30;

// SAFETY: the bins are only touched by whoever holds the lock, and their blocks belong to nobody else.
unsafe impl Sync for KeepLarge {}

impl KeepLarge {
    /// An allocator that keeps nothing yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            locked: AtomicBool::new(false),
            bins: UnsafeCell::new(Bins { heads: [null_mut(); CLASSES], bytes: 0 }),
        }
    }

    /// Runs `f` alone. It must neither allocate nor panic.
    fn with_bins<R>(&self, f: impl FnOnce(&mut Bins) -> R) -> R {
        while self.locked.compare_exchange_weak(false, true, Ordering::Acquire, Ordering::Relaxed).is_err() {
            std::hint::spin_loop();
        }
        // SAFETY: the lock is held, so this is the only reference.
        let result = f(unsafe { &mut *self.bins.get() });
        self.locked.store(false, Ordering::Release);
        result
    }
}

impl Default for KeepLarge {
    fn default() -> Self {
        Self::new()
    }
}

/// Gives back what is kept. An allocator of a whole program is never dropped.
impl Drop for KeepLarge {
    fn drop(&mut self) {
        for (class, head) in self.bins.get_mut().heads.iter_mut().enumerate() {
            let Some(whole) = layout(class) else { continue };
            while !head.is_null() {
                // SAFETY: kept blocks belong to nobody, begin with the link to the next, and come from the system with
                // the layout of their class.
                unsafe {
                    let next = head.cast::<*mut u8>().read();
                    System.dealloc(*head, whole);
                    *head = next;
                }
            }
        }
    }
}

/// The layout of all blocks of a class.
fn layout(class: usize) -> Option<Layout> {
    let steps = (class & ((1 << STEPS) - 1)) + (1 << STEPS);
    Layout::from_size_align(steps << (SMALLEST - STEPS) << (class >> STEPS), ALIGN).ok()
}

/// Size class of a large block, and the layout that all blocks of the class have; None for others.
fn class(wanted: Layout) -> Option<(usize, Layout)> {
    let power =
        wanted.size().checked_ilog2().filter(|power| *power >= SMALLEST && wanted.align() <= ALIGN)?;
    let step = power - STEPS;
    let steps = wanted.size().checked_add((1 << step) - 1)? >> step;
    let class = ((power - SMALLEST) << STEPS) as usize + steps - (1 << STEPS);
    (class < CLASSES).then_some((class, layout(class)?))
}

// SAFETY: large blocks are blocks of the system allocator with the layout of their class, which fits every layout of the
// class; a kept block is on one list and is taken off before it is handed out. All else is the system's.
unsafe impl GlobalAlloc for KeepLarge {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let Some((class, whole)) = class(layout) else {
            // SAFETY: the caller's layout.
            return unsafe { System.alloc(layout) };
        };
        let kept = self.with_bins(|bins| {
            let block = bins.heads[class];
            if !block.is_null() {
                // SAFETY: kept blocks are large, aligned, and begin with the link to the next.
                bins.heads[class] = unsafe { block.cast::<*mut u8>().read() };
                bins.bytes -= whole.size();
            }
            block
        });
        if !kept.is_null() {
            return kept;
        }
        // SAFETY: the class's layout is not empty.
        unsafe { System.alloc(whole) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if class(layout).is_none() {
            // SAFETY: the caller's layout.
            return unsafe { System.alloc_zeroed(layout) };
        }
        // SAFETY: the caller's layout; the block has at least its size.
        unsafe {
            let block = self.alloc(layout);
            if !block.is_null() {
                block.write_bytes(0, layout.size());
            }
            block
        }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        let Some((class, whole)) = class(layout) else {
            // SAFETY: `alloc` passed this layout to the system as well.
            return unsafe { System.dealloc(block, layout) };
        };
        let kept = self.with_bins(|bins| {
            let room = bins.bytes + whole.size() <= MOST;
            if room {
                // SAFETY: the block is free, large and aligned.
                unsafe { block.cast::<*mut u8>().write(bins.heads[class]) };
                bins.heads[class] = block;
                bins.bytes += whole.size();
            }
            room
        });
        if !kept {
            // SAFETY: large blocks come from the system with the layout of their class.
            unsafe { System.dealloc(block, whole) };
        }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: the caller promises a valid size for this alignment.
        let new = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
        let (old_class, new_class) = (class(layout), class(new));
        match (old_class, new_class) {
            // SAFETY: both layouts are the system's.
            (None, None) => unsafe { System.realloc(block, layout, size) },
            (Some(old), Some(new)) if old == new => block,
            // SAFETY: the new block has room for the smaller of both sizes and is another one.
            _ => unsafe {
                let to = self.alloc(new);
                if !to.is_null() {
                    to.copy_from_nonoverlapping(block, layout.size().min(size));
                    self.dealloc(block, layout);
                }
                to
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_fit_and_waste_little() {
        for size in (1usize << 20..1 << 23).step_by(4099).chain([(1 << 21) - 1, 1 << 21, (1 << 30) + 1]) {
            let (index, whole) = class(Layout::from_size_align(size, 4).unwrap()).unwrap();
            assert!(whole.size() >= size && whole.size() <= size + size / 8);
            assert_eq!(class(whole), Some((index, whole)), "a class contains its own size");
        }
        assert_eq!(class(Layout::from_size_align((1 << 20) - 1, 4).unwrap()), None);
        assert_eq!(class(Layout::from_size_align(1 << 21, 2 * ALIGN).unwrap()), None);
    }

    #[test]
    fn blocks_come_back_zeroed_on_request_and_keep_their_values_when_they_grow() {
        let keep = KeepLarge::new();
        let layout = Layout::from_size_align(3 << 20, 4).unwrap();
        // SAFETY: blocks are used within their layouts and freed once, with the layout they have then.
        unsafe {
            let first = keep.alloc(layout);
            first.write_bytes(7, layout.size());
            keep.dealloc(first, layout);
            let again = keep.alloc_zeroed(layout);
            assert_eq!(again, first);
            assert!(std::slice::from_raw_parts(again, layout.size()).iter().all(|v| *v == 0));
            again.write_bytes(9, layout.size());
            let larger = keep.realloc(again, layout, 5 << 20);
            assert!(std::slice::from_raw_parts(larger, layout.size()).iter().all(|v| *v == 9));
            let small = keep.realloc(larger, Layout::from_size_align(5 << 20, 4).unwrap(), 100);
            assert!(std::slice::from_raw_parts(small, 100).iter().all(|v| *v == 9));
            keep.dealloc(small, Layout::from_size_align(100, 4).unwrap());
        }
    }

    #[test]
    fn threads_share_it() {
        let keep = KeepLarge::new();
        std::thread::scope(|scope| {
            for thread in 0..4u8 {
                let keep = &keep;
                scope.spawn(move || {
                    for i in 0..200usize {
                        let layout = Layout::from_size_align((1 << 20) + i % 7 * 300_000, 64).unwrap();
                        // SAFETY: as above.
                        unsafe {
                            let block = keep.alloc(layout);
                            block.write_bytes(thread, layout.size());
                            assert_eq!((*block, *block.add(layout.size() - 1)), (thread, thread));
                            keep.dealloc(block, layout);
                        }
                    }
                });
            }
        });
    }
}
