//! What is surely hidden: the farthest surface of every square of samples.

use super::raster::Region;

/// Samples in a row, and rows, of a tile.
pub(super) const SIDE: usize = 8;

/// For every tile of a region, how near all of its samples are at least.
#[derive(Default)]
pub(super) struct Tiles {
    /// The upper left sample, and tiles in a row.
    left: usize,
    top: usize,
    columns: usize,
    /// Least 1 / depth, of a time at which everything was no nearer than it is now.
    nearness: Vec<f32>,
    /// Whether something was drawn since.
    changed: Vec<bool>,
}

impl Tiles {
    /// Makes them the tiles of a region where nothing was drawn, in the same memory.
    pub(super) fn clear(&mut self, region: &Region) {
        let tiles = region.width().div_ceil(SIDE) * region.height().div_ceil(SIDE);
        (self.left, self.top, self.columns) = (region.left, region.top, region.width().div_ceil(SIDE));
        self.nearness.clear();
        self.nearness.resize(tiles, 0.0);
        self.changed.clear();
        self.changed.resize(tiles, false);
    }

    /// Whether everything at the samples of `bounds` is nearer than something of a nearness.
    pub(super) fn hide(&self, bounds: &Region, nearness: f32) -> bool {
        self.rows(bounds).all(|tiles| self.nearness[tiles].iter().all(|&n| n > nearness))
    }

    /// Notes that something may have been drawn at the samples of `bounds`.
    pub(super) fn change(&mut self, bounds: &Region) {
        for tiles in self.rows(bounds) {
            self.changed[tiles].fill(true);
        }
    }

    /// Looks again at what was drawn: 1 / depth of the samples of the region in rows of `width`, and [`SIDE`] infinite
    /// numbers.
    pub(super) fn update(&mut self, samples: &[f32], width: usize) {
        for (tile, changed) in self.changed.iter_mut().enumerate().filter(|(_, changed)| **changed) {
            *changed = false;
            let (column, row) = (tile % self.columns, tile / self.columns);
            let first = row * SIDE * width + column * SIDE;
            let mut least = [f32::INFINITY; SIDE];
            // Beyond the end of a row the next one begins: that can only make a tile seem farther.
            for row in (0..SIDE).map_while(|row| samples.get(first + row * width..)?.first_chunk::<SIDE>()) {
                for (least, &nearness) in least.iter_mut().zip(row) {
                    *least = if nearness < *least { nearness } else { *least };
                }
            }
            self.nearness[tile] = least.into_iter().fold(f32::INFINITY, f32::min);
        }
    }

    /// The tiles that some samples are in, row by row.
    fn rows(&self, bounds: &Region) -> impl Iterator<Item = std::ops::Range<usize>> + use<> {
        let (first, last) = ((bounds.left - self.left) / SIDE, (bounds.right - 1 - self.left) / SIDE);
        let (top, bottom) = ((bounds.top - self.top) / SIDE, (bounds.bottom - 1 - self.top) / SIDE);
        let columns = self.columns;
        (top..=bottom).map(move |row| row * columns + first..row * columns + last + 1)
    }
}
