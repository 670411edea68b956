//! The heads of a network, laid out for prediction: what depends on a pixel only is computed once per pixel, what
//! depends on a random code only once per prediction, and of the last layers only the primitive that is asked for.

use std::ops::Range;

use burn::nn::Linear;
use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::RngExt;
use rayon::prelude::*;
use where2act_core::Seed;
use where2act_kernels::{Activation, Isa, Lookup, Mlp, MlpInput, Perceptron, ShapeError};
use where2act_model::{Heads, LinearLayer, ModelConfig, ScoreHead};

use super::frames::{self, LANES};
use super::second_look::SecondLook;
use super::sigmoid;
use super::ways::Ways;
use crate::Error;

/// Slope of the heads' hidden activation for negative numbers, as in the model crate.
pub(super) const LEAK: f32 = 0.01;
/// Numbers of a hand that an alignment weighs: approach, forward, left.
pub(super) const AXES: usize = 9;
/// Those of them that the score sees without alignments too: approach, forward.
const SEEN: usize = 6;

/// Heads for prediction.
pub(crate) struct DecodingHeads {
    isa: Isa,
    /// Numbers per row: features, or what the backbone's last layer makes them of.
    features: usize,
    /// Size of the hidden layers but the actionability's, rounded up to what the kernels look up.
    hidden: usize,
    latent: usize,
    /// Feature -> hidden layer of the actionability.
    actionability: LinearLayer,
    /// Its logits, one per primitive.
    logits: Output,
    /// Feature -> its share of the proposals' hidden layer.
    proposal_feature: Mlp,
    /// What a code adds to the proposals' hidden layer, `[latent, hidden]`.
    code: Vec<f32>,
    /// Six raw numbers, per primitive.
    proposals: Vec<Output>,
    /// Feature -> its share of the score's hidden layer.
    score_feature: Mlp,
    /// What a hand's axes add to the score's hidden layer.
    hand: Hand,
    /// A logit, per primitive.
    scores: Vec<Output>,
    /// What the ways of the points add to scores, if the network has them.
    ways: Option<Ways>,
    /// The second score, if the network has one.
    pub(crate) second_look: Option<SecondLook>,
}

/// What the decoder draws orientations from.
pub(crate) struct Codes {
    samples: usize,
    /// What they add to the proposals' hidden layer, `[hidden, samples]`, padded to whole vectors.
    table: Vec<f32>,
}

/// The orientations that were tried at a candidate, with their scores.
pub(crate) struct Tried {
    /// Axes of the hands, `[AXES, samples]`, padded to whole vectors.
    axes: Vec<f32>,
    pub(crate) scores: Vec<f32>,
}

/// Outputs of a hidden layer.
struct Output {
    /// `[outputs, hidden]`.
    weights: Vec<f32>,
    bias: Vec<f32>,
}

/// The hand's half of the score's hidden layer.
///
/// Alignments are sums of axes whose weights a feature chooses, and the hidden layer's products with them are sums of
/// axes again: for each feature one matrix, whatever the number of hands.
struct Hand {
    /// What axes add by themselves: `[SEEN, hidden]`, with alignments `[AXES, hidden]`.
    axes: Vec<f32>,
    /// Feature -> `[AXES, alignments]`, and alignments -> hidden.
    align: Option<(Mlp, Mlp)>,
}

impl DecodingHeads {
    /// `last` is the layer that the backbone leaves to the heads.
    pub(crate) fn new(
        heads: &Heads,
        config: &ModelConfig,
        last: Option<&LinearLayer>,
    ) -> Result<Self, Error> {
        let (isa, hidden) = (Isa::best(), config.hidden.next_multiple_of(16));
        let features = last.map_or(config.features, LinearLayer::inputs);
        let primitives = config.primitives.len();
        let first = |linear: &Linear, outputs: usize| {
            LinearLayer::of(linear).widened(outputs).after(last).split(features)
        };
        let of_actionability = config.hidden_of_actionability().next_multiple_of(16);
        let (actionability, _) = first(&heads.actionability.mlp1, of_actionability);
        let (proposal_feature, code) = first(&heads.proposal.decoder.mlp1.linear, hidden);
        let (score_feature, hand) = first(&heads.score.mlp1.linear, hidden);
        let logits = Output::of(&heads.actionability.mlp2, 1, of_actionability);
        Ok(Self {
            isa,
            features,
            hidden,
            latent: config.latent,
            actionability,
            logits: logits.into_iter().next().unwrap_or(Output { weights: vec![], bias: vec![] }),
            proposal_feature: compiled(isa, &proposal_feature)?,
            code,
            proposals: Output::of(&heads.proposal.decoder.mlp2, primitives, hidden),
            score_feature: compiled(isa, &score_feature)?,
            hand: Hand::new(isa, &heads.score, hand, hidden, last)?,
            scores: Output::of(&heads.score.mlp2, primitives, hidden),
            ways: Ways::new(isa, heads, config, last)?,
            second_look: SecondLook::new(isa, heads, config, last)?,
        })
    }

    /// Logits of actionability of some rows, `[n, features]` -> `[primitives, n]`. Those of other rows are zero.
    pub(crate) fn actionability(&self, features: &[f32], wanted: &[Range<usize>]) -> Result<Vec<f32>, Error> {
        let mut logits = vec![0.0; features.len() / self.features * self.logits.bias.len()];
        let net = self.logits.after(&self.actionability.weights, &self.actionability.bias);
        net.rows(self.isa, features, wanted, &mut logits).map_err(failed)?;
        Ok(logits)
    }

    /// `samples` codes drawn from the normal distribution the decoder was trained for. All candidates share them.
    pub(crate) fn codes(&self, samples: usize, seed: Seed) -> Codes {
        let n = samples.next_multiple_of(LANES);
        let z = normal(samples * self.latent, seed);
        // Number by number, so that the inner loop below runs over samples.
        let z: Vec<f32> =
            (0..self.latent).flat_map(|i| z.iter().skip(i).step_by(self.latent)).copied().collect();
        let mut table = vec![0.0; self.hidden * n];
        for (j, sums) in table.chunks_exact_mut(n).enumerate() {
            let weights = self.code.iter().skip(j).step_by(self.hidden);
            for (z, weight) in z.chunks_exact(samples).zip(weights) {
                sums.iter_mut().zip(z).for_each(|(sum, z)| *sum += weight * z);
            }
        }
        Codes { samples, table }
    }

    /// For each candidate, given by its row of the feature matrix, as many orientations as there are codes, for one output
    /// of the heads.
    pub(crate) fn propose(
        &self,
        features: &[f32],
        candidates: &[u32],
        output: usize,
        codes: &Codes,
    ) -> Result<Vec<Tried>, Error> {
        let (Some(proposal), Some(score)) = (self.proposals.get(output), self.scores.get(output)) else {
            return Ok(Vec::new());
        };
        let n = self.features;
        let at = |row: u32| features.get(row as usize * n..(row as usize + 1) * n);
        let own: Vec<f32> = candidates.iter().filter_map(|&row| at(row)).flatten().copied().collect();
        let of_proposals = run(&self.proposal_feature, &own, None)?;
        let of_scores = run(&self.score_feature, &own, None)?;
        let hands = self.hand.at(&own, candidates.len())?;
        let ways = self.ways.as_ref().map(|head| head.at(&own)).transpose()?.unwrap_or_default();
        let (one, columns) = (hands.len() / candidates.len().max(1), codes.table.len() / self.hidden);
        of_proposals
            .par_chunks_exact(self.hidden)
            .zip(of_scores.par_chunks_exact(self.hidden))
            .zip(hands.par_chunks_exact(one.max(1)))
            .enumerate()
            .map(|(candidate, ((of_proposals, of_scores), hand))| {
                let mut raw = vec![0.0; 6 * columns];
                let net = proposal.after(&[], of_proposals);
                net.columns(self.isa, &[], Some(&codes.table), &mut raw).map_err(failed)?;
                let axes = frames::axes(&raw);
                let seen = axes.get(..one / self.hidden * columns).unwrap_or_default();
                let mut scores = vec![0.0; columns];
                let net = score.after(hand, of_scores);
                net.columns(self.isa, seen, None, &mut scores).map_err(failed)?;
                if let (Some(head), Some(ways)) = (&self.ways, ways.get(candidate)) {
                    head.add(ways, output, &axes, &mut scores);
                }
                scores.iter_mut().for_each(|logit| *logit = sigmoid(*logit));
                scores.truncate(codes.samples);
                Ok(Tried { axes, scores })
            })
            .collect()
    }
}

impl Tried {
    /// Hand rotation of a sample, in the frame in which the network knows directions.
    pub(crate) fn rotation(&self, sample: usize) -> Rotation3<f32> {
        let [approach, forward, left] = frames::columns(&self.axes, sample);
        Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[forward, left, approach]))
    }

    /// Where the hand of a sample goes.
    pub(crate) fn approach(&self, sample: usize) -> Vector3<f32> {
        let [approach, ..] = frames::columns(&self.axes, sample);
        approach
    }
}

impl Hand {
    /// `weights` are those of the score's hidden layer for a hand, `[SEEN + alignments, hidden]`.
    fn new(
        isa: Isa,
        score: &ScoreHead,
        mut weights: Vec<f32>,
        hidden: usize,
        last: Option<&LinearLayer>,
    ) -> Result<Self, Error> {
        let Some(align) = &score.align else { return Ok(Self { axes: weights, align: None }) };
        let align = LinearLayer::of(align).after(last);
        let alignments = align.outputs() / AXES;
        // The model has the axes of each alignment together, the product below the alignments of each axis.
        let align = align.ordered(|i| i % alignments * AXES + i / alignments);
        let mix = LinearLayer { weights: weights.split_off(SEEN * hidden), bias: vec![0.0; hidden] };
        weights.resize(AXES * hidden, 0.0);
        Ok(Self { axes: weights, align: Some((compiled(isa, &align)?, compiled(isa, &mix)?)) })
    }

    /// The matrices at `count` features, each as large as `axes`.
    fn at(&self, features: &[f32], count: usize) -> Result<Vec<f32>, Error> {
        let Some((align, mix)) = &self.align else { return Ok(self.axes.repeat(count)) };
        let weights = run(align, features, None)?;
        let axes: Vec<i64> =
            (0..weights.len() / mix.inputs().max(1)).map(|row| (row % AXES) as i64).collect();
        run(mix, &weights, Some((&self.axes, &axes)))
    }
}

impl Output {
    /// A linear layer after a hidden one, cut into `parts`.
    fn of(linear: &Linear, parts: usize, hidden: usize) -> Vec<Self> {
        let all = LinearLayer::of(linear);
        let each = all.outputs() / parts.max(1);
        let column = |output: usize| {
            let weights = all.weights.iter().skip(output).step_by(all.outputs()).copied();
            weights.chain(std::iter::repeat(0.0)).take(hidden)
        };
        let part = |part: usize| {
            let outputs = part * each..(part + 1) * each;
            let bias = all.bias.get(outputs.clone()).unwrap_or_default().to_vec();
            Self { weights: outputs.flat_map(column).collect(), bias }
        };
        (0..parts).map(part).collect()
    }

    /// With the hidden layer before it.
    fn after<'a>(&'a self, first: &'a [f32], start: &'a [f32]) -> Perceptron<'a> {
        Perceptron { first, start, slope: LEAK, second: &self.weights, bias: &self.bias }
    }
}

/// A linear layer alone, compiled.
pub(super) fn compiled(isa: Isa, layer: &LinearLayer) -> Result<Mlp, Error> {
    Mlp::new(isa, layer.inputs(), &[layer.followed_by(Activation::Identity)]).map_err(failed)
}

/// Rows through an MLP; each result starts from the row of the table that belongs to it.
pub(super) fn run(mlp: &Mlp, rows: &[f32], from: Option<(&[f32], &[i64])>) -> Result<Vec<f32>, Error> {
    let mut out = vec![0.0; rows.len() / mlp.inputs().max(1) * mlp.outputs()];
    let lookup = from.map(|(table, rows)| Lookup { table, rows, weights: None, each: 1 });
    mlp.run(MlpInput { rows, lookup, pool: 1 }, &mut out).map_err(failed)?;
    Ok(out)
}

pub(super) fn failed(error: ShapeError) -> Error {
    Error::Network(error.to_string())
}

/// `count` numbers of the standard normal distribution.
pub(super) fn normal(count: usize, seed: Seed) -> Vec<f32> {
    let mut rng = seed.child("proposal codes", 0).rng();
    let mut z: Vec<f32> = Vec::with_capacity(count + 1);
    while z.len() < count {
        // Box and Muller, 1958. `random` is below 1, so the logarithm is finite.
        let (u, v) = (1.0 - rng.random::<f32>(), rng.random::<f32>());
        let (radius, (sin, cos)) = ((-2.0 * u.ln()).sqrt(), (std::f32::consts::TAU * v).sin_cos());
        z.extend([radius * cos, radius * sin]);
    }
    z.truncate(count);
    z
}
