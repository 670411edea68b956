//! `evaluate` from weights to its report. The network has learnt nothing; what is tested is that the report is whole,
//! says the same every time, and says what is missing.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

use burn::tensor::Device;
use where2act_core::{Category, Primitive, Seed};
use where2act_infer::Predictor;
use where2act_model::{Modality, ModelConfig, Network, Precision, save_weights};
use where2act_sim::collect::ObjectSet;
use where2act_train::evaluate::{
    Contestant, EvaluateConfig, EvaluateError, Fate, Judgement, Report, Row, evaluate,
};

const PRIMITIVES: [Primitive; 2] = [Primitive::Pushing, Primitive::Pulling];

fn network() -> Network {
    let config = ModelConfig::new(Modality::Cloud, &PRIMITIVES).with_points(256);
    Network::new(&config, Seed(1), &Device::flex())
}

/// A folder with the network's weights in it.
fn bench() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let weights = folder.path().join("weights");
    save_weights(&weights, &network(), "random", Precision::F32).unwrap();
    (folder, weights)
}

/// Runs the program in the folder: its report as JSON and as Markdown.
fn run(folder: &Path, args: &str) -> (String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_evaluate"))
        .args("--weights weights --proposals 2 --random 2 --informed 8 --seed 3 --out x.json".split(' '))
        .args(args.split(' '))
        .current_dir(folder)
        .env_remove("RUST_LOG")
        .env("WHERE2ACT_CACHE", folder.join("cache"))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let markdown = read("x.md");
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim_end(), markdown.trim_end());
    (read("x.json"), markdown)
}

/// Two proposals and two random trials in every scene, and nothing that cannot be.
fn check(judgement: &Judgement) {
    assert_eq!(judgement.rows.len(), PRIMITIVES.len());
    for row in &judgement.rows {
        assert!(row.possible_scenes <= judgement.scenes);
        let contestants: Vec<Contestant> = row.rates.iter().map(|(contestant, _)| *contestant).collect();
        assert_eq!(contestants, Contestant::ALL);
        let tries: Vec<u64> = row.rates.iter().map(|(_, rate)| rate.tries).collect();
        let [best, best_two, sampled, random, along_normal, informed] = tries[..] else {
            panic!("{tries:?}")
        };
        assert!(best == row.possible_scenes && best_two <= 2 * row.possible_scenes);
        assert_eq!((sampled, random, along_normal), (best_two, 2 * row.possible_scenes, random));
        assert!(informed <= 2 * row.possible_scenes);
        assert!(row.possible_in_view <= row.possible_scenes);
        for ((who, in_view), (same, whole)) in row.rates_in_view.iter().zip(&row.rates) {
            assert!(who == same && in_view.successes <= whole.successes && in_view.tries <= whole.tries);
        }
        assert_eq!(row.rates_in_view[0].1.tries, row.possible_in_view);
        for (contestant, rate) in &row.rates {
            assert!(rate.successes <= rate.tries, "{contestant:?} {rate:?}");
            let shares = [rate.low, rate.rate, rate.high];
            assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)), "{contestant:?} {rate:?}");
        }
        let successes = row.fates.iter().find(|(fate, _)| *fate == Fate::Success).unwrap().1;
        assert_eq!(successes, row.rates[1].1.successes);
        assert_eq!(row.fates.iter().map(|(_, count)| count).sum::<u64>(), best_two);
        assert_eq!(row.score.trials, 2 * judgement.scenes);
        assert_eq!(row.reliability.iter().map(|r| r.outcome.tries).sum::<u64>(), row.score.trials);
        let metrics = [row.score.f_score, row.score.precision, row.score.recall, row.calibration_error];
        assert!(metrics.iter().all(|metric| (0.0..=1.0).contains(metric)), "{row:?}");
    }
}

#[test]
fn a_report_is_whole_and_the_same_every_time() {
    let (folder, _) = bench();
    let (json, markdown) = run(folder.path(), "--categories Faucet --episodes 1 --jobs 2");
    let report: Report = serde_json::from_str(&json).unwrap();
    assert_eq!((report.total.scenes, report.unfinished), (1, 0));
    assert!(report.without_scene.is_empty());
    assert_eq!(report.categories.keys().collect::<Vec<_>>(), ["Faucet"]);
    assert_eq!(report.objects.len(), 1);
    check(&report.total);
    report.categories.values().chain(report.objects.values()).for_each(check);

    assert!(markdown.starts_with(&format!("Weights `{}`", report.model)), "{markdown}");
    for words in [
        ", 1 scenes, seed 3.",
        "Top-1 is the best of them, top-k the best 2",
        "sampled 2 drawn at random",
        "| primitive | scenes | top-1 | top-k | sampled | random | along normal | knows the joint |",
        "succeeds from where the camera sees that nothing is",
        "| primitive | scenes | top-1 | top-k |\n",
        "What came of the top-k proposals",
        "| primitive | tries | success | no approach | wrong touch | against the joint | no hold |",
        "The score of the hands of random trials",
        "The same trials by score",
        "| score | pushing | pulling |",
        "| 0.9-1.0 |",
        "Top-1 by category",
        "| Faucet | 1 |",
    ] {
        assert!(markdown.contains(words), "{words:?} in {markdown}");
    }
    let tables: Vec<&str> = markdown.split("\n\n").filter(|paragraph| paragraph.starts_with('|')).collect();
    assert_eq!(tables.len(), 6, "{markdown}");
    for table in tables {
        let bars: Vec<usize> = table.trim_end().lines().map(|line| line.matches('|').count()).collect();
        assert!(bars.len() > 2 && bars.iter().all(|n| *n == bars[0]), "{table}");
    }

    let (again, _) = run(folder.path(), "--categories Faucet --episodes 1 --jobs 1");
    assert!(again == json, "another number of threads");
}

#[test]
fn proposals_anywhere_count_where_nothing_moves_too() {
    let (folder, _) = bench();
    let (json, markdown) = run(folder.path(), "--categories StorageFurniture --episodes 3 --anywhere");
    let report: Report = serde_json::from_str(&json).unwrap();
    check(&report.total);
    // A network that has learnt nothing proposes on the carcass as soon as on a drawer.
    let missed = |row: &Row| row.fates.iter().find(|(fate, _)| *fate == Fate::NothingMoves).unwrap().1;
    assert!(report.total.rows.iter().map(missed).sum::<u64>() > 0, "{markdown}");
    assert!(markdown.contains("pixels, of whatever is seen") && markdown.contains(" | nothing moves |"));
}

#[test]
fn cameras_can_be_held_otherwise() {
    let (folder, _) = bench();
    let (straight, markdown) = run(folder.path(), "--categories Faucet --episodes 1");
    assert!(!markdown.contains("Cameras are"));
    let (held, markdown) = run(folder.path(), "--categories Faucet --episodes 1 --roll 10 --beside -20");
    check(&serde_json::from_str::<Report>(&held).unwrap().total);
    assert!(
        markdown.contains("Cameras are rolled by 10 degrees and look -20 degrees beside the object."),
        "{markdown}"
    );
    assert!(held != straight);
}

/// A drawer above a base. In the second object there is another one behind it, and both push each other apart; the third
/// cannot be loaded.
fn write_objects(folder: &Path) {
    let shapes = |size: &str, x: f32, z: f32| {
        let shape = format!("<origin xyz=\"{x} 0 {z}\"/><geometry><box size=\"{size}\"/></geometry>");
        format!("<visual>{shape}</visual><collision>{shape}</collision>")
    };
    let base = format!("<link name=\"base\">{}</link>", shapes("0.4 0.5 0.1", 0.0, -0.3));
    let drawer = |name: &str, x: f32, upper: f32| {
        let shapes = shapes("0.3 0.4 0.2", x, 0.0);
        format!(
            "<link name=\"{name}\">{shapes}</link><joint name=\"{name}_rail\" type=\"prismatic\"><parent \
             link=\"base\"/><child link=\"{name}\"/><axis xyz=\"-1 0 0\"/><limit lower=\"0\" upper=\"{upper}\" \
             effort=\"1\" velocity=\"1\"/></joint>"
        )
    };
    let free = drawer("drawer", -0.1, 0.2);
    let stuck = drawer("drawer", -0.1, 0.02) + &drawer("other", 0.15, 0.02);
    for (name, drawers) in [("free", free), ("stuck", stuck)] {
        let object = folder.join("Box").join(name);
        fs::create_dir_all(&object).unwrap();
        let urdf = format!("<robot name=\"{name}\">{base}{drawers}</robot>");
        fs::write(object.join("mobility.urdf"), urdf).unwrap();
    }
    let torn = folder.join("Box").join("torn");
    fs::create_dir_all(&torn).unwrap();
    fs::write(torn.join("mobility.urdf"), "<robot").unwrap();
}

#[test]
fn objects_take_turns_and_those_without_a_scene_are_named() {
    let (folder, _) = bench();
    write_objects(&folder.path().join("objects"));
    let (json, markdown) = run(folder.path(), "--objects objects --episodes 6");
    let report: Report = serde_json::from_str(&json).unwrap();
    assert_eq!((report.total.scenes, report.unfinished), (2, 0));
    let scenes: Vec<_> =
        report.objects.iter().map(|(name, judgement)| (name.as_str(), judgement.scenes)).collect();
    assert_eq!(scenes, [("Box/free", 2)]);
    let without: Vec<_> =
        report.without_scene.iter().map(|(name, scenes)| (name.as_str(), *scenes)).collect();
    assert_eq!(without, [("Box/stuck", 2), ("Box/torn", 2)]);
    check(&report.total);
    assert!(
        markdown.contains("Scenes that could not be made")
            && markdown.contains(": Box/stuck (2), Box/torn (2)."),
        "{markdown}"
    );
}

#[test]
fn a_category_that_allows_nothing_is_named() {
    let (folder, _) = bench();
    // Lids that nobody can lift.
    let (json, markdown) = run(folder.path(), "--categories Faucet,KitchenPot --episodes 2");
    let report: Report = serde_json::from_str(&json).unwrap();
    assert!(report.categories["KitchenPot"].rows.iter().all(|row| row.possible_scenes == 0));
    assert!(report.categories["Faucet"].rows.iter().any(|row| row.possible_scenes > 0));
    assert!(
        markdown.contains("Categories of which no scene counts") && markdown.contains(": KitchenPot (1)."),
        "{markdown}"
    );
}

#[test]
fn an_interrupted_report_is_of_the_scenes_done_by_then() {
    let (_folder, weights) = bench();
    let predictor = Predictor::load(&weights).unwrap();
    let objects = ObjectSet::Procedural { categories: vec![Category::Faucet], seeds: ObjectSet::TEST_SEEDS };
    let usual = EvaluateConfig::new(objects, 200, Seed(3));
    let config = EvaluateConfig { proposals: 1, random: 1, informed: 1, ..usual };
    let stop = AtomicBool::new(false);
    let judge = || {
        let after_the_first = |_: u64| stop.store(true, Ordering::Relaxed);
        evaluate(&predictor, &config, &stop, &after_the_first)
    };
    let report = judge().unwrap();
    assert!(report.total.scenes > 0 && report.unfinished > 0, "{report:?}");
    let missing = report.unfinished + report.without_scene.values().sum::<u64>();
    assert_eq!(report.total.scenes + missing, 200);
    let told = format!("Interrupted: {} of 200 scenes are missing.", report.unfinished);
    assert!(report.to_markdown().contains(&told));
    // The flag is still set.
    assert!(matches!(judge(), Err(EvaluateError::Interrupted)));
}
