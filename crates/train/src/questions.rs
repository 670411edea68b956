//! What a view asks the network: trials with known outcomes, and questions whose answer is known without a trial.

use rand::RngExt;
use rand::seq::{IndexedRandom, SliceRandom};
use rand_chacha::ChaCha8Rng;
use where2act_core::shard::{DEPTH_SIDE, RGB_SIDE};
use where2act_core::{Invalid, Orientation6, Pixel, Policy, Primitive, Trial};
use where2act_model::{Modality, ModelConfig};

use crate::config::BatchConfig;

/// Would this orientation at this pixel have success?
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Question {
    /// Pixel of the stored depth map.
    pub(crate) pixel: Pixel,
    /// Output of the heads.
    pub(crate) output: usize,
    pub(crate) primitive: Primitive,
    /// `[approach, forward]` in the camera frame.
    pub(crate) orientation: [f32; 6],
    pub(crate) success: bool,
    /// Whether the hand comes from behind: flipped, it would come from the front, and nobody knows what of that.
    from_behind: bool,
}

impl Question {
    fn of(trial: &Trial, output: usize) -> Self {
        let orientation = Orientation6::from_rotation(&trial.grasp_in_camera.rotation).0;
        let (pixel, primitive, verdict) = (trial.pixel, trial.primitive, &trial.verdict);
        let from_behind = verdict.invalid == Some(Invalid::ApproachFromBehind);
        Self { pixel, output, primitive, orientation, success: verdict.success, from_behind }
    }

    /// A question of no scene.
    #[cfg(test)]
    pub(crate) fn example(primitive: Primitive, orientation: [f32; 6]) -> Self {
        let pixel = Pixel { u: 0, v: 0 };
        Self { pixel, output: 0, primitive, orientation, success: true, from_behind: false }
    }

    /// The question about the scene as a mirror shows it, left and right swapped; its pixel stays that of the unmirrored
    /// view.
    pub(crate) fn mirror(&mut self) {
        self.orientation = Orientation6(self.orientation).mirrored(self.primitive).0;
    }

    /// The hand turned half round about its approach. For pushing and pulling the motion is the same.
    fn half_turn(&mut self) {
        if matches!(self.primitive, Primitive::Pushing | Primitive::Pulling) {
            self.orientation[3..].iter_mut().for_each(|x| *x = -*x);
        }
    }
}

/// How far from an outline a pixel still lies beside it: 8 cm in the published view, the width of an open hand.
const BESIDE: usize = 12;
/// One in so many places where nothing moves lies beside an outline. With one in two the background further away lit up.
const BESIDE_IN: u32 = 3;
/// A pixel of the published picture shows [`DEPTH_SIDE`] / [`RGB_SIDE`] pixels of the depth map a side, so that one this close
/// to an outline may show what is on its other side; depth cameras mix the two there.
const BLURRED: usize = DEPTH_SIDE / RGB_SIDE;

/// What pixels of the stored depth map show.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Ground {
    /// Parts that move, each with its pixels.
    movable: Vec<Vec<u32>>,
    /// Where nothing moves.
    still: [Still; 2],
}

/// Pixels of parts that do not move; or, for networks that see them, of what is around the object.
#[derive(Clone, Debug, Default, PartialEq)]
struct Still {
    all: Vec<u32>,
    /// Those right beside something else. Networks that are hardly ever asked there let what they think of a part spill
    /// over its outline.
    beside: Vec<u32>,
}

impl Ground {
    pub(crate) fn new(link: &[u8], modality: Modality) -> Self {
        let mut ground = Self::default();
        let parts = usize::from(link.iter().copied().max().unwrap_or(0));
        ground.movable.resize(parts.saturating_sub(1), Vec::new());
        let beside = beside_outlines(link);
        for (i, (link, beside)) in (0..).zip(link.iter().zip(beside)) {
            let still = match (link, modality) {
                (0, Modality::Cloud) => continue,
                (0, Modality::Rgb) => &mut ground.still[1],
                (1, _) => &mut ground.still[0],
                (part, _) => {
                    ground.movable[usize::from(*part) - 2].push(i);
                    continue;
                }
            };
            still.all.push(i);
            if beside {
                still.beside.push(i);
            }
        }
        ground.movable.retain(|part| !part.is_empty());
        ground
    }

    /// A pixel of a part that moves: half of them by pixel, half by part, so that knobs and buttons are not left out.
    fn movable(&self, rng: &mut ChaCha8Rng) -> Option<Pixel> {
        let by_part = rng.random::<bool>();
        let part =
            if by_part { self.movable.choose(rng) } else { self.movable.choose_weighted(rng, Vec::len).ok() };
        any(part?, rng)
    }

    /// A pixel where nothing moves; each kind as likely, however large it is, and a third of them beside an outline.
    fn still(&self, rng: &mut ChaCha8Rng) -> Option<Pixel> {
        let first = usize::from(rng.random::<bool>());
        let beside = rng.random_ratio(1, BESIDE_IN);
        let of = |still: &Still, rng: &mut ChaCha8Rng| {
            let near = if beside { any(&still.beside, rng) } else { None };
            near.or_else(|| any(&still.all, rng))
        };
        of(&self.still[first], rng).or_else(|| of(&self.still[1 - first], rng))
    }
}

/// Which pixels of a depth map have something else of background, fixed parts and movable ones within [`BESIDE`] along
/// their row or column, though not within [`BLURRED`].
fn beside_outlines(link: &[u8]) -> Vec<bool> {
    let kind = |pixel: usize| link[pixel].min(2);
    let (mut near, mut blurred) = (vec![false; link.len()], vec![false; link.len()]);
    let mut mark = |line: &[usize]| {
        for i in (1..line.len()).filter(|i| kind(line[i - 1]) != kind(line[*i])) {
            for (marks, reach) in [(&mut near, BESIDE), (&mut blurred, BLURRED)] {
                let reached = &line[i.saturating_sub(reach)..(i + reach).min(line.len())];
                reached.iter().for_each(|pixel| marks[*pixel] = true);
            }
        }
    };
    let pixels: Vec<usize> = (0..link.len()).collect();
    pixels.chunks(DEPTH_SIDE).for_each(&mut mark);
    for column in 0..DEPTH_SIDE {
        mark(&pixels.iter().copied().skip(column).step_by(DEPTH_SIDE).collect::<Vec<_>>());
    }
    near.into_iter().zip(blurred).map(|(near, blurred)| near && !blurred).collect()
}

/// Successes and failures of each primitive, half and half as far as they last, and free negatives: the approach
/// flipped out of the surface, or the same orientation somewhere where nothing moves. Trials that the network itself
/// proposed come first, because they show where it is wrong.
pub(crate) fn choose(
    trials: &[Trial],
    ground: &Ground,
    model: &ModelConfig,
    config: &BatchConfig,
    rng: &mut ChaCha8Rng,
) -> Vec<Question> {
    let quota = (config.trials_per_view / (2 * model.primitives.len())).max(1);
    let mut chosen = Vec::new();
    for (output, primitive) in model.primitives.iter().enumerate() {
        for success in [true, false] {
            let mut these: Vec<&Trial> =
                trials.iter().filter(|t| t.primitive == *primitive && t.verdict.success == success).collect();
            these.shuffle(rng);
            these.sort_by_key(|trial| trial.policy != Policy::Adaptive);
            chosen.extend(these.into_iter().take(quota).map(|trial| Question::of(trial, output)));
        }
    }
    chosen.shuffle(rng);
    chosen.truncate(config.trials_per_view);
    if config.half_turns {
        chosen.iter_mut().filter(|_| rng.random()).for_each(Question::half_turn);
    }
    let mut free = Vec::new();
    for question in &chosen {
        if rng.random::<f32>() < config.flipped && !question.from_behind {
            let mut flipped = Question { success: false, ..*question };
            flipped.orientation[..3].iter_mut().for_each(|x| *x = -*x);
            free.push(flipped);
        }
        if rng.random::<f32>() < config.fixed
            && let Some(pixel) = ground.still(rng)
        {
            free.push(Question { success: false, pixel, ..*question });
        }
    }
    chosen.extend(free);
    chosen
}

/// Further places as (pixel, output): on movable parts, and as often where nothing moves if that is asked at all.
pub(crate) fn places(
    ground: &Ground,
    model: &ModelConfig,
    config: &BatchConfig,
    rng: &mut ChaCha8Rng,
) -> Vec<(Pixel, usize)> {
    let mut places = Vec::new();
    for _ in 0..config.places_per_view {
        let nothing_moves = config.fixed > 0.0 && rng.random();
        let pixel = if nothing_moves { ground.still(rng) } else { ground.movable(rng) };
        let output = rng.random_range(0..model.primitives.len());
        places.extend(pixel.map(|pixel| (pixel, output)));
    }
    places
}

/// One of some pixel indices, if there are any.
fn any(pixels: &[u32], rng: &mut ChaCha8Rng) -> Option<Pixel> {
    let i = pixels.choose(rng)?;
    Some(Pixel { u: i % DEPTH_SIDE as u32, v: i / DEPTH_SIDE as u32 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector3};
    use where2act_core::{Grasp, Seed, Verdict};

    fn trial(primitive: Primitive, policy: Policy, success: bool) -> Trial {
        let grasp = Grasp::new(Point3::origin(), Vector3::new(0.3, -0.5, 0.8), Vector3::new(0.9, 0.1, 0.2));
        let verdict = Verdict { invalid: None, q_start: 0.0, q_end: 0.0, motion: Vector3::zeros(), success };
        let pixel = Pixel { u: 7, v: 9 };
        Trial { primitive, policy, pixel, link: 1, grasp_in_camera: grasp, verdict }
    }

    #[test]
    fn a_mirrored_hand_moves_where_the_mirror_shows_it() {
        let mirror = |v: Vector3<f32>| Vector3::new(-v.x, v.y, v.z);
        for primitive in Primitive::ALL {
            let trial = trial(primitive, Policy::Random, true);
            let mut question = Question::of(&trial, 0);
            question.mirror();
            let rotation = Orientation6(question.orientation).to_rotation();
            let mirrored = Grasp { point: Point3::origin(), rotation };
            let (wanted, found) = (
                mirror(primitive.intended_direction(&trial.grasp_in_camera)),
                primitive.intended_direction(&mirrored),
            );
            assert!((wanted - found).norm() < 1e-5, "{primitive}: {wanted} {found}");
            assert!((mirror(trial.grasp_in_camera.approach()) - mirrored.approach()).norm() < 1e-5);
            // The plane of the fingers is mirrored too, whichever finger is which.
            let side = mirror(trial.grasp_in_camera.left()).dot(&mirrored.left());
            assert!((side.abs() - 1.0).abs() < 1e-5, "{primitive}: {side}");
        }
    }

    #[test]
    fn beside_an_outline_is_near_it_but_not_on_it() {
        // A movable square of 100 pixels in the middle of a fixed one of 200 on the background.
        let square = |i: usize, half: usize| {
            [i % DEPTH_SIDE, i / DEPTH_SIDE].iter().all(|x| (224 - half..224 + half).contains(x))
        };
        let link: Vec<u8> = (0..DEPTH_SIDE * DEPTH_SIDE)
            .map(|i| u8::from(square(i, 100)) + 3 * u8::from(square(i, 50)))
            .collect();
        let ground = Ground::new(&link, Modality::Rgb);
        let columns = |still: &Still| {
            let row = (224 * DEPTH_SIDE as u32)..(225 * DEPTH_SIDE as u32);
            still.beside.iter().filter(|i| row.contains(*i)).map(|i| i - row.start).collect::<Vec<_>>()
        };
        let [fixed, around] = &ground.still;
        let ranges = |ranges: &[std::ops::Range<u32>]| ranges.iter().cloned().flatten().collect::<Vec<_>>();
        assert_eq!(columns(fixed), ranges(&[126..136, 162..172, 276..286, 312..322]));
        assert_eq!(columns(around), ranges(&[112..122, 326..336]));
        assert!(fixed.all.len() == 200 * 200 - 100 * 100 && around.all.len() == link.len() - 200 * 200);
    }

    #[test]
    fn small_parts_are_asked_about_too() {
        // A part of 10,000 pixels and one of 10.
        let link: Vec<u8> = (0..10_010).map(|i| if i < 10_000 { 2 } else { 4 }).collect();
        let ground = Ground::new(&link, Modality::Cloud);
        let mut rng = Seed(1).rng();
        let small = (0..1000).filter(|_| {
            let pixel = ground.movable(&mut rng).unwrap();
            pixel.v as usize * DEPTH_SIDE + pixel.u as usize >= 10_000
        });
        assert!((200..300).contains(&small.count()));
    }

    #[test]
    fn free_negatives_are_failures_and_own_proposals_come_first() {
        let model = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]);
        let config = BatchConfig {
            trials_per_view: 4,
            flipped: 1.0,
            fixed: 1.0,
            half_turns: true,
            ..BatchConfig::default()
        };
        let mut trials = vec![trial(Primitive::Pushing, Policy::Random, false); 20];
        trials.extend([trial(Primitive::Pushing, Policy::Random, true); 3]);
        trials.push(Trial {
            pixel: Pixel { u: 1, v: 1 },
            ..trial(Primitive::Pushing, Policy::Adaptive, false)
        });
        // Pixel 0 moves, the rest of the first five rows is background.
        let mut link = vec![0; 448 * 5 + 4];
        (link[0], link[448 * 5 + 3]) = (2, 1);
        let ground = Ground::new(&link, Modality::Cloud);
        let questions = choose(&trials, &ground, &model, &config, &mut Seed(1).rng());
        assert_eq!(questions.len(), 12);
        assert_eq!(questions.iter().filter(|q| q.success).count(), 2);
        assert!(questions[..4].iter().any(|q| q.pixel == Pixel { u: 1, v: 1 } && !q.success));
        assert_eq!(questions[4..].iter().filter(|q| q.pixel == Pixel { u: 3, v: 5 }).count(), 4);
        // Flipped, a hand from behind would come from the front.
        let mut behind = trial(Primitive::Pushing, Policy::Adaptive, false);
        behind.verdict.invalid = Some(Invalid::ApproachFromBehind);
        let questions = choose(&[behind; 3], &ground, &model, &config, &mut Seed(1).rng());
        assert!(questions.len() == 4 && questions[2..].iter().all(|q| q.pixel == Pixel { u: 3, v: 5 }));
        let of_fixed = |ground: &Ground| {
            let places = places(ground, &model, &config, &mut Seed(2).rng());
            assert_eq!(places.len(), config.places_per_view);
            let moving = places.iter().filter(|(p, _)| *p == Pixel { u: 0, v: 0 }).count();
            let fixed = places.iter().filter(|(p, _)| *p == Pixel { u: 3, v: 5 }).count();
            (fixed, places.len() - fixed - moving)
        };
        let (fixed, beside) = of_fixed(&ground);
        assert!((1..config.places_per_view).contains(&fixed) && beside == 0);
        let (of_part, beside) = of_fixed(&Ground::new(&link, Modality::Rgb));
        assert!(of_part > 0 && beside > 0 && of_part < fixed, "a picture shows the background too");
    }
}
