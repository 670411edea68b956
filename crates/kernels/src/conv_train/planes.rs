//! The scratch that holds a portion of the input, padded, as one long row of positions per channel.

use super::Part;

/// Source planes: parts of the channels, all `height` x `width` after doubling.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) parts: &'a [Part<'a>],
    pub(super) channels: usize,
    pub(super) height: usize,
    pub(super) width: usize,
}

/// A portion of the work: some images whole, or some output rows of one image.
#[derive(Clone, Copy)]
pub(super) struct Portion {
    pub(super) first_image: usize,
    pub(super) images: usize,
    pub(super) first_row: usize,
    pub(super) rows: usize,
}

/// How a portion lies in the scratch.
///
/// With stride s a channel becomes s x s planes, so that neighbours in a plane are neighbours of the output: value
/// (q, c) of plane (a, b) is the source at row (first + q) s + a - padding, column c s + b - padding.
pub(super) struct Layout {
    batch: usize,
    stride: usize,
    padding: usize,
    /// Rows and columns that windows reach beyond their position.
    reach: usize,
    out_height: usize,
    out_width: usize,
    /// Positions from row to row.
    pitch: usize,
    /// Rows from image to image of a portion.
    image_rows: usize,
    rows: usize,
    images: usize,
    /// Values of a plane.
    plane: usize,
}

/// Offset of a kernel's tap: plane (a, b), then rows and columns within it.
#[derive(Clone, Copy)]
pub(super) struct Tap {
    pub(super) plane: [usize; 2],
    pub(super) row: usize,
    pub(super) column: usize,
}

/// The most positions that a call of the inner loop computes beyond the last one.
const SLACK: usize = 16;

impl Layout {
    /// For outputs of `out` rows and columns; portions of about `positions` positions.
    pub(super) fn new(
        batch: usize,
        source: &Source<'_>,
        out: [usize; 2],
        stride: usize,
        padding: usize,
        reach: usize,
        positions: usize,
    ) -> Self {
        let [out_height, out_width] = out;
        // Where the output is as large as the input, the padding right of a row serves as the one left of the next.
        let shared = stride == 1 && reach == 2 * padding && out == [source.height, source.width];
        let pitch = if shared { out_width + padding } else { out_width + reach };
        let whole = (out_height + reach) * pitch;
        let (rows, images) = if out_height * pitch >= positions {
            let portions = out_height.div_ceil((positions / pitch).max(1));
            (out_height.div_ceil(portions), 1)
        } else {
            (out_height, (positions / whole).clamp(1, batch))
        };
        let image_rows = if shared && rows == out_height { out_height + padding } else { rows + reach };
        let plane = ((images * image_rows + reach) * pitch + reach + SLACK).next_multiple_of(16) + 16;
        Self { batch, stride, padding, reach, out_height, out_width, pitch, image_rows, rows, images, plane }
    }

    fn by_image(&self) -> bool {
        self.rows == self.out_height
    }

    /// Number of portions.
    pub(super) fn portions(&self) -> usize {
        if self.by_image() {
            self.batch.div_ceil(self.images)
        } else {
            self.batch * self.out_height.div_ceil(self.rows)
        }
    }

    /// Portion `i`.
    pub(super) fn portion(&self, i: usize) -> Portion {
        if self.by_image() {
            let first_image = i * self.images;
            let images = self.images.min(self.batch - first_image);
            Portion { first_image, images, first_row: 0, rows: self.out_height }
        } else {
            let per_image = self.out_height.div_ceil(self.rows);
            let first_row = i % per_image * self.rows;
            let rows = self.rows.min(self.out_height - first_row);
            Portion { first_image: i / per_image, images: 1, first_row, rows }
        }
    }

    /// Positions of a portion, those between rows and images included.
    pub(super) fn positions(&self, portion: Portion) -> usize {
        ((portion.images - 1) * self.image_rows + portion.rows) * self.pitch
    }

    /// Position of the first column of a row of the portion's image.
    pub(super) fn position(&self, image: usize, row: usize) -> usize {
        (image * self.image_rows + row) * self.pitch
    }

    /// Columns that are outputs.
    pub(super) fn out_width(&self) -> usize {
        self.out_width
    }

    /// Values of the scratch.
    pub(super) fn scratch_len(&self, channels: usize) -> usize {
        channels * self.channel_len()
    }

    /// Values of a channel in the scratch, a multiple of 16.
    pub(super) fn channel_len(&self) -> usize {
        self.stride * self.stride * self.plane
    }

    /// For every channel and tap the offset from an output's position to the source value it needs.
    pub(super) fn offsets(&self, channels: usize, taps: &[Tap]) -> Vec<u32> {
        let of = |channel: usize, tap: &Tap| {
            let plane = (channel * self.stride + tap.plane[0]) * self.stride + tap.plane[1];
            (plane * self.plane + tap.row * self.pitch + tap.column) as u32
        };
        (0..channels).flat_map(|channel| taps.iter().map(move |tap| of(channel, tap))).collect()
    }

    /// Fills the scratch with a portion.
    pub(super) fn fill(&self, source: &Source<'_>, portion: Portion, scratch: &mut [f32]) {
        let s = self.stride;
        let mut planes = scratch.chunks_exact_mut(self.plane);
        for part in source.parts {
            let shift = u32::from(part.doubled);
            let (height, width) = (source.height >> shift, source.width >> shift);
            for channel in 0..part.channels {
                for (a, b) in (0..s).flat_map(|a| (0..s).map(move |b| (a, b))) {
                    let Some(plane) = planes.next() else { return };
                    plane.fill(0.0);
                    for image in 0..portion.images {
                        let index = (portion.first_image + image) * part.channels + channel;
                        let from = &part.planes[index * height * width..][..height * width];
                        for q in 0..portion.rows + self.reach {
                            let row = ((portion.first_row + q) * s + a).wrapping_sub(self.padding);
                            if row < source.height {
                                let from = &from[(row >> shift) * width..][..width];
                                let to = &mut plane[self.position(image, q)..][..self.pitch];
                                self.fill_row(from, source.width, b, part.doubled, to);
                            }
                        }
                    }
                }
            }
        }
    }

    /// Copies every `stride`-th column of a row of `width` columns, beginning so that column 0 is at `padding`.
    fn fill_row(&self, from: &[f32], width: usize, b: usize, doubled: bool, to: &mut [f32]) {
        let s = self.stride;
        let skip = self.padding.saturating_sub(b).div_ceil(s);
        let first = skip * s + b - self.padding;
        if first >= width {
            return;
        }
        let count = (width - first).div_ceil(s).min(to.len().saturating_sub(skip));
        let Some(to) = to.get_mut(skip..skip + count) else { return };
        match (s, doubled) {
            (1, false) => to.copy_from_slice(&from[first..first + count]),
            (1, true) if first == 0 => {
                let (pairs, last) = to.as_chunks_mut::<2>();
                for (pair, value) in pairs.iter_mut().zip(from) {
                    *pair = [*value; 2];
                }
                if let [last] = last {
                    *last = from[pairs.len()];
                }
            }
            (_, false) => {
                for (to, from) in to.iter_mut().zip(from[first..].iter().step_by(s)) {
                    *to = *from;
                }
            }
            (_, true) => {
                for (i, to) in to.iter_mut().enumerate() {
                    *to = from[(first + i * s) / 2];
                }
            }
        }
    }
}
