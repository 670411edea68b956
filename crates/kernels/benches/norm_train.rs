//! Training batch-norms at the sizes of both networks, on every isa.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use where2act_kernels::norm_train::planes::{self, Followed};
use where2act_kernels::norm_train::{Affine, Moments, pool, rows};
use where2act_kernels::{Isa, KeepLarge};

/// As in training: results that the system has to clear every time would be measured with it.
#[global_allocator]
static ALLOCATOR: KeepLarge = KeepLarge::new();

/// Why nothing here fails.
const FITS: &str = "these sizes fit";
/// Neighbours of a centre.
const NEIGHBOURS: usize = 32;

fn numbers(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i * 7919 % 1000) as f32 / 500.0 - 1.0).collect()
}

/// Those of [`numbers`].
fn moments(channels: usize) -> Moments {
    Moments { mean: vec![0.0; channels], variance: vec![1.0 / 3.0; channels] }
}

fn pictures(c: &mut Criterion) {
    // 8 pictures at width 0.5: the last step up, the first level of the encoder, its last one.
    for (channels, side, residual) in [(32, 224, false), (32, 56, true), (256, 7, true)] {
        let sizes = [8, channels, side * side];
        let len: usize = sizes.iter().product();
        let (x, dy, added) = (numbers(len), numbers(len), numbers(if residual { len } else { 0 }));
        let added = residual.then_some(added.as_slice());
        let (gamma, beta, moments) = (vec![1.0; channels], vec![0.1; channels], moments(channels));
        let affine = Affine { gamma: &gamma, beta: &beta, epsilon: 1e-5 };
        let y = planes::forward(Isa::best(), sizes, &x, added, &affine, &moments, true).expect(FITS);
        let followed = if residual { Followed::AddRelu(&y) } else { Followed::Relu(&y) };
        let mut group = c.benchmark_group(format!("planes, 8x{channels}x{side}x{side}"));
        group.throughput(Throughput::Elements(len as u64));
        for isa in Isa::available() {
            group.bench_function(format!("moments, {}", isa.name()), |b| {
                b.iter(|| planes::moments(isa, sizes, black_box(&x)).expect(FITS));
            });
            group.bench_function(format!("forward, {}", isa.name()), |b| {
                b.iter(|| {
                    planes::forward(isa, sizes, black_box(&x), added, &affine, &moments, true).expect(FITS)
                });
            });
            group.bench_function(format!("backward, {}", isa.name()), |b| {
                b.iter(|| {
                    planes::backward(isa, sizes, black_box(&dy), &x, followed, &affine, &moments).expect(FITS)
                });
            });
        }
    }
}

fn points(c: &mut Criterion) {
    // Centres of 8 clouds and channels: the first two steps down.
    for (centres, channels) in [(8 * 1024, 32), (8 * 256, 64)] {
        let len = centres * NEIGHBOURS * channels;
        let (x, dy) = (numbers(len), numbers(len));
        let (gamma, beta, moments) = (vec![1.0; channels], vec![0.1; channels], moments(channels));
        let affine = Affine { gamma: &gamma, beta: &beta, epsilon: 1e-5 };
        let mut group = c.benchmark_group(format!("rows, {}x{channels}", centres * NEIGHBOURS));
        group.throughput(Throughput::Elements(len as u64));
        for isa in Isa::available() {
            group.bench_function(format!("moments, {}", isa.name()), |b| {
                b.iter(|| rows::moments(isa, channels, black_box(&x)).expect(FITS));
            });
            group.bench_function(format!("forward, {}", isa.name()), |b| {
                b.iter(|| rows::forward(isa, black_box(&x), &affine, &moments).expect(FITS));
            });
            group.bench_function(format!("backward, {}", isa.name()), |b| {
                b.iter(|| rows::backward(isa, black_box(&dy), &x, &affine, &moments).expect(FITS));
            });
        }
    }
}

fn pools(c: &mut Criterion) {
    // The last layers of the same steps are twice as wide.
    for (centres, channels) in [(8 * 1024, 64), (8 * 256, 128)] {
        let (x, dy) = (numbers(centres * NEIGHBOURS * channels), numbers(centres * channels));
        let (gamma, beta, moments) = (vec![1.0; channels], vec![0.1; channels], moments(channels));
        let affine = Affine { gamma: &gamma, beta: &beta, epsilon: 1e-5 };
        let (_, which) = pool::forward(Isa::best(), NEIGHBOURS, &x, &affine, &moments).expect(FITS);
        let mut group =
            c.benchmark_group(format!("pools of {NEIGHBOURS}, {}x{channels}", x.len() / channels));
        group.throughput(Throughput::Elements(x.len() as u64));
        for isa in Isa::available() {
            group.bench_function(format!("forward, {}", isa.name()), |b| {
                b.iter(|| pool::forward(isa, NEIGHBOURS, black_box(&x), &affine, &moments).expect(FITS));
            });
            group.bench_function(format!("backward, {}", isa.name()), |b| {
                b.iter(|| {
                    pool::backward(isa, NEIGHBOURS, black_box(&dy), &which, &x, &affine, &moments)
                        .expect(FITS)
                });
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_millis(500)).warm_up_time(std::time::Duration::from_millis(100));
    targets = pictures, points, pools
}
criterion_main!(benches);
