//! The forward pass of a training step and its losses.

use burn::module::Module;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Int, Tensor, TensorData};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use where2act_model::losses::{
    binary_cross_entropy, geodesic_distance, kl_divergence, squared_error, weighted_mean,
};
use where2act_model::{Choice, Heads, Input, Network, SecondLook, to_axes};

use crate::batch::{Batch, BatchInput, Queries};
use crate::config::{LossConfig, TrainConfig};
use crate::probes::{Learner, Ways, difference};

/// Losses of a step before they are weighted. They stay tensors until somebody wants to read them.
#[derive(Clone, Debug, Default)]
pub struct Losses {
    /// Binary cross-entropy of the score; `None` in the look phase.
    pub score: Option<Tensor<1>>,
    /// The same of the score at second look; `None` if there is none.
    pub second: Option<Tensor<1>>,
    /// Mean angle between reconstructed and successful orientations, radians; `None` in the score phase.
    pub geodesic: Option<Tensor<1>>,
    /// Divergence of the proposal's code; `None` in the score phase.
    pub kl: Option<Tensor<1>>,
    /// Squared error of the actionability; `None` in the score phase.
    pub actionability: Option<Tensor<1>>,
    /// Difference of the ways that points can go; `None` if it is not asked.
    pub motion: Option<Tensor<1>>,
    /// Squared error of the normals; `None` if they are not asked.
    pub normal: Option<Tensor<1>>,
    /// Divergence of the score from what the teacher says; `None` if there is none.
    pub taught: Option<Tensor<1>>,
}

impl Losses {
    /// The weighted sum that is minimised; `None` if the batch asks nothing.
    #[must_use]
    pub fn total(&self, config: &TrainConfig) -> Option<Tensor<1>> {
        let weights = &config.loss;
        let all = [
            (&self.score, weights.score),
            (&self.second, weights.score),
            (&self.geodesic, weights.geodesic),
            (&self.kl, weights.kl),
            (&self.actionability, weights.actionability),
            (&self.motion, weights.motion),
            (&self.normal, weights.normal),
            (&self.taught, config.teacher.as_ref().map_or(0.0, |teacher| teacher.weight)),
        ];
        let weighted = all.into_iter().filter_map(|(loss, weight)| Some(loss.clone()? * weight));
        weighted.reduce(|sum, loss| sum + loss)
    }
}

/// What learns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The backbone alone, from what the scene knows without trials.
    Look,
    /// Backbone and score head alone.
    Score,
    /// All heads.
    Joint,
}

/// Forward pass of a batch and its losses.
#[must_use]
pub fn forward(
    Learner { network, normal }: &Learner,
    batch: &Batch,
    phase: Phase,
    config: &LossConfig,
    rng: &mut impl Rng,
) -> Losses {
    let device = network.device();
    let queries = &batch.queries;
    let (all, trials) = (queries.places.len(), queries.trials());
    let features = match &batch.input {
        BatchInput::Images { pixels, views, side } => {
            let shape = [*views, 3, *side, *side];
            let images = Tensor::<4>::from_data(TensorData::new(pixels.clone(), shape), &device);
            network.features_at(Input::Images(images), &queries.places)
        }
        BatchInput::Clouds(hierarchy) => network.features_at(Input::Clouds(hierarchy), &queries.places),
    };
    let asked = network.heads.motion.as_ref().filter(|_| config.motion > 0.0);
    let motion = asked.map(|head| {
        let thought = head.ways(features.clone());
        let flat = |[a, b]: Ways| [a.x, a.y, a.z, b.x, b.y, b.z];
        let (ways, known) = answers(queries.ways.iter().map(|ways| ways.map(flat)), &device);
        weighted_mean(difference(thought, ways), known)
    });
    let normal = normal.as_ref().map(|probe| {
        let thought = probe.forward(features.clone());
        let (normals, known) = answers(queries.normals.iter().map(|normal| normal.map(Into::into)), &device);
        let [q, _] = thought.dims();
        weighted_mean((thought - normals).powi_scalar(2).sum_dim(1).reshape([q]), known)
    });
    let seen = Losses { motion, normal, ..Losses::default() };
    if phase == Phase::Look || trials == 0 {
        return seen;
    }

    let outputs = network.config().primitives.len();
    let of_trials = features.clone().narrow(0, 0, trials);
    let orientations = orientations(queries, &device);
    let choice = Choice::new(&queries.outputs[..trials], outputs, &device);
    let labels = Tensor::from_floats(queries.labels.as_slice(), &device);
    let weights = Tensor::from_floats(queries.weights.as_slice(), &device);
    let wrong =
        |logits| weighted_mean(binary_cross_entropy(choice.pick(logits), labels.clone()), weights.clone());
    let hands = network.heads.score.hands(of_trials.clone(), orientations.clone().unsqueeze_dim(1));
    let score = Some(wrong(network.heads.score.forward_hands(of_trials.clone(), hands.clone())));
    let look = |look: &SecondLook| wrong(look.forward(of_trials.clone(), hands.clone(), &queries.hand_views));
    let second = network.heads.second_look.as_ref().map(look);
    let taught = queries.lesson.difference(&network.heads, &features);
    let seen = Losses { taught, ..seen };
    if phase == Phase::Score {
        return Losses { score, second, ..seen };
    }

    let (geodesic, kl) = reconstruction(network, queries, of_trials, &orientations, rng);
    let choice = Choice::new(&queries.outputs, outputs, &device);
    let target =
        actionability_target(&network.heads.clone().valid(), features.clone().inner(), queries, config, rng);
    let guess = choice.pick(network.heads.actionability.forward(features));
    let actionability = squared_error(guess, Tensor::from_inner(target).detach()).sum() / all.max(1) as f32;
    Losses { score, second, geodesic, kl, actionability: Some(actionability), ..seen }
}

/// The right answers to a probe, `[q, n]`, and where they are known, `[q]`.
fn answers<const N: usize>(
    answers: impl Iterator<Item = Option<[f32; N]>>,
    device: &Device,
) -> (Tensor<2>, Tensor<1>) {
    let answers: Vec<Option<[f32; N]>> = answers.collect();
    let known: Vec<f32> = answers.iter().map(|answer| f32::from(u8::from(answer.is_some()))).collect();
    let flat: Vec<f32> = answers.iter().flat_map(|answer| answer.unwrap_or([0.0; N])).collect();
    let all = Tensor::from_data(TensorData::new(flat, [answers.len(), N]), device);
    (all, Tensor::from_floats(known.as_slice(), device))
}

/// Orientations of the trials, `[trials, 6]`.
fn orientations(queries: &Queries, device: &Device) -> Tensor<2> {
    let flat: Vec<f32> = queries.orientations.iter().flatten().copied().collect();
    Tensor::from_data(TensorData::new(flat, [queries.orientations.len(), 6]), device)
}

/// How well the proposal head reconstructs the successful orientations, and how far its code is from normal.
fn reconstruction(
    network: &Network,
    queries: &Queries,
    features: Tensor<2>,
    orientations: &Tensor<2>,
    rng: &mut impl Rng,
) -> (Option<Tensor<1>>, Option<Tensor<1>>) {
    let successes: Vec<usize> =
        (0..queries.trials()).filter(|&i| queries.labels[i] > 0.5 && queries.weights[i] > 0.0).collect();
    if successes.is_empty() {
        return (None, None);
    }
    let device = network.device();
    let (outputs, latent) = (network.config().primitives.len(), network.config().latent);
    let picked: Vec<usize> = successes.iter().map(|&i| queries.outputs[i]).collect();
    let choice = Choice::new(&picked, outputs, &device);
    let features = select(features, successes.iter().copied());
    let orientations = select(orientations.clone(), successes.iter().copied());
    let code = network.heads.proposal.encode(features.clone(), orientations.clone(), &choice);
    let z = code.sample(normal([successes.len(), latent], rng, &device));
    let decoded = to_axes(choice.pick_rows(network.heads.proposal.decode(features, z)));
    (Some(geodesic_distance(decoded, orientations).mean()), Some(kl_divergence(&code).mean()))
}

/// What the score head thinks of the proposals at each query: the mean of all, or of the best few; and nothing where the scene
/// knows that nothing moves, whatever the score thinks. `[q]`, without gradient.
fn actionability_target(
    heads: &Heads,
    features: Tensor<2>,
    queries: &Queries,
    config: &LossConfig,
    rng: &mut impl Rng,
) -> Tensor<1> {
    let device = features.device();
    let [q, _] = features.dims();
    let proposals = config.proposals;
    let latent = heads.proposal.decoder.mlp1.linear.weight.dims()[0] - heads.proposal.decoder.mlp1.features;
    let [_, six] = heads.proposal.decoder.mlp2.weight.dims();
    let outputs = six / 6;
    let [_, hidden] = heads.score.mlp1.linear.weight.dims();

    // The same codes serve all queries: a head's first layer is computed once per query and once per code.
    let codes = heads.proposal.code_half(normal([proposals, latent], rng, &device));
    let decode =
        heads.proposal.feature_half(features.clone()).unsqueeze_dim::<3>(1) + codes.unsqueeze_dim::<3>(0);
    let raw = heads.proposal.decode_from_halves(decode.reshape([q * proposals, hidden]));
    let repeated: Vec<usize> =
        queries.outputs.iter().flat_map(|&output| std::iter::repeat_n(output, proposals)).collect();
    let choice = Choice::new(&repeated, outputs, &device);
    let axes = to_axes(choice.pick_rows(raw.reshape([q * proposals, outputs, 6])));
    let axes = axes.reshape([q, proposals, 6]);
    let logits = heads.score.forward_each(features.clone(), axes.clone());
    let logits = choice.pick(heads.with_ways(logits, features, axes));
    let scores = sigmoid(logits).reshape([q, proposals]);
    let best = if config.best == 0 { scores } else { scores.topk(config.best, 1) };
    let moves =
        |ways: &Option<Ways>| if ways.is_some_and(|ways| ways == Ways::default()) { 0.0 } else { 1.0 };
    let moves: Vec<f32> = queries.ways.iter().map(moves).collect();
    best.mean_dim(1).reshape([q]) * Tensor::from_floats(moves.as_slice(), &device)
}

/// The numbers of a tensor.
pub(crate) fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec().unwrap_or_default()
}

/// Some rows.
pub(crate) fn select(all: Tensor<2>, rows: impl Iterator<Item = usize>) -> Tensor<2> {
    let rows: Vec<i64> = rows.map(|row| row as i64).collect();
    let (device, shape) = (all.device(), [rows.len()]);
    all.select(0, Tensor::<1, Int>::from_data(TensorData::new(rows, shape), &device))
}

/// Standard normal numbers from a generator that is passed in.
fn normal(shape: [usize; 2], rng: &mut impl Rng, device: &Device) -> Tensor<2> {
    let values: Vec<f32> = (0..shape[0] * shape[1]).map(|_| StandardNormal.sample(rng)).collect();
    Tensor::from_data(TensorData::new(values, shape), device)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use where2act_core::{Primitive, Seed};
    use where2act_model::{Modality, ModelConfig};

    #[test]
    fn nothing_is_to_be_expected_where_nothing_moves() {
        let config =
            ModelConfig::new(Modality::Cloud, &[Primitive::Pulling, Primitive::Pushing]).with_points(64);
        let network = Network::new(&config, Seed(1), &Device::flex());
        let mut rng = Seed(2).rng();
        let features = normal([3, config.features], &mut rng, &Device::flex());
        let ways = vec![Some(Ways::default()), Some([Vector3::z(), Vector3::zeros()]), None];
        let queries = Queries { outputs: vec![0, 1, 0], ways, ..Queries::default() };
        for best in [0, 2] {
            let loss = LossConfig { proposals: 8, best, ..LossConfig::default() };
            let target =
                floats(actionability_target(&network.heads, features.clone(), &queries, &loss, &mut rng));
            assert!(target[0] == 0.0 && target[1..].iter().all(|score| *score > 0.01), "{target:?}");
        }
    }
}
