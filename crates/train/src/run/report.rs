//! What a run tells about itself while it goes on, and what its weights' card says.

use std::path::PathBuf;

use burn::tensor::Tensor;
use serde::Serialize;
use where2act_model::{Network, Summary};

use crate::checkpoint::Progress;
use crate::config::TrainConfig;
use crate::step::Losses;
use crate::validate::Validation;

/// How a step went.
#[derive(Clone, Debug, Serialize)]
pub struct StepReport {
    /// Steps done.
    pub step: usize,
    /// Steps in all.
    pub steps: usize,
    /// Weighted sum of the losses.
    pub loss: f32,
    /// Cross-entropy of the score.
    pub score: Option<f32>,
    /// Cross-entropy of the score at second look.
    pub second: Option<f32>,
    /// Angle of the reconstruction, radians.
    pub geodesic: Option<f32>,
    /// Divergence of the code.
    pub kl: Option<f32>,
    /// Squared error of the actionability.
    pub actionability: Option<f32>,
    /// Difference of the ways that points can go.
    pub motion: Option<f32>,
    /// Squared error of the normals.
    pub normal: Option<f32>,
    /// Divergence of the score from what the teacher says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taught: Option<f32>,
    /// Learning rate.
    pub rate: f64,
    /// Seconds by stage.
    pub secs: StageSecs,
}

/// Seconds of one step by stage.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct StageSecs {
    /// Waiting for the batch.
    pub reading: f64,
    /// Forward pass and losses.
    pub forward: f64,
    /// Gradients.
    pub backward: f64,
    /// The optimiser's step.
    pub optimiser: f64,
}

/// How an epoch ended.
#[derive(Debug)]
pub struct EpochReport<'a> {
    /// Steps done.
    pub step: usize,
    /// Whether all heads learn already.
    pub joint: bool,
    /// Number of this epoch, counted from 0.
    pub epoch: usize,
    /// Metrics on validation scenes; empty in the look phase.
    pub validation: &'a Validation,
    /// How much the ways that places of validation scenes can go differ from those the network tells, if it learns them.
    pub ways: Option<f32>,
    /// Whether these are the best weights so far.
    pub is_best: bool,
    /// The network as it stands, without gradients.
    pub network: &'a Network,
}

/// What a finished or interrupted run leaves.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Whether all steps were done.
    pub finished: bool,
    /// Folder of the newest weights, [`files::LAST`](super::files::LAST), if an epoch has ended that makes some.
    pub weights: Option<PathBuf>,
    /// Where the run stands.
    pub progress: Progress,
}

pub(super) fn number(loss: &Tensor<1>) -> f32 {
    loss.clone().into_data().convert::<f32>().as_slice::<f32>().map_or(f32::NAN, |s| s[0])
}

pub(super) fn report(
    config: &TrainConfig,
    step: usize,
    loss: f32,
    losses: &Losses,
    rate: f64,
    secs: StageSecs,
) -> StepReport {
    let read = |loss: &Option<Tensor<1>>| loss.as_ref().map(number);
    StepReport {
        step,
        steps: config.steps(),
        loss,
        score: read(&losses.score),
        second: read(&losses.second),
        geodesic: read(&losses.geodesic),
        kl: read(&losses.kl),
        actionability: read(&losses.actionability),
        motion: read(&losses.motion),
        normal: read(&losses.normal),
        taught: read(&losses.taught),
        rate,
        secs,
    }
}

pub(super) fn card(config: &TrainConfig, progress: &Progress, validation: &Validation) -> String {
    let mut text = format!(
        "# {}\n\nTrained for {} steps ({:.2} hours), seed {}, data and configuration {}.\n\n",
        config.name,
        progress.step,
        progress.secs / 3600.0,
        config.seed,
        &progress.fingerprint[..16]
    );
    text += &format!("Network: {} for each picture or scan.\n\n", Summary::new(&config.model()).total());
    text += "Validation (objects of the training categories that training has not seen, all policies):\n\n";
    text += "| primitive | trials | successes | average precision | F-score | best F-score |\n";
    text += "| --- | --- | --- | --- | --- | --- |\n";
    for (primitive, m) in config.network.primitives.iter().zip(&validation.all) {
        text += &format!(
            "| {primitive} | {} | {} | {:.3} | {:.3} | {:.3} |\n",
            m.trials, m.successes, m.average_precision, m.f_score, m.best_f_score
        );
    }
    text
}
