//! What a run starts from: weights, trials, an optimiser that remembers nothing yet.

use std::fs;

use burn::module::ParamGroup;
use burn::optim::decay::WeightDecayConfig;
use burn::optim::{AdamConfig, ModuleOptimizer};
use burn::tensor::Device;
use rayon::prelude::*;
use where2act_core::sha256_hex;
use where2act_core::shard::Shard;
use where2act_model::preprocess::{CloudInput, CloudScale};
use where2act_model::{Modality, ModelConfig, Network, Weights};

use crate::checkpoint;
use crate::config::{Optimiser, TrainConfig};
use crate::dataset::{DataError, Dataset, Folder, SceneId, spread};
use crate::muon::KernelMuon;
use crate::probes::Learner;
use crate::replay::Replay;
use crate::run::{TrainError, files, io};

/// The sizes of scans are those of so many train scenes.
const RADIUS_SCENES: usize = 400;

/// The optimiser that the configuration names.
pub(crate) fn optimiser(config: &TrainConfig) -> ModuleOptimizer {
    let decay = WeightDecayConfig::new(config.schedule.weight_decay);
    let adam = AdamConfig::new().with_weight_decay(Some(decay)).init();
    match config.schedule.optimiser {
        Optimiser::Adam => adam,
        Optimiser::Muon => {
            let weights = ParamGroup::from_predicates(vec!["backbone", ".weight"]);
            adam.with_group(weights, KernelMuon::new(config.schedule.weight_decay), None)
        }
    }
}

/// Weights that depend on the run's seed alone.
pub(crate) fn random_weights(config: &TrainConfig, model: &ModelConfig, device: &Device) -> Learner {
    let seed = config.root_seed().child("weights", 0);
    Learner::new(Network::new(model, seed, device), &config.loss, seed)
}

/// The weights to start from: those that the configuration names, or random ones, with the encoder that it names. `model` is
/// the configuration's network.
///
/// # Errors
/// [`TrainError::Weights`] if they cannot be read or do not fit, [`TrainError::OtherNetwork`] if they are of a network that
/// this one cannot begin as.
pub fn first_weights(
    config: &TrainConfig,
    model: &ModelConfig,
    device: &Device,
) -> Result<Learner, TrainError> {
    let mut learner = random_weights(config, model, device);
    let Some(folder) = &config.from else {
        if let Some(file) = &config.encoder {
            learner.network = learner.network.with_resnet18(file)?;
        }
        return Ok(learner);
    };
    let network = Weights::load(folder, device)?.network;
    // What does not change the shape of any parameter may differ, a second look and the ways may be added, the backbone may
    // be wider, and the actionability may be of another size: then it is learnt anew.
    let found = network.config().clone();
    let comparable = ModelConfig {
        name: model.name.clone(),
        points: model.points,
        width: found.width.max(model.width),
        preprocessing: model.preprocessing.clone(),
        actionability_hidden: model.actionability_hidden,
        second_look: found.second_look || model.second_look,
        ways: model.ways.or(found.ways),
        ..found
    };
    if let Some([field, found, expected]) = difference(&comparable, model) {
        return Err(TrainError::OtherNetwork { path: folder.clone(), field, found, expected });
    }
    if network.config().hidden_of_actionability() != model.hidden_of_actionability() {
        tracing::info!("{}: the actionability has another size and starts at random", folder.display());
    }
    if network.config().width != model.width {
        tracing::info!(
            "{}: of width {}, widened to {}",
            folder.display(),
            network.config().width,
            model.width
        );
    }
    let close = network.config().preprocessing.close_up;
    if let Some(close) = close.filter(|_| model.preprocessing.close_up.is_none()) {
        tracing::warn!(
            "{}: looks at the square around a mask (network.close_up = {close}), this network at whole pictures",
            folder.display()
        );
    }
    learner.network = learner.network.with_tensors_of(&network)?;
    Ok(learner)
}

/// The first field in which two descriptions differ, and what it is in each.
pub(crate) fn difference(found: &ModelConfig, expected: &ModelConfig) -> Option<[String; 3]> {
    let [found, expected] = [found, expected].map(|config| serde_json::to_value(config).unwrap_or_default());
    // What they read comes first: most else depends on it.
    let all =
        [&found, &expected].into_iter().filter_map(|value| value.as_object()).flat_map(|all| all.keys());
    let fields = std::iter::once("modality").chain(all.map(String::as_str));
    let show = |value: &serde_json::Value| match value {
        serde_json::Value::Null => "nothing".to_owned(),
        value => value.to_string(),
    };
    fields
        .filter(|field| found[*field] != expected[*field])
        .map(|field| [field.to_owned(), show(&found[field]), show(&expected[field])])
        .next()
}

/// The newer trials to begin with: those of the runs that the configuration names.
pub(crate) fn first_trials(config: &TrainConfig, dataset: &Dataset) -> Result<Replay, TrainError> {
    let mut trials = Replay::new(config.adaptive.buffer);
    let contents = if config.replay.is_empty() { Vec::new() } else { contents(dataset)? };
    for run in &config.replay {
        let (path, checkpoints) = (run.join(files::CONFIG), run.join(files::CHECKPOINTS));
        let text = fs::read_to_string(&path).map_err(|e| io(&path, e))?;
        let newest = checkpoint::list(&checkpoints).map_err(|e| io(&checkpoints, e))?.pop();
        let newest = newest.ok_or_else(|| io(&checkpoints, std::io::ErrorKind::NotFound.into()))?;
        let (theirs, progress) = checkpoint::without_weights(&newest)?;
        // Scenes keep their numbers when folders come after theirs.
        let mut begins = (1..=contents.len()).map(|n| contents[..n].concat());
        if !begins.any(|data| progress.fingerprint == checkpoint::fingerprint(&text, &data)) {
            return Err(TrainError::OtherData { path: run.clone() });
        }
        let (before, held) = (trials.len(), theirs.len());
        trials.extend(theirs);
        tracing::info!(
            "{}: {held} newer trials, {before} others before them, {} held",
            run.display(),
            trials.len()
        );
    }
    Ok(trials)
}

/// What tells one data set from another: a text for each of its folders. The same recipe makes other scenes and trials with
/// another version of the generators, so that what the scenes are and what the trials found counts too.
pub(crate) fn contents(dataset: &Dataset) -> Result<Vec<String>, TrainError> {
    let of_shard = |shard: &Shard| {
        let mut bytes = serde_json::to_vec(shard.scenes()).map_err(|e| io(shard.path(), e.into()))?;
        for scene in 0..shard.scenes().len() {
            let trials = shard.trials(scene).map_err(DataError::from)?;
            ciborium::into_writer(&trials, &mut bytes)
                .map_err(|e| io(shard.path(), std::io::Error::other(e.to_string())))?;
        }
        Ok(sha256_hex(&bytes))
    };
    let text = |Folder { path, manifest, shards }: &Folder| {
        let shards: Result<Vec<String>, TrainError> =
            dataset.shards()[shards.clone()].par_iter().map(of_shard).collect();
        serde_json::to_string(&(manifest, shards?)).map_err(|e| io(path, e.into()))
    };
    dataset.folders().iter().map(text).collect()
}

/// The network's description with the sizes of clouds that training will see.
pub(crate) fn with_scan_radius(
    config: &TrainConfig,
    dataset: &Dataset,
    scenes: &[SceneId],
) -> Result<ModelConfig, TrainError> {
    let mut model = config.model();
    if model.modality == Modality::Rgb {
        return Ok(model);
    }
    // The radius is that of the candidates.
    let one_point = model.clone().with_points(1);
    let mut radii = Vec::new();
    for (i, id) in spread(scenes, RADIUS_SCENES).enumerate() {
        let shard = &dataset.shards()[id.shard];
        let points: Vec<_> = shard.foreground(id.scene).into_iter().map(|(_, point)| point).collect();
        let mut rng = config.root_seed().child("radius", i as u64).rng();
        let cloud = CloudInput::new(&points, CloudScale::PerMetre(1.0), &one_point, &mut rng)
            .map_err(|source| DataError::View { path: shard.path().to_owned(), scene: id.scene, source })?;
        radii.push(cloud.robust_radius());
    }
    radii.sort_by(f32::total_cmp);
    if let (Some(smallest), Some(largest)) = (radii.first(), radii.last()) {
        model.preprocessing.scan_radius = [*smallest, *largest];
    }
    Ok(model)
}
