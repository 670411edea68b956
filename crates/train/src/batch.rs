//! From scenes to what one training step sees. A batch is a pure function of the data, the configuration and a seed.

use std::collections::HashSet;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use where2act_core::shard::{DEPTH_SIDE, DEPTH_UNIT, Shard};
use where2act_core::{ImageSize, Orientation6, Pixel, Seed};
use where2act_model::preprocess::{CloudInput, CloudScale, ImageInput, PreprocessError};
use where2act_model::{Grouping, Hierarchy, Modality, ModelConfig, hand_frame};

use crate::config::{BatchConfig, TrainConfig};
use crate::dataset::{DataError, Dataset, SceneId};
use crate::probes::{self, Ways};
use crate::questions::{self, Ground, Question};
use crate::replay::Replay;
use crate::sensor;
use crate::shown::Shown;
use crate::step::Phase;
use crate::teacher::{Desk, Lesson, Teacher, join};

/// So many last rounds of online sampling count as the newest.
const NEWEST_ROUNDS: usize = 8;

/// What the network is shown and asked.
#[derive(Clone, Debug)]
pub struct Batch {
    /// Pictures or clouds.
    pub input: BatchInput,
    /// The questions and their answers.
    pub queries: Queries,
}

/// A batch of prepared inputs.
#[derive(Clone, Debug)]
pub enum BatchInput {
    /// `[views, 3, side, side]`, normalised.
    Images {
        /// The numbers.
        pixels: Vec<f32>,
        /// Views.
        views: usize,
        /// Width and height.
        side: usize,
    },
    /// Clouds with the queries' points as targets.
    Clouds(Box<Hierarchy>),
}

/// Trials first, then places where only actionability is asked.
#[derive(Clone, Debug, Default)]
pub struct Queries {
    /// (view, pixel of the picture or target of the view), for trials and places.
    pub places: Vec<(usize, usize)>,
    /// Which output of the heads each is about, for trials and places.
    pub outputs: Vec<usize>,
    /// `[approach, forward]` of each trial in the camera frame.
    pub orientations: Vec<[f32; 6]>,
    /// 1 for success, 0 for failure, of each trial.
    pub labels: Vec<f32>,
    /// How much each trial counts: successes and failures of a primitive count the same in a batch.
    pub weights: Vec<f32>,
    /// What the hand of each trial would see, if the network takes a second look.
    pub hand_views: Vec<Grouping>,
    /// Which ways each place can go, for trials and places; `None` where nobody knows.
    pub ways: Vec<Option<Ways>>,
    /// Normal of the surface at each place, camera frame, for trials and places; `None` at edges and beside the object.
    pub normals: Vec<Option<Vector3<f32>>>,
    /// What the teacher says of some of the places; empty without one.
    pub lesson: Lesson,
}

impl Queries {
    /// Number of trials.
    #[must_use]
    pub fn trials(&self) -> usize {
        self.labels.len()
    }

    fn see(&mut self, seen: &[Seen]) {
        self.ways.extend(seen.iter().map(|(ways, _)| ways));
        self.normals.extend(seen.iter().map(|(_, normal)| normal));
    }
}

/// One view's share of a batch.
struct View {
    input: ViewInput,
    /// Trials as (place, output, orientation, success).
    trials: Vec<(usize, usize, [f32; 6], bool)>,
    /// What the hands of the trials would see.
    hand_views: Vec<Grouping>,
    /// Places as (place, output).
    places: Vec<(usize, usize)>,
    /// What is seen at the trials, then at the places.
    seen: Vec<Seen>,
    /// What the teacher sees; its places count trials first.
    desk: Option<Desk>,
}

/// What the scene knows of a place: the ways it can go and its normal.
type Seen = (Option<Ways>, Option<Vector3<f32>>);

enum ViewInput {
    Image(Vec<f32>),
    /// The cloud, then the targets' points.
    Cloud(CloudInput, Vec<f32>),
}

/// Everything batches are made from.
#[derive(Clone, Debug)]
pub struct Source {
    /// The shards.
    pub dataset: Arc<Dataset>,
    /// Scenes to draw from.
    pub scenes: Arc<[SceneId]>,
    /// Those of them that some views of every step are drawn from, and how many.
    pub newest: (Arc<[SceneId]>, usize),
    /// Newer trials on the same scenes.
    pub replay: Arc<Replay>,
    /// What is trained.
    pub model: ModelConfig,
    /// What a step sees.
    pub config: BatchConfig,
    /// The run's seed.
    pub seed: Seed,
    /// Who says more about the scenes than their trials do.
    pub teacher: Option<Arc<Teacher>>,
}

impl Source {
    /// A source for a phase of a run. Looking takes any of the scenes; all else needs those with trials of what is learnt,
    /// older or newer.
    #[must_use]
    pub fn new(
        dataset: Arc<Dataset>,
        scenes: &[SceneId],
        replay: Arc<Replay>,
        config: &TrainConfig,
        phase: Phase,
    ) -> Self {
        let (mut model, mut batch, seed) = (config.model(), config.batch.clone(), config.root_seed());
        let mut newest = Vec::new();
        let scenes = if phase == Phase::Look {
            batch.places_per_view = batch.looks_per_view;
            model.second_look = false;
            scenes.into()
        } else {
            let primitives = &config.network.primitives;
            let newer = replay.scenes(primitives);
            let known: HashSet<SceneId> = scenes.iter().copied().collect();
            let rounds = replay.newest(NEWEST_ROUNDS * config.adaptive.scenes);
            newest.extend(rounds.into_iter().filter(|id| known.contains(id) && newer.contains(id)));
            let tried = |id: &SceneId| newer.contains(id) || dataset.is_tried(*id, primitives);
            scenes.iter().copied().filter(tried).collect()
        };
        let of_newest = if newest.is_empty() {
            0
        } else {
            (config.adaptive.newest * batch.views as f32).round() as usize
        };
        let newest = (newest.into(), of_newest);
        Self { dataset, scenes, newest, replay, model, config: batch, seed, teacher: None }
    }

    /// Scenes of a step: of each kind every scene comes once before any comes again, in an order that changes every time. (New
    /// trials between epochs change the scenes and begin another order.)
    #[must_use]
    pub fn scenes_of(&self, step: usize) -> Vec<SceneId> {
        let (newest, count) = &self.newest;
        let mut scenes = deal(newest, *count, step, self.seed.child("newest", 0));
        scenes.extend(deal(&self.scenes, self.config.views - count, step, self.seed));
        scenes
    }

    /// The batch of a step.
    ///
    /// # Errors
    /// Those of reading a shard.
    pub fn batch(&self, step: usize) -> Result<Batch, DataError> {
        let seed = self.seed.child("batch", step as u64);
        let mut views: Vec<View> = self
            .scenes_of(step)
            .into_par_iter()
            .enumerate()
            .map(|(i, id)| self.view(id, &mut seed.child("view", i as u64).rng()))
            .collect::<Result<_, _>>()?;
        let Some(teacher) = &self.teacher else { return Ok(assemble(views, &self.model)) };
        let counts: Vec<[usize; 2]> =
            views.iter().map(|view| [view.trials.len(), view.places.len()]).collect();
        let desks: Vec<Option<Desk>> = views.iter_mut().map(|view| view.desk.take()).collect();
        let asked: Vec<&[usize]> =
            desks.iter().map(|desk| desk.as_ref().map_or(&[][..], |desk| &desk.places)).collect();
        let rows = rows(&asked, &counts);
        let desks: Vec<Desk> = desks.into_iter().flatten().collect();
        let mut batch = assemble(views, &self.model);
        batch.queries.lesson = teacher.lesson(&desks, rows, &mut seed.child("teacher", 0).rng());
        Ok(batch)
    }

    fn view(&self, id: SceneId, rng: &mut ChaCha8Rng) -> Result<View, DataError> {
        let shard = &self.dataset.shards()[id.shard];
        let mut trials = shard.trials(id.scene)?;
        trials.extend(self.replay.trials(id));
        let ground = Ground::new(shard.link(id.scene), self.model.modality);
        let mut questions = questions::choose(&trials, &ground, &self.model, &self.config, rng);
        let mut places = questions::places(&ground, &self.model, &self.config, rng);
        let shown = Shown::draw(&self.config, rng);
        questions.iter_mut().for_each(|question| shown.turn(question));
        // What a rolled picture does not show any more, and what a scanner does not measure, is not asked about.
        let foreground = match self.model.modality {
            Modality::Rgb => {
                let side = shard.rgb_side();
                let inside = |pixel: Pixel| shown.pixel(picture_pixel(pixel, side), side).is_some();
                questions.retain(|q| inside(q.pixel));
                places.retain(|(pixel, _)| inside(*pixel));
                Vec::new()
            }
            Modality::Cloud => {
                let mut seen = shard.foreground(id.scene);
                if rng.random::<f32>() < self.config.measured {
                    sensor::measure(&mut seen, rng);
                }
                questions.retain(|q| point_of(&seen, q.pixel).is_some());
                places.retain(|(pixel, _)| point_of(&seen, *pixel).is_some());
                seen
            }
        };
        let view = match self.model.modality {
            Modality::Rgb => {
                image_view(shard.rgb(id.scene), shard.rgb_side(), &questions, &places, shown, &self.model)
            }
            Modality::Cloud => cloud_view(&foreground, &questions, &places, shown, &self.model, rng),
        };
        let fail = |source| DataError::View { path: shard.path().to_owned(), scene: id.scene, source };
        let mut view = view.map_err(fail)?;
        let pixels = questions.iter().map(|q| q.pixel).chain(places.iter().map(|(pixel, _)| *pixel));
        let pixels: Vec<Pixel> = pixels.collect();
        view.seen = seen_at(shard, id.scene, pixels.iter().copied(), shown);
        if let Some(teacher) = &self.teacher {
            let (foreground, link) = (shard.foreground(id.scene), shard.link(id.scene));
            view.desk =
                desk(teacher, foreground, link, &pixels, questions.len(), shown, rng).map_err(fail)?;
        }
        Ok(view)
    }
}

/// `count` scenes for each step in turn, shuffled anew whenever all have come.
fn deal(scenes: &[SceneId], count: usize, step: usize, seed: Seed) -> Vec<SceneId> {
    let n = scenes.len();
    let mut order: Option<(usize, Vec<usize>)> = None;
    (step * count..(step + 1) * count)
        .map(|position| {
            let (round, place) = (position / n, position % n);
            if order.as_ref().is_none_or(|(r, _)| *r != round) {
                let mut shuffled: Vec<usize> = (0..n).collect();
                shuffled.shuffle(&mut seed.child("order", round as u64).rng());
                order = Some((round, shuffled));
            }
            scenes[order.as_ref().map_or(place, |(_, shuffled)| shuffled[place])]
        })
        .collect()
}

/// What the scene knows of what is seen at some pixels. Nobody knows where the scanner measured nothing, nor the ways in
/// data that was collected without them.
fn seen_at(shard: &Shard, scene: usize, pixels: impl Iterator<Item = Pixel>, shown: Shown) -> Vec<Seen> {
    let (camera, depth, link) = (shard.camera(scene), shard.depth(scene), shard.link(scene));
    let freedoms = &shard.scenes()[scene].freedoms;
    let point = |pixel: Pixel| {
        let metres = f32::from(depth[camera.size.index(pixel)]) * DEPTH_UNIT;
        (metres > 0.0).then(|| camera.intrinsics.pixel_to_point(pixel, metres))
    };
    let ways = |pixel: Pixel| match link[camera.size.index(pixel)] {
        // The background and the root.
        0 | 1 => Some(Ways::default()),
        id => Some(probes::ways(freedoms.get(usize::from(id) - 2)?, &point(pixel)?)),
    };
    let turned = |v: Vector3<f32>| shown.direction(v);
    let seen = |pixel| {
        let normal = probes::normal(pixel, camera.size, point);
        (ways(pixel).map(|ways| ways.map(turned)), normal.map(turned))
    };
    pixels.map(seen).collect()
}

/// The scan that the teacher sees of a view, and the places it talks about: at most a third of them places of trials, many of
/// which are where networks thought that something moves, the others places on parts that move, as far as they last.
fn desk(
    teacher: &Teacher,
    foreground: Vec<(Pixel, Point3<f32>)>,
    link: &[u8],
    pixels: &[Pixel],
    trials: usize,
    shown: Shown,
    rng: &mut ChaCha8Rng,
) -> Result<Option<Desk>, PreprocessError> {
    let size = ImageSize::square(DEPTH_SIDE);
    let (mut of_trials, mut of_parts): (Vec<usize>, Vec<usize>) =
        (0..pixels.len()).filter(|i| link[size.index(pixels[*i])] > 1).partition(|i| *i < trials);
    of_trials.shuffle(rng);
    of_trials.truncate(teacher.places() / 3);
    of_parts.truncate(teacher.places() - of_trials.len());
    let asked: Vec<(usize, Point3<f32>)> = (of_trials.into_iter().chain(of_parts))
        .filter_map(|i| Some((i, shown.point(point_of(&foreground, pixels[i])?))))
        .collect();
    if asked.is_empty() {
        return Ok(None);
    }
    let points: Vec<_> = foreground.into_iter().map(|(_, point)| shown.point(point)).collect();
    teacher.desk(&points, &asked, rng).map(Some)
}

/// Rows of a batch's places, trials of all views first, for places of each view, which count its own trials first.
/// `counts` are each view's trials and places.
fn rows(asked: &[&[usize]], counts: &[[usize; 2]]) -> Vec<usize> {
    let mut first = [0, counts.iter().map(|[trials, _]| trials).sum()];
    let mut rows = Vec::new();
    for (asked, [trials, places]) in asked.iter().zip(counts) {
        let row = |i: &usize| if i < trials { first[0] + i } else { first[1] + i - trials };
        rows.extend(asked.iter().map(row));
        first = [first[0] + trials, first[1] + places];
    }
    rows
}

/// Pixel of the stored picture, `side` x `side` pixels, that shows a pixel of the stored depth map.
pub(crate) fn picture_pixel(pixel: Pixel, side: usize) -> Pixel {
    let shrink = (DEPTH_SIDE / side) as u32;
    Pixel { u: pixel.u / shrink, v: pixel.v / shrink }
}

fn image_view(
    rgb: Vec<[u8; 3]>,
    side: usize,
    questions: &[Question],
    places: &[(Pixel, usize)],
    shown: Shown,
    model: &ModelConfig,
) -> Result<View, PreprocessError> {
    let rgb = shown.picture(rgb, side);
    let input = ImageInput::new(ImageSize::square(side), &rgb, None, &model.preprocessing)?;
    let place = |pixel: Pixel| {
        let pixel = shown.pixel(picture_pixel(pixel, side), side);
        input.letterbox.network_index(pixel.expect("places beside the picture are left out"))
    };
    Ok(View {
        trials: questions.iter().map(|q| (place(q.pixel), q.output, q.orientation, q.success)).collect(),
        hand_views: Vec::new(),
        places: places.iter().map(|(pixel, output)| (place(*pixel), *output)).collect(),
        seen: Vec::new(),
        desk: None,
        input: ViewInput::Image(input.values),
    })
}

/// The point seen at a pixel. Pixels come row by row, so it is found by bisection.
fn point_of(foreground: &[(Pixel, Point3<f32>)], pixel: Pixel) -> Option<Point3<f32>> {
    let found = foreground.binary_search_by_key(&(pixel.v, pixel.u), |(p, _)| (p.v, p.u)).ok()?;
    Some(foreground[found].1)
}

fn cloud_view(
    foreground: &[(Pixel, Point3<f32>)],
    questions: &[Question],
    places: &[(Pixel, usize)],
    shown: Shown,
    model: &ModelConfig,
    rng: &mut ChaCha8Rng,
) -> Result<View, PreprocessError> {
    let points: Vec<_> = foreground.iter().map(|(_, point)| shown.point(*point)).collect();
    let cloud = CloudInput::new(&points, CloudScale::PerMetre(1.0), model, rng)?;
    let asked = questions.iter().map(|q| q.pixel).chain(places.iter().map(|(pixel, _)| *pixel));
    let targets: Vec<f32> = asked
        .filter_map(|pixel| point_of(foreground, pixel))
        .flat_map(|point| <[f32; 3]>::from(cloud.network_from_metres(&shown.point(point))))
        .collect();
    let n = questions.len();
    let hand =
        |(point, question): (&[f32; 3], &Question)| hand_frame(*point, &Orientation6(question.orientation));
    let hands: Vec<_> = targets.as_chunks().0.iter().zip(questions).map(hand).collect();
    Ok(View {
        hand_views: if model.second_look { cloud.hand_views(&hands) } else { Vec::new() },
        input: ViewInput::Cloud(cloud, targets),
        trials: questions.iter().enumerate().map(|(i, q)| (i, q.output, q.orientation, q.success)).collect(),
        places: places.iter().enumerate().map(|(i, (_, output))| (n + i, *output)).collect(),
        seen: Vec::new(),
        desk: None,
    })
}

fn assemble(mut views: Vec<View>, model: &ModelConfig) -> Batch {
    let mut queries = Queries::default();
    for (v, view) in views.iter_mut().enumerate() {
        join(&mut queries.hand_views, std::mem::take(&mut view.hand_views));
        for (place, output, orientation, success) in &view.trials {
            queries.places.push((v, *place));
            queries.outputs.push(*output);
            queries.orientations.push(*orientation);
            queries.labels.push(f32::from(u8::from(*success)));
        }
        queries.see(&view.seen[..view.trials.len()]);
    }
    queries.weights = balanced(&queries, model.primitives.len());
    for (v, view) in views.iter().enumerate() {
        for (place, output) in &view.places {
            queries.places.push((v, *place));
            queries.outputs.push(*output);
        }
        queries.see(&view.seen[view.trials.len()..]);
    }
    let count = views.len();
    let (mut pixels, mut clouds, mut targets) = (Vec::new(), Vec::new(), Vec::new());
    for view in views {
        match view.input {
            ViewInput::Image(image) => pixels.extend(image),
            ViewInput::Cloud(cloud, wanted) => {
                clouds.push(cloud);
                targets.push(wanted);
            }
        }
    }
    let input = match model.modality {
        Modality::Rgb => BatchInput::Images { pixels, views: count, side: model.preprocessing.image_side },
        Modality::Cloud => BatchInput::Clouds(Box::new(CloudInput::hierarchy(&clouds, &targets, model))),
    };
    Batch { input, queries }
}

/// Weights with which successes and failures of every primitive count the same, and all primitives too.
fn balanced(queries: &Queries, outputs: usize) -> Vec<f32> {
    let mut counts = vec![[0usize; 2]; outputs];
    for (output, label) in queries.outputs.iter().zip(&queries.labels) {
        counts[*output][usize::from(*label > 0.5)] += 1;
    }
    let weight = |output: usize, label: f32| 1.0 / counts[output][usize::from(label > 0.5)] as f32;
    queries.outputs.iter().zip(&queries.labels).map(|(output, label)| weight(*output, *label)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::Device;
    use where2act_core::Primitive;
    use where2act_model::Network;

    #[test]
    fn successes_and_failures_weigh_the_same() {
        let queries = Queries {
            outputs: vec![0, 0, 0, 1, 1],
            labels: vec![1.0, 0.0, 0.0, 1.0, 0.0],
            ..Queries::default()
        };
        assert_eq!(balanced(&queries, 2), vec![1.0, 0.5, 0.5, 1.0, 1.0]);
    }

    #[test]
    fn a_depth_pixel_and_its_picture_pixel_agree() {
        let pixel = |u, v| Pixel { u, v };
        assert_eq!(picture_pixel(pixel(447, 447), 224), pixel(223, 223));
        assert_eq!(picture_pixel(pixel(3, 2), 224), pixel(1, 1));
        assert_eq!(picture_pixel(pixel(3, 2), 448), pixel(3, 2));
    }

    #[test]
    fn rows_are_where_views_put_their_places() {
        // Trials are rows 0 to 2, 3 and none; places follow: 4, none, 5 to 7.
        let counts = [[3, 1], [1, 0], [0, 3]];
        assert_eq!(rows(&[&[3, 0], &[0], &[2, 1]], &counts), [4, 0, 3, 7, 6]);
        assert_eq!(rows(&[&[], &[], &[0]], &counts), [5]);
    }

    #[test]
    fn a_teacher_sees_what_is_shown() {
        let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(64);
        let teacher = Teacher::new(Network::new(&config, Seed(1), &Device::flex()), 6);
        let pixel = |i: u32| Pixel { u: 2 * (i % 20), v: 3 * (i / 20) };
        let point = |p: Pixel| Point3::new(p.u as f32 * 0.01, p.v as f32 * 0.01, 1.0 + p.u as f32 * 0.003);
        let foreground: Vec<_> = (0..400).map(pixel).map(|p| (p, point(p))).collect();
        // What is in the first thirty rows does not move.
        let link: Vec<u8> =
            (0..DEPTH_SIDE * DEPTH_SIDE).map(|i| if i < 30 * DEPTH_SIDE { 1 } else { 2 }).collect();
        let pixels: Vec<Pixel> = (0..40).map(|i| pixel(9 * i)).collect();
        for (mirrored, rolled) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let always = BatchConfig { mirrored, rolled, ..BatchConfig::default() };
            let shown = Shown::draw(&always, &mut Seed(2).rng());
            let ask = |pixels: &[Pixel]| {
                desk(&teacher, foreground.clone(), &link, pixels, 30, shown, &mut Seed(3).rng()).unwrap()
            };
            let asked = ask(&pixels).unwrap();
            assert_eq!(asked.places.iter().filter(|place| **place < 30).count(), 2);
            assert_eq!(asked.places.len(), 6);
            for (place, found) in asked.places.iter().zip(asked.points_in_metres()) {
                let expected = shown.point(point(pixels[*place]));
                assert!((found - expected).norm() < 1e-5 && pixels[*place].v >= 30, "{found} {expected}");
            }
            assert!(ask(&pixels[..10]).is_none());
        }
    }
}
