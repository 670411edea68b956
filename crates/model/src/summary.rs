//! What a network costs: parameters and multiply-adds, block by block.

use std::fmt;

use crate::config::{Modality, ModelConfig};
use crate::heads::{ALIGNED, HAND_VIEWS};
use crate::pointnet::{LEVELS, SURROUNDINGS, Sizes};

/// A part of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Block {
    /// Its name, as parameters begin.
    pub name: String,
    /// Numbers that are trained.
    pub parameters: u64,
    /// Multiply-adds for one picture or cloud; of a head: for all its pixels or points, densely, once.
    pub multiply_adds: u64,
}

/// Parameters and multiply-adds of a network.
///
/// Counted as the layers are written. Less is computed: products with a weight are done before points are gathered,
/// and the fast kernels for convolution save most of theirs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Summary {
    /// The backbone's blocks, then the heads.
    pub blocks: Vec<Block>,
}

impl Summary {
    /// Counts the network that a configuration describes.
    #[must_use]
    pub fn new(config: &ModelConfig) -> Self {
        let mut blocks = match config.modality {
            Modality::Rgb => unet(config),
            Modality::Cloud => pointnet(config),
        };
        blocks.extend(heads(config));
        Self { blocks }
    }

    /// Numbers that are trained, in all blocks.
    #[must_use]
    pub fn parameters(&self) -> u64 {
        self.blocks.iter().map(|b| b.parameters).sum()
    }

    /// What all blocks have and the backbone takes, in a few words.
    #[must_use]
    pub fn total(&self) -> String {
        let (parameters, gmac) = (self.parameters() as f64 / 1e6, self.backbone_multiply_adds() as f64 / 1e9);
        format!("{parameters:.2} M parameters, backbone {gmac:.2} GMAC")
    }

    /// Multiply-adds of the backbone for one picture or cloud.
    #[must_use]
    pub fn backbone_multiply_adds(&self) -> u64 {
        self.blocks.iter().filter(|b| b.name.starts_with("backbone")).map(|b| b.multiply_adds).sum()
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<28} {:>12} {:>10}", "block", "parameters", "MMAC")?;
        for b in &self.blocks {
            writeln!(f, "{:<28} {:>12} {:>10.1}", b.name, b.parameters, b.multiply_adds as f64 / 1e6)?;
        }
        write!(f, "total: {}", self.total())
    }
}

/// Adds layers up.
#[derive(Default)]
struct Count {
    parameters: u64,
    multiply_adds: u64,
}

impl Count {
    /// A square convolution without bias and its batch-norm, `side` x `side` outputs.
    fn conv_norm(mut self, input: usize, output: usize, kernel: usize, side: usize) -> Self {
        let weight = (input * output * kernel * kernel) as u64;
        self.parameters += weight + 2 * output as u64;
        self.multiply_adds += weight * (side * side) as u64;
        self
    }

    /// A linear layer with bias or with batch-norm on `rows` rows.
    fn linear(mut self, input: usize, output: usize, extra: usize, rows: usize) -> Self {
        self.parameters += (input * output + extra * output) as u64;
        self.multiply_adds += (input * output * rows) as u64;
        self
    }

    fn mlp(self, input: usize, sizes: &[usize], rows: usize) -> Self {
        let inputs = std::iter::once(&input).chain(sizes);
        inputs.zip(sizes).fold(self, |count, (i, o)| count.linear(*i, *o, 2, rows))
    }

    fn block(self, name: &str) -> Block {
        Block { name: name.to_owned(), parameters: self.parameters, multiply_adds: self.multiply_adds }
    }
}

fn unet(config: &ModelConfig) -> Vec<Block> {
    let c = config.channels();
    let side = config.preprocessing.image_side;
    let basic = |count: Count, input: usize, output: usize, side: usize| {
        let count = count.conv_norm(input, output, 3, side).conv_norm(output, output, 3, side);
        if input == output { count } else { count.conv_norm(input, output, 1, side) }
    };
    let mut blocks = vec![Count::default().conv_norm(3, c[0], 7, side / 2).block("backbone.encoder.conv1")];
    for level in 0..4 {
        let (input, side) = (c[level.max(1) - 1], side >> (level + 2));
        let count = basic(basic(Count::default(), input, c[level], side), c[level], c[level], side);
        blocks.push(count.block(&format!("backbone.encoder.layer{}", level + 1)));
    }
    let ups =
        [[c[3], c[2], c[2]], [c[2], c[1], c[1]], [c[1], c[0], c[0]], [c[0], c[0], c[0]], [c[0], 3, c[0]]];
    for (i, [input, skip, output]) in ups.into_iter().enumerate() {
        let side = side >> (4 - i);
        let count =
            Count::default().conv_norm(input + skip, output, 3, side).conv_norm(output, output, 3, side);
        blocks.push(count.block(&format!("backbone.decoder.blocks.{i}")));
    }
    blocks.push(Count::default().linear(c[0], config.features, 1, side * side).block("backbone.head"));
    blocks
}

fn pointnet(config: &ModelConfig) -> Vec<Block> {
    let sizes = Sizes::new(config.width);
    let channels = sizes.levels();
    let mut blocks = Vec::new();
    for (i, level) in LEVELS.iter().enumerate() {
        let count = Count::default().mlp(3 + channels[i], &sizes.down[i], level.centres * level.neighbours);
        blocks.push(count.block(&format!("backbone.abstraction.{i}")));
    }
    let mut around = 0;
    if config.surroundings {
        for (i, level) in SURROUNDINGS.iter().enumerate() {
            around += sizes.around[2];
            let count = Count::default().mlp(3, &sizes.around, config.points * level.neighbours);
            blocks.push(count.block(&format!("backbone.surroundings.{i}")));
        }
    }
    for i in (0..4).rev() {
        let input = sizes.below(i) + channels[i] + if i == 0 { around } else { 0 };
        let rows = if i == 0 { config.points } else { LEVELS[i - 1].centres };
        let count = Count::default().mlp(input, &sizes.up[i], rows);
        blocks.push(count.block(&format!("backbone.propagation.{i}")));
    }
    blocks.push(
        Count::default().linear(sizes.finest(), config.features, 2, config.points).block("backbone.head"),
    );
    blocks
}

fn heads(config: &ModelConfig) -> Vec<Block> {
    let (f, h, p, z) = (config.features, config.hidden, config.primitives.len(), config.latent);
    let a = config.alignments;
    let rows = match config.modality {
        Modality::Rgb => config.preprocessing.image_side.pow(2),
        Modality::Cloud => config.points,
    };
    let head_of = |hidden, input, output| {
        Count::default().linear(input, hidden, 1, rows).linear(hidden, output, 1, rows)
    };
    let head = |input, output| head_of(h, input, output);
    let mut blocks = vec![
        head_of(config.hidden_of_actionability(), f, p).block("heads.actionability"),
        head(f + 6 + a, p).linear(f, ALIGNED * a, usize::from(a > 0), rows).block("heads.score"),
        head(f + z, 6 * p).block("heads.proposal.decoder"),
        head(f + 6, p * z).linear(h, p * z, 1, rows).block("heads.proposal.encoder"),
    ];
    if config.looks_twice() {
        let around = Sizes::new(config.width).around;
        let seen = HAND_VIEWS.len() * around[2];
        let views = HAND_VIEWS
            .iter()
            .fold(head(f + 6 + a + seen, p), |count, view| count.mlp(3, &around, rows * view.points));
        blocks.push(views.block("heads.second_look"));
    }
    if config.ways.is_some() {
        blocks.push(Count::default().linear(f, 6, 1, rows).block("heads.motion"));
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::Network;
    use burn::tensor::Device;
    use where2act_core::{Primitive, Seed};

    /// Parameters without the running statistics, as the network itself counts them.
    fn trained(network: &Network) -> u64 {
        let tensors = network.tensors();
        let trained = tensors.by_name.iter().filter(|(name, _)| !name.contains("running_"));
        trained.map(|(_, tensor)| tensor.values.len() as u64).sum()
    }

    #[test]
    fn the_documented_sizes() {
        let unet = Summary::new(&ModelConfig::new(Modality::Rgb, &[Primitive::Pushing]));
        assert_eq!(format!("{:.1}", unet.parameters() as f64 / 1e6), "14.5");
        assert_eq!(format!("{:.1}", unet.backbone_multiply_adds() as f64 / 1e9), "8.8");
        let cloud = Summary::new(&ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]));
        let published: u64 =
            cloud.blocks.iter().filter(|b| !b.name.ends_with("encoder")).map(|b| b.parameters).sum();
        assert_eq!(format!("{:.2}", published as f64 / 1e6), "1.02");
        assert_eq!(format!("{:.2}", cloud.backbone_multiply_adds() as f64 / 1e9), "1.35");
    }

    #[test]
    fn counts_are_those_of_the_network() {
        for modality in [Modality::Rgb, Modality::Cloud] {
            for primitives in [&Primitive::ALL[..1], &Primitive::ALL] {
                let mut config = ModelConfig::new(modality, primitives).with_width(0.25);
                config.alignments = primitives.len() - 1;
                config.actionability_hidden = (primitives.len() > 1).then_some(17);
                config.second_look = modality == Modality::Cloud;
                config.ways = (primitives.len() > 1).then_some(2.0);
                let network = Network::new(&config, Seed(1), &Device::flex());
                assert_eq!(Summary::new(&config).parameters(), trained(&network));
            }
        }
    }
}
