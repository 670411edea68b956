//! The gradient of a whole training step against finite differences: every loss, through every part of the network. And what a step
//! sees, by rolled cameras.

mod boards;

use std::path::Path;
use std::sync::Arc;

use burn::module::{Module, ModuleVisitor, Param};
use burn::optim::{GradientsParams, SgdConfig};
use burn::tensor::{Device, Tensor};
use nalgebra::Vector3;
use where2act_core::{Primitive, Seed};
use where2act_model::{Backbone, Modality, Network, Precision, save_weights};
use where2act_train::batch::{Batch, Queries, Source};
use where2act_train::probes::{Learner, Ways};
use where2act_train::step::{Phase, forward};
use where2act_train::teacher::{Lesson, Teacher};
use where2act_train::{
    BatchConfig, Dataset, LossConfig, NetworkConfig, Part, SceneId, ScheduleConfig, TeacherConfig,
    TrainConfig,
};

fn config(modality: Modality) -> TrainConfig {
    TrainConfig {
        name: "gradients".to_owned(),
        seed: 5,
        from: None,
        replay: vec![],
        encoder: None,
        teacher: None,
        network: NetworkConfig {
            modality,
            primitives: vec![Primitive::Pulling, Primitive::Pushing],
            width: 0.125,
            hidden: 24,
            actionability_hidden: None,
            latent: 4,
            points: 256,
            candidates: 1024,
            surroundings: true,
            alignments: 3,
            second_look: true,
            ways: Some(2.0),
            image_side: 224,
            close_up: None,
        },
        batch: BatchConfig {
            views: 2,
            trials_per_view: 40,
            flipped: 0.2,
            fixed: 0.2,
            places_per_view: 12,
            looks_per_view: 12,
            ..BatchConfig::default()
        },
        schedule: ScheduleConfig {
            look_steps: 0,
            score_steps: 0,
            joint_steps: 1,
            epoch_steps: 1,
            mean_steps: 0,
            optimiser: Default::default(),
            precision: Default::default(),
            rate: 1e-3,
            trial_rate: None,
            weight_decay: 0.0,
            decay: Default::default(),
        },
        loss: LossConfig { proposals: 8, best: 2, motion: 1.0, normal: 1.0, ..LossConfig::default() },
        adaptive: Default::default(),
        collect: Default::default(),
    }
}

/// Some boards, and which of them are trained on.
fn training_boards(folder: &Path) -> (Arc<Dataset>, Vec<SceneId>) {
    boards::write(folder, 0..16);
    let dataset = Arc::new(Dataset::open(folder, false).unwrap());
    let scenes = dataset.scenes(Part::Train).unwrap();
    (dataset, scenes)
}

/// The sum of the squared gradients of some parameters.
fn squared_norm(module: &impl Module, gradients: &GradientsParams) -> f64 {
    struct Sum<'a>(&'a GradientsParams, f64);
    impl ModuleVisitor for Sum<'_> {
        fn visit_float<const D: usize>(&mut self, param: &Param<Tensor<D>>) {
            if let Some(gradient) = self.0.get::<D>(param.id) {
                self.1 += f64::from(gradient.powi_scalar(2).sum().into_scalar::<f32>());
            }
        }
    }
    let mut sum = Sum(gradients, 0.0);
    module.visit(&mut sum);
    sum.1
}

/// Moves `part` of the learner along its gradient, forth and back, and compares how much the loss changes with what the
/// gradient says.
fn check<M: Module>(
    name: &str,
    learner: &Learner,
    batch: &Batch,
    config: &TrainConfig,
    part: impl Fn(&Learner) -> &M,
) {
    // The same noise every time.
    let total = |learner: &Learner| {
        forward(learner, batch, Phase::Joint, &config.loss, &mut Seed(9).rng()).total(config).unwrap()
    };
    let of_part = || GradientsParams::from_grads(total(learner).backward(), part(learner));
    let squared = squared_norm(part(learner), &of_part());
    assert!(squared > 1e-8, "{name}: no gradient");
    // The loss bends within some hundredths, and below a thousandth rounding shows. PointNet++ has a large gradient in many
    // small weights, whose own rounding shows below a hundredth already.
    let change = if name.ends_with("PointNet++") { 0.02 } else { 0.001 };
    let rate = change / squared;
    let moved = |by: f64| {
        let moved = SgdConfig::new().init().step(by, learner.clone(), of_part());
        f64::from(total(&moved).into_scalar::<f32>())
    };
    let (found, expected) = (moved(-rate) - moved(rate), 2.0 * rate * squared);
    assert!((found - expected).abs() < 0.02 * expected, "{name}: {found}, expected {expected}");
}

/// A roll turns hands and surfaces alike; what leaves a picture is asked about no more, wherever it is listed.
#[test]
fn rolled_cameras_see_the_same_hands_on_the_same_surfaces() {
    let folder = tempfile::tempdir().unwrap();
    let (dataset, scenes) = training_boards(folder.path());
    for modality in [Modality::Cloud, Modality::Rgb] {
        let batch = |rolled| {
            let mut config = config(modality);
            config.batch.rolled = rolled;
            Source::new(dataset.clone(), &scenes, Arc::default(), &config, Phase::Joint).batch(0).unwrap()
        };
        let (upright, rolled) = (batch(0.0).queries, batch(1.0).queries);
        for queries in [&upright, &rolled] {
            let count = queries.places.len();
            assert_eq!([queries.ways.len(), queries.normals.len(), queries.outputs.len()], [count; 3]);
        }
        // A trial's view, outcome, hand along the axis, and hand against the surface.
        let trials = |queries: &Queries| -> Vec<(usize, f32, [f32; 2])> {
            let of = |i: usize| {
                let [ax, ay, az, ..] = queries.orientations[i];
                let against = queries.normals[i].map_or(0.0, |n| n.dot(&Vector3::new(ax, ay, az)));
                (queries.places[i].0, queries.labels[i], [az, against])
            };
            (0..queries.trials()).map(of).collect()
        };
        let near = |a: [f32; 2], b: [f32; 2]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-4);
        let all = trials(&upright);
        let mut left = all.iter();
        for (view, label, seen) in trials(&rolled) {
            assert!(
                left.any(|known| known.0 == view && known.1 == label && near(known.2, seen)),
                "{modality:?}"
            );
        }
        assert_ne!(upright.orientations, rolled.orientations);
        // The boards are in the middle: of them no picture loses anything. Nor does a scan.
        assert_eq!(rolled.trials(), upright.trials());
        assert!(rolled.places.len() <= upright.places.len());
    }
}

#[test]
fn the_gradient_of_a_step_is_how_its_loss_changes() {
    let folder = tempfile::tempdir().unwrap();
    let (dataset, scenes) = training_boards(folder.path());
    let teacher = folder.path().join("teacher");
    let for_scans = Network::new(&config(Modality::Cloud).model(), Seed(8), &Device::flex());
    save_weights(&teacher, &for_scans, "", Precision::F32).unwrap();
    for modality in [Modality::Cloud, Modality::Rgb] {
        let mut config = config(modality);
        let mut source = Source::new(dataset.clone(), &scenes, Arc::default(), &config, Phase::Joint);
        if modality == Modality::Rgb {
            let named = TeacherConfig::new(teacher.clone());
            source.teacher = Some(Arc::new(Teacher::load(&named, &config, &Device::flex()).unwrap()));
            config.teacher = Some(named);
        }
        let mut batch = source.batch(0).unwrap();
        // Random networks agree that they do not know; here the teacher is sure of itself.
        batch.queries.lesson.logits.iter_mut().for_each(|logit| *logit *= 100.0);
        // As many hands at each place as there are primitives, all on parts that move.
        let Lesson { rows, orientations, logits } = &batch.queries.lesson;
        assert_eq!(rows.is_empty(), modality == Modality::Cloud);
        assert!(orientations.len() == 2 * rows.len() && logits.len() == 4 * rows.len());
        let moves = |row: &usize| batch.queries.ways[*row].is_some_and(|ways| ways != Ways::default());
        let (of_trials, of_places): (Vec<usize>, Vec<usize>) =
            rows.iter().partition(|row| **row < batch.queries.trials());
        assert!(rows.iter().all(moves));
        assert_eq!(of_trials.is_empty() || of_places.is_empty(), modality == Modality::Cloud);
        let network = Network::new(&config.model(), Seed(4), &Device::flex().autodiff());
        let learner = Learner::new(network, &config.loss, Seed(4));
        // The target of the actionability stands still in the gradient, and moves with all but its own head.
        let mut still = config.clone();
        still.loss.actionability = 0.0;
        let name = |part: &str| format!("{modality:?}, {part}");
        match &learner.network.backbone {
            Backbone::UNet(_) => check(&name("U-Net"), &learner, &batch, &still, |l| &l.network.backbone),
            Backbone::PointNet2(_) => {
                check(&name("PointNet++"), &learner, &batch, &still, |l| &l.network.backbone);
                check(&name("second look"), &learner, &batch, &still, |l| &l.network.heads.second_look);
            }
        }
        check(&name("score"), &learner, &batch, &still, |l| &l.network.heads.score);
        check(&name("proposal"), &learner, &batch, &still, |l| &l.network.heads.proposal);
        check(&name("motion"), &learner, &batch, &still, |l| &l.network.heads.motion);
        check(&name("normal"), &learner, &batch, &still, |l| &l.normal);
        check(&name("actionability"), &learner, &batch, &config, |l| &l.network.heads.actionability);
    }
}
