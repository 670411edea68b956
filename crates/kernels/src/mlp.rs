//! Shared multi-layer perceptrons over rows: points, neighbours of points, pixels.
//!
//! All layers of a block of rows are computed while it is in the cache; a layer's output has the layout of the
//! next one's input. What PointNet++ gathers is gathered here: nothing of the size neighbours x channels is
//! ever stored.

use crate::gemm::{Gemm, Panels, Rows};
use crate::parallel::{self, Shared};
use crate::simd::{Kernel, Vector};
use crate::{AlignedBuf, Isa, ShapeError};

/// What follows a layer's product.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    /// Nothing.
    Identity,
    /// `max(x, 0)`.
    Relu,
    /// `x` where it is positive, this multiple of it elsewhere.
    Leaky(f32),
}

/// One linear layer.
#[derive(Clone, Copy, Debug)]
pub struct MlpLayer<'a> {
    /// `[inputs, outputs]`.
    pub weights: &'a [f32],
    /// `[outputs]`.
    pub bias: &'a [f32],
    /// What follows.
    pub activation: Activation,
}

/// Several linear layers compiled for one instruction set.
#[derive(Clone)]
pub struct Mlp {
    layers: Vec<Layer>,
    inputs: usize,
    outputs: usize,
}

#[derive(Clone)]
struct Layer {
    weights: Panels,
    bias: AlignedBuf,
    outputs: usize,
    activation: Activation,
}

/// Rows of a table that are added, weighted, to the first layer's product before its activation.
///
/// A layer on `(a, b)` is the sum of a layer on `a` and one on `b`; where many rows share their `a`, its part
/// is computed once and looked up here.
#[derive(Clone, Copy, Debug)]
pub struct Lookup<'a> {
    /// `[any, outputs of the first layer]`, which must be a multiple of 16.
    pub table: &'a [f32],
    /// `[rows, each]`: which rows of the table.
    pub rows: &'a [i64],
    /// `[rows, each]`: how much each counts; none is one.
    pub weights: Option<&'a [f32]>,
    /// Rows of the table per row.
    pub each: usize,
}

/// The input of a [`Mlp`].
#[derive(Clone, Copy, Debug)]
pub struct MlpInput<'a> {
    /// `[rows, inputs]`.
    pub rows: &'a [f32],
    /// What is added to the first layer.
    pub lookup: Option<Lookup<'a>>,
    /// The maximum over so many successive rows is one row of the output; 1 keeps them all.
    pub pool: usize,
}

/// Rows of a job, before they are rounded to whole pools.
const ROWS: usize = 56;

impl Mlp {
    /// Packs the layers; the first takes `inputs` values.
    ///
    /// # Errors
    /// When the sizes disagree.
    pub fn new(isa: Isa, inputs: usize, layers: &[MlpLayer<'_>]) -> Result<Self, ShapeError> {
        let mut width = inputs;
        let mut packed = Vec::new();
        for layer in layers {
            let outputs = layer.bias.len();
            ShapeError::check("weights of a layer", width * outputs, layer.weights.len())?;
            let padded = outputs.next_multiple_of(16);
            let valid = (0..width.div_ceil(16)).map(|b| (width - 16 * b).min(16)).collect();
            let weights = Panels::pack(isa.exact(), 1, valid, padded, |_, k, n| {
                if n < outputs { layer.weights[k * outputs + n] } else { 0.0 }
            });
            let mut bias = AlignedBuf::zeros(padded);
            bias[..outputs].copy_from_slice(layer.bias);
            packed.push(Layer { weights, bias, outputs, activation: layer.activation });
            width = outputs;
        }
        ShapeError::check("missing layers", 0, usize::from(packed.is_empty()))?;
        Ok(Self { layers: packed, inputs, outputs: width })
    }

    /// Values of a row of the input.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Values of a row of the output.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Computes `[rows / pool, outputs]`.
    ///
    /// # Errors
    /// When the sizes disagree or the lookup leaves its table.
    pub fn run(&self, input: MlpInput<'_>, output: &mut [f32]) -> Result<(), ShapeError> {
        let pool = input.pool.max(1);
        ShapeError::check("rows of values beyond whole ones", 0, output.len() % self.outputs.max(1))?;
        let groups = output.len() / self.outputs.max(1);
        let widest = self.layers.iter().map(|layer| layer.bias.len()).max().unwrap_or(0);
        let widest = widest.max(self.inputs.next_multiple_of(16));
        ShapeError::product("values of all rows", &[groups, pool, 2 * widest])?;
        let count = groups * pool;
        ShapeError::check("values of the rows", count * self.inputs, input.rows.len())?;
        if let Some(lookup) = &input.lookup {
            lookup.check(count, self.layers[0].outputs)?;
        }
        let per_job = (ROWS / pool).max(1);
        let jobs = groups.div_ceil(per_job);
        let to = Shared(output.as_mut_ptr());
        parallel::for_each(jobs, |job| {
            let groups = job * per_job..((job + 1) * per_job).min(groups);
            let (start, rows) = (groups.start * pool, groups.len() * pool);
            parallel::with_scratch(2 * widest * rows, |scratch| {
                let (mut from, mut into) = scratch.split_at_mut(widest * rows);
                load(&input.rows[start * self.inputs..][..rows * self.inputs], self.inputs, rows, from);
                for (i, layer) in self.layers.iter().enumerate() {
                    let lookup = input.lookup.filter(|_| i == 0).map(|lookup| lookup.part(start, rows));
                    layer.run(rows, from, into, lookup);
                    std::mem::swap(&mut from, &mut into);
                }
                let isa = self.layers[0].weights.isa();
                // SAFETY: `from` holds the last layer's rows; each job writes the rows of its own groups.
                unsafe {
                    let to = to.get().add(groups.start * self.outputs);
                    isa.run(Store { from, rows, pool, outputs: self.outputs, to });
                }
            });
        });
        Ok(())
    }
}

impl Lookup<'_> {
    fn check(&self, rows: usize, width: usize) -> Result<(), ShapeError> {
        ShapeError::check("outputs beyond whole blocks, with a lookup", 0, width % 16)?;
        let entries = ShapeError::product("entries of a lookup", &[rows, self.each])?;
        ShapeError::check("entries of a lookup", entries, self.rows.len())?;
        if let Some(weights) = self.weights {
            ShapeError::check("weights of a lookup", entries, weights.len())?;
        }
        // Whole blocks are added, and tables come from other layers, whose outputs are stored without padding.
        ShapeError::check("looked up values beyond whole blocks", 0, self.table.len() % width.max(1))?;
        let size = (self.table.len() / width.max(1)) as i64;
        let outside = self.rows.iter().filter(|row| !(0..size).contains(*row)).count();
        ShapeError::check("entries of a lookup outside its table", 0, outside)
    }

    fn part(self, start: usize, rows: usize) -> Self {
        let range = start * self.each..(start + rows) * self.each;
        Self { rows: &self.rows[range.clone()], weights: self.weights.map(|w| &w[range]), ..self }
    }
}

/// Rows `[rows, width]` to blocks `[width / 16][rows][16]`.
fn load(values: &[f32], width: usize, rows: usize, to: &mut [f32]) {
    for (row, values) in values.chunks_exact(width.max(1)).enumerate() {
        for (block, values) in values.chunks(16).enumerate() {
            let at = (block * rows + row) * 16;
            to[at..at + values.len()].copy_from_slice(values);
        }
    }
}

impl Layer {
    fn run(&self, rows: usize, from: &[f32], to: &mut [f32], lookup: Option<Lookup<'_>>) {
        let (isa, blocks) = (self.weights.isa(), self.weights.n() / 16);
        assert!(from.len() >= self.weights.blocks() * rows * 16 && to.len() >= blocks * rows * 16);
        let relu = self.activation == Activation::Relu && lookup.is_none();
        // SAFETY: both buffers hold `rows` rows of the layer's blocks; lookups were checked by `run`.
        unsafe {
            isa.run(Gemm {
                weights: &self.weights,
                panels: 0..self.weights.count(),
                rows,
                input: Rows { at: from.as_ptr(), plane: 0, block: rows * 16 },
                output: Rows { at: to.as_mut_ptr(), plane: 0, block: rows * 16 },
                bias: Some(self.bias.as_ptr()),
                relu,
            });
            if let Some(lookup) = lookup {
                isa.run(AddRows { lookup, to, rows, blocks });
            }
            if self.activation != Activation::Identity && !relu {
                let slope = if let Activation::Leaky(slope) = self.activation { slope } else { 0.0 };
                isa.run(Leak { values: &mut to[..blocks * rows * 16], slope });
            }
        }
    }
}

/// Adds looked up rows to blocks `[block][row][16]`. The lookup's rows lie in its table.
struct AddRows<'a> {
    lookup: Lookup<'a>,
    to: &'a mut [f32],
    rows: usize,
    blocks: usize,
}

impl Kernel for AddRows<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        let Lookup { table, rows, weights, each } = self.lookup;
        let width = self.blocks * 16;
        assert!(self.to.len() >= self.rows * width && rows.len() >= self.rows * each);
        for row in 0..self.rows {
            for lane in (0..width).step_by(V::LANES) {
                // SAFETY: rows of the table were checked; the blocks hold all rows.
                unsafe {
                    let to = self.to.as_mut_ptr().add((lane / 16 * self.rows + row) * 16 + lane % 16);
                    let mut sum = V::load(to);
                    for entry in row * each..(row + 1) * each {
                        let value = V::load(table.as_ptr().add(rows[entry] as usize * width + lane));
                        sum = match weights {
                            Some(weights) => value.scale_add(weights[entry], sum),
                            None => sum.add(value),
                        };
                    }
                    sum.store(to);
                }
            }
        }
    }
}

/// `x` where it is positive, `slope * x` elsewhere.
struct Leak<'a> {
    values: &'a mut [f32],
    slope: f32,
}

impl Kernel for Leak<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        for values in self.values.chunks_exact_mut(V::LANES) {
            // SAFETY: a chunk holds LANES values.
            unsafe {
                let x = V::load(values.as_ptr());
                // max(x, 0) + slope * min(x, 0), where min(x, 0) = -max(-x, 0).
                let negative = x.scale(-1.0).max(V::splat(0.0));
                negative.scale_add(-self.slope, x.max(V::splat(0.0))).store(values.as_mut_ptr());
            }
        }
    }
}

/// Blocks `[block][row][16]` to rows, the maximum over each `pool` of them. `to` holds `rows / pool` rows.
struct Store<'a> {
    from: &'a [f32],
    rows: usize,
    pool: usize,
    outputs: usize,
    to: *mut f32,
}

impl Kernel for Store<'_> {
    #[inline(always)]
    unsafe fn run<V: Vector>(self) {
        assert!(self.from.len() >= self.rows * self.outputs.next_multiple_of(16));
        for group in 0..self.rows / self.pool {
            for lane in (0..self.outputs).step_by(V::LANES) {
                // SAFETY: rows and lanes as asserted; only the outputs are written.
                unsafe {
                    let first = (lane / 16 * self.rows + group * self.pool) * 16 + lane % 16;
                    let mut most = V::load(self.from.as_ptr().add(first));
                    for row in 1..self.pool {
                        most = most.max(V::load(self.from.as_ptr().add(first + row * 16)));
                    }
                    let to = self.to.add(group * self.outputs + lane);
                    if lane + V::LANES <= self.outputs {
                        most.store(to);
                    } else {
                        let mut rest = [0.0; 16];
                        most.store(rest.as_mut_ptr());
                        to.copy_from_nonoverlapping(rest.as_ptr(), self.outputs - lane);
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

    /// One layer by definition, in f64.
    fn layer(x: &[f64], layer: &MlpLayer<'_>, add: &[f64]) -> Vec<f64> {
        let n = layer.bias.len();
        let outputs = (0..n).map(|j| {
            let product: f64 =
                x.iter().enumerate().map(|(i, x)| x * f64::from(layer.weights[i * n + j])).sum();
            let y = f64::from(layer.bias[j]) + product + add.get(j).copied().unwrap_or(0.0);
            match layer.activation {
                Activation::Identity => y,
                Activation::Relu => y.max(0.0),
                Activation::Leaky(slope) => {
                    if y > 0.0 {
                        y
                    } else {
                        y * f64::from(slope)
                    }
                }
            }
        });
        outputs.collect()
    }

    #[test]
    fn equals_naive_loops() {
        let activations = [Activation::Identity, Activation::Relu, Activation::Leaky(0.01)];
        for (case, (inputs, sizes, pool, groups, each)) in [
            (3, vec![32, 32, 64], 32, 9, 1),
            (67, vec![64, 128], 4, 33, 1),
            (5, vec![16], 1, 100, 3),
            (128, vec![128, 6], 1, 57, 0),
            (35, vec![48, 20, 7], 3, 21, 0),
        ]
        .into_iter()
        .enumerate()
        {
            let before = std::iter::once(&inputs).chain(&sizes);
            let weights: Vec<_> = before.zip(&sizes).map(|(i, o)| noise(i * o, (i + o) as u64)).collect();
            let biases: Vec<_> = sizes.iter().map(|o| noise(*o, 7)).collect();
            let layers: Vec<_> = weights
                .iter()
                .zip(&biases)
                .enumerate()
                .map(|(i, (weights, bias))| MlpLayer {
                    weights,
                    bias,
                    activation: activations[(case + i) % 3],
                })
                .collect();
            let (count, last) = (groups * pool, sizes[sizes.len() - 1]);
            let rows = noise(count * inputs, 11);
            let table = noise(13 * sizes[0], 12);
            let near: Vec<i64> = (0..count * each).map(|i| (i * 5 % 13) as i64).collect();
            let counts = noise(count * each, 13);
            let counts = (each == 3).then_some(&counts[..]);
            let lookup = (each > 0).then_some(Lookup { table: &table, rows: &near, weights: counts, each });

            let mut expected = vec![f64::MIN; groups * last];
            for (row, values) in rows.chunks_exact(inputs).enumerate() {
                let mut add = vec![0.0; sizes[0]];
                for entry in row * each..(row + 1) * each {
                    let found = &table[near[entry] as usize * sizes[0]..][..sizes[0]];
                    let count = f64::from(counts.map_or(1.0, |counts| counts[entry]));
                    add.iter_mut().zip(found).for_each(|(add, x)| *add += count * f64::from(*x));
                }
                let mut x: Vec<f64> = values.iter().map(|x| f64::from(*x)).collect();
                for (i, l) in layers.iter().enumerate() {
                    x = layer(&x, l, if i == 0 { &add } else { &[] });
                }
                let most = &mut expected[row / pool * last..][..last];
                most.iter_mut().zip(&x).for_each(|(most, x)| *most = most.max(*x));
            }
            for isa in Isa::available().into_iter().chain(Isa::bf16()) {
                let mlp = Mlp::new(isa, inputs, &layers).unwrap();
                let mut output = vec![f32::NAN; groups * last];
                mlp.run(MlpInput { rows: &rows, lookup, pool }, &mut output).unwrap();
                for (e, y) in expected.iter().zip(&output) {
                    assert!(
                        (e - f64::from(*y)).abs() < 2e-4 * e.abs().max(1.0),
                        "{} case {case}: {e} {y}",
                        isa.name()
                    );
                }
            }
        }
    }

    #[test]
    fn wrong_sizes_are_refused() {
        let isa = Isa::best();
        let layer = MlpLayer { weights: &[0.5; 4 * 16], bias: &[0.0; 16], activation: Activation::Relu };
        assert!(Mlp::new(isa, 5, &[layer]).is_err());
        assert!(Mlp::new(isa, 4, &[]).is_err());
        let mlp = Mlp::new(isa, 4, &[layer]).unwrap();
        let rows = [1.0; 8];
        let run = |lookup, pool, n: usize| mlp.run(MlpInput { rows: &rows, lookup, pool }, &mut vec![0.0; n]);
        assert!(run(None, 1, 32).is_ok() && run(None, 2, 16).is_ok());
        assert!(run(None, 1, 31).is_err() && run(None, 1, 48).is_err());
        let table = [0.0; 32];
        let lookup = |rows| Some(Lookup { table: &table, rows, weights: None, each: 1 });
        assert!(run(lookup(&[0, 1]), 1, 32).is_ok());
        for bad in [&[0, 2][..], &[0, -1], &[0]] {
            assert!(run(lookup(bad), 1, 32).is_err());
        }
        let huge = MlpInput { rows: &[], lookup: None, pool: 1 << 63 };
        assert!(mlp.run(huge, &mut [0.0; 32]).is_err(), "the rows are too many to count");
        let narrow = MlpLayer { weights: &[0.5; 4 * 8], bias: &[0.0; 8], ..layer };
        let narrow = Mlp::new(isa, 4, &[narrow]).unwrap();
        let input = MlpInput { rows: &rows, lookup: lookup(&[0, 1]), pool: 1 };
        assert!(narrow.run(input, &mut [0.0; 16]).is_err(), "looked up in halves of blocks");
    }
}
