//! `predict`: pictures, depth maps and scans in; actions out.

mod args;
mod inputs;
mod results;

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use where2act_core::program::{self, Progress};
use where2act_core::{Observation, one_line};
use where2act_infer::{Predictor, find_weights};
use where2act_model::Modality;

use args::Args;
use inputs::Input;

/// Scaled down by more than this an object would be some 100 m wide, if its numbers were metres.
const HUGE: f32 = 0.02;

fn main() -> ExitCode {
    program::run("predict", "warn", |args: Args| run(&args))
}

fn run(args: &Args) -> Result<()> {
    args.check()?;
    program::limit_threads(args.jobs)?;
    let inputs = inputs::list(args)?;
    let folders = args.out_folders(&inputs);
    let options = args.options();
    let mut predictors: BTreeMap<bool, Predictor> = BTreeMap::new();
    let template = "{bar:30} {pos}/{len} {msg} {eta}";
    let progress = Progress::new(args.quiet || inputs.len() < 2, inputs.len() as u64, template);
    // One bad file among many costs no other its prediction.
    let mut failed = 0;
    let mut pictures_alone = true;
    let mut fail = |error: anyhow::Error| {
        if inputs.len() == 1 {
            return Err(error);
        }
        failed += 1;
        progress.inc(1);
        progress.suspend(|| eprintln!("predict: {}", one_line(error.as_ref())));
        Ok(())
    };
    for (input, folder) in inputs.iter().zip(&folders) {
        progress.set_message(input.path.display().to_string());
        let observation = match input.read(args) {
            Ok(observation) => observation,
            Err(error) => {
                fail(error)?;
                continue;
            }
        };
        let scan = input.modality() == Modality::Cloud;
        let predictor = match predictors.entry(scan) {
            Entry::Occupied(found) => Ok(found.into_mut()),
            Entry::Vacant(empty) => load(args, input).map(|loaded| empty.insert(loaded)),
        };
        let predicted = predictor.and_then(|predictor| Ok(predictor.predict_dense(&observation, &options)?));
        let mut output = match predicted.with_context(|| input.path.display().to_string()) {
            Ok(output) => output,
            Err(error) => {
                fail(error)?;
                continue;
            }
        };
        output.prediction.input.source = input.path.display().to_string();
        let huge =
            output.prediction.input.network_from_metres < HUGE && options.network_from_metres.is_none();
        let huge = huge.then(|| {
            "expected metres, found an object larger than a house: are these millimetres?".to_owned()
        });
        pictures_alone &=
            matches!(&observation, Observation::Image { rgb: Some(_), depth: None, mask: None, .. });
        for doubt in inputs::doubts(&observation).into_iter().chain(huge) {
            tracing::warn!("{}: {doubt}", input.path.display());
        }
        if let Some(folder) = folder
            && let Err(error) = results::write(folder, &observation, &mut output, args.no_pictures)
        {
            fail(error)?;
            continue;
        }
        progress.suspend(|| report(args, input, &output.prediction, folder.as_deref()))?;
        progress.inc(1);
    }
    progress.finish_and_clear();
    if args.has_camera() && pictures_alone {
        tracing::warn!(
            "expected --mask, --box or --depth with --intrinsics or --fov, which say little of a picture alone, found none (a \
             depth map is a 16-bit grey png or an npy)"
        );
    }
    if failed > 0 {
        bail!("{failed} of {} inputs failed", inputs.len());
    }
    Ok(())
}

fn load(args: &Args, input: &Input) -> Result<Predictor> {
    #[cfg(feature = "bundled-weights")]
    if args.weights.is_none() {
        return Ok(Predictor::bundled(input.modality(), args.backend())?);
    }
    let folder = find_weights(args.weights.as_deref(), input.modality())?;
    tracing::info!(folder = %folder.display(), "loading weights");
    Ok(Predictor::load_with(&folder, args.backend())?)
}

fn report(
    args: &Args,
    input: &Input,
    prediction: &where2act_core::Prediction,
    folder: Option<&Path>,
) -> Result<()> {
    let mut out = std::io::stdout().lock();
    let written = if args.json {
        serde_json::to_string(prediction).context("prediction").map(|json| writeln!(out, "{json}"))?
    } else if args.quiet {
        Ok(())
    } else {
        results::table(&mut out, &input.path, prediction, folder)
    };
    match written {
        // `predict ... | head` has seen enough.
        Err(e) if e.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other.context("stdout"),
    }
}
