//! PointNet++ as a sequence of kernels.

use where2act_kernels::{Activation, Isa, Lookup, Mlp, MlpInput, ShapeError};

use super::fold::{self, mlp};
use super::linear::LinearLayer;
use crate::pointnet::{Grouping, Hierarchy, Interpolation, MlpLayer, PointMlp, PointNet2, Surroundings};

/// A step down or up. Its first layer is a sum over two inputs: one that many rows share, whose part is computed
/// once for each of its own rows and looked up, and one of each row.
struct Step {
    shared: Mlp,
    rest: Mlp,
}

/// A [`Surroundings`] compiled for one instruction set.
pub struct SurroundingsEngine {
    mlps: Vec<Mlp>,
}

/// PointNet++ compiled for one instruction set.
pub(super) struct CloudEngine {
    down: Vec<Step>,
    surroundings: Option<SurroundingsEngine>,
    up: Vec<Step>,
    head: Mlp,
}

/// Buffers of one call, kept for the next, which needs them in the same sizes.
#[derive(Default)]
pub(super) struct CloudMemory {
    pub(super) free: Vec<Vec<f32>>,
}

impl CloudMemory {
    /// A buffer of so many numbers, whatever they are: the smallest that is large enough, or else the largest, grown.
    fn take(&mut self, len: usize) -> Vec<f32> {
        let room = |i: &usize| self.free[*i].capacity();
        let fitting = (0..self.free.len()).filter(|i| room(i) >= len).min_by_key(room);
        let found = fitting.or_else(|| (0..self.free.len()).max_by_key(room));
        let mut buffer = found.map(|i| self.free.swap_remove(i)).unwrap_or_default();
        buffer.resize(len, 0.0);
        buffer
    }

    fn give(&mut self, buffer: Vec<f32>) {
        self.free.push(buffer);
    }
}

fn folded(layer: &MlpLayer) -> LinearLayer {
    fold::linear(&layer.linear, &layer.norm)
}

/// `shared` are the weights of the first layer's inputs that many rows share, `first` is the layer on each row's own.
fn step(isa: Isa, shared: Vec<f32>, first: LinearLayer, layers: &PointMlp) -> Result<Step, ShapeError> {
    let shared = LinearLayer { weights: shared, bias: vec![0.0; first.outputs()] };
    // Whole blocks are looked up: both parts get further outputs, which are always 0 and nobody heeds.
    let outputs = first.outputs().next_multiple_of(16);
    let mut rest = vec![first.widened(outputs)];
    rest.extend(layers.layers.iter().skip(1).map(folded));
    if let Some(second) = rest.get_mut(1) {
        second.weights.resize(outputs * second.outputs(), 0.0);
    }
    let shared = mlp(isa, &[shared.widened(outputs)], Activation::Identity)?;
    Ok(Step { shared, rest: mlp(isa, &rest, Activation::Relu)? })
}

impl CloudEngine {
    pub(super) fn new(isa: Isa, net: &PointNet2) -> Result<Self, ShapeError> {
        let mut channels = vec![crate::pointnet::INPUT_CHANNELS];
        let mut down = Vec::new();
        for abstraction in &net.abstraction {
            // Offsets come first in the weights; the features are shared by the neighbourhoods they are in.
            let (offsets, features) = folded(&abstraction.mlp.layers[0]).split(3);
            let step = step(isa, features, offsets, &abstraction.mlp)?;
            channels.push(step.rest.outputs());
            down.push(step);
        }
        let mut coarse = channels[channels.len() - 1];
        let mut up = Vec::new();
        for propagation in net.propagation.iter().rev() {
            let (LinearLayer { weights: shared, bias }, rest) =
                folded(&propagation.mlp.layers[0]).split(coarse);
            let step = step(isa, shared, LinearLayer { weights: rest, bias }, &propagation.mlp)?;
            coarse = step.rest.outputs();
            up.push(step);
        }
        let surroundings =
            net.surroundings.as_ref().map(|net| SurroundingsEngine::new(isa, net)).transpose()?;
        Ok(Self { down, surroundings, up, head: mlp(isa, &[folded(&net.head)], Activation::Relu)? })
    }

    pub(super) fn features(&self) -> usize {
        self.head.outputs()
    }

    /// Features `[targets, features]` of all targets of the hierarchy.
    pub(super) fn run(
        &self,
        hierarchy: &Hierarchy,
        output: &mut [f32],
        memory: &mut CloudMemory,
    ) -> Result<(), ShapeError> {
        // What each step down says; the points themselves are the level before the first.
        let mut levels: Vec<Vec<f32>> = Vec::with_capacity(self.down.len());
        for (step, grouping) in self.down.iter().zip(hierarchy.groupings()) {
            let finer = levels.last().map_or(hierarchy.points(), |level| level);
            let level = step.down(finer, grouping, memory)?;
            levels.push(level);
        }
        let mut coarse = levels.pop().unwrap_or_default();
        let around = match &self.surroundings {
            Some(net) => Some(net.append(hierarchy.targets(), 3, hierarchy.surroundings(), memory)?),
            None => None,
        };
        for (step, interpolation) in self.up.iter().zip(hierarchy.interpolations().iter().rev()) {
            let level = levels.pop();
            let skip = level.as_deref().or(around.as_deref()).unwrap_or(hierarchy.targets());
            let finer = step.up(&coarse, skip, interpolation, memory)?;
            memory.give(std::mem::replace(&mut coarse, finer));
            level.into_iter().for_each(|level| memory.give(level));
        }
        around.into_iter().for_each(|around| memory.give(around));
        self.head.run(MlpInput { rows: &coarse, lookup: None, pool: 1 }, output)?;
        memory.give(coarse);
        Ok(())
    }
}

impl SurroundingsEngine {
    /// Compiles the shared MLPs of all kinds of neighbourhoods.
    ///
    /// # Errors
    /// Never for a [`Surroundings`] of this crate.
    pub fn new(isa: Isa, net: &Surroundings) -> Result<Self, ShapeError> {
        let compile =
            |net: &PointMlp| mlp(isa, &net.layers.iter().map(folded).collect::<Vec<_>>(), Activation::Relu);
        Ok(Self { mlps: net.mlps.iter().map(compile).collect::<Result<_, _>>()? })
    }

    /// Rows of `width` numbers, one for each place, with what is around the place behind them: zeros if nobody looked.
    ///
    /// # Errors
    /// When there are not as many neighbourhoods as rows.
    pub fn describe(&self, rows: &[f32], width: usize, around: &[Grouping]) -> Result<Vec<f32>, ShapeError> {
        self.append(rows, width, around, &mut CloudMemory::default())
    }

    /// [`Self::describe`], in buffers of `memory`.
    fn append(
        &self,
        rows: &[f32],
        width: usize,
        around: &[Grouping],
        memory: &mut CloudMemory,
    ) -> Result<Vec<f32>, ShapeError> {
        let places = rows.len() / width.max(1);
        let channels = width + self.mlps.iter().map(Mlp::outputs).sum::<usize>();
        let mut longer = memory.take(places * channels);
        if around.len() < self.mlps.len() {
            longer.fill(0.0);
        }
        for (row, own) in longer.chunks_exact_mut(channels).zip(rows.chunks_exact(width.max(1))) {
            row[..width].copy_from_slice(own);
        }
        let mut start = width;
        for (net, found) in self.mlps.iter().zip(around) {
            let mut described = memory.take(places * net.outputs());
            let input = MlpInput { rows: &found.offsets, lookup: None, pool: found.neighbours };
            net.run(input, &mut described)?;
            for (row, of_place) in
                longer.chunks_exact_mut(channels).zip(described.chunks_exact(net.outputs()))
            {
                row[start..start + net.outputs()].copy_from_slice(of_place);
            }
            memory.give(described);
            start += net.outputs();
        }
        Ok(longer)
    }
}

impl Step {
    fn shared(&self, rows: &[f32], memory: &mut CloudMemory) -> Result<Vec<f32>, ShapeError> {
        let mut table = memory.take(rows.len() / self.shared.inputs().max(1) * self.shared.outputs());
        self.shared.run(MlpInput { rows, lookup: None, pool: 1 }, &mut table)?;
        Ok(table)
    }

    fn down(
        &self,
        features: &[f32],
        grouping: &Grouping,
        memory: &mut CloudMemory,
    ) -> Result<Vec<f32>, ShapeError> {
        let table = self.shared(features, memory)?;
        let lookup = Lookup { table: &table, rows: &grouping.rows, weights: None, each: 1 };
        let input = MlpInput { rows: &grouping.offsets, lookup: Some(lookup), pool: grouping.neighbours };
        let centres = grouping.rows.len() / grouping.neighbours.max(1);
        let mut output = memory.take(centres * self.rest.outputs());
        self.rest.run(input, &mut output)?;
        memory.give(table);
        Ok(output)
    }

    fn up(
        &self,
        coarse: &[f32],
        skip: &[f32],
        near: &Interpolation,
        memory: &mut CloudMemory,
    ) -> Result<Vec<f32>, ShapeError> {
        let table = self.shared(coarse, memory)?;
        let lookup = Lookup { table: &table, rows: &near.rows, weights: Some(&near.weights), each: 3 };
        let mut output = memory.take(near.rows.len() / 3 * self.rest.outputs());
        self.rest.run(MlpInput { rows: skip, lookup: Some(lookup), pool: 1 }, &mut output)?;
        memory.give(table);
        Ok(output)
    }
}
