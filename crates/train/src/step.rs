//! The forward pass of a training step and its losses.

use burn::module::Module;
use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Int, Tensor, TensorData};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use where2act_model::losses::{
    binary_cross_entropy, geodesic_distance, kl_divergence, squared_error, weighted_mean,
};
use where2act_model::{Choice, Heads, Input, Network, SecondLook, intended_axes, to_axes};

use crate::batch::{Batch, BatchInput, Queries};
use crate::config::{LossConfig, TrainConfig};
use crate::probes::{Learner, Ways, difference, is_hopeless};

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
    /// Binary cross-entropy of the score of own proposals that cannot succeed; `None` if it is not asked.
    pub hopeless: Option<Tensor<1>>,
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
            (&self.hopeless, weights.hopeless),
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
    let own = OwnHands::new(&network.heads.clone().valid(), features.clone().inner(), queries, config, rng);
    let hopeless = (config.hopeless > 0.0).then(|| hopeless(network, &features, queries, &own)).flatten();
    let target = Tensor::from_inner(own.actionability(queries, config)).detach();
    let guess = choice.pick(network.heads.actionability.forward(features));
    let actionability = squared_error(guess, target).sum() / all.max(1) as f32;
    Losses { score, second, geodesic, kl, actionability: Some(actionability), hopeless, ..seen }
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

/// The hands that the network would try at each query, without gradient.
struct OwnHands {
    /// Orthonormal `[approach, forward]`, `[q, proposals, 6]`.
    axes: Tensor<3>,
    /// What the score thinks of them, the ways of their places included, `[q, proposals]`.
    logits: Tensor<2>,
}

impl OwnHands {
    fn new(
        heads: &Heads,
        features: Tensor<2>,
        queries: &Queries,
        config: &LossConfig,
        rng: &mut impl Rng,
    ) -> Self {
        let device = features.device();
        let [q, _] = features.dims();
        let proposals = config.proposals;
        let latent =
            heads.proposal.decoder.mlp1.linear.weight.dims()[0] - heads.proposal.decoder.mlp1.features;
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
        let logits = choice.pick(heads.with_ways(logits, features, axes.clone()));
        Self { axes, logits: logits.reshape([q, proposals]) }
    }

    /// What is to be expected of them at each query, `[q]`: the mean score of all, or of the best few, and nothing where the
    /// scene knows that nothing moves, if what is hopeless is asked at all.
    fn actionability(&self, queries: &Queries, config: &LossConfig) -> Tensor<1> {
        let scores = sigmoid(self.logits.clone());
        let [q, _] = scores.dims();
        let expected =
            if config.best == 0 { scores.mean_dim(1) } else { scores.topk(config.best, 1).mean_dim(1) };
        let expected = expected.reshape([q]);
        if config.hopeless == 0.0 {
            return expected;
        }
        let still = |ways: &Option<Ways>| ways.is_some_and(|ways| ways == Ways::default());
        let moves: Vec<f32> = queries.ways.iter().map(|ways| if still(ways) { 0.0 } else { 1.0 }).collect();
        expected.clone() * Tensor::from_floats(moves.as_slice(), &expected.device())
    }
}

/// How wrong the score is about the best hand at each query that cannot succeed there, whatever it touches: at a place where
/// nothing moves, or against all ways its joint leaves it. The scene knows that without a trial. `None` without such hands.
fn hopeless(network: &Network, features: &Tensor<2>, queries: &Queries, own: &OwnHands) -> Option<Tensor<1>> {
    let primitives = &network.config().primitives;
    let intended: Vec<_> = primitives.iter().copied().map(intended_axes).collect();
    let [_, proposals] = own.logits.dims();
    let (axes, logits) = (floats(own.axes.clone()), floats(own.logits.clone()));
    let mut hands: Vec<(usize, [f32; 6])> = Vec::new();
    let of_queries = axes.as_chunks::<6>().0.chunks(proposals).zip(logits.chunks(proposals));
    for (i, ((axes, logits), ways)) in of_queries.zip(&queries.ways).enumerate() {
        let (Some(ways), output) = (ways, queries.outputs[i]) else { continue };
        let bad = |axes: &[f32; 6]| is_hopeless(primitives[output], intended[output], axes, ways);
        let best = axes.iter().zip(logits).filter(|(axes, _)| bad(axes)).max_by(|a, b| a.1.total_cmp(b.1));
        hands.extend(best.map(|(axes, _)| (i, *axes)));
    }
    let n = hands.len();
    if n == 0 {
        return None;
    }
    let device = features.device();
    let outputs: Vec<usize> = hands.iter().map(|(i, _)| queries.outputs[*i]).collect();
    let flat: Vec<f32> = hands.iter().flat_map(|(_, axes)| *axes).collect();
    let axes = Tensor::<3>::from_data(TensorData::new(flat, [n, 1, 6]), &device);
    let logits =
        network.heads.score.forward_each(select(features.clone(), hands.iter().map(|(i, _)| *i)), axes);
    let logits = Choice::new(&outputs, primitives.len(), &device).pick(logits);
    Some(binary_cross_entropy(logits, Tensor::zeros([n], &device)).mean())
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
    fn the_best_of_the_hands_that_cannot_succeed_is_taught_as_a_failure() {
        let config =
            ModelConfig::new(Modality::Cloud, &[Primitive::Pulling, Primitive::Pushing]).with_points(64);
        let network = Network::new(&config, Seed(1), &Device::flex());
        let mut rng = Seed(2).rng();
        let features = normal([4, config.features], &mut rng, &Device::flex());
        let free = [Vector3::z(), -Vector3::z()];
        // Nothing moves at the first two places; a push along any way of the third moves it; nobody knows the fourth.
        let ways = vec![Some(Ways::default()), Some(Ways::default()), Some(free), None];
        let queries = Queries { outputs: vec![0, 1, 1, 0], ways, ..Queries::default() };
        let loss = LossConfig { proposals: 8, best: 2, hopeless: 1.0, ..LossConfig::default() };
        let own = OwnHands::new(&network.heads, features.clone(), &queries, &loss, &mut rng);
        let logits = floats(own.logits.clone());
        let best = |place: usize| logits[8 * place..8 * (place + 1)].iter().copied().fold(f32::MIN, f32::max);
        let wrong = |logit: f32| (1.0 + logit.exp()).ln();
        let found = hopeless(&network, &features, &queries, &own).unwrap().into_scalar::<f32>();
        let expected = (wrong(best(0)) + wrong(best(1))) / 2.0;
        assert!((found - expected).abs() < 1e-4, "{found} {expected}");

        let expected = floats(own.actionability(&queries, &loss));
        assert!(
            expected[..2] == [0.0, 0.0] && expected[2..].iter().all(|score| *score > 0.01),
            "{expected:?}"
        );
        let published = LossConfig { hopeless: 0.0, ..loss.clone() };
        assert!(floats(own.actionability(&queries, &published)).iter().all(|score| *score > 0.01));

        let (features, queries) =
            (features.narrow(0, 2, 1), Queries { outputs: vec![1], ways: vec![Some(free)], ..queries });
        let own = OwnHands::new(&network.heads, features.clone(), &queries, &loss, &mut rng);
        assert!(hopeless(&network, &features, &queries, &own).is_none());
    }
}
