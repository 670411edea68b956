//! How good the scores are on trials that were made already.

use burn::tensor::activation::sigmoid;
use burn::tensor::{Tensor, TensorData};
use nalgebra::Point3;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use where2act_core::shard::SceneRecord;
use where2act_core::{ImageSize, Orientation6, Policy, Seed, Trial};
use where2act_model::preprocess::{CloudInput, CloudScale, ImageInput, PreprocessError};
use where2act_model::{Choice, Input, Modality, Network, hand_frame};

use crate::batch::picture_pixel;
use crate::dataset::{DataError, Dataset, SceneId};
use crate::metrics::ScoreMetrics;

/// With fewer successes than this among random trials their best threshold is chance.
const FEWEST_SUCCESSES: u64 = 8;

/// Metrics of the score head, one entry per primitive of the network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    /// Over trials of every policy.
    pub all: Vec<ScoreMetrics>,
    /// Over random trials only, as published.
    pub random: Vec<ScoreMetrics>,
    /// Mean average precision over primitives, all policies: what picks the best weights.
    pub figure: f64,
}

/// Scores of the record's trials of primitives that the network knows: (trial, score in [0, 1]).
///
/// # Errors
/// If the view cannot be shown to the network.
fn score_record(
    network: &Network,
    record: &SceneRecord,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<(Trial, f32)>, PreprocessError> {
    let config = network.config();
    let device = network.device();
    let (trials, outputs): (Vec<&Trial>, Vec<usize>) =
        record.trials.iter().filter_map(|t| Some((t, config.output_of(t.primitive)?))).unzip();
    if trials.is_empty() {
        return Ok(Vec::new());
    }
    let orientations: Vec<Orientation6> =
        trials.iter().map(|t| Orientation6::from_rotation(&t.grasp_in_camera.rotation)).collect();
    let mut hand_views = Vec::new();
    let features = match config.modality {
        Modality::Rgb => {
            let side = record.rgb_side();
            let input = ImageInput::new(ImageSize::square(side), &record.rgb, None, &config.preprocessing)?;
            let place = |t: &&Trial| (0, input.letterbox.network_index(picture_pixel(t.pixel, side)));
            let images = ImageInput::batch(std::slice::from_ref(&input), &device);
            network.features_at(Input::Images(images), &trials.iter().map(place).collect::<Vec<_>>())
        }
        Modality::Cloud => {
            let points: Vec<Point3<f32>> = record.foreground().into_iter().map(|(_, point)| point).collect();
            let cloud = CloudInput::new(&points, CloudScale::PerMetre(1.0), config, rng)?;
            let target = |t: &&Trial| <[f32; 3]>::from(cloud.network_from_metres(&t.grasp_in_camera.point));
            let targets: Vec<f32> = trials.iter().flat_map(target).collect();
            if config.second_look {
                let hand = |(point, orientation): (&[f32; 3], &Orientation6)| hand_frame(*point, orientation);
                let hands: Vec<_> = targets.as_chunks().0.iter().zip(&orientations).map(hand).collect();
                hand_views = cloud.hand_views(&hands);
            }
            let queries: Vec<_> = (0..trials.len()).map(|i| (0, i)).collect();
            let hierarchy = CloudInput::hierarchy(&[cloud], &[targets], config);
            network.features_at(Input::Clouds(&hierarchy), &queries)
        }
    };
    let orientations: Vec<f32> = orientations.iter().flat_map(|orientation| orientation.0).collect();
    let orientations = Tensor::<2>::from_data(TensorData::new(orientations, [trials.len(), 6]), &device);
    let logits = network.heads.logits(features, orientations, &hand_views);
    let choice = Choice::new(&outputs, config.primitives.len(), &device);
    let scores = sigmoid(choice.pick(logits)).into_data().convert::<f32>();
    let scores = scores.as_slice::<f32>().unwrap_or_default();
    Ok(trials.into_iter().copied().zip(scores.iter().copied()).collect())
}

impl Validation {
    /// From scored trials.
    #[must_use]
    pub fn new(network: &Network, scored: &[(Trial, f32)]) -> Self {
        let metrics = |wanted: &dyn Fn(&Trial) -> bool| -> Vec<ScoreMetrics> {
            let of = |primitive| {
                let mine = scored.iter().filter(|(t, _)| t.primitive == primitive && wanted(t));
                ScoreMetrics::new(&mine.map(|(t, s)| (*s, t.verdict.success)).collect::<Vec<_>>())
            };
            network.config().primitives.iter().map(|p| of(*p)).collect()
        };
        let all = metrics(&|_| true);
        let random = metrics(&|t| t.policy == Policy::Random);
        // A primitive that nobody managed in these scenes says nothing about the network.
        let judged: Vec<f64> = all.iter().filter(|m| m.successes > 0).map(|m| m.average_precision).collect();
        let figure = judged.iter().sum::<f64>() / judged.len().max(1) as f64;
        Self { all, random, figure }
    }

    /// How far each primitive's logit must move for the best F-score to be expected on random trials at a score of 0.5.
    /// Training shows successes and failures equally often, so its own 0.5 is far too generous for random trials.
    #[must_use]
    pub fn shifts(&self) -> Vec<f32> {
        let shift = |m: &ScoreMetrics| {
            if m.successes < FEWEST_SUCCESSES || m.successes == m.trials {
                return 0.0;
            }
            let threshold = (m.best_threshold as f32).clamp(1e-4, 1.0 - 1e-4);
            // The trial at the threshold itself counts as called a success.
            1e-3 - (threshold / (1.0 - threshold)).ln()
        };
        self.random.iter().map(shift).collect()
    }
}

/// Scores with their logits moved, those of each of the network's primitives by its own number, as
/// [`Network::shift_scores`] moves them.
pub(crate) fn shifted(network: &Network, scored: &[(Trial, f32)], by: &[f32]) -> Vec<(Trial, f32)> {
    let shift = |trial: &Trial| network.config().output_of(trial.primitive).map_or(0.0, |output| by[output]);
    let moved = |score: f32, by: f32| 1.0 / (1.0 + (1.0 / score - 1.0) * (-by).exp());
    scored.iter().map(|(trial, score)| (*trial, moved(*score, shift(trial)))).collect()
}

/// Scores every trial of some scenes, one view at a time: (trial, score in [0, 1]).
///
/// # Errors
/// Those of reading a shard.
pub fn score_scenes(
    network: &Network,
    dataset: &Dataset,
    scenes: &[SceneId],
    seed: Seed,
) -> Result<Vec<(Trial, f32)>, DataError> {
    let mut scored = Vec::new();
    for (i, id) in scenes.iter().enumerate() {
        let shard = &dataset.shards()[id.shard];
        let mut rng = seed.child("validate", i as u64).rng();
        let of_scene = score_record(network, &shard.record(id.scene)?, &mut rng)
            .map_err(|source| DataError::View { path: shard.path().to_owned(), scene: id.scene, source })?;
        scored.extend(of_scene);
    }
    Ok(scored)
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use nalgebra::{Rotation3, Vector3};
    use where2act_core::{Grasp, Pixel, Primitive, Verdict};
    use where2act_model::ModelConfig;

    #[test]
    fn shifted_scores_have_their_best_expected_f_score_at_one_half() {
        let mut rng = Seed(4).rng();
        // Scores of a network that takes everything for far likelier than it is.
        let logit = |p: f32| (p / (1.0 - p)).ln();
        let scored: Vec<(f32, bool)> = (0..4000)
            .map(|_| {
                let score = rand::RngExt::random_range(&mut rng, 0.01..0.99f32);
                let likely = 1.0 / (1.0 + (6.0 - 3.0 * logit(score)).exp());
                (score, rand::RngExt::random::<f32>(&mut rng) < likely)
            })
            .collect();
        let metrics = ScoreMetrics::new(&scored);
        let validation = Validation { random: vec![metrics.clone()], ..Validation::default() };
        let [shift] = validation.shifts()[..] else { panic!("one primitive") };
        let moved: Vec<_> =
            scored.iter().map(|(s, y)| (1.0 / (1.0 + (-(logit(*s) + shift)).exp()), *y)).collect();
        let after = ScoreMetrics::new(&moved);
        assert!((after.best_threshold - 0.5).abs() < 1e-3, "{metrics:?} {after:?}");
        assert!(after.f_score > metrics.f_score + 0.2, "{metrics:?} {after:?}");
        assert!(after.f_score > metrics.best_f_score - 0.02, "{metrics:?} {after:?}");

        // Where all trials end the same way there is nothing to tell apart.
        for success in [false, true] {
            let alike = ScoreMetrics::new(&[(0.7, success); 50]);
            let validation = Validation { random: vec![alike], ..Validation::default() };
            assert_eq!(validation.shifts(), [0.0]);
        }

        // The network does what the arithmetic above does, and so does what the card is made of.
        let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(64);
        let network = Network::new(&config, Seed(1), &Device::flex());
        let score = |network: &Network| {
            let zeros = |n: usize| Tensor::zeros([1, n], &Device::flex());
            network.heads.score.forward(zeros(128), zeros(6)).into_scalar::<f32>()
        };
        assert!((score(&network.clone().shift_scores(&[shift])) - score(&network) - shift).abs() < 1e-5);
        let grasp = Grasp { point: Point3::origin(), rotation: Rotation3::identity() };
        let verdict =
            Verdict { invalid: None, q_start: 0.0, q_end: 0.0, motion: Vector3::zeros(), success: true };
        let (primitive, policy, pixel) = (Primitive::Pushing, Policy::Random, Pixel { u: 0, v: 0 });
        let trial = Trial { primitive, policy, pixel, link: 1, grasp_in_camera: grasp, verdict };
        for score in [0.0, 0.3, 1.0] {
            let [(_, found)] = shifted(&network, &[(trial, score)], &[shift])[..] else { panic!("one") };
            assert!((found - 1.0 / (1.0 + (-(logit(score) + shift)).exp())).abs() < 1e-6, "{found}");
        }
    }
}
