//! The heads of a network, laid out for prediction: what depends on a pixel only is computed once per pixel, what
//! depends on a random code only once per prediction, and of the last layers only the primitive that is asked for.

use burn::nn::Linear;
use burn::tensor::Tensor;
use nalgebra::Rotation3;
use rand::RngExt;
use where2act_core::{Orientation6, Seed};
use where2act_kernels::{Activation, Isa, Lookup, Mlp, MlpInput, MlpLayer, ShapeError};
use where2act_model::{Heads, ModelConfig, SplitLinear};

use super::sigmoid;
use crate::Error;

/// Slope of the heads' hidden activation for negative numbers, as in the model crate.
const LEAK: Activation = Activation::Leaky(0.01);

/// Heads for prediction.
pub(crate) struct DecodingHeads {
    features: usize,
    /// Size of the hidden layers, rounded up to what the kernels look up.
    hidden: usize,
    latent: usize,
    primitives: usize,
    /// Feature -> logits, one per primitive.
    actionability: Mlp,
    /// Feature -> its share of the proposals' hidden layer.
    proposal_feature: Mlp,
    /// Code -> six raw numbers, per primitive.
    proposals: Vec<Mlp>,
    /// Feature -> its share of the score's hidden layer.
    score_feature: Mlp,
    /// Feature -> of every alignment the weights of a hand's approach, forward and left; `None` without alignments.
    align: Option<Mlp>,
    /// Orientation and alignments -> logit, per primitive.
    scores: Vec<Mlp>,
}

/// What the decoder draws orientations from, `[samples, latent]`.
pub(crate) struct Codes(Vec<f32>);

/// An orientation and its score.
pub(crate) type Tried = (Rotation3<f32>, f32);

impl DecodingHeads {
    pub(crate) fn new(heads: &Heads, config: &ModelConfig) -> Result<Self, Error> {
        let ModelConfig { features, latent, .. } = *config;
        let hidden = config.hidden.next_multiple_of(16);
        let primitives = config.primitives.len();
        let head = Head { isa: Isa::best(), features, hidden, primitives };
        let (proposal_feature, proposals) =
            head.split(&heads.proposal.decoder.mlp1, &heads.proposal.decoder.mlp2)?;
        let (score_feature, scores) = head.split(&heads.score.mlp1, &heads.score.mlp2)?;
        let align = heads
            .score
            .align
            .as_ref()
            .map(|align| head.mlp(features, &[Plain::of(align)?.layer(Activation::Identity)]));
        let a = &heads.actionability;
        let layers = [Plain::of(&a.mlp1)?.widened(hidden), Plain::of(&a.mlp2)?.deepened(hidden)];
        let actionability =
            head.mlp(features, &[layers[0].layer(LEAK), layers[1].layer(Activation::Identity)])?;
        Ok(Self {
            features,
            hidden,
            latent,
            primitives,
            actionability,
            proposal_feature,
            proposals,
            score_feature,
            align: align.transpose()?,
            scores,
        })
    }

    /// Logits of actionability of every row, `[n, features]` -> `[n, primitives]`.
    pub(crate) fn actionability(&self, features: &[f32]) -> Result<Vec<f32>, Error> {
        let mut logits = vec![0.0; features.len() / self.features * self.primitives];
        run(&self.actionability, features, None, &mut logits)?;
        Ok(logits)
    }

    /// `samples` codes drawn from the normal distribution the decoder was trained for. All candidates share them.
    pub(crate) fn codes(&self, samples: usize, seed: Seed) -> Codes {
        let mut rng = seed.child("proposal codes", 0).rng();
        let mut z: Vec<f32> = Vec::with_capacity(samples * self.latent + 1);
        while z.len() < samples * self.latent {
            // Box and Muller, 1958. `random` is below 1, so the logarithm is finite.
            let (u, v) = (1.0 - rng.random::<f32>(), rng.random::<f32>());
            let (radius, (sin, cos)) = ((-2.0 * u.ln()).sqrt(), (std::f32::consts::TAU * v).sin_cos());
            z.extend([radius * cos, radius * sin]);
        }
        z.truncate(samples * self.latent);
        Codes(z)
    }

    /// For each candidate, given by its row of the feature matrix, as many orientations as there are codes and their
    /// scores, for one output of the heads.
    pub(crate) fn propose(
        &self,
        features: &[f32],
        candidates: &[u32],
        output: usize,
        Codes(codes): &Codes,
    ) -> Result<Vec<Vec<Tried>>, Error> {
        let (Some(proposal), Some(score)) = (self.proposals.get(output), self.scores.get(output)) else {
            return Ok(Vec::new());
        };
        let n = self.features;
        let at = |row: u32| features.get(row as usize * n..(row as usize + 1) * n);
        let own: Vec<f32> = candidates.iter().filter_map(|&row| at(row)).flatten().copied().collect();
        let samples = codes.len() / self.latent;
        let rows: Vec<i64> =
            (0..candidates.len() as i64).flat_map(|c| std::iter::repeat_n(c, samples)).collect();
        let mut half = vec![0.0; candidates.len() * self.hidden];

        run(&self.proposal_feature, &own, None, &mut half)?;
        let mut raw = vec![0.0; rows.len() * 6];
        run(proposal, &codes.repeat(candidates.len()), Some((&half, &rows)), &mut raw)?;
        let rotations: Vec<Rotation3<f32>> =
            raw.as_chunks().0.iter().map(|six| Orientation6(*six).to_rotation()).collect();

        let hands = self.hands(&own, &rotations, samples)?;
        run(&self.score_feature, &own, None, &mut half)?;
        let mut logits = vec![0.0; rows.len()];
        run(score, &hands, Some((&half, &rows)), &mut logits)?;
        let tried: Vec<Tried> = rotations.into_iter().zip(logits.into_iter().map(sigmoid)).collect();
        Ok(tried.chunks(samples.max(1)).map(<[Tried]>::to_vec).collect())
    }

    /// What the score sees of hands, `each` of them at every feature: `[rotations, 6 + alignments]`.
    fn hands(&self, features: &[f32], rotations: &[Rotation3<f32>], each: usize) -> Result<Vec<f32>, Error> {
        let axes = rotations.iter().map(|r| Orientation6::from_rotation(r).0);
        let Some(align) = &self.align else { return Ok(axes.flatten().collect()) };
        let width = align.outputs();
        let mut weights = vec![0.0; features.len() / self.features * width];
        run(align, features, None, &mut weights)?;
        let mut hands = Vec::with_capacity(rotations.len() * (6 + width / 9));
        for (i, (rotation, axes)) in rotations.iter().zip(axes).enumerate() {
            hands.extend(axes);
            let left: [f32; 3] = rotation.matrix().column(1).into();
            for weights in weights[i / each * width..][..width].as_chunks::<9>().0 {
                let weighted = |axes: &[f32], weights: &[f32]| -> f32 {
                    axes.iter().zip(weights).map(|(a, w)| a * w).sum()
                };
                hands.push(weighted(&axes, &weights[..6]) + weighted(&left, &weights[6..]));
            }
        }
        Ok(hands)
    }
}

/// Rows through an MLP; the hidden layer starts from the row of the table that belongs to each.
fn run(mlp: &Mlp, rows: &[f32], from: Option<(&[f32], &[i64])>, out: &mut [f32]) -> Result<(), Error> {
    let lookup = from.map(|(table, rows)| Lookup { table, rows, weights: None, each: 1 });
    mlp.run(MlpInput { rows, lookup, pool: 1 }, out).map_err(|e| Error::Network(e.to_string()))
}

/// What all heads have in common.
struct Head {
    isa: Isa,
    features: usize,
    hidden: usize,
    primitives: usize,
}

impl Head {
    fn mlp(&self, inputs: usize, layers: &[MlpLayer<'_>]) -> Result<Mlp, Error> {
        Mlp::new(self.isa, inputs, layers).map_err(|e: ShapeError| Error::Network(e.to_string()))
    }

    /// A head on a feature and something else: the feature's share of the hidden layer, and for each primitive what
    /// becomes of the something else.
    fn split(&self, first: &SplitLinear, second: &Linear) -> Result<(Mlp, Vec<Mlp>), Error> {
        let first = Plain::of(&first.linear)?.widened(self.hidden);
        let other = first.inputs - self.features;
        let (of_feature, of_other) = first.weights.split_at(self.features * self.hidden);
        let zero = vec![0.0; self.hidden];
        // The bias counts once, in the feature's share.
        let feature = MlpLayer { weights: of_feature, bias: &first.bias, activation: Activation::Identity };
        let last = Plain::of(second)?.deepened(self.hidden);
        let per_primitive = (0..self.primitives).map(|p| {
            let own =
                last.columns(p * last.outputs / self.primitives..(p + 1) * last.outputs / self.primitives);
            let hidden = MlpLayer { weights: of_other, bias: &zero, activation: LEAK };
            self.mlp(other, &[hidden, own.layer(Activation::Identity)])
        });
        Ok((self.mlp(self.features, &[feature])?, per_primitive.collect::<Result<_, _>>()?))
    }
}

/// A linear layer as numbers: weights `[inputs, outputs]`.
struct Plain {
    inputs: usize,
    outputs: usize,
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Plain {
    fn of(linear: &Linear) -> Result<Self, Error> {
        let weight = linear.weight.val();
        let [inputs, outputs] = weight.dims();
        let bias = match &linear.bias {
            Some(bias) => numbers(bias.val())?,
            None => vec![0.0; outputs],
        };
        Ok(Self { inputs, outputs, weights: numbers(weight)?, bias })
    }

    /// More outputs, all zero.
    fn widened(mut self, outputs: usize) -> Self {
        let padding = vec![0.0; outputs - self.outputs];
        let rows = self.weights.chunks_exact(self.outputs);
        self.weights = rows.flat_map(|row| row.iter().chain(&padding)).copied().collect();
        self.bias.resize(outputs, 0.0);
        self.outputs = outputs;
        self
    }

    /// More inputs that count nothing.
    fn deepened(mut self, inputs: usize) -> Self {
        self.weights.resize(inputs * self.outputs, 0.0);
        self.inputs = inputs;
        self
    }

    /// Some of the outputs.
    fn columns(&self, range: std::ops::Range<usize>) -> Self {
        let rows = self.weights.chunks_exact(self.outputs);
        let weights = rows.flat_map(|row| row.get(range.clone()).unwrap_or_default()).copied().collect();
        let bias = self.bias.get(range.clone()).unwrap_or_default().to_vec();
        Self { inputs: self.inputs, outputs: range.len(), weights, bias }
    }

    fn layer(&self, activation: Activation) -> MlpLayer<'_> {
        MlpLayer { weights: &self.weights, bias: &self.bias, activation }
    }
}

fn numbers<const D: usize>(tensor: Tensor<D>) -> Result<Vec<f32>, Error> {
    tensor.into_data().convert::<f32>().try_into_vec().map_err(|e| Error::Network(format!("{e:?}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Device, TensorData};
    use where2act_core::Primitive;
    use where2act_model::{Modality, Network, to_axes};

    /// The heads of the model crate, one row at a time, for every output: what decoding must equal.
    #[test]
    fn decoding_equals_the_heads_of_the_model() {
        let device = Device::flex();
        let mut config = ModelConfig::new(Modality::Cloud, &Primitive::ALL[1..4]);
        (config.hidden, config.latent, config.alignments) = (40, 7, 5);
        let network = Network::new(&config, Seed(3), &device);
        let heads = DecodingHeads::new(&network.heads, &config).unwrap();
        let rows = 50;
        let features: Vec<f32> =
            (0..rows * 128).map(|i| ((i * 37 % 101) as f32 / 50.0 - 1.0).powi(3)).collect();
        let tensor = |v: &[f32], width: usize| {
            Tensor::<2>::from_data(TensorData::new(v.to_vec(), [v.len() / width, width]), &device)
        };
        let plain = |t: Tensor<2>| numbers(t).unwrap();
        let close = |a: &[f32], b: &[f32]| {
            assert_eq!(a.len(), b.len());
            // Sums of 128 products in another order.
            a.iter().zip(b).for_each(|(a, b)| assert!((a - b).abs() < 2e-5, "{a} {b}"));
        };
        let all = plain(network.heads.actionability.forward(tensor(&features, 128)));
        close(&heads.actionability(&features).unwrap(), &all);

        let codes = heads.codes(11, Seed(5));
        for output in 0..3 {
            let found = heads.propose(&features, &[49, 3], output, &codes).unwrap();
            for (row, found) in [49usize, 3].into_iter().zip(found) {
                let feature = tensor(&features[row * 128..(row + 1) * 128].repeat(11), 128);
                let raw = network.heads.proposal.decode(feature.clone(), tensor(&codes.0, 7));
                let axes = to_axes(raw.slice([0..11, output..output + 1, 0..6]).reshape([11, 6]));
                let logits =
                    network.heads.score.forward(feature, axes.clone()).slice([0..11, output..output + 1]);
                let found_axes: Vec<f32> =
                    found.iter().flat_map(|(r, _)| Orientation6::from_rotation(r).0).collect();
                close(&found_axes, &plain(axes));
                let scores: Vec<f32> = found.iter().map(|(_, s)| *s).collect();
                close(&scores, &plain(logits).into_iter().map(sigmoid).collect::<Vec<_>>());
            }
        }
    }

    #[test]
    fn codes_are_normal_and_depend_on_the_seed() {
        let config = ModelConfig::new(Modality::Cloud, &Primitive::ALL);
        let network = Network::new(&config, Seed(3), &Device::flex());
        let heads = DecodingHeads::new(&network.heads, &config).unwrap();
        let Codes(z) = heads.codes(10_000, Seed(1));
        let n = z.len() as f32;
        let mean = z.iter().sum::<f32>() / n;
        let variance = z.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>() / n;
        // Standard errors at 100,000 numbers: 0.003 and 0.0045.
        assert!(mean.abs() < 0.015 && (variance - 1.0).abs() < 0.02, "{mean} {variance}");
        assert_ne!(z, heads.codes(10_000, Seed(2)).0);
        assert_eq!(z[..50], heads.codes(5, Seed(1)).0);
    }
}
