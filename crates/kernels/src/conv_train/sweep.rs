//! The common part of forward and input gradient: windows over packed planes, channels by the eight.

use rayon::prelude::*;

use super::CHANNELS;
use super::micro::Correlate;
use super::operands;
use super::planes::{Layout, Portion, Source};
use crate::Isa;
use crate::parallel::{Shared, with_scratch};

/// One sweep over all positions. A strided gradient needs several, each for its own phase of the output.
pub(super) struct Pass {
    pub(super) offsets: Vec<u32>,
    /// As [`pack_weights`] makes them.
    pub(super) weights: Vec<f32>,
    /// Position (y, x) is written to row `y * step + phase[0]`, column `x * step + phase[1]`.
    pub(super) phase: [usize; 2],
}

/// What is computed: `[batch, channels, height, width]`.
pub(super) struct Output<'a> {
    pub(super) channels: usize,
    pub(super) height: usize,
    pub(super) width: usize,
    pub(super) step: usize,
    pub(super) bias: Option<&'a [f32]>,
}

/// Weights in the order of the inner loop: blocks of [`CHANNELS`] outputs, then offsets, that is groups of input channels and
/// taps, then the outputs of the block. `weight` is asked for output, input channel and tap.
pub(super) fn pack_weights(
    isa: Isa,
    [outputs, channels, taps]: [usize; 3],
    weight: impl Fn(usize, usize, usize) -> f32 + Sync,
) -> Vec<f32> {
    let per_block = operands::groups(isa, channels) * taps * CHANNELS;
    let mut packed = vec![0.0; outputs.div_ceil(CHANNELS) * per_block];
    // Without taps there is nothing to pack.
    packed.par_chunks_mut(per_block.max(1)).enumerate().for_each(|(block, packed)| {
        let groups = (0..channels)
            .step_by(isa.operands())
            .flat_map(|channel| (0..taps).map(move |tap| (channel, tap)));
        for ((channel, tap), to) in groups.zip(packed.chunks_exact_mut(CHANNELS)) {
            for (o, to) in (block * CHANNELS..outputs).zip(to) {
                let next = || if channel + 1 < channels { weight(o, channel + 1, tap) } else { 0.0 };
                *to = operands::weights(isa, weight(o, channel, tap), next);
            }
        }
    });
    packed
}

/// Runs all passes. Together their phases cover every row and column of the output exactly once.
pub(super) fn sweep(
    isa: Isa,
    batch: usize,
    layout: &Layout,
    source: &Source<'_>,
    passes: &[Pass],
    output: &Output<'_>,
) -> Vec<f32> {
    let len = batch * output.channels * output.height * output.width;
    // Not zeroed: that would be one more pass over memory, and every value is written below.
    let mut out: Vec<f32> = Vec::with_capacity(len);
    let base = Shared(out.as_mut_ptr());
    let portions = layout.portions();
    let blocks = output.channels.div_ceil(CHANNELS);
    // Few portions: share out their channels as well, at the price of packing them again.
    let shares = (4 * rayon::current_num_threads()).div_ceil(portions).clamp(1, blocks);
    (0..portions * shares).into_par_iter().with_max_len(1).for_each(|job| {
        let portion = layout.portion(job / shares);
        let share = job % shares;
        let channels = share * blocks / shares..(share + 1) * blocks / shares;
        let packed = layout.scratch_len(source.channels);
        let positions = layout.positions(portion);
        let pitch = positions.next_multiple_of(16) + 16;
        with_scratch(packed + CHANNELS * pitch, |scratch| {
            let (x, rows) = scratch.split_at_mut(packed);
            layout.fill(source, portion, x);
            operands::pack_channels(isa, x, layout.channel_len());
            for pass in passes {
                for block in channels.clone() {
                    let first = block * CHANNELS;
                    let mut bias = [0.0; CHANNELS];
                    for (to, from) in bias.iter_mut().zip(output.bias.iter().flat_map(|b| &b[first..])) {
                        *to = *from;
                    }
                    let weights = CHANNELS * pass.offsets.len();
                    let weights = &pass.weights[block * weights..][..weights];
                    Correlate { x, offsets: &pass.offsets, weights, bias, out: rows, positions }.run_on(isa);
                    for (o, row) in (first..output.channels).zip(rows.chunks_exact(pitch)) {
                        write(layout, portion, row, pass.phase, output, o, base);
                    }
                }
            }
        });
    });
    // SAFETY: `len` values were reserved, and the portions, channels and phases above are all there are.
    unsafe { out.set_len(len) };
    out
}

/// Writes one channel of a portion to its place.
fn write(
    layout: &Layout,
    portion: Portion,
    from: &[f32],
    phase: [usize; 2],
    output: &Output<'_>,
    channel: usize,
    base: Shared,
) {
    let step = output.step;
    let columns = output.width.saturating_sub(phase[1]).div_ceil(step).min(layout.out_width());
    // Of a narrow output a phase has no column, and its first would be outside of the buffer.
    if columns == 0 {
        return;
    }
    for image in 0..portion.images {
        let plane = (portion.first_image + image) * output.channels + channel;
        for y in 0..portion.rows {
            let row = (portion.first_row + y) * step + phase[0];
            if row >= output.height {
                break;
            }
            let from = &from[layout.position(image, y)..][..columns];
            let at = (plane * output.height + row) * output.width + phase[1];
            // SAFETY: image, channel and row are in range, so at + (columns - 1) * step is within the buffer's `len`
            // values; no other job or pass has this portion, channel and phase.
            unsafe {
                let to = base.get().add(at);
                if step == 1 {
                    to.copy_from_nonoverlapping(from.as_ptr(), columns);
                } else {
                    from.iter().enumerate().for_each(|(x, value)| to.add(x * step).write(*value));
                }
            }
        }
    }
}
