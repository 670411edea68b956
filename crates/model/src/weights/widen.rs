//! A network inside a wider one of its kind that says the same.

use super::{StoredTensor, Tensors};
use crate::config::ModelConfig;
use crate::heads::HAND_VIEWS;
use crate::pointnet::{INPUT_CHANNELS, SURROUNDINGS, Sizes};

/// The tensors of a narrower network, each in the corner of the wider network's tensor of that name. Channels that are new see
/// all others with the weights that the wider network has for them, and nobody hears them: their weights are 0 in
/// every layer above. Training finds out what they are good for. Tensors that the wider network lacks stay as they are.
pub(super) fn widened(narrow: &Tensors, from: &ModelConfig, wide: &Tensors, to: &ModelConfig) -> Tensors {
    let widen = |(name, tensor): (&String, &StoredTensor)| {
        let tensor = match wide.by_name.get(name) {
            Some(room) if fits(tensor, room) => {
                let sources = sources(from, name).into_iter().zip(sources(to, name)).collect::<Vec<_>>();
                placed(tensor, room, &sources)
            }
            _ => tensor.clone(),
        };
        (name.clone(), tensor)
    };
    Tensors { path: narrow.path.clone(), by_name: narrow.by_name.iter().map(widen).collect() }
}

fn fits(tensor: &StoredTensor, room: &StoredTensor) -> bool {
    let extents = tensor.shape.iter().zip(&room.shape);
    tensor.shape.len() == room.shape.len() && extents.clone().all(|(small, large)| small <= large)
}

/// `tensor` in the corner of `room`. Of a weight, whose inputs come from several sources one after the other, each source keeps
/// its place; what is between them becomes 0.
fn placed(tensor: &StoredTensor, room: &StoredTensor, sources: &[(usize, usize)]) -> StoredTensor {
    let mut placed = room.clone();
    let [outputs, inputs, ref kernel @ ..] = tensor.shape[..] else {
        placed.values[..tensor.values.len()].copy_from_slice(&tensor.values);
        return placed;
    };
    let kernel: usize = kernel.iter().product();
    let rows = placed.values.chunks_exact_mut((room.shape[1] * kernel).max(1));
    for (row, own) in rows.zip(tensor.values.chunks_exact((inputs * kernel).max(1))).take(outputs) {
        row.fill(0.0);
        let (mut at, mut own) = (0, own);
        for (narrow, wide) in sources {
            let (of_source, others) = own.split_at((narrow * kernel).min(own.len()));
            row[at..at + of_source.len()].copy_from_slice(of_source);
            (at, own) = (at + wide * kernel, others);
        }
        row[at..at + own.len()].copy_from_slice(own);
    }
    placed
}

/// How many inputs a weight has from each of its sources but the last, in order.
fn sources(config: &ModelConfig, name: &str) -> Vec<usize> {
    let (c, sizes) = (config.channels(), Sizes::new(config.width));
    let of = |prefix: &str, suffix: &str| -> Option<usize> {
        name.strip_prefix(prefix)?.strip_suffix(suffix)?.parse().ok()
    };
    if let Some(block) = of("backbone.decoder.blocks.", ".conv1.weight") {
        // What is upsampled, then the skip.
        return vec![[c[3], c[2], c[1], c[0], c[0]][block]];
    }
    let first = ".mlp.layers.0.linear.weight";
    if of("backbone.abstraction.", first).is_some() {
        return vec![3];
    }
    match of("backbone.propagation.", first) {
        Some(0) if config.surroundings => {
            let points = [sizes.below(0), INPUT_CHANNELS];
            points.into_iter().chain([sizes.around[2]; SURROUNDINGS.len() - 1]).collect()
        }
        Some(level) => vec![sizes.below(level)],
        None if name == "heads.second_look.mlp1.weight" => {
            let hand = [config.features + 6 + config.alignments];
            hand.into_iter().chain([sizes.around[2]; HAND_VIEWS.len() - 1]).collect()
        }
        None => Vec::new(),
    }
}
