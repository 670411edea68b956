//! Loading an object of 200 collision meshes: cold, and with its convex pieces in the cache. Required: below 3 s and
//! 0.3 s on two cores.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use where2act_sim::object;

/// An arched handle (not convex), a board, and a flat sheet take turns, as they do in cabinets of PartNet-Mobility.
fn mesh(k: usize) -> String {
    let mut text = String::new();
    let mut strip = |profile: &[[f64; 2]], depth: f64| {
        for [x, y] in profile {
            let _ = writeln!(text, "v {x} {y} 0\nv {x} {y} {depth}");
        }
        let n = profile.len();
        for i in 0..n {
            let (a, b) = (2 * i + 1, 2 * ((i + 1) % n) + 1);
            let _ = writeln!(text, "f {a} {b} {} {}", b + 1, a + 1);
        }
    };
    // Every mesh has another size, so that none is decomposed once for all.
    let size = 0.1 + 0.001 * k as f64;
    match k % 3 {
        0 => {
            let arc = |r: f64, i: usize| {
                let angle = std::f64::consts::PI * i as f64 / 24.0;
                [r * angle.cos(), r * angle.sin()]
            };
            let outer = (0..=24).map(|i| arc(size, i));
            let inner = (0..=24).rev().map(|i| arc(0.8 * size, i));
            strip(&outer.chain(inner).collect::<Vec<_>>(), 0.02);
        }
        1 => strip(&[[0.0, 0.0], [size, 0.0], [size, 0.5], [0.0, 0.5]], 0.02),
        _ => strip(&[[0.0, 0.0], [size, 0.0]], 0.3),
    }
    text
}

fn write_object(folder: &Path) {
    let mut links = String::from("<link name=\"body\">");
    for k in 0..200 {
        fs::write(folder.join(format!("{k}.obj")), mesh(k)).expect("a temporary file");
        if k == 100 {
            links.push_str("</link><link name=\"door\">");
        }
        for element in ["visual", "collision"] {
            let _ = write!(
                links,
                "<{element}><origin xyz=\"0 0 {}\"/><geometry><mesh filename=\"{k}.obj\"/></geometry></{element}>",
                k as f64 / 100.0
            );
        }
    }
    let joint = "<joint name=\"hinge\" type=\"revolute\"><parent link=\"body\"/><child link=\"door\"/>\
                 <axis xyz=\"0 0 1\"/><limit lower=\"0\" upper=\"1\"/></joint>";
    fs::write(folder.join("mobility.urdf"), format!("<robot name=\"r\">{links}</link>{joint}</robot>"))
        .expect("a temporary file");
}

fn load(c: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    write_object(folder.path());
    let spec = folder.path().to_str().expect("a path in UTF-8").to_owned();
    let cache = folder.path().join("cache");
    let mut group = c.benchmark_group("load an object of 200 collision meshes");
    group.sample_size(10);
    group.bench_function("cold", |b| {
        b.iter(|| {
            let _ = fs::remove_dir_all(&cache);
            object::open_with_cache(&spec, Some(&cache)).expect("a good object")
        });
    });
    group.bench_function("cached", |b| {
        b.iter(|| object::open_with_cache(&spec, Some(&cache)).expect("a good object"));
    });
    group.finish();
}

criterion_group!(benches, load);
criterion_main!(benches);
