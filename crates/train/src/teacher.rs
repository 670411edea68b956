//! A network for scans that tells a network for pictures how likely hands are to succeed. Trials are dear, and pictures
//! need more of them than scans do, because they have to guess what a scan measures; a network that has learnt from scans
//! answers thousands of such questions a second, on any scene that has a depth map.

use burn::tensor::activation::sigmoid;
use burn::tensor::{Device, Int, Tensor, TensorData};
use nalgebra::{Point3, Rotation3, UnitVector3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal, UnitSphere};
use where2act_core::Orientation6;
use where2act_model::losses::binary_cross_entropy;
use where2act_model::preprocess::{CloudInput, CloudScale, PreprocessError};
use where2act_model::{Grouping, Heads, Input, Modality, Network, Weights, hand_frame, to_axes};

use crate::config::{TeacherConfig, TrainConfig};
use crate::run::TrainError;

/// How far half of the hands are turned away from what the teacher would do, at most, radians. What it never proposes a
/// network that knows less does propose.
const TURN: f32 = 1.2;

/// Farthest that logits are moved.
const FURTHEST: f32 = 20.0;

/// A trained network for scans.
#[derive(Clone, Debug)]
pub struct Teacher {
    network: Network,
    /// Places of a view that it talks about.
    places: usize,
}

/// A view as the teacher sees it, and the places to talk about.
#[derive(Clone, Debug)]
pub(crate) struct Desk {
    scan: CloudInput,
    /// Network units.
    points: Vec<[f32; 3]>,
    /// Which of the view's places each is.
    pub(crate) places: Vec<usize>,
}

/// What the teacher says of hands at some places.
#[derive(Clone, Debug, Default)]
pub struct Lesson {
    /// Rows of the batch's places, n of them.
    pub rows: Vec<usize>,
    /// `[approach, forward]` of the hands, camera frame, as many at each place: `[n * each]`.
    pub orientations: Vec<[f32; 6]>,
    /// How likely each is to succeed with each primitive: logits, `[n * each, primitives]`, less the odds of a success in the
    /// whole lesson, as if successes and failures were as frequent. That is what trials' weights do too.
    pub logits: Vec<f32>,
}

impl Teacher {
    /// Reads the network that a configuration names.
    ///
    /// # Errors
    /// Those of reading weights, and [`TrainError::OtherTeacher`] if it is none for scans with the same primitives.
    pub fn load(config: &TeacherConfig, run: &TrainConfig, device: &Device) -> Result<Self, TrainError> {
        let network = Weights::load(&config.weights, device)?.network;
        let theirs = network.config();
        if theirs.modality != Modality::Cloud || theirs.primitives != run.network.primitives {
            return Err(TrainError::OtherTeacher { path: config.weights.clone() });
        }
        Ok(Self { network, places: config.places })
    }

    /// How many places of a view it talks about.
    pub(crate) fn places(&self) -> usize {
        self.places
    }

    /// Prepares a view: its points, camera frame, and the (place, point) to talk about.
    pub(crate) fn desk(
        &self,
        points: &[Point3<f32>],
        asked: &[(usize, Point3<f32>)],
        rng: &mut ChaCha8Rng,
    ) -> Result<Desk, PreprocessError> {
        let scan = CloudInput::new(points, CloudScale::PerMetre(1.0), self.network.config(), rng)?;
        let points = asked.iter().map(|(_, point)| scan.network_from_metres(point).into()).collect();
        Ok(Desk { scan, points, places: asked.iter().map(|(place, _)| *place).collect() })
    }

    /// What the network says of its own proposals, one for each primitive, at every place of every desk, half of them
    /// turned away. `rows` are those of the batch, desk by desk.
    pub(crate) fn lesson(&self, desks: Vec<Desk>, rows: Vec<usize>, rng: &mut ChaCha8Rng) -> Lesson {
        if rows.is_empty() {
            return Lesson::default();
        }
        let (heads, config, device) = (&self.network.heads, self.network.config(), self.network.device());
        let (n, each, latent) = (rows.len(), config.primitives.len(), config.latent);
        let places: Vec<(usize, usize)> = desks
            .iter()
            .enumerate()
            .flat_map(|(v, desk)| (0..desk.points.len()).map(move |i| (v, i)))
            .collect();
        let (scans, points): (Vec<_>, Vec<_>) =
            desks.into_iter().map(|desk| (desk.scan, desk.points)).unzip();
        let targets: Vec<Vec<f32>> = points.iter().map(|points| points.concat()).collect();
        let hierarchy = CloudInput::hierarchy(&scans, &targets, config);
        let features = self.network.features_at(Input::Clouds(&hierarchy), &places);

        let codes: Vec<f32> = (0..n * latent).map(|_| StandardNormal.sample(rng)).collect();
        let codes = Tensor::from_data(TensorData::new(codes, [n, latent]), &device);
        let own = to_axes(heads.proposal.decode(features.clone(), codes).reshape([n * each, 6]));
        let mut orientations: Vec<[f32; 6]> = floats(own).as_chunks().0.to_vec();
        for hand in &mut orientations {
            if rng.random() {
                turn(hand, rng);
            }
        }

        let mut views: Vec<Grouping> = Vec::new();
        if heads.second_look.is_some() {
            let mut hands = orientations.chunks(each);
            for (scan, points) in scans.iter().zip(&points) {
                let of_point = |(point, hands): (&[f32; 3], &[[f32; 6]])| {
                    hands.iter().map(|hand| hand_frame(*point, &Orientation6(*hand))).collect::<Vec<_>>()
                };
                let frames: Vec<_> = points.iter().zip(hands.by_ref()).flat_map(of_point).collect();
                join(&mut views, scan.hand_views(&frames));
            }
        }
        let axes = Tensor::<3>::from_data(TensorData::new(orientations.concat(), [n, each, 6]), &device);
        let logits = match &heads.second_look {
            Some(look) => {
                let hands = heads.score.hands(features.clone(), axes);
                let repeated = (0..n * each).map(|i| (i / each) as i64).collect::<Vec<_>>();
                let repeated = Tensor::<1, Int>::from_data(TensorData::new(repeated, [n * each]), &device);
                look.forward(features.select(0, repeated), hands, &views)
            }
            None => scores(heads, features, axes),
        };
        Lesson { rows, orientations, logits: floats(evened(logits)) }
    }
}

impl Lesson {
    /// How much the scores of a network differ from the lesson: the mean divergence (Kullback and Leibler) of the chances
    /// that they mean, with the network's logits moved by one number for each primitive. Only how hands compare is taught:
    /// how often hands succeed is another thing among the trials that the network learns from at the same time.
    ///
    /// # Shapes
    /// features at all places of the batch, `[places, features]` -> `[1]`; `None` without a lesson
    pub(crate) fn difference(&self, heads: &Heads, features: &Tensor<2>) -> Option<Tensor<1>> {
        let n = self.rows.len();
        let each = self.orientations.len().checked_div(n)?;
        let (device, primitives) = (features.device(), self.logits.len() / self.orientations.len());
        let rows: Vec<i64> = self.rows.iter().map(|row| *row as i64).collect();
        let rows = Tensor::<1, Int>::from_data(TensorData::new(rows, [n]), &device);
        let axes = TensorData::new(self.orientations.concat(), [n, each, 6]);
        let thought = scores(heads, features.clone().select(0, rows), Tensor::from_data(axes, &device));
        let taught = TensorData::new(self.logits.clone(), [n * each, primitives]);
        let taught = Tensor::<2>::from_data(taught, &device);
        let apart = apart(&floats(thought.clone().detach()), &self.logits, primitives);
        let apart = Tensor::<2>::from_data(TensorData::new(apart, [1, primitives]), &device);
        let flat = |all: Tensor<2>| all.reshape([n * each * primitives]);
        let (thought, taught) = (flat(thought + apart), flat(taught));
        let chances = sigmoid(taught.clone());
        let wrong = |logits| binary_cross_entropy(logits, chances.clone()).mean();
        Some(wrong(thought) - wrong(taught))
    }
}

/// Logits of the score for hands at places.
///
/// # Shapes
/// `[n, features]`, `[n, each, 6]` -> `[n * each, primitives]`
fn scores(heads: &Heads, features: Tensor<2>, axes: Tensor<3>) -> Tensor<2> {
    let [n, each, _] = axes.dims();
    let hands = heads.score.hand_half(heads.score.hands(features.clone(), axes));
    let [_, hidden] = hands.dims();
    let halves = heads.score.feature_half(features).unsqueeze_dim::<3>(1) + hands.reshape([n, each, hidden]);
    heads.score.from_halves(halves.reshape([n * each, hidden]))
}

/// Logits less the odds of a success in their column.
///
/// # Shapes
/// `[n, primitives]` -> the same
fn evened(logits: Tensor<2>) -> Tensor<2> {
    let successes = sigmoid(logits.clone()).mean_dim(0).clamp(1e-4, 1.0 - 1e-4);
    let odds = successes.clone().neg().add_scalar(1.0).log() - successes.log();
    logits + odds
}

/// How far the logits of each column must move for as many successes in all as the lesson expects, which is where they differ
/// least from it.
fn apart(thought: &[f32], taught: &[f32], primitives: usize) -> Vec<f32> {
    let chance = |logit: f32| 1.0 / (1.0 + (-logit).exp());
    let expected = |logits: &[f32], column: usize, by: f32| -> f64 {
        logits.iter().skip(column).step_by(primitives).map(|logit| f64::from(chance(logit + by))).sum()
    };
    let of_column = |column| {
        let wanted = expected(taught, column, 0.0);
        let (mut low, mut high) = (-FURTHEST, FURTHEST);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            let half = if expected(thought, column, middle) < wanted { &mut low } else { &mut high };
            *half = middle;
        }
        0.5 * (low + high)
    };
    (0..primitives).map(of_column).collect()
}

/// Turns a hand about a random axis.
fn turn(hand: &mut [f32; 6], rng: &mut ChaCha8Rng) {
    let axis = UnitVector3::new_unchecked(Vector3::from(UnitSphere.sample(rng)));
    let turn = Rotation3::from_axis_angle(&axis, rng.random_range(0.0..TURN));
    for direction in hand.as_chunks_mut::<3>().0 {
        *direction = (turn * Vector3::from(*direction)).into();
    }
}

/// Appends what further hands see.
pub(crate) fn join(all: &mut Vec<Grouping>, views: Vec<Grouping>) {
    if all.is_empty() {
        *all = views;
        return;
    }
    for (all, view) in all.iter_mut().zip(views) {
        all.offsets.extend(view.offsets);
    }
}

fn floats<const D: usize>(tensor: Tensor<D>) -> Vec<f32> {
    tensor.into_data().convert::<f32>().try_into_vec().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_core::{Primitive, Seed};
    use where2act_model::ModelConfig;

    /// Points of a wavy board a metre away.
    fn board() -> Vec<Point3<f32>> {
        let at = |i: usize| (i as f32 / 20.0 - 0.5) * 0.6;
        (0..441)
            .map(|i| (at(i % 21), at(i / 21)))
            .map(|(x, y)| Point3::new(x, y, 1.0 + 0.1 * (9.0 * x).sin()))
            .collect()
    }

    fn teacher(second_look: bool) -> Teacher {
        let mut config =
            ModelConfig::new(Modality::Cloud, &[Primitive::Pushing, Primitive::Pulling]).with_points(256);
        config.second_look = second_look;
        Teacher { network: Network::new(&config, Seed(1), &Device::flex()), places: 5 }
    }

    fn lesson(teacher: &Teacher, rows: Vec<usize>) -> Lesson {
        let points = board();
        let asked: Vec<_> = (0..3).map(|i| (i, points[100 * i])).collect();
        let desk = |asked: &[(usize, Point3<f32>)]| teacher.desk(&points, asked, &mut Seed(2).rng()).unwrap();
        teacher.lesson(vec![desk(&asked), desk(&[]), desk(&asked[..2])], rows, &mut Seed(3).rng())
    }

    #[test]
    fn who_thinks_the_same_has_nothing_to_learn() {
        let teacher = teacher(false);
        let lesson = lesson(&teacher, vec![0, 1, 2, 7, 8]);
        assert_eq!((lesson.orientations.len(), lesson.logits.len()), (10, 20));
        let points = board();
        let scan =
            CloudInput::new(&points, CloudScale::PerMetre(1.0), teacher.network.config(), &mut Seed(2).rng());
        let scan = scan.unwrap();
        let targets = [0, 100, 200].map(|i| <[f32; 3]>::from(scan.network_from_metres(&points[i]))).concat();
        let hierarchy = CloudInput::hierarchy(&[scan], &[targets], teacher.network.config());
        let input = || Input::Clouds(&hierarchy);
        let places = [0, 1, 2, 0, 0, 0, 0, 0, 1].map(|i| (0, i));
        let features = teacher.network.features_at(input(), &places);
        let same = lesson.difference(&teacher.network.heads, &features).unwrap().into_scalar::<f32>();
        let other = Network::new(teacher.network.config(), Seed(9), &Device::flex());
        let apart = lesson.difference(&other.heads, &features).unwrap().into_scalar::<f32>();
        assert!(same.abs() < 1e-6 && apart > 1e-5, "{same} {apart}");
    }

    #[test]
    fn a_second_look_has_the_last_word_and_no_place_no_lesson() {
        let teacher = teacher(true);
        let lesson = lesson(&teacher, vec![0, 1, 2, 3, 4]);
        assert_eq!(lesson.logits.len(), 20);
        assert!(lesson.logits.iter().all(|x| x.is_finite()));
        let none = teacher.lesson(Vec::new(), Vec::new(), &mut Seed(1).rng());
        let features = Tensor::<2>::zeros([1, teacher.network.config().features], &Device::flex());
        assert!(none.difference(&teacher.network.heads, &features).is_none());
    }

    #[test]
    fn a_turned_hand_is_a_hand() {
        let mut rng = Seed(4).rng();
        let straight = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0];
        for _ in 0..100 {
            let mut hand = straight;
            turn(&mut hand, &mut rng);
            let [z, x] = [0, 3].map(|i| Vector3::new(hand[i], hand[i + 1], hand[i + 2]));
            assert!((z.norm() - 1.0).abs() < 1e-5 && (x.norm() - 1.0).abs() < 1e-5 && z.dot(&x).abs() < 1e-5);
            assert!(z.z > TURN.cos() - 1e-5);
        }
    }

    #[test]
    fn moved_logits_expect_as_many_successes() {
        // The second column is the first less 3, and one hand has no chance at all, which must not count for more than that.
        let taught = [1.0, 1.0, -1.0, -1.0, -60.0, 0.5];
        let thought = [1.0, -2.0, -1.0, -4.0, -4.0, -2.5];
        let [first, second] = apart(&thought, &taught, 2)[..] else { panic!("two columns") };
        assert!((-0.1..0.0).contains(&first) && (second - 3.0).abs() < 1e-4, "{first} {second}");
    }

    #[test]
    fn odds_of_a_lesson_do_not_count() {
        let logits = Tensor::<2>::from_floats([[-2.0, 1.0], [-4.0, 1.0]], &Device::flex());
        let evened = floats(evened(logits));
        let mean = [-2.0f32, -4.0].map(|x| 1.0 / (1.0 + (-x).exp())).iter().sum::<f32>() / 2.0;
        let odds = (mean / (1.0 - mean)).ln();
        for (found, expected) in evened.iter().zip([-2.0 - odds, 0.0, -4.0 - odds, 0.0]) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
    }
}
