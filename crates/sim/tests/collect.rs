//! `collect` as users run it: the same files whatever happens on the way, and clear refusals.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use rand::RngExt;
use where2act_core::Seed;
use where2act_core::shard::{Manifest, Shard, list_shards};
use where2act_sim::collect::{Preparer, Recipe};
use where2act_sim::object;

/// Six small scenes in shards of two.
fn collect(out: &Path, more: &[&str]) -> Command {
    collect_shards_of(2, out, more)
}

fn collect_shards_of(scenes: u32, out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_collect"));
    command.args(["--scenes", "6", "--trials", "3", "--seed", "5", "--quiet"]);
    command.args(["--categories", "Faucet,Microwave,Switch", "--object-seeds", "0..40"]);
    command.args(["--scenes-per-shard", &scenes.to_string()]).arg("--out").arg(out).args(more);
    command
}

fn run(out: &Path, more: &[&str]) -> Output {
    collect(out, more).output().unwrap()
}

fn contents(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| !path.file_name().unwrap().to_string_lossy().starts_with(".partial"))
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect();
    files.sort();
    files
}

fn refused(output: &Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert_eq!(text.trim_end().lines().count(), 1, "{text}");
    assert!(words.iter().all(|word| text.contains(word)), "{text}");
}

#[test]
fn threads_and_shares_make_no_difference() {
    let folder = tempfile::tempdir().unwrap();
    let (whole, both, split) = (folder.path().join("a"), folder.path().join("b"), folder.path().join("c"));
    assert!(run(&whole, &["--jobs", "1"]).status.success());
    let expected = contents(&whole);
    assert_eq!(expected.len(), 4, "three shards and a manifest");
    // Six primitives take turns over six scenes with three trials each.
    let mut tried = [0; 6];
    for path in list_shards(&whole).unwrap() {
        let shard = Shard::open(&path).unwrap();
        let trials = (0..shard.scenes().len()).flat_map(|scene| shard.trials(scene).unwrap());
        trials.for_each(|trial| tried[trial.primitive as usize] += 1);
    }
    assert_eq!(tried, [3; 6]);
    assert!(run(&both, &["--jobs", "2"]).status.success());
    assert!(contents(&both) == expected, "two threads");
    assert!(run(&split, &["--shard", "1/2"]).status.success());
    assert_eq!(list_shards(&split).unwrap().len(), 1);
    assert!(run(&split, &["--shard", "0/2"]).status.success());
    assert!(contents(&split) == expected, "two shares");
}

/// SIGKILL at 20 moments, each followed by a run that goes on: most after a random time, so before, between and in
/// the work on shards, every fourth while a file is being written. Data sets are begun until all moments are used up.
#[test]
fn kills_make_no_difference() {
    const KILLS: u32 = 20;
    let small = |out: &Path| collect_shards_of(1, out, &["--resume", "--jobs", "2"]);
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    let start = Instant::now();
    assert!(small(&whole).status().unwrap().success());
    let one_shard = start.elapsed().div_f32(6.0);
    let expected = contents(&whole);
    assert_eq!(expected.len(), 7, "six shards and a manifest");

    let rng = &mut Seed(20).rng();
    let (mut kills, mut while_writing) = (0, 0);
    for data_set in 0.. {
        let killed = folder.path().join(data_set.to_string());
        loop {
            let mut child = small(&killed).stderr(Stdio::null()).spawn().unwrap();
            let patience = one_shard.mul_f32(rng.random_range(0.0..2.0));
            let is_partial = |name: &std::ffi::OsStr| name.to_string_lossy().starts_with(".partial");
            let writes = || {
                let mut entries = fs::read_dir(&killed).into_iter().flatten().flatten();
                entries.any(|entry| is_partial(&entry.file_name()))
            };
            let wait_for_file = kills % 4 == 3;
            let start = Instant::now();
            let mut done = None;
            while done.is_none() && kills < KILLS && (wait_for_file || start.elapsed() < patience) {
                if wait_for_file && writes() {
                    break;
                }
                std::thread::sleep(Duration::from_micros(200));
                done = child.try_wait().unwrap();
            }
            if kills == KILLS {
                done = Some(child.wait().unwrap());
            }
            if let Some(status) = done {
                assert!(status.success());
                break;
            }
            child.kill().unwrap();
            let ended = child.wait().unwrap();
            if ended.success() {
                break;
            }
            kills += 1;
            while_writing += u32::from(writes());
            for shard in list_shards(&killed).unwrap_or_default() {
                Shard::open(&shard).unwrap();
            }
            // What a killed program was writing is nobody's: files like it must not count as being written.
            for entry in fs::read_dir(&killed).into_iter().flatten().flatten() {
                if is_partial(&entry.file_name()) {
                    fs::remove_file(entry.path()).unwrap();
                }
            }
        }
        assert!(contents(&killed) == expected, "data set {data_set}, after {kills} kills");
        if kills == KILLS {
            break;
        }
    }
    assert!(while_writing > 0, "no kill hit a file being written");
}

/// Files of more than 100 kB cannot be written, as on a full disk.
#[cfg(unix)]
#[test]
fn a_full_disk_is_told_and_what_was_written_stays() {
    let full = |command: &Command| {
        let mut shell = Command::new("bash");
        // Without a handler for SIGXFSZ, writing fails as it does on a full disk, with an error.
        shell.args(["-c", "trap '' XFSZ; ulimit -f 100; exec \"$0\" \"$@\""]);
        shell.arg(command.get_program()).args(command.get_args());
        shell.output().unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    refused(&full(&collect(&out, &[])), &["shard-00000", "File too large"]);
    assert!(!out.exists(), "of a data set without shards nothing stays");

    assert!(run(&out, &["--shard", "0/3"]).status.success());
    let before = contents(&out);
    refused(&full(&collect(&out, &["--resume"])), &["shard-00001", "File too large"]);
    assert!(contents(&out) == before);
    assert_eq!(fs::read_dir(&out).unwrap().count(), 2, "a manifest and a shard, no half files");
    let shards = list_shards(&out).unwrap();
    assert_eq!(Shard::open(&shards[0]).unwrap().scenes().len(), 2);

    assert!(run(&out, &["--resume"]).status.success());
    let whole = folder.path().join("whole");
    assert!(run(&whole, &[]).status.success());
    assert!(contents(&out) == contents(&whole));
}

#[test]
fn scenes_are_made_again_from_their_info() {
    let folder = tempfile::tempdir().unwrap();
    assert!(run(folder.path(), &["--randomise", "--wide", "--close", "1"]).status.success());
    let manifest = Manifest::load(folder.path()).unwrap();
    let recipe: Recipe = serde_json::from_value(manifest.recipe).unwrap();
    let preparer = Preparer::new(recipe);
    for path in list_shards(folder.path()).unwrap() {
        let shard = Shard::open(&path).unwrap();
        for scene in 0..shard.scenes().len() {
            let record = shard.record(scene).unwrap();
            let again = preparer.restore(&record.info).unwrap();
            assert!(
                again.record(record.trials.clone(), record.rgb_side()) == record,
                "scene {}",
                record.info.index
            );
            // The camera zoomed in.
            let (columns, rows): (Vec<_>, Vec<_>) =
                record.foreground().iter().map(|(pixel, _)| (pixel.u, pixel.v)).unzip();
            let extent = |of: &[u32]| of.iter().max().unwrap() - of.iter().min().unwrap();
            assert!((240..430).contains(&extent(&columns).max(extent(&rows))), "scene {}", record.info.index);
            assert_eq!(record.trials.len(), 3);
        }
    }
}

#[test]
fn an_object_that_cannot_be_loaded_costs_no_other_its_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let objects = folder.path().join("objects");
    let torn = objects.join("Switch").join("torn");
    fs::create_dir_all(&torn).unwrap();
    fs::write(torn.join("mobility.urdf"), "<robot").unwrap();
    let collect = |name: &str, more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_collect"));
        command.args(["--scenes", "4", "--trials", "3", "--quiet", "--objects"]).arg(&objects).args(more);
        command.arg("--out").arg(folder.path().join(name)).output().unwrap()
    };
    refused(&collect("nothing", &[]), &["torn", "mobility.urdf"]);
    assert!(!folder.path().join("nothing").exists());

    let object = object::open("Switch:3").unwrap();
    object::export(&object, &objects.join("Switch").join("whole")).unwrap();
    let half = |name: &str, more: &[&str], left_out: usize| {
        let output = collect(name, more);
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && told.matches("left out").count() == left_out, "{told}");
        assert!(!told.contains('\x1b'), "colour where nobody sees it: {told}");
        let shards = list_shards(&folder.path().join(name)).unwrap();
        shards.iter().map(|path| Shard::open(path).unwrap().scenes().len()).collect::<Vec<_>>()
    };
    assert_eq!(half("half", &[], 2), [2]);
    // The torn object begins every pair of scenes: half of the shards, all of the first of two parts, hold no other.
    let singly = ["--scenes-per-shard", "1"];
    assert_eq!(half("singly", &singly, 2), [0, 1, 0, 1]);
    assert_eq!(half("parts", &[&singly[..], &["--shard", "0/2"]].concat(), 2), [0, 0]);
    assert_eq!(half("parts", &[&singly[..], &["--shard", "1/2"]].concat(), 0), [0, 1, 0, 1]);
    assert!(contents(&folder.path().join("parts")) == contents(&folder.path().join("singly")));
}

#[test]
fn what_cannot_work_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("data");
    assert!(run(&out, &["--shard", "2/3"]).status.success());
    let before = contents(&out);
    refused(&run(&out, &[]), &["data", "--resume"]);
    refused(&run(&out, &["--resume", "--guided", "0.25"]), &["manifest.json", "recipe.guided 0.5", "0.25"]);
    assert!(contents(&out) == before, "refusals write nothing");

    let manifest = out.join("manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    fs::write(&manifest, text.replace("\"format\": 1", "\"format\": 99")).unwrap();
    refused(&run(&out, &["--resume"]), &["manifest.json", "99", "expected 1"]);

    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    refused(&run(&file.join("data"), &[]), &["file"]);
    refused(&run(&out, &["--objects", "/nowhere"]), &["/nowhere"]);
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).unwrap();
    refused(&run(&out, &["--objects", empty.to_str().unwrap()]), &["no object", "mobility.urdf"]);
    fs::create_dir_all(empty.join("Faucet/1")).unwrap();
    fs::write(empty.join("Faucet/1/mobility.urdf"), "").unwrap();
    refused(&run(&out, &["--objects", empty.to_str().unwrap()]), &["--object-seeds", "folder of objects"]);
    refused(&run(&out, &["--categories", "Sofa"]), &["unknown category", "Sofa"]);
}
