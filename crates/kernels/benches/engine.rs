//! Every kernel of the prediction engine on the layers of the paper's network, per instruction set.
//!
//! `cargo bench -p where2act-kernels --bench engine --profile dev`; times per layer, throughput in multiply-adds of
//! the plain convolution.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;
use where2act_kernels::{
    Activation, Add, AlignedBuf, Blocked, Conv, Form, Head, Isa, Lookup, Mlp, MlpInput, MlpLayer, Picture,
    Source, Stem, Weights, Workspace, max_pool,
};

fn numbers(len: usize) -> Vec<f32> {
    (0..len).map(|i| (i * 7919 % 1000) as f32 / 500.0 - 1.0).collect()
}

fn maps(channels: usize, side: usize) -> Blocked {
    let mut maps = Blocked::zeros(1, channels, side, side);
    if let Ok(filled) = Blocked::from_nchw(&numbers(channels * side * side), 1, channels, side, side) {
        maps = filled;
    }
    maps
}

fn convolutions(c: &mut Criterion) {
    let direct = |size, stride| Form::Direct { size, stride, pad: size / 2 };
    // Form, channels in, channels out, side of the input: layers of the network at width 1.
    let layers = [
        (Form::Winograd4, 64, 64, 224),
        (Form::Winograd4, 64, 64, 56),
        (Form::Winograd4, 128, 128, 28),
        (Form::Winograd2, 256, 256, 14),
        (direct(3, 1), 512, 512, 7),
        (direct(3, 2), 64, 128, 56),
        (direct(1, 2), 64, 128, 56),
        (Form::UpDirect, 512, 256, 7),
        (Form::UpWinograd, 256, 128, 14),
        (Form::UpWinograd, 64, 64, 56),
    ];
    for isa in Isa::available() {
        let mut group = c.benchmark_group(format!("conv/{}", isa.name()));
        for (form, inputs, outputs, side) in layers {
            let k = form.kernel();
            let (kernel, bias) = (numbers(outputs * inputs * k * k), numbers(outputs));
            let weights = Weights { kernel: &kernel, bias: Some(&bias), outputs };
            let Ok(conv) = Conv::new(isa, form, &[Source::Plain(inputs)], weights) else { continue };
            let (input, mut output, mut workspace) =
                (maps(inputs, side), Blocked::default(), Workspace::default());
            let (height, width) = form.output_size((side, side));
            group.throughput(Throughput::Elements((height * width * inputs * outputs * k * k) as u64));
            group.bench_function(format!("{form:?} {inputs}->{outputs} at {side}"), |b| {
                b.iter(|| conv.run(black_box(&[&input]), Add::Nothing, true, &mut output, &mut workspace));
            });
        }
        group.finish();
    }
}

fn ends(c: &mut Criterion) {
    for isa in Isa::available() {
        let mut group = c.benchmark_group(format!("ends/{}", isa.name()));
        let kernel = numbers(64 * 64 * 9);
        let weights = Weights { kernel: &kernel[..64 * 3 * 49], bias: None, outputs: 64 };
        let mut picture = Picture::default();
        let mut output = Blocked::default();
        if let (Ok(stem), Ok(())) =
            (Stem::new(isa, weights, 3, 7, 2), picture.fill(&numbers(3 * 224 * 224), [1, 3, 224, 224], 3))
        {
            group.bench_function("stem 3->64 at 224", |b| {
                b.iter(|| stem.run(black_box(&picture), &mut output));
            });
        }
        let input = maps(64, 112);
        group.bench_function("max pool 64 at 112", |b| {
            b.iter(|| max_pool(isa, black_box(&input), &mut output));
        });
        let weights = Weights { kernel: &kernel, bias: None, outputs: 64 };
        if let (Ok(conv), Ok(head)) = (
            Conv::new(isa, Form::Winograd4, &[Source::Plain(64)], weights),
            Head::new(isa, &numbers(64 * 128), &[0.0; 128], 64),
        ) {
            let (input, mut features) = (maps(64, 224), AlignedBuf::zeros(224 * 224 * 128));
            group.bench_function("conv 64->64 and head 64->128 at 224", |b| {
                b.iter(|| conv.run_with_head(black_box(&[&input]), &head, &mut features));
            });
        }
        group.finish();
    }
}

fn points(c: &mut Criterion) {
    for isa in Isa::available() {
        let mut group = c.benchmark_group(format!("mlp/{}", isa.name()));
        let sizes = [(64, 64), (64, 64), (64, 128)];
        let weights: Vec<_> = sizes.iter().map(|(i, o)| numbers(i * o)).collect();
        let bias = numbers(128);
        let layer = |i: usize| MlpLayer {
            weights: if i == 0 { &weights[0][..3 * 64] } else { &weights[i] },
            bias: &bias[..sizes[i].1],
            activation: Activation::Relu,
        };
        let Ok(mlp) = Mlp::new(isa, 3, &[layer(0), layer(1), layer(2)]) else { continue };
        let (offsets, table) = (numbers(256 * 32 * 3), numbers(1024 * 64));
        let rows: Vec<i64> = (0..256 * 32).map(|i| (i * 37 % 1024) as i64).collect();
        let mut output = vec![0.0; 256 * 128];
        group.bench_function("second step down: 256 centres x 32 neighbours, 64, 64, 128", |b| {
            b.iter(|| {
                let lookup = Some(Lookup { table: &table, rows: &rows, weights: None, each: 1 });
                mlp.run(MlpInput { rows: black_box(&offsets), lookup, pool: 32 }, &mut output)
            });
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(15)
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_millis(1500));
    targets = convolutions, ends, points
}
criterion_main!(benches);
