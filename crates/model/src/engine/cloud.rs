//! PointNet++ as a sequence of kernels.

use where2act_kernels::{Isa, Lookup, Mlp, MlpInput, ShapeError};

use super::fold::{Plain, mlp};
use crate::pointnet::{Grouping, Hierarchy, Interpolation, MlpLayer, PointMlp, PointNet2};

/// A step down or up. Its first layer is a sum over two inputs: one that many rows share, whose part is computed
/// once for each of its own rows and looked up, and one of each row.
struct Step {
    shared: Mlp,
    rest: Mlp,
}

/// PointNet++ compiled for one instruction set.
pub(super) struct CloudEngine {
    down: Vec<Step>,
    /// One for each of the surroundings a point is described by.
    surroundings: Vec<Mlp>,
    up: Vec<Step>,
    head: Mlp,
}

fn plain(layer: &MlpLayer) -> Plain {
    Plain::norm_relu(&layer.linear, &layer.norm)
}

fn inputs(layer: &Plain) -> usize {
    layer.weights.len() / layer.bias.len().max(1)
}

fn step(isa: Isa, shared: Plain, first: Plain, layers: &PointMlp) -> Result<Step, ShapeError> {
    let (of_shared, of_rest) = (inputs(&shared), inputs(&first));
    let rest: Vec<_> = std::iter::once(first).chain(layers.layers.iter().skip(1).map(plain)).collect();
    Ok(Step { shared: mlp(isa, of_shared, &[shared])?, rest: mlp(isa, of_rest, &rest)? })
}

impl CloudEngine {
    pub(super) fn new(isa: Isa, net: &PointNet2) -> Result<Self, ShapeError> {
        let mut channels = vec![crate::pointnet::INPUT_CHANNELS];
        let mut down = Vec::new();
        for abstraction in &net.abstraction {
            // Offsets come first in the weights; the features are shared by the neighbourhoods they are in.
            let (offsets, features) = plain(&abstraction.mlp.layers[0]).split(3);
            let rest =
                Plain { bias: features.bias.clone(), activation: features.activation, ..offsets.clone() };
            let shared = Plain { bias: offsets.bias, activation: offsets.activation, ..features };
            let step = step(isa, shared, rest, &abstraction.mlp)?;
            channels.push(step.rest.outputs());
            down.push(step);
        }
        let mut coarse = channels[channels.len() - 1];
        let mut up = Vec::new();
        for propagation in net.propagation.iter().rev() {
            let (shared, rest) = plain(&propagation.mlp.layers[0]).split(coarse);
            let step = step(isa, shared, rest, &propagation.mlp)?;
            coarse = step.rest.outputs();
            up.push(step);
        }
        let around = |net: &PointMlp| mlp(isa, 3, &net.layers.iter().map(plain).collect::<Vec<_>>());
        let described = net.surroundings.iter().flat_map(|surroundings| &surroundings.mlps);
        let surroundings = described.map(around).collect::<Result<_, _>>()?;
        Ok(Self { down, surroundings, up, head: mlp(isa, coarse, &[plain(&net.head)])? })
    }

    pub(super) fn features(&self) -> usize {
        self.head.outputs()
    }

    /// Features `[points, features]` of all points of the hierarchy.
    pub(super) fn run(&self, hierarchy: &Hierarchy, output: &mut [f32]) -> Result<(), ShapeError> {
        let mut levels = vec![hierarchy.points().to_vec()];
        for (step, grouping) in self.down.iter().zip(hierarchy.groupings()) {
            let finer = levels.last().map_or(&[][..], |level| level);
            let level = step.down(finer, grouping)?;
            levels.push(level);
        }
        let mut coarse = levels.pop().unwrap_or_default();
        if let Some(points) = levels.first_mut() {
            *points = self.surrounded(points, hierarchy)?;
        }
        for (step, interpolation) in self.up.iter().zip(hierarchy.interpolations().iter().rev()) {
            let skip = levels.pop().unwrap_or_default();
            coarse = step.up(&coarse, &skip, interpolation)?;
        }
        self.head.run(MlpInput { rows: &coarse, lookup: None, pool: 1 }, output)
    }

    /// Points with what is around each behind its coordinates; zeros if nobody looked.
    fn surrounded(&self, points: &[f32], hierarchy: &Hierarchy) -> Result<Vec<f32>, ShapeError> {
        let channels: usize = 3 + self.surroundings.iter().map(Mlp::outputs).sum::<usize>();
        let mut rows = vec![0.0; points.len() / 3 * channels];
        for (row, point) in rows.chunks_exact_mut(channels).zip(points.chunks_exact(3)) {
            row[..3].copy_from_slice(point);
        }
        let mut start = 3;
        for (net, found) in self.surroundings.iter().zip(hierarchy.surroundings()) {
            let mut described = vec![0.0; points.len() / 3 * net.outputs()];
            let input = MlpInput { rows: &found.offsets, lookup: None, pool: found.neighbours };
            net.run(input, &mut described)?;
            for (row, of_point) in rows.chunks_exact_mut(channels).zip(described.chunks_exact(net.outputs()))
            {
                row[start..start + net.outputs()].copy_from_slice(of_point);
            }
            start += net.outputs();
        }
        Ok(rows)
    }
}

impl Step {
    fn shared(&self, rows: &[f32]) -> Result<Vec<f32>, ShapeError> {
        let mut table = vec![0.0; rows.len() / self.shared.inputs().max(1) * self.shared.outputs()];
        self.shared.run(MlpInput { rows, lookup: None, pool: 1 }, &mut table)?;
        Ok(table)
    }

    fn down(&self, features: &[f32], grouping: &Grouping) -> Result<Vec<f32>, ShapeError> {
        let table = self.shared(features)?;
        let lookup = Lookup { table: &table, rows: &grouping.rows, weights: None, each: 1 };
        let input = MlpInput { rows: &grouping.offsets, lookup: Some(lookup), pool: grouping.neighbours };
        let mut output = vec![0.0; grouping.rows.len() / grouping.neighbours.max(1) * self.rest.outputs()];
        self.rest.run(input, &mut output)?;
        Ok(output)
    }

    fn up(&self, coarse: &[f32], skip: &[f32], near: &Interpolation) -> Result<Vec<f32>, ShapeError> {
        let table = self.shared(coarse)?;
        let lookup = Lookup { table: &table, rows: &near.rows, weights: Some(&near.weights), each: 3 };
        let mut output = vec![0.0; near.rows.len() / 3 * self.rest.outputs()];
        self.rest.run(MlpInput { rows: skip, lookup: Some(lookup), pool: 1 }, &mut output)?;
        Ok(output)
    }
}
