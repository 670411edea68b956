//! Convolutions for prediction.
//!
//! Every form of convolution is the same three steps on blocks of tiles: gather the rows of a matrix product
//! ([`gather`](self::gather)), multiply by weights that were packed once, scatter the products to pixels with
//! bias, residual and ReLU. A block's rows and products stay in the second-level cache.

mod form;
mod gather;
mod head;
mod pack;
mod scatter;
mod stem;
#[cfg(test)]
mod tests;

pub use form::{Form, Source};
pub use head::Head;
pub use pack::Weights;
pub use stem::{Picture, Stem};

use crate::gemm::{Gemm, Panels, Rows};
use crate::parallel::{self, Shared};
use crate::{AlignedBuf, Blocked, Isa, ShapeError};
use gather::{Gather, Map};
use scatter::{Place, Scatter};
use std::ops::Range;

/// Values of rows and products that one thread keeps at hand: about half of a second-level cache of 1 MiB.
const BLOCK_VALUES: usize = 80 * 1024;

/// Memory that layers share, reused from call to call.
#[derive(Default)]
pub struct Workspace {
    rows: AlignedBuf,
}

/// What is added to a convolution's result before the ReLU.
#[derive(Clone, Copy)]
pub enum Add<'a> {
    /// Nothing.
    Nothing,
    /// Maps of the output's shape.
    Maps(&'a Blocked),
    /// What the output holds already; it must have the result's shape.
    Output,
}

/// A convolution compiled for one instruction set.
#[derive(Clone)]
pub struct Conv {
    form: Form,
    sources: Vec<Source>,
    weights: Panels,
    bias: AlignedBuf,
    outputs: usize,
}

/// Sizes of one run.
struct Run<'a> {
    maps: Vec<Map>,
    size: (usize, usize),
    grid: (usize, usize),
    /// Tiles of all images.
    tiles: usize,
    place: Place,
    relu: bool,
    bias: *const f32,
    conv: &'a Conv,
}

// SAFETY: the pointers are to maps that are borrowed for the whole run; jobs read them, and write disjoint
// tiles of the output.
unsafe impl Sync for Run<'_> {}
// SAFETY: as above.
unsafe impl Send for Run<'_> {}

impl Conv {
    /// Packs the weights.
    ///
    /// # Errors
    /// When the weights do not have `outputs` x channels of the sources x kernel values.
    pub fn new(isa: Isa, form: Form, sources: &[Source], weights: Weights<'_>) -> Result<Self, ShapeError> {
        let (panels, bias) = pack::pack(isa, form, sources, weights)?;
        Ok(Self { form, sources: sources.to_vec(), weights: panels, bias, outputs: weights.outputs })
    }

    /// Output channels.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Computes `max(conv(inputs) + add, 0 if relu)`. The output takes the right shape.
    ///
    /// # Errors
    /// When inputs or `add` do not have the expected shapes.
    pub fn run(
        &self,
        inputs: &[&Blocked],
        add: Add<'_>,
        relu: bool,
        output: &mut Blocked,
        workspace: &mut Workspace,
    ) -> Result<(), ShapeError> {
        let (images, height, width) = self.check(inputs)?;
        let (out_height, out_width) = self.form.output_size((height, width));
        let wanted = [images, self.outputs, out_height, out_width];
        match add {
            Add::Output => check_shape("output that is added to", wanted, output)?,
            Add::Maps(maps) => check_shape("maps that are added", wanted, maps)?,
            Add::Nothing => {}
        }
        if !matches!(add, Add::Output) {
            output.reshape(images, self.outputs, out_height, out_width);
        }
        let (image, plane) = (output.image_len(), output.plane_len());
        let at = output.data_mut().as_mut_ptr();
        let add = match add {
            Add::Nothing => None,
            Add::Maps(maps) => Some(maps.data().as_ptr()),
            Add::Output => Some(at.cast_const()),
        };
        let place = Place::Map { at, add, image, plane, height: out_height, width: out_width };
        let run = self.prepare(inputs, place, relu);
        // Few tiles under many weights: let each thread stream its own part of the weights over all tiles.
        let by_tiles = run.block_count();
        if by_tiles >= 8 || self.weights.count() < 4 {
            run.by_tiles(by_tiles);
        } else {
            run.by_panels(&mut workspace.rows);
        }
        Ok(())
    }

    /// Checks the inputs; gives number, height and width of the images.
    fn check(&self, inputs: &[&Blocked]) -> Result<(usize, usize, usize), ShapeError> {
        ShapeError::check("inputs of a convolution", self.sources.len(), inputs.len())?;
        let Some(first) = inputs.first() else { return Ok((0, 0, 0)) };
        let shape = (first.images(), first.height(), first.width());
        for (source, input) in self.sources.iter().zip(inputs) {
            check_shape("input of a convolution", [shape.0, source.stored(), shape.1, shape.2], input)?;
        }
        Ok(shape)
    }

    fn prepare(&self, inputs: &[&Blocked], place: Place, relu: bool) -> Run<'_> {
        let maps: Vec<Map> = inputs
            .iter()
            .map(|input| Map {
                at: input.data().as_ptr(),
                image: input.image_len(),
                plane: input.plane_len(),
                blocks: input.blocks(),
            })
            .collect();
        let (images, size) =
            inputs.first().map_or((0, (0, 0)), |input| (input.images(), (input.height(), input.width())));
        let grid = self.form.grid(size);
        let tiles = images * grid.0 * grid.1;
        Run { maps, size, grid, tiles, place, relu, bias: self.bias.as_ptr(), conv: self }
    }
}

fn check_shape(what: &str, wanted: [usize; 4], found: &Blocked) -> Result<(), ShapeError> {
    let found = [found.images(), found.channels(), found.height(), found.width()];
    for (axis, (wanted, found)) in
        ["images", "channels", "height", "width"].iter().zip(wanted.into_iter().zip(found))
    {
        ShapeError::check(&format!("{axis} of {what}"), wanted, found)?;
    }
    Ok(())
}

/// A matrix of `blocks` blocks of `rows` rows in each plane. One line more per plane, so that planes do not
/// compete for the same cache sets.
fn layout<P>(at: P, blocks: usize, rows: usize) -> Rows<P> {
    Rows { at, plane: blocks * rows * 16 + 16, block: rows * 16 }
}

impl Run<'_> {
    /// Into how many blocks of tiles the work is cut. Never depends on the number of threads.
    fn block_count(&self) -> usize {
        let weights = &self.conv.weights;
        let row = weights.planes() * (weights.blocks() + weights.n() / 16) * 16;
        let rows = (BLOCK_VALUES / row.max(1)).clamp(14, 56) / 14 * 14;
        self.tiles.div_ceil(rows)
    }

    fn tiles_of(&self, block: usize, blocks: usize) -> Range<usize> {
        block * self.tiles / blocks..(block + 1) * self.tiles / blocks
    }

    fn gather(&self, tiles: Range<usize>, to: Rows<*mut f32>) -> Gather<'_> {
        let (height, width) = self.size;
        Gather { form: self.conv.form, maps: &self.maps, height, width, grid: self.grid, tiles, to }
    }

    fn multiply(
        &self,
        panels: Range<usize>,
        rows: usize,
        input: Rows<*const f32>,
        output: Rows<*mut f32>,
    ) -> Gemm<'_> {
        Gemm { weights: &self.conv.weights, panels, rows, input, output, bias: None, relu: false }
    }

    fn scatter(&self, tiles: Range<usize>, blocks: Range<usize>, from: Rows<*const f32>) -> Scatter {
        let conv = self.conv;
        Scatter {
            form: conv.form,
            grid: self.grid,
            tiles,
            blocks,
            output_blocks: conv.bias.len() / 16,
            from,
            bias: self.bias,
            relu: self.relu,
            place: self.place,
        }
    }

    /// Gathers and multiplies one block of tiles in `scratch`; gives the products.
    fn products(&self, tiles: Range<usize>, scratch: &mut [f32]) -> Rows<*const f32> {
        let weights = &self.conv.weights;
        let (rows, isa) = (tiles.len(), weights.isa());
        assert!(scratch.len() >= self.scratch_len(rows), "scratch of a block of tiles");
        let input = layout(scratch.as_mut_ptr(), weights.blocks(), rows);
        // SAFETY: the scratch holds the rows and, behind them, the products, as `scratch_len` counts them; the
        // maps were checked to have this size and these channels.
        unsafe {
            isa.run(self.gather(tiles, input));
            let output = layout(input.at.add(weights.planes() * input.plane), weights.n() / 16, rows);
            isa.run(self.multiply(0..weights.count(), rows, input.as_const(), output));
            output.as_const()
        }
    }

    /// Values of rows and products of `rows` tiles.
    fn scratch_len(&self, rows: usize) -> usize {
        let weights = &self.conv.weights;
        let plane = |blocks| layout((), blocks, rows).plane;
        weights.planes() * (plane(weights.blocks()) + plane(weights.n() / 16))
    }

    /// Each job takes a block of tiles through all three steps.
    fn by_tiles(&self, blocks: usize) {
        let weights = &self.conv.weights;
        let most = self.tiles.div_ceil(blocks.max(1));
        parallel::for_each(blocks, |block| {
            let tiles = self.tiles_of(block, blocks);
            parallel::with_scratch(self.scratch_len(most), |scratch| {
                let products = self.products(tiles.clone(), scratch);
                // SAFETY: the products of all blocks of these tiles; no other job writes these tiles.
                unsafe { weights.isa().run(self.scatter(tiles, 0..weights.n() / 16, products)) };
            });
        });
    }

    /// All rows are gathered first; then each job multiplies them by one panel of the weights.
    fn by_panels(&self, rows: &mut AlignedBuf) {
        let weights = &self.conv.weights;
        let (isa, width) = (weights.isa(), weights.width() / 16);
        let plane = layout((), weights.blocks(), self.tiles).plane;
        rows.resize(weights.planes() * plane);
        let at = Shared(rows.as_mut_ptr());
        let portions = self.tiles.div_ceil(14);
        parallel::for_each(portions, |portion| {
            let tiles = self.tiles_of(portion, portions);
            // SAFETY: each job writes the rows of its own tiles.
            unsafe {
                let to = layout(at.get().add(tiles.start * 16), weights.blocks(), self.tiles);
                isa.run(self.gather(tiles, to));
            }
        });
        let blocks = self.tiles.div_ceil(112);
        parallel::for_each(weights.count() * blocks, |job| {
            let (panel, tiles) = (job / blocks, self.tiles_of(job % blocks, blocks));
            let channels = panel * width..((panel + 1) * width).min(weights.n() / 16);
            let output_plane = layout((), width, tiles.len()).plane;
            parallel::with_scratch(weights.planes() * output_plane, |scratch| {
                let output = layout(scratch.as_mut_ptr(), width, tiles.len());
                // SAFETY: the rows are complete; the scratch holds one panel's products; no other job writes
                // these channels of these tiles.
                unsafe {
                    let input =
                        layout(at.get().add(tiles.start * 16).cast_const(), weights.blocks(), self.tiles);
                    isa.run(self.multiply(panel..panel + 1, tiles.len(), input, output));
                    isa.run(self.scatter(tiles.clone(), channels, output.as_const()));
                }
            });
        });
    }
}
