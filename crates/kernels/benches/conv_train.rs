//! Training convolutions at the sizes of the U-Net, on every isa.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use where2act_kernels::Isa;
use where2act_kernels::conv_train::{ConvShape, Part, forward, input_gradient, weight_gradient};

fn convolutions(c: &mut Criterion) {
    // (inputs, side, outputs, kernel, stride), batch 8: decoder, encoder, the deepest level, the first layer.
    for (inputs, side, outputs, kernel, stride) in [
        (64, 112, 64, 3, 1),
        (128, 28, 128, 3, 1),
        (512, 7, 512, 3, 1),
        (64, 56, 128, 3, 2),
        (3, 224, 64, 7, 2),
    ] {
        let shape = ConvShape {
            batch: 8,
            inputs,
            height: side,
            width: side,
            outputs,
            kernel,
            stride,
            padding: kernel / 2,
        };
        let (x, w, dy) =
            (vec![0.5; shape.input_len()], vec![0.1; shape.weight_len()], vec![0.2; shape.output_len()]);
        let mut group = c.benchmark_group(format!("{inputs}x{side}x{side} to {outputs}, {kernel}/{stride}"));
        group.throughput(Throughput::Elements((shape.output_len() * inputs * kernel * kernel) as u64));
        for isa in Isa::available().into_iter().chain(Isa::bf16()) {
            let parts = [Part { planes: &x, channels: inputs, doubled: false }];
            group.bench_function(format!("forward, {}", isa.name()), |b| {
                b.iter(|| forward(isa, &shape, black_box(&parts), &w, None));
            });
            group.bench_function(format!("input gradient, {}", isa.name()), |b| {
                b.iter(|| input_gradient(isa, &shape, black_box(&dy), &w));
            });
            group.bench_function(format!("weight gradient, {}", isa.name()), |b| {
                b.iter(|| weight_gradient(isa, &shape, black_box(&parts), &dy));
            });
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_millis(500)).warm_up_time(std::time::Duration::from_millis(100));
    targets = convolutions
}
criterion_main!(benches);
