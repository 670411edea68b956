//! The first convolution of the U-Net's steps up in training: an input that is doubled on the fly beside the encoder's,
//! and the gradient of the doubling. On every isa, where there is a choice.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use where2act_kernels::conv_train::{
    ConvShape, Part, forward, input_gradient, upsampling_gradient, weight_gradient,
};
use where2act_kernels::{Isa, KeepLarge};

/// As in training: results that the system has to clear every time would be measured with it.
#[global_allocator]
static ALLOCATOR: KeepLarge = KeepLarge::new();

/// Why nothing here fails.
const FITS: &str = "these sizes fit";

fn steps_up(c: &mut Criterion) {
    // Channels that are doubled and those beside them, the side afterwards and the outputs, 8 pictures at width 0.5: from
    // the deepest level, half way, to the full size with the picture itself beside.
    for (doubled, beside, side, outputs) in [(256, 128, 14, 128), (64, 32, 56, 32), (32, 3, 224, 32)] {
        let inputs = doubled + beside;
        let shape = ConvShape {
            batch: 8,
            inputs,
            height: side,
            width: side,
            outputs,
            kernel: 3,
            stride: 1,
            padding: 1,
        };
        let pixels = 8 * side * side;
        let (small, skip) = (vec![0.5; pixels / 4 * doubled], vec![0.5; pixels * beside]);
        let (w, dx, dy) =
            (vec![0.1; shape.weight_len()], vec![0.2; shape.input_len()], vec![0.2; shape.output_len()]);
        let parts = [
            Part { planes: &small, channels: doubled, doubled: true },
            Part { planes: &skip, channels: beside, doubled: false },
        ];
        let mut group = c.benchmark_group(format!("{doubled} doubled and {beside} at {side} to {outputs}"));
        group.throughput(Throughput::Elements((shape.output_len() * inputs * 9) as u64));
        for isa in Isa::available() {
            group.bench_function(format!("forward, {}", isa.name()), |b| {
                b.iter(|| forward(isa, &shape, black_box(&parts), &w, None).expect(FITS));
            });
            group.bench_function(format!("input gradient, {}", isa.name()), |b| {
                b.iter(|| input_gradient(isa, &shape, black_box(&dy), &w).expect(FITS));
            });
            group.bench_function(format!("weight gradient, {}", isa.name()), |b| {
                b.iter(|| weight_gradient(isa, &shape, black_box(&parts), &dy).expect(FITS));
            });
        }
        group.throughput(Throughput::Elements((pixels * doubled) as u64));
        group.bench_function("gradient of the doubling", |b| {
            b.iter(|| upsampling_gradient(black_box(&dx), [8, inputs, side, side], 0, doubled).expect(FITS));
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).measurement_time(std::time::Duration::from_millis(500)).warm_up_time(std::time::Duration::from_millis(100));
    targets = steps_up
}
criterion_main!(benches);
