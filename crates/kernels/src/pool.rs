//! Maximum over 3x3 windows at every second pixel.

use crate::parallel::{self, Shared};
use crate::simd::{Kernel, Vector};
use crate::{Blocked, Isa};

/// The maximum over each 3x3 window around every second pixel; windows are cut at the border. The output takes
/// the shape `[images, channels, ceil(height / 2), ceil(width / 2)]`.
pub fn max_pool(isa: Isa, input: &Blocked, output: &mut Blocked) {
    let (height, width) = (input.height().div_ceil(2), input.width().div_ceil(2));
    output.reshape(input.images(), input.channels(), height, width);
    let (from, plane) = (input.data(), output.plane_len());
    let to = Shared(output.data_mut().as_mut_ptr());
    parallel::for_each(input.images() * input.blocks(), |block| {
        let pool = Pool {
            from: &from[block * input.plane_len()..(block + 1) * input.plane_len()],
            // SAFETY: each job writes its own plane of `height * width` pixels.
            to: unsafe { to.get().add(block * plane) },
            size: (input.height(), input.width()),
        };
        // SAFETY: as above.
        unsafe { isa.run(pool) };
    });
}

/// One block of 16 channels; `to` holds the pooled pixels.
struct Pool<'a> {
    from: &'a [f32],
    to: *mut f32,
    size: (usize, usize),
}

impl Kernel for Pool<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let (height, width) = self.size;
        assert!(self.from.len() >= height * width * 16, "a plane of pixels");
        let columns = width.div_ceil(2);
        for y in 0..height.div_ceil(2) {
            let rows = (2 * y).saturating_sub(1)..(2 * y + 2).min(height);
            for x in 0..columns {
                let around = (2 * x).saturating_sub(1)..(2 * x + 2).min(width);
                for lane in (0..16).step_by(V::LANES) {
                    // SAFETY: rows and columns are inside the plane.
                    unsafe {
                        let mut most = V::splat(f32::NEG_INFINITY);
                        for row in rows.clone() {
                            for column in around.clone() {
                                most = most
                                    .max(V::load(self.from.as_ptr().add((row * width + column) * 16 + lane)));
                            }
                        }
                        most.store(self.to.add((y * columns + x) * 16 + lane));
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;

    #[test]
    fn equals_naive_loops() {
        for (images, channels, height, width) in [(1, 16, 8, 8), (2, 20, 7, 9), (1, 1, 1, 1), (1, 40, 2, 5)] {
            let values = noise(images * channels * height * width, 1);
            let input = Blocked::from_nchw(&values, images, channels, height, width).unwrap();
            let mut expected = Vec::new();
            for plane in values.chunks_exact(height * width) {
                for y in (0..height).step_by(2) {
                    for x in (0..width).step_by(2) {
                        let (rows, columns) =
                            (y.max(1) - 1..(y + 2).min(height), x.max(1) - 1..(x + 2).min(width));
                        let window = rows.flat_map(|y| columns.clone().map(move |x| plane[y * width + x]));
                        expected.push(window.fold(f32::MIN, f32::max));
                    }
                }
            }
            for isa in Isa::available().into_iter().chain(Isa::bf16()) {
                let mut output = Blocked::default();
                max_pool(isa, &input, &mut output);
                assert_eq!(output.to_nchw(), expected, "{}", isa.name());
            }
        }
    }
}
