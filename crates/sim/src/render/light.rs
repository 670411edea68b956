//! Light at the samples of a band and in its pixels.
//!
//! The places of samples in a pixel (u, v) are its upper left corner (2u, 2v), the middles of its upper and its left
//! edge, and its centre. Samples of a kind are kept together, in a plane with a place for every pixel, so that
//! neighbours lie at fixed distances and rows are worked on as a whole.

/// Kinds of samples: those with odd i are odd, those with odd j are at least [`LEFT`].
const CORNER: usize = 0;
const UPPER: usize = 1;
const LEFT: usize = 2;
pub(super) const CENTRE: usize = 3;

/// All kinds, in an order in which light can be interpolated.
pub(super) const KINDS: [usize; 4] = [CENTRE, CORNER, UPPER, LEFT];

/// The samples around corners, upper and left middles: their kinds, columns to the right and rows down.
const AROUND: [[(usize, isize, isize); 4]; 3] = [
    [(CENTRE, -1, -1), (CENTRE, 0, -1), (CENTRE, -1, 0), (CENTRE, 0, 0)],
    [(CORNER, 0, 0), (CORNER, 1, 0), (CENTRE, 0, -1), (CENTRE, 0, 0)],
    [(CENTRE, -1, 0), (CENTRE, 0, 0), (CORNER, 0, 0), (CORNER, 0, 1)],
];

/// What a sample shows: nothing, glass before whatever else is there, or a number of an opaque mesh, odd if that has
/// more than one colour.
pub(super) const NOTHING: u32 = u32::MAX;
pub(super) const GLASS: u32 = NOTHING - 1;

/// Where the light at a sample comes from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Source {
    Background,
    Neighbours,
    Surface,
}

/// The samples of a grid of pixels.
#[derive(Default)]
pub(super) struct Planes {
    columns: usize,
    rows: usize,
    /// Of every kind of sample: what it shows.
    pub(super) surfaces: [Vec<u32>; 4],
    /// Of every kind of sample: its light, linear RGB.
    pub(super) lights: [Vec<[f32; 3]>; 4],
    /// Of a row of samples.
    sources: Vec<Source>,
}

impl Planes {
    /// Makes them planes of other pixels that show nothing, in the same memory.
    pub(super) fn clear(&mut self, columns: usize, rows: usize) {
        (self.columns, self.rows) = (columns, rows);
        for plane in &mut self.surfaces {
            plane.clear();
            plane.resize(columns * rows, NOTHING);
        }
    }

    /// Interpolates light at the samples of a kind and finds those that are to be shaded: (row, column).
    ///
    /// Pixel centres are shaded. Between centres of one mesh light is interpolated, of meshes of many colours the
    /// corners between four pixels are shaded too: twice a pixel is enough for both. Everything else is shaded.
    pub(super) fn interpolate(&mut self, kind: usize, shaded: &mut Vec<(usize, usize)>) {
        let Self { columns, surfaces, lights, sources, .. } = self;
        let mut own = std::mem::take(&mut lights[kind]);
        // The grid ends with the corners and edges of pixels that are not drawn.
        let count = *columns - 1 - kind % 2;
        for row in usize::from(kind != CENTRE)..self.rows - usize::from(kind == LEFT) {
            let first = row * *columns + 1;
            let shown = &surfaces[kind][first..][..count];
            let around = AROUND.get(kind).map(|around| {
                around.map(|(kind, right, down)| {
                    (kind, first.wrapping_add_signed(right + down * *columns as isize))
                })
            });
            sources.clear();
            match around.map(|around| around.map(|(kind, first)| &surfaces[kind][first..][..count])) {
                None => sources.extend(shown.iter().map(|&own| source(own, false))),
                Some([a, b, c, d]) => {
                    let neighbours = a.iter().zip(b).zip(c.iter().zip(d));
                    sources.extend(shown.iter().zip(neighbours).map(|(&own, ((&a, &b), (&c, &d)))| {
                        let is_same = (a == own) & (b == own) & (c == own) & (d == own);
                        source(own, is_same & (own != GLASS) & ((kind != CORNER) | (own % 2 == 0)))
                    }));
                }
            }
            let mut start = 0;
            for run in sources.chunk_by(|a, b| a == b) {
                let end = start + run.len();
                match (run[0], around) {
                    (Source::Surface, _) => shaded.extend((start..end).map(|n| (row, n + 1))),
                    (Source::Neighbours, Some(around)) => {
                        let around = around.map(|(kind, first)| &lights[kind][first + start..first + end]);
                        mean(&mut own[first + start..first + end], around);
                    }
                    _ => {}
                }
                start = end;
            }
        }
        lights[kind] = own;
    }

    /// Light at the three by three samples of some pixels of a row, from a place on.
    pub(super) fn around(&self, at: usize, count: usize) -> [[&[[f32; 3]]; 3]; 3] {
        let below = at + self.columns;
        let lights = |kind: usize, at: usize| &self.lights[kind][at..][..count];
        [
            [lights(CORNER, at), lights(UPPER, at), lights(CORNER, at + 1)],
            [lights(LEFT, at), lights(CENTRE, at), lights(LEFT, at + 1)],
            [lights(CORNER, below), lights(UPPER, below), lights(CORNER, below + 1)],
        ]
    }
}

fn source(shown: u32, can_interpolate: bool) -> Source {
    let other = if can_interpolate { Source::Neighbours } else { Source::Surface };
    if shown == NOTHING { Source::Background } else { other }
}

/// The means of four numbers each.
fn mean(means: &mut [[f32; 3]], of: [&[[f32; 3]]; 4]) {
    let [a, b, c, d] = of.map(<[_]>::as_flattened);
    for ((mean, (a, b)), (c, d)) in
        means.as_flattened_mut().iter_mut().zip(a.iter().zip(b)).zip(c.iter().zip(d))
    {
        *mean = (a + b + c + d) * 0.25;
    }
}

/// Light of some pixels: the samples around their centres through a tent as wide as two pixels.
pub(super) fn filter(rows: [[&[[f32; 3]]; 3]; 3], pixels: &mut [[f32; 3]]) {
    let pixels = pixels.as_flattened_mut();
    pixels.fill(0.0);
    for (row, weight) in rows.into_iter().zip([0.25, 0.5, 0.25]) {
        let [a, b, c] = row.map(<[_]>::as_flattened);
        for (((sum, a), b), c) in pixels.iter_mut().zip(a).zip(b).zip(c) {
            *sum += (a + b * 2.0 + c) * (0.25 * weight);
        }
    }
}
