//! Training convolutions against plain loops in f64, on every isa, over odd sizes.

use proptest::prelude::*;
use where2act_kernels::Isa;
use where2act_kernels::conv_train::{
    ConvShape, Part, forward, input_gradient, upsampling_gradient, weight_gradient,
};

/// Values in (-1, 1).
fn noise(len: usize, seed: u64) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f32 / 8_388_608.0 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

/// Every instruction set, products in bf16 included.
fn every_isa() -> impl Iterator<Item = Isa> {
    Isa::available().into_iter().chain(Isa::bf16())
}

/// Calls `f(output index, input index, weight index)` for every product of the convolution.
fn products(s: &ConvShape, mut f: impl FnMut(usize, usize, usize)) {
    let (oh, ow, k) = (s.out_height(), s.out_width(), s.kernel);
    for n in 0..s.batch {
        for o in 0..s.outputs {
            for (y, x) in (0..oh).flat_map(|y| (0..ow).map(move |x| (y, x))) {
                for c in 0..s.inputs {
                    for (ky, kx) in (0..k).flat_map(|ky| (0..k).map(move |kx| (ky, kx))) {
                        let (iy, ix) = (
                            (y * s.stride + ky).wrapping_sub(s.padding),
                            (x * s.stride + kx).wrapping_sub(s.padding),
                        );
                        if iy < s.height && ix < s.width {
                            f(
                                ((n * s.outputs + o) * oh + y) * ow + x,
                                ((n * s.inputs + c) * s.height + iy) * s.width + ix,
                                ((o * s.inputs + c) * k + ky) * k + kx,
                            );
                        }
                    }
                }
            }
        }
    }
}

/// Whether sums of so many products within [-1, 1] are the expected ones: relative to the largest, or to what such sums
/// usually are should all of them happen to be small.
fn close(
    name: &str,
    isa: Isa,
    found: &[f32],
    expected: &[f64],
    products: usize,
) -> Result<(), TestCaseError> {
    prop_assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold((products as f64).sqrt().max(1.0), |m: f64, v| m.max(v.abs()));
    // bf16 rounds both operands by up to 2^-9.
    let tolerance = if isa == isa.exact() { 1e-5 } else { 8e-3 };
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        prop_assert!(
            (f64::from(*a) - b).abs() <= tolerance * scale,
            "{name} on {}, value {i}: {a}, expected {b}",
            isa.name()
        );
    }
    Ok(())
}

fn check(shape: ConvShape, seed: u64) -> Result<(), TestCaseError> {
    let (x, w) = (noise(shape.input_len(), seed), noise(shape.weight_len(), seed + 1));
    let (b, dy) = (noise(shape.outputs, seed + 2), noise(shape.output_len(), seed + 3));
    let pixels = shape.out_height() * shape.out_width();
    let mut y: Vec<f64> = (0..dy.len()).map(|i| f64::from(b[i / pixels % shape.outputs])).collect();
    let (mut dx, mut dw) = (vec![0.0; x.len()], vec![0.0; w.len()]);
    products(&shape, |o, i, k| {
        y[o] += f64::from(x[i]) * f64::from(w[k]);
        dx[i] += f64::from(dy[o]) * f64::from(w[k]);
        dw[k] += f64::from(dy[o]) * f64::from(x[i]);
    });
    let mut db = vec![0.0; shape.outputs];
    dy.iter().enumerate().for_each(|(i, dy)| db[i / pixels % shape.outputs] += f64::from(*dy));
    let fails = |error| TestCaseError::fail(format!("{error}"));
    let window = shape.kernel * shape.kernel;
    for isa in every_isa() {
        let parts = [Part { planes: &x, channels: shape.inputs, doubled: false }];
        close(
            "forward",
            isa,
            &forward(isa, &shape, &parts, &w, Some(&b)).map_err(fails)?,
            &y,
            shape.inputs * window,
        )?;
        close(
            "input gradient",
            isa,
            &input_gradient(isa, &shape, &dy, &w).map_err(fails)?,
            &dx,
            shape.outputs * window,
        )?;
        close(
            "weight gradient",
            isa,
            &weight_gradient(isa, &shape, &parts, &dy).map_err(fails)?,
            &dw,
            shape.batch * pixels,
        )?;
    }
    Ok(())
}

fn shapes() -> impl Strategy<Value = ConvShape> {
    (1usize..4, 1usize..20, 1usize..40, 1usize..40, 1usize..20, 1usize..8, 1usize..4, 0usize..5)
        .prop_map(|(batch, inputs, height, width, outputs, kernel, stride, padding)| ConvShape {
            batch,
            inputs,
            height,
            width,
            outputs,
            kernel,
            stride,
            padding,
        })
        .prop_filter("has an output", ConvShape::is_valid)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]
    #[test]
    fn any_shape_equals_the_plain_loops(shape in shapes(), seed in 0u64..1000) {
        check(shape, seed)?;
    }
}

#[test]
fn shapes_of_the_network_equal_the_plain_loops() {
    // Rows split into portions; images taken together; 7x7 with stride 2; 1x1 with stride 2.
    for (batch, inputs, side, outputs, kernel, stride) in [
        (1, 5, 97, 9, 3, 1),
        (9, 16, 7, 24, 3, 1),
        (2, 3, 64, 8, 7, 2),
        (3, 8, 28, 16, 1, 2),
        (2, 4, 70, 4, 3, 2),
    ] {
        let shape = ConvShape {
            batch,
            inputs,
            height: side,
            width: side,
            outputs,
            kernel,
            stride,
            padding: kernel / 2,
        };
        check(shape, 5).unwrap();
    }
}

#[test]
fn strides_that_outreach_the_picture_equal_the_plain_loops() {
    // The first is the shape that the property test once found: planes of the stride that hold no row of the picture.
    for (kernel, stride, padding, height, width) in
        [(1, 3, 0, 1, 1), (1, 3, 0, 2, 1), (2, 3, 1, 1, 1), (3, 3, 4, 1, 2), (1, 2, 0, 1, 9), (1, 3, 2, 1, 1)]
    {
        for batch in [1, 3] {
            let shape = ConvShape { batch, inputs: 2, height, width, outputs: 9, kernel, stride, padding };
            check(shape, 7).unwrap();
        }
    }
}

#[test]
fn parts_equal_their_concatenation() {
    for (height, width, kernel, stride, padding) in
        [(12, 20, 3, 1, 1), (8, 8, 1, 1, 0), (10, 6, 3, 2, 1), (6, 8, 5, 1, 0)]
    {
        let (batch, up, skip) = (3, 5, 4);
        let small = noise(batch * up * height * width / 4, 1);
        let same = noise(batch * skip * height * width, 2);
        let mut whole = Vec::new();
        for n in 0..batch {
            for c in 0..up {
                let plane = &small[(n * up + c) * height * width / 4..];
                whole.extend((0..height * width).map(|i| plane[i / width / 2 * (width / 2) + i % width / 2]));
            }
            whole.extend(&same[n * skip * height * width..(n + 1) * skip * height * width]);
        }
        let shape =
            ConvShape { batch, inputs: up + skip, height, width, outputs: 7, kernel, stride, padding };
        let (w, dy) = (noise(shape.weight_len(), 3), noise(shape.output_len(), 4));
        let parts = [
            Part { planes: &small, channels: up, doubled: true },
            Part { planes: &same, channels: skip, doubled: false },
        ];
        let one = [Part { planes: &whole, channels: up + skip, doubled: false }];
        for isa in every_isa() {
            assert_eq!(forward(isa, &shape, &parts, &w, None), forward(isa, &shape, &one, &w, None));
            assert_eq!(weight_gradient(isa, &shape, &parts, &dy), weight_gradient(isa, &shape, &one, &dy));
        }
    }
}

#[test]
fn upsampling_gradient_sums_two_by_two() {
    let (batch, all, height, width, first, channels) = (2, 5, 6, 4, 1, 3);
    let gradient = noise(batch * all * height * width, 1);
    let sums = upsampling_gradient(&gradient, [batch, all, height, width], first, channels).unwrap();
    let mut expected = vec![0.0; sums.len()];
    for n in 0..batch {
        for c in 0..channels {
            for i in 0..height * width {
                let to = ((n * channels + c) * height / 2 + i / width / 2) * width / 2 + i % width / 2;
                expected[to] += gradient[(n * all + first + c) * height * width + i];
            }
        }
    }
    for (a, b) in sums.iter().zip(&expected) {
        assert!((a - b).abs() < 1e-6);
    }
}

/// Whole numbers that bf16 holds and whose sums f32 holds: nothing may differ.
#[test]
fn bf16_rounds_nothing_but_the_operands() {
    let Some(isa) = Isa::bf16() else { return };
    for (inputs, kernel, stride) in [(5, 3, 1), (6, 3, 2), (3, 7, 2), (1, 1, 1)] {
        let shape = ConvShape {
            batch: 2,
            inputs,
            height: 21,
            width: 34,
            outputs: 11,
            kernel,
            stride,
            padding: kernel / 2,
        };
        let whole = |len, seed| noise(len, seed).into_iter().map(|x| (x * 3.0).round()).collect::<Vec<f32>>();
        let (x, w, dy) =
            (whole(shape.input_len(), 1), whole(shape.weight_len(), 2), whole(shape.output_len(), 3));
        let parts = [Part { planes: &x, channels: inputs, doubled: false }];
        let exact = isa.exact();
        assert_eq!(forward(isa, &shape, &parts, &w, None), forward(exact, &shape, &parts, &w, None));
        assert_eq!(input_gradient(isa, &shape, &dy, &w), input_gradient(exact, &shape, &dy, &w));
        assert_eq!(weight_gradient(isa, &shape, &parts, &dy), weight_gradient(exact, &shape, &parts, &dy));
    }
    // And it does round.
    let shape =
        ConvShape { batch: 1, inputs: 2, height: 4, width: 4, outputs: 1, kernel: 1, stride: 1, padding: 0 };
    let (x, w) = (noise(shape.input_len(), 1), noise(shape.weight_len(), 2));
    let parts = [Part { planes: &x, channels: 2, doubled: false }];
    assert_ne!(forward(isa, &shape, &parts, &w, None), forward(isa.exact(), &shape, &parts, &w, None));
}

#[test]
fn threads_do_not_change_a_bit() {
    let shape = ConvShape {
        batch: 3,
        inputs: 20,
        height: 37,
        width: 41,
        outputs: 33,
        kernel: 3,
        stride: 1,
        padding: 1,
    };
    let (x, w, dy) =
        (noise(shape.input_len(), 1), noise(shape.weight_len(), 2), noise(shape.output_len(), 3));
    let parts = [Part { planes: &x, channels: shape.inputs, doubled: false }];
    let run = |isa: Isa, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            (
                forward(isa, &shape, &parts, &w, None),
                input_gradient(isa, &shape, &dy, &w),
                weight_gradient(isa, &shape, &parts, &dy),
            )
        })
    };
    for isa in every_isa() {
        let one = run(isa, 1);
        for threads in [2, 3, 7] {
            assert_eq!(run(isa, threads), one, "{threads} threads on {}", isa.name());
        }
    }
}

#[test]
fn wrong_sizes_are_errors() {
    let shape =
        ConvShape { batch: 1, inputs: 2, height: 4, width: 4, outputs: 3, kernel: 3, stride: 1, padding: 1 };
    let (x, w, dy) = (vec![0.0; 32], vec![0.0; 54], vec![0.0; 48]);
    let isa = Isa::best();
    let part = |planes, channels, doubled| [Part { planes, channels, doubled }];
    assert!(forward(isa, &shape, &part(&x, 2, false), &w, None).is_ok());
    assert!(forward(isa, &shape, &part(&x[1..], 2, false), &w, None).is_err());
    assert!(forward(isa, &shape, &part(&x, 3, false), &w, None).is_err());
    assert!(forward(isa, &shape, &part(&x, 2, true), &w, None).is_err());
    assert!(forward(isa, &shape, &part(&x, 2, false), &w[1..], None).is_err());
    assert!(forward(isa, &shape, &part(&x, 2, false), &w, Some(&[0.0; 2])).is_err());
    assert!(input_gradient(isa, &shape, &dy[1..], &w).is_err());
    assert!(weight_gradient(isa, &shape, &part(&x, 2, false), &dy[1..]).is_err());
    let none = ConvShape { kernel: 7, ..shape };
    assert!(forward(isa, &none, &part(&x, 2, false), &vec![0.0; 294], None).is_err());
    assert!(upsampling_gradient(&dy, [1, 3, 4, 4], 1, 3).is_err());
    assert!(upsampling_gradient(&dy, [1, 3, 16, 1], 0, 3).is_err());
}
