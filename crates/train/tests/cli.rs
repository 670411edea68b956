//! `train`, `evaluate` and `mean` as users run them: what cannot work is refused in one line, before any work is done.

mod boards;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use burn::tensor::Device;
use where2act_core::shard::{FORMAT, Manifest};
use where2act_core::{Category, Primitive, Seed};
use where2act_model::{Modality, ModelConfig, Network, Precision, Weights, save_weights};
use where2act_train::Part;

const CONFIG: &str = "name = 'test'
[network]
modality = 'cloud'
points = 256
[schedule]
score_steps = 1
joint_steps = 1
epoch_steps = 1
";

/// A folder to work in, with a good configuration in it and nothing else.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().unwrap() };
        bench.write("run.toml", CONFIG);
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// Runs a program in the folder.
    fn run(&self, program: &str, args: &str) -> Output {
        Command::new(program)
            .args(args.split_whitespace())
            .current_dir(self.folder.path())
            .env_remove("RUST_LOG")
            .output()
            .unwrap()
    }

    fn train(&self, args: &str) -> Output {
        self.run(env!("CARGO_BIN_EXE_train"), args)
    }

    fn evaluate(&self, args: &str) -> Output {
        self.run(env!("CARGO_BIN_EXE_evaluate"), args)
    }

    /// Weights of a small random network.
    fn weights(&self, name: &str) {
        let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pushing]).with_points(256);
        let network = Network::new(&config, Seed(1), &Device::flex());
        save_weights(&self.path(name), &network, "random", Precision::F32).unwrap();
    }

    /// A data set without a scene.
    fn data(&self, name: &str) {
        let recipe = serde_json::Value::Null;
        let version = "test".to_owned();
        Manifest { format: FORMAT, version, seed: Seed(1), scenes: 0, scenes_per_shard: 1, recipe }
            .save(&self.path(name))
            .unwrap();
    }
}

/// Exit code 2, nothing on stdout, and one line on stderr with all of these words.
fn refused(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    assert!(words.iter().all(|word| text.contains(word)), "expected {words:?} in {text}");
    let told_twice = text.matches("(os error").count() > 1;
    assert!(!told_twice, "{text}");
    assert!(output.stdout.is_empty(), "{}", String::from_utf8_lossy(&output.stdout));
}

/// What clap refuses, in its own words, of which the first line counts.
fn misused(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    let first = text.lines().next().unwrap_or_default();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(words.iter().all(|word| first.contains(word)), "expected {words:?} in {first}");
}

/// Exit code 0; returns what was said on stderr.
fn worked(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{text}");
    text
}

/// Every file of a folder and of those in it, with its contents.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files.extend(contents(&path));
        } else {
            files.push((path.clone(), fs::read(&path).unwrap()));
        }
    }
    files.sort();
    files
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn a_mean_says_what_it_is_of_and_harms_no_other_weights() {
    let bench = Bench::new();
    let mean = |args: &str| bench.run(env!("CARGO_BIN_EXE_mean"), args);
    bench.weights("a");
    bench.weights("b");
    worked(&mean("a b --out both"));
    let [a, both] = ["a", "both"].map(|name| Weights::load(&bench.path(name), &Device::flex()).unwrap());
    let card = fs::read_to_string(bench.path("both/card.md")).unwrap();
    assert_eq!(card.matches(&a.sha256[..12]).count(), 2, "{card}");
    refused(&mean("a b --out both"), &["--out both", "new folder"]);
    assert_eq!(Weights::load(&bench.path("both"), &Device::flex()).unwrap().sha256, both.sha256);
    let config = ModelConfig::new(Modality::Cloud, &[Primitive::Pulling]).with_points(256);
    let network = Network::new(&config, Seed(1), &Device::flex());
    save_weights(&bench.path("c"), &network, "random", Precision::F32).unwrap();
    refused(&mean("a c --out other"), &["differ in their weights alone"]);
    assert!(!bench.path("other").exists());
    misused(&mean("a --out other"), &["2 values required"]);
}

#[test]
fn train_misses_what_it_shall_start_from_before_it_collects() {
    let bench = Bench::new();
    refused(&bench.train("--config run.toml --from nowhere"), &["--from", "nowhere"]);
    refused(&bench.train("--config run.toml --replay nowhere"), &["--replay", "nowhere"]);
    misused(&bench.train("--config run.toml --primitive pull"), &["--primitive", "pull"]);
    bench.write("rgb.toml", &CONFIG.replace("cloud", "rgb"));
    refused(&bench.train("--config rgb.toml --encoder nowhere.pth"), &["--encoder", "nowhere.pth"]);
    refused(&bench.train("--config rgb.toml --teacher nowhere"), &["--teacher", "nowhere"]);
    assert!(!bench.path("data").exists());
}

#[test]
fn train_names_what_is_wrong_with_its_configuration() {
    let bench = Bench::new();
    refused(&bench.train("--config nowhere.toml"), &["nowhere.toml", "No such file"]);
    bench.write("unknown.toml", &format!("{CONFIG}[batch]\nvievs = 3\n"));
    refused(&bench.train("--config unknown.toml"), &["unknown.toml", "vievs", "views"]);
    bench.write("value.toml", &format!("{CONFIG}[batch]\nviews = 0\n"));
    refused(&bench.train("--config value.toml"), &["batch.views", "1 to 1024"]);
    bench.write("half.toml", "name = 'test'\n[network]\n");
    refused(&bench.train("--config half.toml"), &["half.toml", "modality"]);
    bench.write("noise.toml", "\u{1}\u{2} = [");
    refused(&bench.train("--config noise.toml"), &["noise.toml"]);
    refused(&bench.train("--config ."), &["."]);
    refused(&bench.train("--config run.toml --steps 0 --data data"), &["steps", "at least"]);
    refused(&bench.train("--config run.toml --jobs 0"), &["--jobs", "at least 1", "found 0"]);
    // A ResNet-18 fits one kind of network.
    let resnet = |args: &str| bench.train(&format!("{args} --encoder resnet18.pth"));
    refused(&resnet("--config run.toml"), &["network.modality is cloud", "expected rgb", "encoder"]);
    let pictures = CONFIG.replace("'cloud'", "'rgb'");
    bench.write("narrow.toml", &pictures.replace("points = 256", "width = 0.5"));
    refused(&resnet("--config narrow.toml"), &["network.width is 0.5", "expected 1", "encoder"]);
    bench.write("both.toml", &format!("from = 'weights'\nencoder = 'resnet18.pth'\n{pictures}"));
    refused(&bench.train("--config both.toml"), &["encoder is resnet18.pth", "expected no file", "from"]);
    misused(&resnet("--from weights"), &["--encoder", "--from"]);
    misused(&bench.train("--modality sound"), &["--modality", "sound"]);
    misused(&bench.train("--device gpu"), &["--device", "gpu"]);
    misused(&bench.train("--confg run.toml"), &["--confg"]);
    assert!(!bench.path("runs").exists() && !bench.path("data").exists(), "refusals write nothing");
}

#[test]
fn train_names_what_is_wrong_with_its_data() {
    let bench = Bench::new();
    let train = |data: &str| bench.train(&format!("--config run.toml --data {data} --out run --quiet"));
    refused(&train("nowhere"), &["nowhere", "manifest.json"]);
    bench.data("empty");
    refused(&train("empty"), &["empty"]);
    bench.write("noise/manifest.json", "{");
    refused(&train("noise"), &["noise", "manifest.json"]);
    bench.data("later");
    let manifest = bench.path("later/manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"format\": 1", "\"format\": 99")).unwrap();
    refused(&train("later"), &["later", "99"]);
    bench.data("damaged");
    fs::write(Manifest::shard_path(&bench.path("damaged"), 0), b"not a shard").unwrap();
    refused(&train("damaged"), &["shard-00000"]);
    refused(&train("run.toml"), &["run.toml"]);
}

/// A configuration that trains on boards within a second.
const BOARDS: &str = "name = 'boards'
[network]
modality = 'cloud'
primitives = ['pushing']
hidden = 16
latent = 4
points = 256
candidates = 256
[batch]
views = 2
trials_per_view = 8
[schedule]
score_steps = 2
joint_steps = 4
epoch_steps = 3
[loss]
proposals = 4
";
/// Boards that have one for validation among them.
const SCENES: std::ops::Range<u64> = 0..32;

#[test]
fn a_damaged_shard_is_named_and_skipped_only_when_told_to() {
    let bench = Bench::new();
    bench.write("boards.toml", BOARDS);
    boards::write(&bench.path("data"), SCENES);
    let shard = Manifest::shard_path(&bench.path("data"), 2);
    let sound = fs::read(&shard).unwrap();
    let train = |more: &str| {
        bench.train(&format!("--config boards.toml --data data --out run --quiet --episodes 0 {more}"))
    };
    // Half a shard; bytes of something else; nothing.
    let mut noise = sound.clone();
    noise[..64].fill(0xff);
    for damaged in [&sound[..sound.len() / 2], &noise, b""] {
        fs::write(&shard, damaged).unwrap();
        refused(&train(""), &["shard-00002", "damaged"]);
        assert_eq!(names(&bench.path("run")), [""; 0], "nothing is begun");
    }
    let said = worked(&train("--skip-damaged"));
    assert!(said.contains("skipped:") && said.contains("shard-00002"), "{said}");
    assert!(bench.path("run/weights/model.safetensors").is_file());
    let card = fs::read_to_string(bench.path("run/weights/card.md")).unwrap();
    assert!(card.contains("M parameters, backbone") && !said.contains("GMAC"), "{card} {said}");
    assert_eq!(fs::read(&shard).unwrap(), b"", "the shard is left as it is");
}

#[test]
fn shards_of_another_version_are_named_whatever_the_flags() {
    let bench = Bench::new();
    bench.write("boards.toml", BOARDS);
    boards::write(&bench.path("data"), SCENES);
    let shard = Manifest::shard_path(&bench.path("data"), 1);
    let mut bytes = fs::read(&shard).unwrap();
    // In the header: the same length, another number.
    let at = bytes.windows(10).position(|w| w == br#"format\":1"#).expect("the version is in the header");
    bytes[at + 9] = b'9';
    fs::write(&shard, &bytes).unwrap();
    for flag in ["", "--skip-damaged"] {
        let output = bench.train(&format!("--config boards.toml --data data --out run --quiet {flag}"));
        refused(&output, &["shard-00001", "format version 9", "expected 1"]);
    }
    assert_eq!(names(&bench.path("run")), [""; 0]);
}

#[test]
fn what_nothing_can_be_learnt_from_is_refused() {
    let bench = Bench::new();
    boards::write(&bench.path("data"), SCENES);
    bench.write("pulling.toml", &BOARDS.replace("['pushing']", "['pushing', 'pulling-left']"));
    refused(
        &bench.train("--config pulling.toml --data data --out run --quiet"),
        &["data", "no successful trial of pulling-left"],
    );
    // Boards of one part alone.
    bench.write("boards.toml", BOARDS);
    let part = |n: u64| Part::of(&format!("Door:{n}"), Some(Category::Door));
    for (missing, kept) in [("Validation", Part::Train), ("Train", Part::Validation)] {
        let number = (0..).find(|n| part(*n) == kept).unwrap();
        boards::write(&bench.path(missing), number..number + 1);
        refused(
            &bench.train(&format!("--config boards.toml --data {missing} --out run --quiet")),
            &["none of the 1 scenes", &format!("belongs to {missing}"), "collect more"],
        );
    }
    let begun = ["run/checkpoints", "run/weights", "run/metrics.jsonl"];
    assert!(begun.iter().all(|name| !bench.path(name).exists()));
}

#[test]
fn a_run_is_only_resumed_as_what_it_was() {
    let bench = Bench::new();
    bench.write("boards.toml", BOARDS);
    boards::write(&bench.path("data"), SCENES);
    boards::write(&bench.path("more"), 0..40);
    let train = |args: &str| bench.train(&format!("--out run --quiet --episodes 0 {args}"));
    worked(&train("--config boards.toml --data data"));
    let before = contents(&bench.path("run"));
    assert!(before.len() > 8);

    refused(&train("--config boards.toml --data data"), &["run", "holds a run already", "--resume"]);
    let other = |args: &str, words: &[&str]| refused(&train(&format!("--resume {args}")), words);
    other("--config boards.toml --data data --seed 4", &["run", "another configuration", "--out"]);
    other("--config boards.toml --data data --steps 40", &["run", "another configuration"]);
    bench.write("rate.toml", &BOARDS.replace("epoch_steps = 3", "epoch_steps = 3\nrate = 0.01"));
    other("--config rate.toml --data data", &["run", "another configuration"]);
    other("--config boards.toml --data more", &["run", "other data"]);
    other("--config boards.toml --data nowhere", &["nowhere", "manifest.json"]);
    assert!(contents(&bench.path("run")) == before, "refusals change nothing");

    // A damaged checkpoint is named, not trained over.
    let newest = bench.path("run/checkpoints/step-00000006");
    let learner = fs::read(newest.join("learner.bpk")).unwrap();
    fs::write(newest.join("learner.bpk"), &learner[..learner.len() / 2]).unwrap();
    other("--config boards.toml --data data", &["step-00000006", "learner.bpk"]);
    fs::write(newest.join("learner.bpk"), &learner).unwrap();
    assert!(contents(&bench.path("run")) == before);
    let said = worked(&bench.train("--out run --episodes 0 --config boards.toml --data data --resume"));
    assert_eq!(said.matches("GMAC").count(), 1, "how large the network is, once: {said}");

    // Weights whose checkpoints somebody has deleted are still a run.
    fs::remove_dir_all(bench.path("run/checkpoints")).unwrap();
    let before = contents(&bench.path("run"));
    refused(&train("--config boards.toml --data data --seed 4"), &["run", "holds a run already"]);
    other("--config boards.toml --data data", &["run", "no checkpoint to go on from"]);
    assert!(contents(&bench.path("run")) == before);
}

#[test]
fn train_leaves_an_existing_run_alone() {
    let bench = Bench::new();
    bench.write("run/checkpoints/000001/state", "precious");
    let output = bench.train("--config run.toml --data nowhere --out run");
    refused(&output, &["run", "--resume"]);
    assert_eq!(fs::read_to_string(bench.path("run/checkpoints/000001/state")).unwrap(), "precious");
    assert_eq!(names(&bench.path("run")), ["checkpoints"]);
}

#[test]
fn train_finds_out_first_that_it_cannot_write() {
    let bench = Bench::new();
    let output = bench.train("--config run.toml --out run.toml/run --quiet");
    refused(&output, &["--out", "run.toml/run"]);
    assert_eq!(names(bench.folder.path()), ["run.toml"], "nothing is collected");
}

#[test]
fn evaluate_names_what_is_wrong() {
    let bench = Bench::new();
    bench.weights("weights");
    let evaluate = |args: &str| bench.evaluate(&format!("--episodes 1 --quiet {args}"));
    refused(&evaluate("--weights nowhere --out report.json"), &["nowhere", "SHA256SUMS"]);
    refused(&evaluate("--weights run.toml --out report.json"), &["run.toml"]);

    // A folder of something else, a damaged file, and a file that is not the one it was.
    bench.write("other/readme.txt", "");
    refused(&evaluate("--weights other --out report.json"), &["other", "SHA256SUMS"]);
    bench.weights("damaged");
    bench.write("damaged/config.json", "{}");
    refused(&evaluate("--weights damaged --out report.json"), &["damaged", "config.json"]);
    bench.weights("swapped");
    let file = bench.path("swapped/model.safetensors");
    let mut bytes = fs::read(&file).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    fs::write(&file, bytes).unwrap();
    refused(&evaluate("--weights swapped --out report.json"), &["model.safetensors"]);

    refused(&evaluate("--weights weights --out run.toml/report.json"), &["--out", "run.toml/report.json"]);
    fs::create_dir(bench.path("folder.json")).unwrap();
    refused(&evaluate("--weights weights --out folder.json"), &["--out", "folder.json", "is a directory"]);
    refused(&evaluate("--weights weights --out report.json --objects nowhere"), &["nowhere"]);
    refused(&evaluate("--weights weights --out report.json --objects other"), &["other", "mobility.urdf"]);
    refused(&evaluate("--weights weights --out report.json --proposals 0"), &["--proposals", "from 1 to"]);
    refused(&evaluate("--weights weights --out report.json --proposals 20000"), &["--proposals", "10000"]);
    refused(&evaluate("--weights weights --out report.json --informed 0"), &["--informed", "at least 1"]);
    refused(&evaluate("--weights weights --out report.json --jobs 0"), &["--jobs", "found 0"]);
    misused(&evaluate("--weights weights --out report.json --categories Sofa"), &["Sofa", "--categories"]);
    misused(&evaluate("--weights weights --out report.json --split all"), &["--split", "all"]);
    misused(&evaluate("--out report.json"), &["required"]);
    assert!(!bench.path("report.json").exists() && !bench.path("report.md").exists());
}
