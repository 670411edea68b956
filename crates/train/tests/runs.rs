//! Whole training runs on a tiny data set made up for the purpose.

mod boards;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use burn::tensor::Device;
use where2act_core::shard::Manifest;
use where2act_core::{Primitive, Seed};
use where2act_kernels::Isa;
use where2act_model::{Modality, Network, Precision, Tensors, Weights, save_weights};
use where2act_train::batch::Source;
use where2act_train::checkpoint;
use where2act_train::probes::Learner;
use where2act_train::run::{Control, Outcome, TrainError, files, train};
use where2act_train::step::Phase;
use where2act_train::{
    Arithmetic, BatchConfig, CollectConfig, DataError, Dataset, Decay, LossConfig, NetworkConfig, Optimiser,
    Part, Replay, ScheduleConfig, TeacherConfig, TrainConfig,
};

fn data(folder: &Path, scenes: u64) -> Arc<Dataset> {
    boards::write(folder, 0..scenes);
    Arc::new(Dataset::open(folder, false).unwrap())
}

fn config(score_steps: usize, joint_steps: usize) -> TrainConfig {
    TrainConfig {
        name: "test".to_owned(),
        seed: 3,
        from: None,
        replay: vec![],
        encoder: None,
        teacher: None,
        network: NetworkConfig {
            modality: Modality::Cloud,
            primitives: vec![Primitive::Pushing],
            width: 1.0,
            hidden: 32,
            actionability_hidden: None,
            latent: 4,
            points: 256,
            surroundings: false,
            alignments: 2,
            second_look: true,
            ways: Some(2.0),
            image_side: 224,
            close_up: None,
            candidates: 256,
        },
        batch: BatchConfig {
            views: 4,
            trials_per_view: 32,
            flipped: 0.2,
            places_per_view: 4,
            looks_per_view: 16,
            measured: 0.5,
            ..BatchConfig::default()
        },
        schedule: ScheduleConfig {
            look_steps: 0,
            score_steps,
            joint_steps,
            epoch_steps: 6,
            mean_steps: 0,
            optimiser: Default::default(),
            precision: Default::default(),
            rate: 3e-3,
            trial_rate: None,
            weight_decay: 1e-5,
            decay: Default::default(),
        },
        loss: LossConfig { proposals: 8, best: 2, motion: 1.0, ..LossConfig::default() },
        adaptive: Default::default(),
        collect: CollectConfig::default(),
    }
}

/// Trains until `stop_after` steps are done in this call; returns the losses of the steps.
fn train_for(
    config: &TrainConfig,
    data: &Arc<Dataset>,
    out: &Path,
    stop_after: usize,
) -> Result<(Outcome, Vec<f32>), TrainError> {
    let stop = AtomicBool::new(false);
    let mut losses = Vec::new();
    let mut on_step = |report: &where2act_train::run::StepReport| {
        losses.push(report.loss);
        if losses.len() == stop_after {
            stop.store(true, Ordering::Relaxed);
        }
    };
    let control = Control { stop: &stop, on_step: &mut on_step, on_epoch: &mut |_| Vec::new() };
    let outcome = train(config, Arc::clone(data), out, &Device::flex(), control)?;
    Ok((outcome, losses))
}

#[test]
fn an_interrupted_run_ends_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 32);
    let mut config = config(7, 13);
    // Which leaves some parameters to Adam.
    config.schedule.optimiser = Optimiser::Muon;
    let (whole, pieces) = (folder.path().join("whole"), folder.path().join("pieces"));
    let (outcome, losses) = train_for(&config, &data, &whole, usize::MAX).unwrap();
    assert!(outcome.finished);
    assert_eq!(losses.len(), 20);
    let mut resumed = Vec::new();
    // Inside an epoch, at its end, in both phases, and twice in a row.
    for steps in [3, 3, 1, 6, 2, usize::MAX] {
        let (outcome, losses) = train_for(&config, &data, &pieces, steps).unwrap();
        resumed.extend(losses);
        // The last step of an epoch is done again if what ends the epoch was not.
        resumed.truncate(outcome.progress.step);
        assert_eq!(outcome.finished, resumed.len() == 20);
    }
    assert_eq!(losses, resumed);
    let tensors =
        |run: &Path| Tensors::read(&run.join(files::WEIGHTS).join("model.safetensors")).unwrap().by_name;
    let (a, b) = (tensors(&whole), tensors(&pieces));
    let different: Vec<_> =
        a.iter().filter(|(name, tensor)| b.get(*name) != Some(tensor)).map(|x| x.0).collect();
    assert!(different.is_empty(), "{different:?}");
    assert!(std::fs::metadata(whole.join(files::CURVES)).unwrap().len() > 1000);
}

/// The epoch's last step is the first with trials.
#[test]
fn where_an_interrupted_run_says_it_stands_is_where_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 16);
    let mut config = config(0, 2);
    config.schedule.look_steps = 5;
    let run = folder.path().join("run");
    let (outcome, losses) = train_for(&config, &data, &run, 6).unwrap();
    assert!(!outcome.finished && losses.len() == 6);
    let (_, rest) = train_for(&config, &data, &run, usize::MAX).unwrap();
    assert_eq!(outcome.progress.step, config.steps() - rest.len());
}

#[test]
fn two_programs_do_not_train_in_one_folder() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 12);
    let run = folder.path().join("run");
    train_for(&config(2, 4), &data, &run, 1).unwrap();
    let other = std::fs::File::open(run.join(files::LOCK)).unwrap();
    other.try_lock().unwrap();
    let error = train_for(&config(2, 4), &data, &run, 1).unwrap_err();
    assert!(matches!(error, TrainError::Busy { .. }), "{error}");
    drop(other);
    train_for(&config(2, 4), &data, &run, usize::MAX).unwrap();
}

#[test]
fn what_can_be_learnt_is_learnt() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 40);
    // A rate that falls, because one that does not keeps features and heads moving under each other.
    let mut config = config(60, 60);
    config.schedule.decay = Decay::Cosine;
    let (outcome, losses) = train_for(&config, &data, &folder.path().join("run"), usize::MAX).unwrap();
    let mean = |l: &[f32]| l.iter().sum::<f32>() / l.len() as f32;
    assert!(mean(&losses[50..60]) < 0.6 * mean(&losses[..5]), "{losses:?}");
    // Every board can go one way, away from the camera.
    let metrics = std::fs::read_to_string(folder.path().join("run").join(files::METRICS)).unwrap();
    let lines = metrics.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let motion: Vec<f64> = lines.filter_map(|line| line["motion"].as_f64()).collect();
    assert!(motion.len() == 120 && motion[119] < 0.1 * motion[0], "{motion:?}");
    // A quarter of the trials succeed, which is what chance would get.
    assert!(outcome.progress.best.unwrap() > 0.6, "{:?}", outcome.progress);
    let weights = Weights::load(&outcome.weights.unwrap(), &Device::flex()).unwrap();
    assert_eq!(weights.network.config().primitives, [Primitive::Pushing]);
}

#[test]
fn a_run_may_start_from_weights() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 40);
    let (first, _) = train_for(&config(3, 3), &data, &folder.path().join("first"), usize::MAX).unwrap();
    let weights = first.weights.unwrap();
    // Steps too small to change a weight's last digit.
    let mut further = TrainConfig { from: Some(weights.clone()), ..config(1, 1) };
    further.schedule.rate = 1e-12;
    let (second, _) = train_for(&further, &data, &folder.path().join("second"), usize::MAX).unwrap();
    let tensors = |weights: &Path| Tensors::read(&weights.join("model.safetensors")).unwrap().by_name;
    let (before, after) = (tensors(&weights), tensors(&second.weights.unwrap()));
    // Statistics follow the data, and the last scores' bias their best threshold.
    let own = |name: &str| !name.contains("running_") && name != "heads.second_look.mlp2.bias";
    let same = |name: &str| before.get(name) == after.get(name);
    let different: Vec<_> = before.keys().filter(|name| own(name) && !same(name)).collect();
    assert!(different.is_empty(), "{different:?}");
    // A second look and the ways may be added to what had none, and not the other way round.
    let mut without = config(3, 3);
    without.network.second_look = false;
    (without.network.ways, without.loss.motion) = (None, 0.0);
    let plain = train_for(&without, &data, &folder.path().join("plain"), usize::MAX).unwrap().0.weights;
    let added = TrainConfig { from: plain, ..config(1, 1) };
    let (added, _) = train_for(&added, &data, &folder.path().join("added"), usize::MAX).unwrap();
    let added = Weights::load(&added.weights.unwrap(), &Device::flex()).unwrap().network;
    assert!(added.config().second_look && added.config().ways == Some(2.0));
    let less = TrainConfig { from: Some(weights.clone()), ..without };
    let error = train_for(&less, &data, &folder.path().join("less"), 1).unwrap_err();
    assert!(matches!(error, TrainError::OtherNetwork { .. }), "{error}");
    // An actionability of another size is learnt anew, everything else stays.
    let mut leaner = further.clone();
    leaner.network.actionability_hidden = Some(16);
    let (leaner, _) = train_for(&leaner, &data, &folder.path().join("leaner"), usize::MAX).unwrap();
    let leaner = leaner.weights.unwrap();
    let kept = Weights::load(&leaner, &Device::flex()).unwrap().network;
    assert_eq!(kept.config().actionability_hidden, Some(16));
    let leaner = tensors(&leaner);
    assert_eq!(leaner["heads.actionability.mlp1.weight"].shape[0], 16);
    let other = |name: &str| before.get(name) != leaner.get(name);
    let changed: Vec<_> = before.keys().filter(|name| own(name) && other(name)).collect();
    assert!(changed.iter().all(|name| name.starts_with("heads.actionability.")), "{changed:?}");
    // A wider network begins with what a narrower one knows, and not the other way round.
    let mut wider = further.clone();
    wider.network.width = 1.25;
    let (widened, _) = train_for(&wider, &data, &folder.path().join("wider"), usize::MAX).unwrap();
    let widened = widened.weights.unwrap();
    let name = "backbone.abstraction.0.mlp.layers.2.linear.weight";
    let (narrow, wide) = (&before[name], &tensors(&widened)[name]);
    assert_eq!((&narrow.shape[..], &wide.shape[..]), (&[64, 32][..], &[80, 40][..]));
    assert_eq!(narrow.values[..32], wide.values[..32]);
    let narrower = TrainConfig { from: Some(widened.clone()), ..further.clone() };
    let error = train_for(&narrower, &data, &folder.path().join("narrower"), 1).unwrap_err();
    assert!(
        matches!(&error, TrainError::OtherNetwork { path, field, .. } if *path == widened && field == "width"),
        "{error}"
    );
    let mut other = further;
    other.network.hidden = 48;
    let error = train_for(&other, &data, &folder.path().join("other"), 1).unwrap_err();
    assert!(
        matches!(&error, TrainError::OtherNetwork { path, field, .. } if *path == weights && field == "hidden"),
        "{error}"
    );
}

#[test]
fn a_network_for_pictures_learns_from_one_for_scans() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 16);
    let teacher = |config: &TrainConfig, name: &str| {
        let weights = folder.path().join(name);
        let network = Network::new(&config.model(), Seed(1), &Device::flex());
        save_weights(&weights, &network, "", Precision::F32).unwrap();
        Some(TeacherConfig { weights, places: 24, weight: 1.0 })
    };
    let for_scans = config(0, 30);
    let mut config = for_scans.clone();
    config.teacher = teacher(&for_scans, "teacher");
    config.network.modality = Modality::Rgb;
    config.network.width = 0.125;
    (config.network.second_look, config.batch.measured) = (false, 0.0);
    // Without trials' own losses the lesson is all there is to learn.
    config.loss = LossConfig { score: 0.0, geodesic: 0.0, kl: 0.0, actionability: 0.0, ..config.loss };
    (config.loss.motion, config.network.ways) = (0.0, Some(0.0));
    let (_, losses) = train_for(&config, &data, &folder.path().join("run"), usize::MAX).unwrap();
    let mean = |losses: &[f32]| losses.iter().sum::<f32>() / losses.len() as f32;
    let (first, last) = (mean(&losses[..5]), mean(&losses[25..]));
    assert!(losses.iter().all(|loss| *loss > 0.0) && last < 0.8 * first, "{losses:?}");

    // In pieces it is the same, with the same teacher.
    config.schedule.look_steps = 2;
    config.loss.motion = 1.0;
    config.schedule.joint_steps = 6;
    let (_, whole) = train_for(&config, &data, &folder.path().join("whole"), usize::MAX).unwrap();
    let pieces = folder.path().join("pieces");
    let mut resumed = Vec::new();
    for steps in [2, 3] {
        resumed.extend(train_for(&config, &data, &pieces, steps).unwrap().1);
    }
    let (named, aside) = (folder.path().join("teacher"), folder.path().join("aside"));
    std::fs::rename(&named, &aside).unwrap();
    let stranger = Network::new(&for_scans.model(), Seed(2), &Device::flex());
    save_weights(&named, &stranger, "", Precision::F32).unwrap();
    let error = train_for(&config, &data, &pieces, usize::MAX).unwrap_err();
    assert!(error.to_string().contains("a teacher with other weights"), "{error}");
    std::fs::remove_dir_all(&named).unwrap();
    std::fs::rename(&aside, &named).unwrap();
    resumed.extend(train_for(&config, &data, &pieces, usize::MAX).unwrap().1);
    assert_eq!(whole, resumed);

    // A teacher for other primitives, and a network for scans that has one.
    let mut other = config.clone();
    other.network.primitives = vec![Primitive::Pulling];
    other.network.modality = Modality::Cloud;
    config.teacher = teacher(&other, "other-teacher");
    let error = train_for(&config, &data, &folder.path().join("other"), 1).unwrap_err();
    assert!(
        matches!(&error, TrainError::OtherTeacher { path, .. } if path.ends_with("other-teacher")),
        "{error}"
    );
    config.network.modality = Modality::Cloud;
    let error = train_for(&config, &data, &folder.path().join("scans"), 1).unwrap_err();
    assert!(error.to_string().contains("teacher.weights"), "{error}");
}

#[test]
fn a_network_for_pictures_may_see_more_pixels_than_the_one_it_begins_as() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let small = data(&path("data"), 16);
    boards::write_with_large_pictures(&path("large"), 0..16);
    let large = Arc::new(Dataset::open(&path("large"), false).unwrap());
    let mut config = config(0, 2);
    config.network.modality = Modality::Rgb;
    config.network.width = 0.125;
    (config.network.second_look, config.batch.measured, config.batch.rolled) = (false, 0.0, 0.5);
    train_for(&config, &small, &path("first"), usize::MAX).unwrap();

    config.from = Some(path("first").join(files::LAST));
    config.network.image_side = 288;
    let error = train_for(&config, &small, &path("refused"), 1).unwrap_err();
    assert!(error.to_string().contains("pictures of 224 pixels a side"), "{error}");
    let (outcome, _) = train_for(&config, &large, &path("second"), usize::MAX).unwrap();
    assert!(outcome.finished);
    let network = Weights::load(&path("second").join(files::LAST), &Device::flex()).unwrap().network;
    assert_eq!(network.config().preprocessing.image_side, 288);
}

/// The first loss is that of the forward pass alone, those after it of gradients too.
#[test]
fn steps_in_bf16_come_near_those_in_f32() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 16);
    let mut config = config(0, 6);
    config.network.modality = Modality::Rgb;
    config.network.width = 0.125;
    (config.network.second_look, config.batch.measured) = (false, 0.0);
    let (_, exact) = train_for(&config, &data, &folder.path().join("f32"), usize::MAX).unwrap();
    config.schedule.precision = Arithmetic::Bf16;
    let run = folder.path().join("bf16");
    if Isa::bf16().is_some() {
        let (_, losses) = train_for(&config, &data, &run, usize::MAX).unwrap();
        // Adam's first steps go by the signs of gradients, of which some are nearly zero.
        let differ: Vec<f32> = exact.iter().zip(&losses).map(|(a, b)| (a - b).abs() / a).collect();
        assert!(differ[0] < 0.01 && differ.iter().all(|d| (1e-6..0.25).contains(d)), "{exact:?}, {losses:?}");
        let other = ScheduleConfig { precision: Arithmetic::F32, ..config.schedule.clone() };
        let other = TrainConfig { schedule: other, ..config.clone() };
        let error = train_for(&other, &data, &run, 1).unwrap_err();
        assert!(error.to_string().contains("another configuration"), "{error}");
    } else {
        let error = train_for(&config, &data, &run, 1).unwrap_err();
        assert!(error.to_string().contains("schedule.precision: expected f32, found bf16"), "{error}");
    }
    config.network.modality = Modality::Cloud;
    let error = train_for(&config, &data, &folder.path().join("scans"), 1).unwrap_err();
    assert!(error.to_string().contains("schedule.precision is bf16"), "{error}");
}

#[test]
fn an_encoder_may_start_as_a_resnet18() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let data = data(&path("data"), 32);
    let mut config = config(0, 1);
    config.network.modality = Modality::Rgb;
    config.batch.views = 2;
    // A step too small to change a weight's last digit.
    config.schedule.rate = 1e-12;
    // Torchvision's names, another seed's numbers, and no more digits than the run's weights are saved with.
    let mut resnet = Tensors::default();
    for (name, tensor) in Network::new(&config.model(), Seed(9), &Device::flex()).tensors().by_name {
        if let Some(name) = name.strip_prefix("backbone.encoder.") {
            resnet.by_name.insert(name.to_owned(), tensor);
        }
    }
    let file = path("resnet18.safetensors");
    resnet.write(&file, Precision::F16).unwrap();
    config.encoder = Some(file.clone());
    let (outcome, _) = train_for(&config, &data, &path("run"), usize::MAX).unwrap();
    let read = |path: &Path| Tensors::read(path).unwrap().by_name;
    let (before, after) = (read(&file), read(&outcome.weights.unwrap().join("model.safetensors")));
    // Statistics follow the data.
    let own = |name: &str| !name.contains("running_");
    let same = |name: &str| before.get(name) == after.get(&format!("backbone.encoder.{name}"));
    let different: Vec<_> = before.keys().filter(|name| own(name) && !same(name)).collect();
    assert!(different.is_empty(), "{different:?}");
    let saved = TrainConfig::load(&path("run").join(files::CONFIG)).unwrap();
    assert_eq!(saved, config, "a file says what it was");

    // An eighth as wide, in PyTorch's own format.
    let narrow = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/unet/resnet18.pth");
    config.encoder = Some(narrow);
    let error = train_for(&config, &data, &path("narrow"), 1).unwrap_err().to_string();
    assert!(error.contains("resnet18.pth"), "{error}");
    assert!(error.contains("conv1.weight has shape [8, 3, 7, 7], expected [64, 3, 7, 7]"), "{error}");
}

#[test]
fn a_backbone_may_look_before_there_are_any_trials() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data");
    boards::write_without_trials(&path, 0..40);
    let data = Arc::new(Dataset::open(&path, false).unwrap());
    let mut looks = config(0, 0);
    looks.schedule.look_steps = 30;
    looks.batch.looks_per_view = 32;
    let (outcome, losses) = train_for(&looks, &data, &folder.path().join("looks"), usize::MAX).unwrap();
    assert!(losses[29] < 0.5 * losses[0], "{losses:?}");
    let metrics = std::fs::read_to_string(folder.path().join("looks").join(files::METRICS)).unwrap();
    let lines = metrics.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let ways: Vec<f64> = lines.filter_map(|line| line["ways"].as_f64()).collect();
    assert!(ways.len() == 5 && ways[4] < ways[0], "{ways:?}");
    // What it learnt is where training with trials goes on from.
    let further = TrainConfig { from: outcome.weights, ..config(1, 1) };
    let error = train_for(&further, &data, &folder.path().join("none"), 1).unwrap_err();
    assert!(matches!(error, TrainError::Data(DataError::NoSuccess { .. })), "{error}");
    let trials = self::data(&folder.path().join("trials"), 32);
    assert!(train_for(&further, &trials, &folder.path().join("further"), usize::MAX).unwrap().0.finished);
}

#[test]
fn one_run_looks_at_all_scenes_and_then_learns_from_those_with_trials() {
    let folder = tempfile::tempdir().unwrap();
    let [with, without] = ["with", "without"].map(|name| folder.path().join(name));
    boards::write(&with, 0..32);
    boards::write_without_trials(&without, 0..40);
    let data = Arc::new(Dataset::open_all(&[&with, &without], false).unwrap());
    let all = data.scenes(Part::Train).unwrap();
    let tried = data.tried_scenes(Part::Train, &Primitive::ALL).unwrap();
    assert!(tried.iter().all(|id| data.folder_of(id.shard) == 0));
    let others = data.tried_scenes(Part::Train, &[Primitive::Pulling]);
    assert!(matches!(others, Err(DataError::EmptyPart { .. })), "boards are only pushed");
    let untried = *all.iter().find(|id| data.folder_of(id.shard) == 1).unwrap();
    assert_eq!(tried, Dataset::open(&with, false).unwrap().scenes(Part::Train).unwrap());

    let mut config = config(2, 8);
    config.schedule = ScheduleConfig { look_steps: 8, decay: Decay::Cosine, ..config.schedule };
    let scenes_of = |phase, replay: &Replay| {
        Source::new(data.clone(), &all, Arc::new(replay.clone()), &config, phase).scenes.to_vec()
    };
    let mut replay = Replay::new(100);
    assert_eq!(scenes_of(Phase::Look, &replay), all);
    assert_eq!(scenes_of(Phase::Score, &replay), tried);
    replay.add(untried, data.shards()[0].trials(0).unwrap());
    let newly: Vec<_> = tried.iter().chain([&untried]).copied().collect();
    assert_eq!(scenes_of(Phase::Joint, &replay), newly);

    // The rate falls twice, and looking ends inside an epoch.
    let full = config.schedule.rate;
    assert!(
        config.rate(7) < 0.1 * full && (config.rate(8) - full).abs() < 1e-9 && config.rate(17) < 0.1 * full
    );
    let (outcome, losses) = train_for(&config, &data, &folder.path().join("run"), usize::MAX).unwrap();
    assert!(outcome.finished && losses.len() == 18);
    let metrics = std::fs::read_to_string(folder.path().join("run").join(files::METRICS)).unwrap();
    let lines = metrics.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let scores: Vec<bool> =
        lines.filter(|line| line.get("loss").is_some()).map(|line| !line["score"].is_null()).collect();
    assert_eq!(scores, (0..18).map(|step| step >= 8).collect::<Vec<_>>());
    // In pieces it ends the same.
    let pieces: Vec<f32> = [5, 3, 2, usize::MAX]
        .iter()
        .flat_map(|&steps| train_for(&config, &data, &folder.path().join("pieces"), steps).unwrap().1)
        .collect();
    assert_eq!(losses, pieces);
}

#[test]
fn resuming_with_another_configuration_or_data_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let data_path = folder.path().join("data");
    let data = data(&data_path, 32);
    let out = folder.path().join("run");
    train_for(&config(2, 2), &data, &out, 1).unwrap();
    let error = train_for(&config(2, 4), &data, &out, 1).unwrap_err();
    assert!(error.to_string().contains("another configuration"), "{error}");
    // The run itself is untouched and goes on.
    assert!(train_for(&config(2, 2), &data, &out, usize::MAX).unwrap().0.finished);
}

#[test]
fn bad_data_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("data");
    data(&path, 16);
    let shard = Manifest::shard_path(&path, 1);
    let bytes = std::fs::read(&shard).unwrap();
    std::fs::write(&shard, &bytes[..bytes.len() / 2]).unwrap();
    let error = Dataset::open(&path, false).unwrap_err();
    assert!(error.to_string().contains("shard-00001"), "{error}");
    let rest = Dataset::open(&path, true).unwrap();
    assert_eq!((rest.shards().len(), rest.skipped.len()), (1, 1));

    let mut other = config(2, 2);
    other.network.primitives = vec![Primitive::Pulling];
    let whole = data(&folder.path().join("whole"), 32);
    let error = train_for(&other, &whole, &folder.path().join("run"), 1).unwrap_err();
    assert!(
        matches!(error, TrainError::Data(DataError::NoSuccess { primitive: Primitive::Pulling, .. })),
        "{error}"
    );

    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    assert!(Dataset::open(&empty, false).unwrap_err().to_string().contains("manifest.json"));
}

#[test]
fn a_run_that_leaves_the_road_names_what_to_go_on_from() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 8);
    let mut wild = config(0, 40);
    wild.schedule.rate = 0.99;
    let diverged = |out: &Path| match train_for(&wild, &data, out, usize::MAX) {
        Err(TrainError::Diverged { last_good, .. }) => last_good,
        other => panic!("{other:?}"),
    };
    assert_eq!(diverged(&folder.path().join("at-once")), None);
    let out = folder.path().join("after-a-step");
    train_for(&wild, &data, &out, 1).unwrap();
    let last_good = diverged(&out).unwrap();
    assert!(last_good.join("learner.bpk").exists() && last_good.ends_with("step-00000001"), "{last_good:?}");
    // What is no number is not saved either.
    let network = Network::new(&wild.model(), Seed(1), &Device::flex());
    let learner = |network| Learner::new(network, &wild.loss, Seed(1));
    assert!(checkpoint::is_finite(&learner(network.clone())));
    assert!(!checkpoint::is_finite(&learner(network.shift_scores(&[f32::NAN]))));
}

#[test]
fn a_run_may_begin_with_the_trials_of_others() {
    let folder = tempfile::tempdir().unwrap();
    let data = data(&folder.path().join("data"), 8);
    let scene = data.scenes(Part::Train).unwrap()[0];
    let trials = data.shards()[scene.shard].trials(scene.scene).unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let control = Control {
        stop: &AtomicBool::new(false),
        on_step: &mut |_| (),
        on_epoch: &mut |_| vec![(scene, trials[..5].to_vec())],
    };
    train(&config(0, 6), Arc::clone(&data), &first, &Device::flex(), control).unwrap();
    let after = |runs: &[&PathBuf]| TrainConfig {
        replay: runs.iter().map(|&run| run.clone()).collect(),
        ..config(0, 1)
    };
    let held = |run: &Path| {
        let newest = checkpoint::list(&run.join(files::CHECKPOINTS)).unwrap().pop().unwrap();
        checkpoint::without_weights(&newest).unwrap().0.trials(scene).collect::<Vec<_>>()
    };
    train_for(&after(&[&first]), &data, &second, usize::MAX).unwrap();
    assert_eq!(held(&second), trials[..5]);
    // The second holds the first's: none twice. A run of pictures may have gone before.
    let mut of_pictures = after(&[&first, &second]);
    of_pictures.network.modality = Modality::Rgb;
    (of_pictures.network.second_look, of_pictures.network.width) = (false, 0.1);
    let pictures = folder.path().join("pictures");
    train_for(&of_pictures, &data, &pictures, usize::MAX).unwrap();
    assert_eq!(held(&pictures), trials[..5]);
    let third = folder.path().join("after pictures");
    train_for(&after(&[&pictures]), &data, &third, usize::MAX).unwrap();
    assert_eq!(held(&third), trials[..5]);
    // Folders may come after those of the first run, but not before.
    let [old, new] = ["data", "other"].map(|name| folder.path().join(name));
    let other = self::data(&new, 16);
    let more = Arc::new(Dataset::open_all(&[&old, &new], false).unwrap());
    let fourth = folder.path().join("fourth");
    train_for(&after(&[&first]), &more, &fourth, usize::MAX).unwrap();
    assert_eq!(held(&fourth), trials[..5]);
    for wrong in [other, Arc::new(Dataset::open_all(&[&new, &old], false).unwrap())] {
        let error = train_for(&after(&[&first]), &wrong, &folder.path().join("fifth"), 1).unwrap_err();
        assert!(matches!(&error, TrainError::OtherData { path } if *path == first), "{error}");
    }
}
