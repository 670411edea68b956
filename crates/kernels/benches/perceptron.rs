//! The heads' hidden layer and few outputs, as decoding runs them with the weights of the repository, on every isa.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use where2act_kernels::{Isa, Perceptron};

/// Why nothing here fails.
const FITS: &str = "these sizes fit";
/// Hidden units of a head.
const HIDDEN: usize = 256;
/// Orientations tried at a candidate, in whole vectors.
const SAMPLES: usize = 112;

fn numbers(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i * 7919 % 1000) as f32 / 500.0 - 1.0).collect()
}

/// Parameters of a head, to be borrowed.
struct Head {
    first: Vec<f32>,
    start: Vec<f32>,
    second: Vec<f32>,
    bias: Vec<f32>,
}

impl Head {
    fn new(inputs: usize, outputs: usize) -> Self {
        Self {
            first: numbers(inputs * HIDDEN),
            start: numbers(HIDDEN),
            second: numbers(outputs * HIDDEN),
            bias: numbers(outputs),
        }
    }

    fn net(&self) -> Perceptron<'_> {
        Perceptron {
            first: &self.first,
            start: &self.start,
            slope: 0.01,
            second: &self.second,
            bias: &self.bias,
        }
    }
}

/// Actionability of every pixel of `weights/rgb` and every point of `weights/cloud`.
fn maps(c: &mut Criterion) {
    for (count, inputs, outputs) in [(224 * 224, 32, 6), (4096, 128, 6)] {
        let head = Head::new(inputs, outputs);
        let (rows, mut logits) = (numbers(count * inputs), vec![0.0; count * outputs]);
        let mut group = c.benchmark_group(format!("{count} rows, {inputs} to {HIDDEN} to {outputs}"));
        group.throughput(Throughput::Elements((count * (inputs + outputs) * HIDDEN) as u64));
        for isa in Isa::available() {
            group.bench_function(isa.name(), |b| {
                let all = 0..count;
                b.iter(|| {
                    head.net()
                        .rows(isa, black_box(&rows), std::slice::from_ref(&all), &mut logits)
                        .expect(FITS);
                });
            });
        }
    }
}

/// What is tried at one candidate: the codes' proposals, where the hidden layer is a sum, and the score of each.
fn tries(c: &mut Criterion) {
    for (what, inputs, outputs) in [("proposals", 0, 6), ("scores", 9, 1)] {
        let head = Head::new(inputs, outputs);
        let columns = numbers(inputs * SAMPLES);
        let codes = numbers(HIDDEN * SAMPLES);
        let added = (inputs == 0).then_some(codes.as_slice());
        let mut found = vec![0.0; outputs * SAMPLES];
        let mut group = c.benchmark_group(format!("{what}, {SAMPLES} columns, {HIDDEN} to {outputs}"));
        for isa in Isa::available() {
            group.bench_function(isa.name(), |b| {
                b.iter(|| {
                    head.net().columns(isa, black_box(&columns), added, &mut found).expect(FITS);
                });
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_millis(500)).warm_up_time(std::time::Duration::from_millis(100));
    targets = maps, tries
}
criterion_main!(benches);
