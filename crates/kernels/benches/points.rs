//! Sampling and neighbourhoods at the sizes of the 3D network, on every instruction set.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use where2act_kernels::Isa;
use where2act_kernels::points::{
    Bounds, Frame, ball_query_with, furthest_point_sampling_with, in_boxes_with, three_nearest_with,
};

/// Points spread over the faces of a unit cube, in no order.
fn cloud(n: usize) -> Vec<f32> {
    let mut state = 1u64;
    let mut uniform = move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f32 / (1 << 24) as f32 - 0.5
    };
    (0..n)
        .flat_map(|i| {
            let mut p = [uniform(), uniform(), uniform()];
            p[i % 3] = p[i % 3].signum() * 0.5;
            p
        })
        .collect()
}

fn points(c: &mut Criterion) {
    let (scan, points) = (cloud(30_000), cloud(10_000));
    let centres = cloud(1024);
    let hands: Vec<Frame> = centres
        .as_chunks()
        .0
        .iter()
        .map(|&origin| Frame { origin, axes: [[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]] })
        .collect();
    let around = Bounds { min: [-0.1, -0.16, -0.2], max: [0.1, 0.16, 0.08] };
    for isa in Isa::available() {
        c.bench_function(&format!("sampling 30000 to 10000, {}", isa.name()), |b| {
            b.iter(|| furthest_point_sampling_with(isa, black_box(&scan), 10_000, 0));
        });
        c.bench_function(&format!("sampling 10000 to 1024, {}", isa.name()), |b| {
            b.iter(|| furthest_point_sampling_with(isa, black_box(&points), 1024, 0));
        });
        c.bench_function(&format!("ball query 1024 in 10000, {}", isa.name()), |b| {
            b.iter(|| ball_query_with(isa, black_box(&points), black_box(&centres), 0.1, 32));
        });
        c.bench_function(&format!("boxes of 1024 hands in 10000, {}", isa.name()), |b| {
            b.iter(|| in_boxes_with(isa, black_box(&points), black_box(&hands), &around, 48));
        });
        c.bench_function(&format!("three nearest 10000 in 1024, {}", isa.name()), |b| {
            b.iter(|| three_nearest_with(isa, black_box(&points), black_box(&centres)));
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_secs(1));
    targets = points
}
criterion_main!(benches);
