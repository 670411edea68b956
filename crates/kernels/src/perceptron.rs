//! One hidden layer and a few outputs, for many inputs at once.
//!
//! [`Mlp`](crate::Mlp) has a layer's outputs in the lanes of its vectors: with one or six of them, most lanes would be
//! idle. Here the lanes are the inputs, and the hidden layer never leaves the registers.

use std::ops::Range;

use crate::parallel::{self, Shared};
use crate::simd::{Kernel, Vector};
use crate::{Isa, ShapeError};

/// A hidden layer with a leaky activation, and the outputs after it. Everything is borrowed: what one caller knows
/// for good, another computes for every call.
#[derive(Clone, Copy, Debug)]
pub struct Perceptron<'a> {
    /// `[inputs, hidden]`.
    pub first: &'a [f32],
    /// What the hidden layer starts from: its bias and whatever all inputs share. `[hidden]`, a multiple of 8.
    pub start: &'a [f32],
    /// What negative values of the hidden layer are multiplied with, in [0, 1].
    pub slope: f32,
    /// `[outputs, hidden]`.
    pub second: &'a [f32],
    /// `[outputs]`.
    pub bias: &'a [f32],
}

/// Columns are a multiple of this: the lanes of the widest vectors.
pub(crate) const LANES: usize = 16;

/// Rows that go through at once: as many columns as fill the registers of AVX-512.
const ROWS: usize = 3 * LANES;

impl Perceptron<'_> {
    /// Columns `[inputs, n]` -> `[outputs, n]`, on this thread; `n` is a multiple of 16. `added`, `[hidden, n]`, is
    /// added to the hidden layer before its activation.
    ///
    /// # Errors
    /// When the sizes disagree.
    pub fn columns(
        &self,
        isa: Isa,
        columns: &[f32],
        added: Option<&[f32]>,
        output: &mut [f32],
    ) -> Result<(), ShapeError> {
        let inputs = self.check()?;
        let n = output.len() / self.bias.len().max(1);
        ShapeError::check("values of outputs beyond whole ones", n * self.bias.len(), output.len())?;
        ShapeError::check("columns beyond a multiple of 16", 0, n % LANES)?;
        ShapeError::check("values of the columns", inputs * n, columns.len())?;
        if let Some(added) = added {
            ShapeError::check("values added to the hidden layer", self.start.len() * n, added.len())?;
        }
        // SAFETY: the sizes were checked.
        unsafe { isa.run(Columns { net: *self, columns, added, n, output }) };
        Ok(())
    }

    /// Some rows of `[rows, inputs]` -> the same columns of `[outputs, rows]`; the others stay as they are.
    ///
    /// # Errors
    /// When the sizes disagree.
    pub fn rows(
        &self,
        isa: Isa,
        rows: &[f32],
        wanted: &[Range<usize>],
        output: &mut [f32],
    ) -> Result<(), ShapeError> {
        let (inputs, outputs) = (self.check()?, self.bias.len());
        let count = output.len() / outputs.max(1);
        ShapeError::check("values of outputs beyond whole ones", count * outputs, output.len())?;
        ShapeError::check("values of the rows", count * inputs, rows.len())?;
        let beyond = wanted.iter().filter(|range| range.start > range.end || range.end > count).count();
        ShapeError::check("ranges of rows that there are not", 0, beyond)?;
        let overlaps = wanted.windows(2).filter(|pair| pair[0].end > pair[1].start).count();
        ShapeError::check("ranges of rows that overlap", 0, overlaps)?;
        let jobs: Vec<Range<usize>> = wanted
            .iter()
            .flat_map(|range| range.clone().step_by(ROWS).map(|start| start..(start + ROWS).min(range.end)))
            .collect();
        let to = Shared(output.as_mut_ptr());
        parallel::for_each(jobs.len(), |job| {
            let (start, len) = (jobs[job].start, jobs[job].len());
            let n = len.next_multiple_of(LANES);
            parallel::with_scratch((inputs + outputs) * n, |scratch| {
                let (columns, found) = scratch.split_at_mut(inputs * n);
                for (i, row) in rows[start * inputs..][..len * inputs].chunks_exact(inputs.max(1)).enumerate()
                {
                    for (column, x) in columns.chunks_exact_mut(n).zip(row) {
                        column[i] = *x;
                    }
                }
                // SAFETY: the sizes are those of this job; each job writes the columns of its own rows.
                unsafe {
                    isa.run(Columns { net: *self, columns, added: None, n, output: &mut *found });
                    for (output, found) in found.chunks_exact(n).enumerate() {
                        let to = to.get().add(output * count + start);
                        to.copy_from_nonoverlapping(found.as_ptr(), len);
                    }
                }
            });
        });
        Ok(())
    }

    /// The number of inputs, if the sizes agree.
    fn check(&self) -> Result<usize, ShapeError> {
        let hidden = self.start.len();
        ShapeError::check("hidden values beyond a multiple of 8", 0, hidden % 8)?;
        ShapeError::check("weights of the second layer", hidden * self.bias.len(), self.second.len())?;
        let inputs = self.first.len() / hidden.max(1);
        ShapeError::check("weights of the first layer", inputs * hidden, self.first.len())?;
        Ok(inputs)
    }
}

/// The kernel; sizes as in [`Perceptron::columns`].
struct Columns<'a> {
    net: Perceptron<'a>,
    columns: &'a [f32],
    added: Option<&'a [f32]>,
    n: usize,
    output: &'a mut [f32],
}

impl Kernel for Columns<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for (output, bias) in self.output.chunks_exact_mut(self.n.max(1)).zip(self.net.bias) {
            output.fill(*bias);
        }
        let vectors = self.n / V::LANES;
        let parts = vectors.div_ceil(3);
        let mut at = 0;
        for part in 0..parts {
            let wide = (vectors - at).div_ceil(parts - part);
            let tile = Tile {
                net: self.net,
                x: self.columns.as_ptr().wrapping_add(at * V::LANES),
                added: self.added.map(|added| added.as_ptr().wrapping_add(at * V::LANES)),
                n: self.n,
                to: self.output.as_mut_ptr().wrapping_add(at * V::LANES),
            };
            // SAFETY: `wide` vectors from column `at * LANES` on lie within the `n` columns.
            unsafe {
                match wide {
                    1 => tile.hidden_layer::<V, 1>(),
                    2 => tile.hidden_layer::<V, 2>(),
                    _ => tile.hidden_layer::<V, 3>(),
                }
            }
            at += wide;
        }
    }
}

/// Some vectors of columns.
#[derive(Clone, Copy)]
struct Tile<'a> {
    net: Perceptron<'a>,
    x: *const f32,
    added: Option<*const f32>,
    n: usize,
    to: *mut f32,
}

impl Tile<'_> {
    /// All hidden values, as many at once as the registers hold.
    #[inline(always)]
    unsafe fn hidden_layer<V: Vector, const WIDE: usize>(self) {
        let some = match V::ROWS {
            8.. => 8,
            4..8 => 4,
            _ => 2,
        };
        for first in (0..self.net.start.len()).step_by(some) {
            // SAFETY: the caller's promise; 8 is a multiple of every number of values.
            unsafe {
                match some {
                    8 => self.some::<V, 8, WIDE>(first),
                    4 => self.some::<V, 4, WIDE>(first),
                    _ => self.some::<V, 2, WIDE>(first),
                }
            }
        }
    }

    /// `SOME` hidden values from `first` on, and what they add to the outputs.
    #[inline(always)]
    unsafe fn some<V: Vector, const SOME: usize, const WIDE: usize>(self, first: usize) {
        let Self { net, x, added, n, to } = self;
        let hidden = net.start.len();
        // SAFETY: hidden values `first..first + SOME` exist, and every matrix has the size that was checked.
        unsafe {
            let load =
                |from: *const f32| -> [V; WIDE] { std::array::from_fn(|v| V::load(from.add(v * V::LANES))) };
            let mut sum: [[V; WIDE]; SOME] =
                std::array::from_fn(|j| [V::splat(*net.start.as_ptr().add(first + j)); WIDE]);
            if let Some(added) = added {
                for (j, sum) in sum.iter_mut().enumerate() {
                    let added = load(added.add((first + j) * n));
                    for (sum, added) in sum.iter_mut().zip(added) {
                        *sum = sum.add(added);
                    }
                }
            }
            let mut weights = net.first.as_ptr().wrapping_add(first);
            for k in 0..net.first.len() / hidden {
                let x = load(x.add(k * n));
                for (j, sum) in sum.iter_mut().enumerate() {
                    let weight = V::splat(*weights.add(j));
                    for (sum, x) in sum.iter_mut().zip(x) {
                        *sum = x.fma(weight, *sum);
                    }
                }
                weights = weights.wrapping_add(hidden);
            }
            let slope = V::splat(net.slope);
            for sum in &mut sum {
                for sum in sum {
                    *sum = sum.max(sum.mul(slope));
                }
            }
            for output in 0..net.bias.len() {
                let weights = net.second.as_ptr().add(output * hidden + first);
                let mut y = load(to.add(output * n));
                for (j, sum) in sum.iter().enumerate() {
                    let weight = V::splat(*weights.add(j));
                    for (y, sum) in y.iter_mut().zip(sum) {
                        *y = sum.fma(weight, *y);
                    }
                }
                for (v, y) in y.into_iter().enumerate() {
                    y.store(to.add(output * n + v * V::LANES));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::noise;

    /// Column `i` by definition, in f64.
    fn expected(net: &Perceptron<'_>, x: &[f32], added: &[f32]) -> Vec<f64> {
        let hidden = net.start.len();
        let layer = (0..hidden).map(|j| {
            let product: f64 =
                x.iter().enumerate().map(|(k, x)| f64::from(*x) * f64::from(net.first[k * hidden + j])).sum();
            let y = product + f64::from(net.start[j]) + added.get(j).copied().map_or(0.0, f64::from);
            if y > 0.0 { y } else { y * f64::from(net.slope) }
        });
        let layer: Vec<f64> = layer.collect();
        let outputs = net.second.chunks_exact(hidden).zip(net.bias);
        let dot = |w: &[f32]| -> f64 { w.iter().zip(&layer).map(|(w, y)| f64::from(*w) * y).sum() };
        outputs.map(|(w, bias)| f64::from(*bias) + dot(w)).collect()
    }

    #[test]
    fn equals_naive_loops() {
        for (inputs, hidden, outputs, n) in [(9, 40, 1, 32), (0, 64, 6, 32), (35, 8, 3, 16), (5, 24, 2, 112)]
        {
            let (first, start) = (noise(inputs * hidden, 1), noise(hidden, 2));
            let (second, bias) = (noise(outputs * hidden, 3), noise(outputs, 4));
            let net = Perceptron { first: &first, start: &start, slope: 0.01, second: &second, bias: &bias };
            let (columns, added) = (noise(inputs * n, 5), noise(hidden * n, 6));
            for isa in Isa::available() {
                for added in [None, Some(&added[..])] {
                    let mut found = vec![f32::NAN; outputs * n];
                    net.columns(isa, &columns, added, &mut found).unwrap();
                    for i in 0..n {
                        let column = |m: &[f32]| m.iter().skip(i).step_by(n).copied().collect::<Vec<_>>();
                        let expected = expected(&net, &column(&columns), &column(added.unwrap_or_default()));
                        for (found, expected) in column(&found).iter().zip(expected) {
                            assert!((f64::from(*found) - expected).abs() < 2e-5, "{} {n}", isa.name());
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn rows_are_columns_wherever_they_are_and_whoever_computes_them() {
        let (inputs, hidden, outputs, count) = (20, 32, 6, 500);
        let (first, start) = (noise(inputs * hidden, 1), noise(hidden, 2));
        let (second, bias) = (noise(outputs * hidden, 3), noise(outputs, 4));
        let net = Perceptron { first: &first, start: &start, slope: 0.01, second: &second, bias: &bias };
        let rows = noise(count * inputs, 5);
        for isa in Isa::available() {
            let with = |threads: usize, wanted: &[Range<usize>]| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let mut found = vec![7.0; outputs * count];
                pool.install(|| net.rows(isa, &rows, wanted, &mut found)).unwrap();
                found
            };
            let whole = [0..count - 1, count - 1..count];
            let all = with(1, &whole);
            assert!(with(3, &whole) == all, "threads");
            let some = with(2, &[3..50, 50..51, 120..481]);
            for (i, (found, all)) in some.iter().zip(&all).enumerate() {
                let wanted = matches!(i % count, 3..51 | 120..481);
                assert_eq!(*found, if wanted { *all } else { 7.0 });
            }
            for row in [0, 333, 499] {
                let expected = expected(&net, &rows[row * inputs..][..inputs], &[]);
                for (output, expected) in expected.into_iter().enumerate() {
                    assert!((f64::from(all[output * count + row]) - expected).abs() < 2e-5);
                }
            }
        }
    }

    #[test]
    fn wrong_sizes_are_refused() {
        let (first, start, second) = (vec![0.0; 16], vec![0.0; 8], vec![0.0; 8]);
        let net = Perceptron { first: &first, start: &start, slope: 0.01, second: &second, bias: &[0.0] };
        let isa = Isa::best();
        assert!(net.columns(isa, &[0.0; 32], None, &mut [0.0; 16]).is_ok());
        assert!(net.columns(isa, &[0.0; 31], None, &mut [0.0; 16]).is_err());
        assert!(net.columns(isa, &[0.0; 34], None, &mut [0.0; 17]).is_err());
        assert!(net.columns(isa, &[0.0; 32], Some(&[0.0; 9]), &mut [0.0; 16]).is_err());
        assert!(net.rows(isa, &[0.0; 8], &[0..1, 1..5], &mut [0.0; 4]).is_err());
        assert!(net.rows(isa, &[0.0; 8], &[0..3, 2..4], &mut [0.0; 4]).is_err());
        assert!(Perceptron { start: &start[1..], ..net }.columns(isa, &[], None, &mut []).is_err());
    }
}
