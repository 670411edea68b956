//! A network for scans that tells a network for pictures how likely hands are to succeed. Trials are dear, and pictures
//! need more of them than scans do, because they have to guess what a scan measures; a network that has learnt from scans
//! answers for all primitives at once, on any scene that has a depth map.

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
use crate::step::{floats, select};

/// How far half of the hands are turned away from what the teacher would do, at most, radians. What it never proposes a
/// network that knows less does propose.
const TURN: f32 = 1.2;
/// Farthest that logits are moved.
const FURTHEST: f32 = 20.0;

/// A trained network for scans.
#[derive(Clone, Debug)]
pub struct Teacher {
    network: Network,
    /// Its outputs for the primitives of the network that learns.
    outputs: Vec<usize>,
    /// Of its weights' file.
    sha256: String,
    /// Places of a view that it talks about, at most.
    places: usize,
}

/// A view as the teacher sees it, and the places to talk about, at least one.
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
    /// How likely each is to succeed with each primitive: logits, `[n * each, primitives]`, less the logarithm of the odds of
    /// a success in the whole lesson, as if successes and failures were as frequent. That is what trials' weights do too.
    /// What the ways add is left out: the network that learns adds its own when it predicts.
    pub logits: Vec<f32>,
}

impl Teacher {
    /// Reads the network that a configuration names.
    ///
    /// # Errors
    /// Those of reading weights, and [`TrainError::OtherTeacher`] if it is none for scans, or does not know a primitive.
    pub fn load(config: &TeacherConfig, run: &TrainConfig, device: &Device) -> Result<Self, TrainError> {
        let Weights { network, sha256 } = Weights::load(&config.weights, device)?;
        let theirs = network.config();
        let outputs: Option<Vec<usize>> =
            run.network.primitives.iter().map(|primitive| theirs.output_of(*primitive)).collect();
        match outputs.filter(|_| theirs.modality == Modality::Cloud) {
            Some(outputs) => Ok(Self { network, outputs, sha256, places: config.places }),
            None => Err(TrainError::OtherTeacher {
                path: config.weights.clone(),
                modality: theirs.modality,
                primitives: theirs.primitives.clone(),
            }),
        }
    }

    /// SHA-256 of its weights.
    pub(crate) fn sha256(&self) -> &str {
        &self.sha256
    }

    /// How many places of a view it talks about, at most.
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
    pub(crate) fn lesson(&self, desks: &[Desk], rows: Vec<usize>, rng: &mut ChaCha8Rng) -> Lesson {
        if rows.is_empty() {
            return Lesson::default();
        }
        let (config, device) = (self.network.config(), self.network.device());
        let (n, each, latent) = (rows.len(), config.primitives.len(), config.latent);
        let features = self.features(desks);
        let codes: Vec<f32> = (0..n * latent).map(|_| StandardNormal.sample(rng)).collect();
        let codes = Tensor::from_data(TensorData::new(codes, [n, latent]), &device);
        let own = self.network.heads.proposal.decode(features.clone(), codes);
        let own = to_axes(own.reshape([n * each, 6]));
        let mut orientations: Vec<[f32; 6]> = floats(own).as_chunks().0.to_vec();
        for hand in &mut orientations {
            if rng.random() {
                turn(hand, rng);
            }
        }
        let outputs: Vec<i64> = self.outputs.iter().map(|output| *output as i64).collect();
        let outputs = Tensor::<1, Int>::from_ints(outputs.as_slice(), &device);
        let logits = self.logits(desks, features, &orientations).select(1, outputs);
        Lesson { rows, orientations, logits: floats(evened(logits)) }
    }

    /// `[n, features]` at the places of all desks.
    fn features(&self, desks: &[Desk]) -> Tensor<2> {
        let scans: Vec<CloudInput> = desks.iter().map(|desk| desk.scan.clone()).collect();
        let targets: Vec<Vec<f32>> = desks.iter().map(|desk| desk.points.concat()).collect();
        let of_desk = |(v, desk): (usize, &Desk)| (0..desk.points.len()).map(move |i| (v, i));
        let places: Vec<(usize, usize)> = desks.iter().enumerate().flat_map(of_desk).collect();
        let hierarchy = CloudInput::hierarchy(&scans, &targets, self.network.config());
        self.network.features_at(Input::Clouds(&hierarchy), &places)
    }

    /// `[n * each, primitives of the teacher]` for as many hands at each of the places of all desks, whose features are
    /// `[n, features]`.
    fn logits(&self, desks: &[Desk], features: Tensor<2>, orientations: &[[f32; 6]]) -> Tensor<2> {
        let (heads, device, [n, _]) = (&self.network.heads, features.device(), features.dims());
        let each = orientations.len() / n;
        let axes = Tensor::<3>::from_data(TensorData::new(orientations.concat(), [n, each, 6]), &device);
        let Some(look) = &heads.second_look else { return heads.score.forward_each(features, axes) };
        let mut views: Vec<Grouping> = Vec::new();
        let mut of_places = orientations.chunks(each);
        for Desk { scan, points, .. } in desks {
            let of_place = |(point, hands): (&[f32; 3], &[[f32; 6]])| {
                hands.iter().map(|hand| hand_frame(*point, &Orientation6(*hand))).collect::<Vec<_>>()
            };
            let frames: Vec<_> = points.iter().zip(of_places.by_ref()).flat_map(of_place).collect();
            join(&mut views, scan.hand_views(&frames));
        }
        let hands = heads.score.hands(features.clone(), axes);
        look.forward(select(features, (0..n * each).map(|i| i / each)), hands, &views)
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
        let axes = TensorData::new(self.orientations.concat(), [n, each, 6]);
        let features = select(features.clone(), self.rows.iter().copied());
        let thought = heads.score.forward_each(features, Tensor::from_data(axes, &device));
        let shifts = shifts(&floats(thought.clone().detach()), &self.logits, primitives);
        let shifts = Tensor::<2>::from_data(TensorData::new(shifts, [1, primitives]), &device);
        let taught = TensorData::new(self.logits.clone(), [n * each, primitives]);
        let flat = |all: Tensor<2>| all.reshape([n * each * primitives]);
        let (thought, taught) = (flat(thought + shifts), flat(Tensor::from_data(taught, &device)));
        let chances = sigmoid(taught.clone());
        let wrong = |logits| binary_cross_entropy(logits, chances.clone()).mean();
        Some(wrong(thought) - wrong(taught))
    }
}

/// Logits less the logarithm of the odds of a success in their column.
///
/// # Shapes
/// `[n, primitives]` -> the same
fn evened(logits: Tensor<2>) -> Tensor<2> {
    let successes = sigmoid(logits.clone()).mean_dim(0).clamp(1e-4, 1.0 - 1e-4);
    let log_odds = successes.clone().log() - successes.neg().add_scalar(1.0).log();
    logits - log_odds
}

/// How far the logits of each column must move for as many successes in all as the lesson expects, which is where they differ
/// least from it.
fn shifts(thought: &[f32], taught: &[f32], primitives: usize) -> Vec<f32> {
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

#[cfg(test)]
impl Teacher {
    pub(crate) fn new(network: Network, places: usize) -> Self {
        let outputs = (0..network.config().primitives.len()).collect();
        Self { network, outputs, sha256: String::new(), places }
    }
}

#[cfg(test)]
impl Desk {
    /// Its points, metres.
    pub(crate) fn points_in_metres(&self) -> impl Iterator<Item = Point3<f32>> + '_ {
        self.points.iter().map(|point| self.scan.metres_from_network(&Point3::from(*point)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use where2act_core::{Primitive, Seed};
    use where2act_model::ModelConfig;

    const STRAIGHT: [f32; 6] = [0.0, 0.0, 1.0, 1.0, 0.0, 0.0];

    /// Points of a wavy board a metre away.
    fn board() -> Vec<Point3<f32>> {
        let at = |i: usize| (i as f32 / 20.0 - 0.5) * 0.6;
        let point = |(x, y): (f32, f32)| Point3::new(x, y, 1.0 + 0.1 * (9.0 * x).sin());
        (0..441).map(|i| point((at(i % 21), at(i / 21)))).collect()
    }

    fn teacher(second_look: bool) -> Teacher {
        let primitives = [Primitive::Pushing, Primitive::Pulling];
        let mut config = ModelConfig::new(Modality::Cloud, &primitives).with_points(256);
        config.second_look = second_look;
        Teacher::new(Network::new(&config, Seed(1), &Device::flex()), 5)
    }

    /// Desks with three and two places.
    fn desks(teacher: &Teacher) -> [Desk; 2] {
        let points = board();
        let asked: Vec<_> = (0..3).map(|i| (i, points[150 * i])).collect();
        [&asked[..], &asked[..2]].map(|asked| teacher.desk(&points, asked, &mut Seed(2).rng()).unwrap())
    }

    fn largest(a: &[f32], b: &[f32]) -> f32 {
        a.iter().zip(b).fold(0.0, |largest, (a, b)| largest.max((a - b).abs()))
    }

    #[test]
    fn who_thinks_the_same_has_nothing_to_learn() {
        let teacher = teacher(false);
        let desks = desks(&teacher);
        // The batch has another place too.
        let rows = [4, 0, 2, 1, 5];
        let lesson = teacher.lesson(&desks, rows.to_vec(), &mut Seed(3).rng());
        assert_eq!((lesson.orientations.len(), lesson.logits.len()), (10, 20));
        let place_of = |row: usize| rows.iter().position(|r| *r == row).unwrap_or(0);
        let features = select(teacher.features(&desks), (0..6).map(place_of));
        let difference = |lesson: &Lesson, network: &Network| {
            lesson.difference(&network.heads, &features).unwrap().into_scalar::<f32>()
        };
        let other = Network::new(teacher.network.config(), Seed(9), &Device::flex());
        let (same, apart) = (difference(&lesson, &teacher.network), difference(&lesson, &other));
        assert!(same.abs() < 1e-6 && apart > 1e-5, "{same} {apart}");
        // Nothing but a number for each primitive is between what both think of these hands, at these places.
        let axes = TensorData::new(lesson.orientations.concat(), [5, 2, 6]);
        let spread = |rows: [usize; 5]| {
            let features = select(features.clone(), rows.into_iter());
            let axes = Tensor::from_data(axes.clone(), &Device::flex());
            let thought = floats(teacher.network.heads.score.forward_each(features, axes));
            let apart: Vec<f32> = thought.iter().zip(&lesson.logits).map(|(a, b)| a - b).collect();
            largest(&apart[2..], &apart)
        };
        assert!(spread(rows) < 1e-5 && spread([0, 4, 2, 1, 5]) > 1e-4, "{}", spread([0, 4, 2, 1, 5]));
    }

    #[test]
    fn a_second_look_has_the_last_word() {
        let teacher = teacher(true);
        let desks = desks(&teacher);
        let mut hands = vec![STRAIGHT; 10];
        hands.iter_mut().enumerate().for_each(|(i, hand)| turn(hand, &mut Seed(i as u64).rng()));
        let together = floats(teacher.logits(&desks, teacher.features(&desks), &hands));
        // Desk by desk it is the same.
        let alone =
            |desk: &[Desk], hands: &[[f32; 6]]| floats(teacher.logits(desk, teacher.features(desk), hands));
        let each = [alone(&desks[..1], &hands[..6]), alone(&desks[1..], &hands[6..])].concat();
        let mut blind = teacher.clone();
        blind.network.heads.second_look = None;
        let first_look = floats(blind.logits(&desks, teacher.features(&desks), &hands));
        let (changed, looked) = (largest(&together, &each), largest(&together, &first_look));
        assert!(together.len() == each.len() && changed < 1e-5 && looked > 1e-3, "{changed} {looked}");
    }

    #[test]
    fn who_learns_one_primitive_hears_of_that_alone() {
        let mut teacher = teacher(false);
        let desks = desks(&teacher);
        let lesson = |teacher: &Teacher| teacher.lesson(&desks, (0..5).collect(), &mut Seed(3).rng());
        let all = lesson(&teacher);
        teacher.outputs = vec![1];
        let pulling: Vec<f32> = all.logits.iter().skip(1).step_by(2).copied().collect();
        let one = lesson(&teacher);
        assert!(one.logits.len() == 10 && largest(&one.logits, &pulling) < 1e-6);
        assert_eq!(one.orientations, all.orientations);
    }

    #[test]
    fn without_places_there_is_no_lesson() {
        let teacher = teacher(true);
        let none = teacher.lesson(&[], Vec::new(), &mut Seed(1).rng());
        let features = Tensor::<2>::zeros([1, teacher.network.config().features], &Device::flex());
        assert!(none.difference(&teacher.network.heads, &features).is_none());
    }

    #[test]
    fn a_turned_hand_is_a_hand() {
        let mut rng = Seed(4).rng();
        let mut farthest = 1.0f32;
        for _ in 0..100 {
            let mut hand = STRAIGHT;
            turn(&mut hand, &mut rng);
            let [z, x] = [0, 3].map(|i| Vector3::new(hand[i], hand[i + 1], hand[i + 2]));
            assert!((z.norm() - 1.0).abs() < 1e-5 && (x.norm() - 1.0).abs() < 1e-5 && z.dot(&x).abs() < 1e-5);
            assert!(z.z > TURN.cos() - 1e-5);
            farthest = farthest.min(z.z);
        }
        assert!(farthest < 0.7, "{farthest}");
    }

    #[test]
    fn moved_logits_expect_as_many_successes() {
        // The second column is the first less 3, and one hand has no chance at all, which must not count for more than that.
        let taught = [1.0, 1.0, -1.0, -1.0, -60.0, 0.5];
        let thought = [1.0, -2.0, -1.0, -4.0, -4.0, -2.5];
        let [first, second] = shifts(&thought, &taught, 2)[..] else { panic!("two columns") };
        assert!((-0.1..0.0).contains(&first) && (second - 3.0).abs() < 1e-4, "{first} {second}");
    }

    #[test]
    fn odds_of_a_lesson_do_not_count() {
        let logits = Tensor::<2>::from_floats([[-2.0, 1.0], [-4.0, 1.0]], &Device::flex());
        let evened = floats(evened(logits));
        let mean = [-2.0f32, -4.0].map(|x| 1.0 / (1.0 + (-x).exp())).iter().sum::<f32>() / 2.0;
        let log_odds = (mean / (1.0 - mean)).ln();
        assert!(largest(&evened, &[-2.0 - log_odds, 0.0, -4.0 - log_odds, 0.0]) < 1e-5, "{evened:?}");
    }
}
