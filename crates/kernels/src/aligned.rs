//! Memory aligned to cache lines.

/// One cache line, and one block of 16 channels of a pixel.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
struct Line([f32; 16]);

/// A growable buffer of f32 whose first value is aligned to 64 bytes. Always initialised.
#[derive(Clone, Default)]
pub struct AlignedBuf {
    lines: Vec<Line>,
    len: usize,
}

impl AlignedBuf {
    /// A buffer of `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let mut buf = Self::default();
        buf.resize(len);
        buf
    }

    /// Changes the length. Memory is only ever added: a smaller buffer keeps it for the next time, and values
    /// that stay or come back are whatever was there. A buffer that grows beyond what it ever held is all zeros.
    pub fn resize(&mut self, len: usize) {
        let lines = len.div_ceil(16);
        if lines > self.lines.len() {
            // A new allocation rather than `resize`, which would copy values that nobody wants. The buffer is empty until
            // there is one: allocating may panic.
            self.len = 0;
            self.lines = Vec::new();
            self.lines = vec![Line([0.0; 16]); lines];
        }
        self.len = len;
    }
}

impl std::ops::Deref for AlignedBuf {
    type Target = [f32];
    fn deref(&self) -> &[f32] {
        debug_assert!(self.len <= 16 * self.lines.len());
        // SAFETY: `resize` keeps `len <= 16 * lines.len()`, and a `Line` is exactly 16 initialised f32.
        unsafe { std::slice::from_raw_parts(self.lines.as_ptr().cast(), self.len) }
    }
}

impl std::ops::DerefMut for AlignedBuf {
    fn deref_mut(&mut self) -> &mut [f32] {
        debug_assert!(self.len <= 16 * self.lines.len());
        // SAFETY: as for `deref`; the borrow of `self` is exclusive.
        unsafe { std::slice::from_raw_parts_mut(self.lines.as_mut_ptr().cast(), self.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn is_aligned_and_keeps_its_memory() {
        let mut buf = AlignedBuf::zeros(1000);
        assert_eq!(buf.as_ptr() as usize % 64, 0);
        assert!(buf.iter().all(|x| *x == 0.0));
        let at = buf.as_ptr();
        buf.resize(10);
        assert_eq!(buf.len(), 10);
        buf.resize(1000);
        assert_eq!(buf.as_ptr(), at);
        assert!(AlignedBuf::default().is_empty());
    }

    #[test]
    fn is_empty_when_there_is_no_memory_for_more() {
        let mut buf = AlignedBuf::zeros(1000);
        // More bytes than there are addresses.
        let growing = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| buf.resize(usize::MAX)));
        assert!(growing.is_err() && buf.is_empty());
        buf.resize(1000);
        assert!(buf.iter().all(|x| *x == 0.0));
    }
}
