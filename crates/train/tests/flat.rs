//! Memory of `train` while its data grows tenfold.
#![cfg(target_os = "linux")]

mod boards;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

const CONFIG: &str = "name = 'flat'
[network]
modality = 'cloud'
primitives = ['pushing']
hidden = 16
points = 256
candidates = 256
[batch]
views = 4
[schedule]
score_steps = 10
joint_steps = 10
epoch_steps = 10
[loss]
proposals = 4
";

/// Largest values of a running program's memory, MiB: all that is resident (`VmHWM`), what it allocated (`RssAnon`),
/// and what of its mapped files happens to be in the page cache and was looked at (`RssFile`).
fn peaks(folder: &Path, data: &str) -> BTreeMap<&'static str, u64> {
    let mut child = Command::new(env!("CARGO_BIN_EXE_train"))
        .args(["--config", "flat.toml", "--data", data, "--episodes", "0", "--quiet"])
        .args(["--out", &format!("{data}-run")])
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut peaks = BTreeMap::new();
    let status = Path::new("/proc").join(child.id().to_string()).join("status");
    let ended = loop {
        // Empty fields when it has just ended.
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        for name in ["VmHWM", "RssAnon", "RssFile"] {
            let line = text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(':'));
            let kilobytes = line.and_then(|l| l.trim().trim_end_matches(" kB").parse::<u64>().ok());
            let peak = peaks.entry(name).or_default();
            *peak = kilobytes.unwrap_or(0).max(*peak);
        }
        if let Some(ended) = child.try_wait().unwrap() {
            break ended;
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert!(ended.success());
    peaks.values_mut().for_each(|kilobytes| *kilobytes >>= 10);
    peaks
}

#[test]
fn ten_times_the_data_takes_the_same_memory() {
    const SCENES: u64 = 32;
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("flat.toml"), CONFIG).unwrap();
    boards::write(&folder.join("small"), 0..SCENES);
    boards::write(&folder.join("large"), 0..10 * SCENES);
    let (small, large) = (peaks(folder, "small"), peaks(folder, "large"));
    println!("MiB at the peak: {small:?} for {SCENES} scenes, {large:?} for {}", 10 * SCENES);
    // The larger set has 217 MiB more; what is held of it in memory are names and counts.
    assert!(small["RssAnon"] > 20, "measured: {small:?}");
    assert!(large["RssAnon"] < small["RssAnon"] + 24, "{small:?}, {large:?}");
}
