//! What cannot work, through all three programs: one line on stderr that says what is wrong, exit code 2, nothing
//! written.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use where2act_core::shard::Manifest;

const OBJECTS: &str = env!("CARGO_BIN_EXE_objects");
const TRIAL: &str = env!("CARGO_BIN_EXE_trial");
const COLLECT: &str = env!("CARGO_BIN_EXE_collect");

const URDF: &str = r#"<robot name="cupboard">
<link name="body"><visual><geometry><box size="0.4 0.6 0.8"/></geometry></visual></link>
<link name="door"><visual><geometry><mesh filename="door.obj"/></geometry></visual></link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
<axis xyz="0 0 1"/><limit lower="0" upper="2"/></joint>
</robot>"#;

const DOOR: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";

/// A folder `set` with one object, a file where folders are expected, and a table of trials.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().unwrap() };
        fs::create_dir_all(bench.path("set/Door/1")).unwrap();
        bench.write("set/Door/1/mobility.urdf", URDF);
        bench.write("set/Door/1/door.obj", DOOR);
        bench.write("file", "");
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn run(&self, program: &str, arguments: &str) -> std::process::Output {
        let mut command = Command::new(program);
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        command.env("WHERE2ACT_CACHE", "").env_remove("RUST_LOG").output().unwrap()
    }

    /// Expects one line on stderr with all of `words`, exit code 2, and every file as it was.
    fn refuses(&self, program: &str, arguments: &str, words: &[&str]) {
        let before = self.files();
        let output = self.run(program, arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        let context = format!("{} {arguments}: {text}", Path::new(program).display());
        assert_eq!(output.status.code(), Some(2), "{context}");
        assert!(text.ends_with('\n') && text.lines().count() == 1, "{context}");
        assert!(words.iter().all(|word| text.contains(word)), "{words:?} in {context}");
        assert!(self.files() == before, "something was written: {context}");
    }

    /// Names and contents of all files; folders have none.
    fn files(&self) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
        let mut files = BTreeMap::new();
        let mut folders = vec![self.folder.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for path in fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
                if path.is_dir() {
                    folders.push(path.clone());
                }
                files.insert(path.clone(), fs::read(&path).ok());
            }
        }
        files
    }
}

#[test]
fn bad_objects_are_refused_by_every_program() {
    let urdf = |from: &str, to: &str| {
        assert!(URDF.contains(from), "{from}");
        (URDF.replace(from, to), DOOR.to_owned())
    };
    let mesh = |from: &str, to: &str| (URDF.to_owned(), DOOR.replace(from, to));
    let joint = |parent: &str, child: &str| {
        let joint = format!(
            "<joint name=\"j\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/></joint>"
        );
        urdf("</robot>", &format!("{joint}</robot>"))
    };
    let visual = r#"<visual><geometry><box size="0.4 0.6 0.8"/></geometry></visual>"#;
    let empty = urdf(visual, "")
        .0
        .replace(r#"<visual><geometry><mesh filename="door.obj"/></geometry></visual>"#, "");
    let table: [(&str, (String, String), &[&str]); 14] = [
        ("missing mesh", urdf("door.obj", "none.obj"), &["none.obj", "no such file"]),
        ("broken XML", urdf("</link>", "</lnk>"), &["mobility.urdf", "valid URDF"]),
        ("cut off XML", urdf("</robot>", ""), &["mobility.urdf", "valid URDF"]),
        ("joint loop", joint("door", "body"), &["mobility.urdf", "joint loop"]),
        ("unknown parent", joint("shelf", "door"), &["mobility.urdf", "parent", "\"shelf\""]),
        ("unknown child", joint("door", "shelf"), &["mobility.urdf", "child", "\"shelf\""]),
        ("NaN in a mesh", mesh("v 1 0 0", "v nan 0 0"), &["door.obj", "finite"]),
        ("infinity in a mesh", mesh("v 1 0 0", "v 1e60 0 0"), &["door.obj", "finite"]),
        ("index out of range", mesh("f 2 3 4", "f 2 3 7"), &["door.obj", "out of bounds"]),
        ("empty object", (empty, DOOR.to_owned()), &["mobility.urdf", "geometry"]),
        ("no links", ("<robot name=\"r\"></robot>".to_owned(), DOOR.to_owned()), &["mobility.urdf", "links"]),
        (
            "millimetres",
            urdf("0.4 0.6 0.8", "400 600 800"),
            &["mobility.urdf", "expected metres", "m radius"],
        ),
        ("no movable joint", urdf("\"revolute\"", "\"fixed\""), &["mobility.urdf", "movable joint"]),
        ("NaN in a limit", urdf("upper=\"2\"", "upper=\"nan\""), &["\"hinge\"", "limits"]),
    ];
    for (what, (urdf, obj), words) in table {
        let bench = Bench::new();
        bench.write("set/Door/1/mobility.urdf", &urdf);
        bench.write("set/Door/1/door.obj", &obj);
        eprintln!("{what}");
        bench.refuses(OBJECTS, "render set/Door/1 --out picture.png", words);
        bench.refuses(TRIAL, "set/Door/1 --primitive pushing --point 0.5,0,0.2 --gif trial.gif", words);
        bench.refuses(COLLECT, "--objects set --scenes 2 --trials 1 --out data --quiet", words);
    }
}

#[test]
fn unknown_names_and_senseless_arguments_are_refused() {
    let bench = Bench::new();
    let table: [(&str, &str, &[&str]); 21] = [
        (OBJECTS, "", &["expected a command", "--help"]),
        (OBJECTS, "paint Door:1", &["'paint'", "--help"]),
        (OBJECTS, "render Sofa:1 --out a.png", &["unknown category", "Sofa", "Door"]),
        (OBJECTS, "render Door:one --out a.png", &["Door:one", "whole number"]),
        (OBJECTS, "render Door:1", &["--out"]),
        (OBJECTS, "export Sofa:1 --out new", &["unknown category", "Sofa"]),
        (OBJECTS, "list --jobs 0", &["--jobs", "at least 1"]),
        (TRIAL, "Sofa:1 --primitive pushing --pixel 200,200", &["unknown category", "Sofa"]),
        (TRIAL, "Door:1 --primitive poking --pixel 200,200", &["--primitive", "poking", "pulling-left"]),
        (TRIAL, "Door:1 --primitive pushing", &["--point"]),
        (TRIAL, "Door:1 --primitive pushing --point 1,2", &["--point", "3 finite numbers"]),
        (TRIAL, "Door:1 --primitive pushing --point 1,nan,2", &["--point", "3 finite numbers"]),
        (TRIAL, "Door:1 --primitive pushing --pixel 200,200 --hz 60", &["--hz", "60", "500 or 250"]),
        (TRIAL, "set/Door/1 --batch none.tsv --out out.tsv", &["none.tsv"]),
        (COLLECT, "--scenes 1 --out data --categories Sofa", &["unknown category", "Sofa"]),
        (COLLECT, "--scenes 1 --out data --primitives poking", &["--primitives", "poking"]),
        (COLLECT, "--scenes 0 --out data", &["--scenes", "at least one"]),
        (COLLECT, "--scenes 1 --out data --shard 2/2", &["--shard", "2/2", "I < N"]),
        (COLLECT, "--scenes 1 --out data --guided 2", &["--guided", "0 to 1"]),
        (COLLECT, "--scenes 1 --out data --objects nowhere", &["nowhere"]),
        (COLLECT, "--scenes 1", &["--out"]),
    ];
    for (program, arguments, words) in table {
        bench.refuses(program, arguments, words);
    }
}

#[test]
fn what_cannot_be_written_is_named() {
    let bench = Bench::new();
    let columns = ["primitive", "target_link", "px", "py", "pz", "ax", "ay", "az", "fx", "fy", "fz"];
    let row = ["pushing", "door", "0.5", "0", "0.2", "0", "1", "0", "0", "0", "1"];
    bench.write("trials.tsv", &format!("{}\n{}\n", columns.join("\t"), row.join("\t")));
    bench.refuses(OBJECTS, "render Door:1 --out file/a.png", &["file/a.png"]);
    bench.refuses(OBJECTS, "sheet --categories Door --per-category 1 --out file/a.png", &["file/a.png"]);
    bench.refuses(OBJECTS, "export Door:1 --out file/door", &["file/door"]);
    bench.refuses(TRIAL, "set/Door/1 --batch trials.tsv --hz 250 --out file/a.tsv", &["file/a.tsv"]);
    let trial = "Microwave:3 --primitive pushing --pixel 224,240 --hz 250 --gif file/a.gif";
    bench.refuses(TRIAL, trial, &["file/a.gif"]);
    bench.refuses(COLLECT, "--scenes 1 --trials 1 --out file/data", &["file"]);
}

#[test]
fn shards_of_another_version_are_named() {
    let bench = Bench::new();
    let arguments = "--categories Microwave --scenes 2 --trials 1 --scenes-per-shard 1 --out data --quiet";
    let resumed = format!("{arguments} --resume");
    assert!(bench.run(COLLECT, arguments).status.success());
    let shard = Manifest::shard_path(&bench.path("data"), 0);
    let good = fs::read(&shard).unwrap();
    // The header is JSON in JSON; the number's length stays, so all offsets do.
    let start = good.windows(12).position(|w| w == br#"\"format\":1"#).expect("a format in the header");
    let mut other = good.clone();
    other[start + 11] = b'7';
    fs::write(&shard, other).unwrap();
    bench.refuses(COLLECT, &resumed, &["shard-00000", "format version 7", "expected 1"]);
    fs::write(&shard, good).unwrap();
    let manifest = fs::read_to_string(bench.path("data/manifest.json")).unwrap();
    bench.write("data/manifest.json", &manifest.replace("\"format\": 1", "\"format\": 7"));
    bench.refuses(COLLECT, &resumed, &["manifest.json", "format version 7", "expected 1"]);
    bench.write("data/manifest.json", "{");
    bench.refuses(COLLECT, &resumed, &["manifest.json", "damaged"]);
    bench.write("data/manifest.json", &manifest);
    assert!(bench.run(COLLECT, &resumed).status.success());
}
