//! `train` as it is killed and resumed, with other numbers of threads: the weights at the end are those of a run that nobody
//! disturbed, bit for bit. The scenes are simulated and new trials are added online, so that everything a checkpoint keeps is
//! in play.
#![cfg(unix)]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use burn::module::Module;
use burn::optim::AdamConfig;
use burn::tensor::Device;
use rand::RngExt;
use where2act_core::{Category, Primitive, Seed};
use where2act_model::{Network, StoredTensor, Weights};
use where2act_sim::collect::{Collector, ObjectSet, Plan, Recipe};
use where2act_train::checkpoint::{self, Progress, State};
use where2act_train::probes::Learner;
use where2act_train::{LossConfig, Part, Replay};

const CONFIG: &str = "name = 'interrupted'
seed = 5
[network]
modality = 'cloud'
primitives = ['pushing', 'pulling']
hidden = 16
latent = 4
points = 256
candidates = 256
alignments = 2
ways = 2.0
[batch]
views = 2
trials_per_view = 16
[schedule]
score_steps = 8
joint_steps = 22
epoch_steps = 5
mean_steps = 4
[loss]
proposals = 8
motion = 1.0
normal = 1.0
[adaptive]
enabled = true
scenes = 1
trials = 2
";
const STEPS: usize = 30;

/// Guided trials on generated switches, of which one is for validation.
fn collect(folder: &Path) {
    let category = Category::Switch;
    let kept = (2..1000).find(|seed| Part::of(&format!("Switch:{seed}"), Some(category)) == Part::Validation);
    let kept = kept.unwrap();
    let recipe = Recipe {
        seed: Seed(1),
        objects: ObjectSet::Procedural { categories: vec![category], seeds: kept - 2..kept + 1 },
        primitives: vec![Primitive::Pushing, Primitive::Pulling],
        trials: 12,
        guided: 1.0,
        ..Recipe::default()
    };
    let plan = Plan { scenes_per_shard: 4, ..Plan::new(8) };
    Collector::new(folder, recipe, plan).unwrap().run(&AtomicBool::new(false), &|_, _| {}).unwrap();
}

fn start(folder: &Path, out: &str, resume: bool, jobs: usize) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_train"));
    command.args(["--config", "run.toml", "--data", "data", "--out", out, "--episodes", "0", "--quiet"]);
    command.args(["--jobs", &jobs.to_string()]);
    if resume {
        command.arg("--resume");
    }
    let piped = command.current_dir(folder).env_remove("RUST_LOG").stdout(Stdio::piped());
    piped.stderr(Stdio::piped()).spawn().unwrap()
}

fn finish(child: Child) -> Output {
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

/// Lines of the metrics: what can differ between runs, the seconds, is taken out.
fn metrics(run: &Path) -> Vec<serde_json::Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).unwrap_or_default();
    // A line may be half written.
    let lines = text.lines().filter_map(|line| serde_json::from_str(line).ok());
    lines
        .map(|mut line: serde_json::Value| {
            line.as_object_mut().unwrap().remove("secs");
            line
        })
        .collect()
}

fn steps(run: &Path) -> usize {
    let of = |line: &serde_json::Value| line["step"].as_u64().unwrap() as usize;
    metrics(run).iter().map(of).max().unwrap_or(0)
}

fn newest_checkpoint(run: &Path) -> PathBuf {
    let entries = fs::read_dir(run.join("checkpoints")).unwrap();
    entries.map(|e| e.unwrap().path()).max().unwrap()
}

/// What the network is after the last step, and the mean of the last steps. Not the files' bytes: burn numbers parameters at
/// random in every run.
fn last_tensors(run: &Path) -> [BTreeMap<String, StoredTensor>; 2] {
    let device = Device::flex();
    let config = Weights::load(&run.join("weights"), &device).unwrap().network.config().clone();
    let network = Network::new(&config, Seed(0), &device.autodiff());
    let loss = LossConfig { motion: 1.0, normal: 1.0, ..LossConfig::default() };
    let learner = Learner::new(network, &loss, Seed(0));
    let fresh = State {
        mean: Some(learner.valid()),
        learner,
        optimiser: AdamConfig::new().init(),
        replay: Replay::new(10),
        progress: Progress::default(),
    };
    let state = checkpoint::load(&newest_checkpoint(run), fresh).unwrap();
    [state.learner, state.mean.unwrap()].map(|learner| learner.network.tensors().by_name)
}

#[test]
fn killed_five_times_it_ends_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("run.toml"), CONFIG).unwrap();
    let began = Instant::now();
    collect(&folder.join("data"));
    println!("collected after {:?}", began.elapsed());
    finish(start(folder, "whole", false, 2));
    println!("undisturbed run after {:?}", began.elapsed());

    let run = folder.join("pieces");
    let mut rng = Seed(8).child("moments", 0).rng();
    let mut seen = 0;
    for (piece, signal) in ["KILL", "TERM", "KILL", "TERM", "KILL"].into_iter().enumerate() {
        let child = start(folder, "pieces", piece > 0, 1 + piece % 3);
        // Somewhere in the steps after those that were seen before, or in what follows an epoch.
        let until = seen + rng.random_range(2..=5);
        let a_bit = Duration::from_micros(rng.random_range(0..60_000));
        let deadline = Instant::now() + Duration::from_secs(120);
        while steps(&run) < until {
            assert!(Instant::now() < deadline, "step {until} of piece {piece} is never reached");
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(a_bit);
        Command::new("kill").args([&format!("-{signal}"), &child.id().to_string()]).status().unwrap();
        let output = child.wait_with_output().unwrap();
        seen = steps(&run);
        println!("SIG{signal} in step {seen}, {:?} after it was to be", a_bit);
        assert!(seen < STEPS, "too late to interrupt anything");
        let said = String::from_utf8_lossy(&output.stderr);
        match signal {
            "TERM" => assert!(output.status.code() == Some(2) && said.contains("stopped after"), "{said}"),
            _ => assert_eq!(output.status.code(), None, "{said}"),
        }
    }
    finish(start(folder, "pieces", true, 3));
    println!("all after {:?}", began.elapsed());

    let whole = folder.join("whole");
    assert_eq!(steps(&whole), STEPS);
    assert_eq!(metrics(&whole), metrics(&run));
    let file = |run: &Path, name: &str| fs::read(run.join("weights").join(name)).unwrap();
    for name in ["model.safetensors", "config.json"] {
        assert!(file(&whole, name) == file(&run, name), "{name} differs");
    }
    let (a, b) = (newest_checkpoint(&whole), newest_checkpoint(&run));
    assert_eq!(a.file_name(), b.file_name());
    assert!(last_tensors(&whole) == last_tensors(&run), "the last step's weights differ");
    assert!(fs::read(a.join("replay.cbor")).unwrap() == fs::read(b.join("replay.cbor")).unwrap());
    let (replay, _) = checkpoint::without_weights(&a).unwrap();
    assert!(!replay.is_empty(), "online sampling took place");
    let left: Vec<_> =
        fs::read_dir(run.join("checkpoints")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "nothing half written stays: {left:?}");
}
