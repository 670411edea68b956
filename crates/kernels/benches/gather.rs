//! Gathering along neighbourhoods and its gradients at the sizes of PointNet++ in training, on every isa.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use where2act_kernels::points::{Selection, gather_around, offset_gradient};
use where2act_kernels::{Isa, KeepLarge};

/// As in training: results that the system has to clear every time would be measured with it.
#[global_allocator]
static ALLOCATOR: KeepLarge = KeepLarge::new();

/// Why nothing here fails.
const FITS: &str = "these sizes fit";
/// Clouds of a step.
const CLOUDS: usize = 8;
/// Neighbours of a centre.
const NEIGHBOURS: usize = 32;

fn numbers(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i * 7919 % 1000) as f32 / 500.0 - 1.0).collect()
}

/// For each cloud `each` of its `points`, all over it as sampled points are.
fn indices(each: usize, points: usize) -> Vec<u32> {
    let of_cloud = |cloud: usize| (0..each).map(move |i| (cloud * points + i * 7919 % points) as u32);
    (0..CLOUDS).flat_map(of_cloud).collect()
}

fn steps_down(c: &mut Criterion) {
    // Points, centres and channels of the first two steps.
    for (points, centres, channels) in [(10_000, 1024, 32), (1024, 256, 64)] {
        let (inputs, rows) = (CLOUDS * points, CLOUDS * centres * NEIGHBOURS);
        let chosen = indices(centres * NEIGHBOURS, points);
        let neighbours = Selection::new(chosen, None, 1, inputs).expect(FITS);
        let (features, dy) = (numbers(inputs * channels), numbers(rows * channels));
        let (offsets, weight) = (numbers(3 * rows), numbers(3 * channels));
        let mut group = c.benchmark_group(format!("step down, {rows} of {inputs} rows x {channels}"));
        group.throughput(Throughput::Elements((rows * channels) as u64));
        for isa in Isa::available() {
            group.bench_function(format!("gather around, {}", isa.name()), |b| {
                b.iter(|| {
                    gather_around(isa, &neighbours, black_box(&offsets), &weight, &features).expect(FITS)
                });
            });
            group.bench_function(format!("scatter, {}", isa.name()), |b| {
                b.iter(|| neighbours.scatter(isa, channels, black_box(&dy)).expect(FITS));
            });
            group.bench_function(format!("offset gradient, {}", isa.name()), |b| {
                b.iter(|| offset_gradient(isa, channels, black_box(&offsets), &dy).expect(FITS));
            });
        }
    }
}

fn step_up(c: &mut Criterion) {
    // From 256 centres to 1024, each between three of them.
    let (coarse, fine, channels) = (256, 1024, 256);
    let (inputs, rows) = (CLOUDS * coarse, CLOUDS * fine);
    let weights = vec![1.0 / 3.0; 3 * rows];
    let three = Selection::new(indices(3 * fine, coarse), Some(weights), 3, inputs).expect(FITS);
    let (features, base, dy) =
        (numbers(inputs * channels), numbers(rows * channels), numbers(rows * channels));
    let mut group = c.benchmark_group(format!("step up, {rows} of {inputs} rows x {channels}"));
    group.throughput(Throughput::Elements((rows * channels) as u64));
    for isa in Isa::available() {
        group.bench_function(format!("gather, {}", isa.name()), |b| {
            b.iter(|| three.gather(isa, channels, black_box(&features), Some(&base)).expect(FITS));
        });
        group.bench_function(format!("scatter, {}", isa.name()), |b| {
            b.iter(|| three.scatter(isa, channels, black_box(&dy)).expect(FITS));
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_millis(500)).warm_up_time(std::time::Duration::from_millis(100));
    targets = steps_down, step_up
}
criterion_main!(benches);
