//! Every form on every instruction set against naive loops in f64.

use super::*;
use crate::testing::noise;
use proptest::prelude::*;

/// Values `[images, channels, height, width]` in f64.
#[derive(Clone)]
struct Naive {
    shape: [usize; 4],
    values: Vec<f64>,
}

impl Naive {
    fn new(shape: [usize; 4], values: &[f32]) -> Self {
        Self { shape, values: values.iter().map(|x| f64::from(*x)).collect() }
    }

    fn at(&self, image: usize, c: usize, y: isize, x: isize) -> f64 {
        let [_, channels, height, width] = self.shape;
        if y < 0 || x < 0 || y >= height as isize || x >= width as isize {
            return 0.0;
        }
        self.values[((image * channels + c) * height + y as usize) * width + x as usize]
    }

    fn map(shape: [usize; 4], f: impl Fn(usize, usize, isize, isize) -> f64) -> Self {
        let mut values = Vec::new();
        for image in 0..shape[0] {
            for c in 0..shape[1] {
                for y in 0..shape[2] {
                    values.extend((0..shape[3]).map(|x| f(image, c, y as isize, x as isize)));
                }
            }
        }
        Self { shape, values }
    }

    fn upsampled(&self) -> Self {
        let [images, channels, height, width] = self.shape;
        Self::map([images, channels, 2 * height, 2 * width], |i, c, y, x| self.at(i, c, y / 2, x / 2))
    }

    fn beside(&self, other: &Self) -> Self {
        let [images, channels, height, width] = self.shape;
        Self::map([images, channels + other.shape[1], height, width], |i, c, y, x| {
            if c < channels { self.at(i, c, y, x) } else { other.at(i, c - channels, y, x) }
        })
    }

    fn conv(&self, weights: Weights<'_>, size: usize, stride: usize, pad: usize) -> Self {
        let [images, channels, height, width] = self.shape;
        let (out_height, out_width) = Form::Direct { size, stride, pad }.output_size((height, width));
        Self::map([images, weights.outputs, out_height, out_width], |image, n, y, x| {
            let mut sum = weights.bias.map_or(0.0, |bias| f64::from(bias[n]));
            for c in 0..channels {
                for k in 0..size * size {
                    let shift = |k: usize| k as isize - pad as isize;
                    let pixel = self.at(
                        image,
                        c,
                        y * stride as isize + shift(k / size),
                        x * stride as isize + shift(k % size),
                    );
                    sum += pixel * f64::from(weights.kernel[(n * channels + c) * size * size + k]);
                }
            }
            sum
        })
    }

    fn finish(mut self, add: Option<&[f32]>, relu: bool) -> Self {
        if let Some(add) = add {
            self.values.iter_mut().zip(add).for_each(|(x, add)| *x += f64::from(*add));
        }
        if relu {
            self.values.iter_mut().for_each(|x| *x = x.max(0.0));
        }
        self
    }

    /// Largest difference over largest value.
    fn error(&self, found: &[f32]) -> f64 {
        assert_eq!(self.values.len(), found.len());
        let largest = self.values.iter().fold(1e-3_f64, |a, b| a.max(b.abs()));
        let difference = |(a, b): (&f64, &f32)| {
            let d = (a - f64::from(*b)).abs();
            if d.is_nan() { f64::INFINITY } else { d }
        };
        self.values.iter().zip(found).map(difference).fold(0.0, f64::max) / largest
    }
}

/// What a form computes, by definition.
fn expected(form: Form, inputs: &[Naive], weights: Weights<'_>) -> Naive {
    match form {
        Form::Direct { size, stride, pad } => {
            let all = inputs[1..].iter().fold(inputs[0].clone(), |all, next| all.beside(next));
            all.conv(weights, size, stride, pad)
        }
        Form::Winograd2 | Form::Winograd4 => {
            expected(Form::Direct { size: 3, stride: 1, pad: 1 }, inputs, weights)
        }
        Form::UpDirect | Form::UpWinograd => {
            let large: Vec<Naive> = inputs.iter().map(Naive::upsampled).collect();
            expected(Form::Winograd2, &large, weights)
        }
    }
}

/// Largest difference to expect over the largest value. bf16 rounds both operands by up to 2^-9.
fn tolerance(isa: Isa) -> f64 {
    if isa == isa.exact() { 1e-5 } else { 1e-2 }
}

/// Every instruction set, products in bf16 included.
fn all() -> impl Iterator<Item = Isa> {
    Isa::available().into_iter().chain(Isa::bf16())
}

fn forms() -> impl Strategy<Value = Form> {
    prop_oneof![
        (1..=7_usize, 1..=3_usize, 0..=3_usize).prop_map(|(size, stride, pad)| Form::Direct {
            size,
            stride,
            pad: pad.min(size - 1)
        }),
        Just(Form::Winograd2),
        Just(Form::Winograd4),
        Just(Form::UpDirect),
        Just(Form::UpWinograd),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    /// Odd sizes, channels off the blocks, several sources, batches, every way of finishing.
    #[test]
    fn every_form_equals_naive_loops(
        form in forms(),
        images in 1..=3_usize,
        channels in prop::collection::vec(1..34_usize, 1..=2),
        outputs in 1..100_usize,
        height in 1..20_usize,
        width in 1..20_usize,
        add in 0..3_u8,
        relu: bool,
        whole_numbers: bool,
        seed: u64,
    ) {
        let size = form.kernel();
        let noise = if whole_numbers { whole } else { noise };
        let inner: usize = channels.iter().sum();
        let kernel = noise(outputs * inner * size * size, seed);
        let bias = noise(outputs, seed ^ 1);
        let weights = Weights { kernel: &kernel, bias: Some(&bias), outputs };
        let inputs: Vec<Vec<f32>> = channels
            .iter()
            .enumerate()
            .map(|(i, c)| noise(images * c * height * width, seed ^ (2 + i as u64)))
            .collect();
        let naive: Vec<Naive> = channels
            .iter()
            .zip(&inputs)
            .map(|(c, values)| Naive::new([images, *c, height, width], values))
            .collect();
        let blocked: Vec<Blocked> = channels
            .iter()
            .zip(&inputs)
            .map(|(c, values)| Blocked::from_nchw(values, images, *c, height, width).unwrap())
            .collect();
        let blocked: Vec<&Blocked> = blocked.iter().collect();
        let expected = expected(form, &naive, weights);
        let [_, _, out_height, out_width] = expected.shape;
        let extra = noise(expected.values.len(), seed ^ 9);
        let extra_maps = Blocked::from_nchw(&extra, images, outputs, out_height, out_width).unwrap();
        let expected = expected.finish((add > 0).then_some(&extra), relu);
        let sources: Vec<Source> = channels.iter().map(|c| Source::Plain(*c)).collect();
        // F(4, 3) has irrational points.
        let exact = whole_numbers && form != Form::Winograd4;
        for isa in Isa::available().into_iter().chain(Isa::bf16().filter(|_| exact)) {
            let conv = Conv::new(isa, form, &sources, weights).unwrap();
            let (mut output, mut workspace) = (Blocked::default(), Workspace::default());
            let add = match add {
                0 => Add::Nothing,
                1 => Add::Maps(&extra_maps),
                _ => {
                    output = extra_maps.clone();
                    Add::Output
                }
            };
            conv.run(&blocked, add, relu, &mut output, &mut workspace).unwrap();
            let error = expected.error(&output.to_nchw());
            let limit = if isa == isa.exact() { 2e-5 } else { 0.0 };
            prop_assert!(error <= limit, "{} {form:?}: error {error:e}", isa.name());
        }
    }
}

/// Whole numbers from -3 to 3. The sums of them and the quarters that F(2, 3) and F(3, 2) make have few enough bits for bf16.
fn whole(len: usize, seed: u64) -> Vec<f32> {
    noise(len, seed).into_iter().map(|x| (3.0 * x).round()).collect()
}

/// With bf16 every form but F(4, 3), whose points are irrational, gets sums of such numbers exactly; that one comes near.
#[test]
fn bf16_rounds_nothing_but_the_operands() {
    let Some(isa) = Isa::bf16() else { return };
    for (form, c, n, height, width, images) in [
        (Form::Direct { size: 3, stride: 2, pad: 1 }, 33, 40, 15, 9, 2),
        (Form::Direct { size: 1, stride: 1, pad: 0 }, 7, 16, 5, 4, 1),
        (Form::Winograd2, 20, 160, 14, 14, 1),
        (Form::UpWinograd, 19, 32, 11, 13, 2),
        (Form::UpDirect, 48, 24, 7, 7, 1),
        (Form::Winograd4, 32, 48, 50, 30, 1),
    ] {
        let size = form.kernel();
        let values = whole(images * c * height * width, 1);
        let (kernel, bias) = (whole(n * c * size * size, 2), whole(n, 3));
        let weights = Weights { kernel: &kernel, bias: Some(&bias), outputs: n };
        let naive = expected(form, &[Naive::new([images, c, height, width], &values)], weights);
        let input = Blocked::from_nchw(&values, images, c, height, width).unwrap();
        let conv = Conv::new(isa, form, &[Source::Plain(c)], weights).unwrap();
        let mut output = Blocked::default();
        conv.run(&[&input], Add::Nothing, false, &mut output, &mut Workspace::default()).unwrap();
        let error = naive.error(&output.to_nchw());
        // F(4, 3) rounds its operands to 2^-9 and sums many of them.
        let limit = if form == Form::Winograd4 { 2e-2 } else { 0.0 };
        assert!(error <= limit, "{form:?}: {error:e}");
        if form != Form::Winograd4 {
            continue;
        }
        assert!(error > 1e-5, "not computed with bf16");
        let (head, none) = (whole(32 * n, 4), vec![0.0; 32]);
        let last = Weights { kernel: &head, bias: None, outputs: 32 };
        let out = naive.finish(None, true).conv(last, 1, 1, 0);
        let pixels = Naive::map([images, height * width, 32, 1], |i, p, c, _| {
            out.at(i, c as usize, (p / width) as isize, (p % width) as isize)
        });
        let mut found = AlignedBuf::zeros(images * height * width * 32);
        conv.run_with_head(&[&input], &Head::new(isa, &head, &none, n).unwrap(), &mut found).unwrap();
        let error = pixels.error(&found);
        assert!(error < 2e-2, "head: {error:e}");
    }
}

/// Both schedules (by tiles, by panels) of large layers, with the same bits on one thread and on three.
#[test]
fn schedules_and_threads_do_not_change_a_bit() {
    for (form, c, n, side, images) in [
        (Form::Winograd4, 32, 48, 50, 1),
        (Form::Winograd2, 64, 160, 14, 1),
        (Form::UpWinograd, 32, 32, 30, 2),
        (Form::UpDirect, 48, 128, 7, 1),
        (Form::Direct { size: 3, stride: 2, pad: 1 }, 32, 128, 15, 1),
    ] {
        let values = noise(images * c * side * side, 1);
        let input = Blocked::from_nchw(&values, images, c, side, side).unwrap();
        let kernel = noise(n * c * 9, 2);
        let weights = Weights { kernel: &kernel, bias: None, outputs: n };
        let naive = expected(form, &[Naive::new([images, c, side, side], &values)], weights);
        let conv = Conv::new(Isa::best(), form, &[Source::Plain(c)], weights).unwrap();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut output = Blocked::default();
            pool.install(|| conv.run(&[&input], Add::Nothing, false, &mut output, &mut Workspace::default()))
                .unwrap();
            output.to_nchw()
        };
        let one = run(1);
        assert!(naive.error(&one) < 2e-5, "{form:?}");
        assert!(one == run(3), "{form:?}");
    }
}

/// A picture's own channels beside upsampled ones.
#[test]
fn split_channels_are_not_upsampled() {
    let (images, c, n, height, width) = (2, 20, 24, 7, 9);
    let (low, picture) = (noise(images * c * height * width, 1), noise(images * 3 * 4 * height * width, 2));
    let kernel = noise(n * (c + 3) * 9, 3);
    let weights = Weights { kernel: &kernel, bias: None, outputs: n };
    let large = Naive::new([images, c, height, width], &low)
        .upsampled()
        .beside(&Naive::new([images, 3, 2 * height, 2 * width], &picture))
        .conv(weights, 3, 1, 1);
    let low = Blocked::from_nchw(&low, images, c, height, width).unwrap();
    let (mut staged, mut split) = (Picture::default(), Blocked::default());
    staged.fill(&picture, [images, 3, 2 * height, 2 * width], 3).unwrap();
    staged.split(&mut split);
    for isa in all() {
        let conv = Conv::new(isa, Form::UpWinograd, &[Source::Plain(c), Source::Split(3)], weights).unwrap();
        let mut output = Blocked::default();
        conv.run(&[&low, &split], Add::Nothing, false, &mut output, &mut Workspace::default()).unwrap();
        assert!(large.error(&output.to_nchw()) < tolerance(isa), "{}", isa.name());
    }
}

#[test]
fn stem_equals_naive_loops() {
    for (images, channels, size, stride, height, width, n) in
        [(1, 3, 7, 2, 32, 32, 64), (2, 3, 7, 2, 13, 18, 16), (1, 1, 3, 1, 5, 4, 20), (2, 4, 5, 3, 9, 30, 32)]
    {
        let values = noise(images * channels * height * width, 1);
        let (kernel, bias) = (noise(n * channels * size * size, 2), noise(n, 3));
        let weights = Weights { kernel: &kernel, bias: Some(&bias), outputs: n };
        let expected = Naive::new([images, channels, height, width], &values)
            .conv(weights, size, stride, size / 2)
            .finish(None, true);
        let mut picture = Picture::default();
        picture.fill(&values, [images, channels, height, width], size / 2).unwrap();
        for isa in all() {
            let stem = Stem::new(isa, weights, channels, size, stride).unwrap();
            let mut output = Blocked::default();
            stem.run(&picture, &mut output).unwrap();
            assert!(expected.error(&output.to_nchw()) < tolerance(isa), "{} {size}", isa.name());
        }
    }
}

#[test]
fn head_writes_pixels() {
    for (form, images, c, n, height, width) in [
        (Form::Winograd4, 1, 32, 32, 32, 32),
        (Form::Winograd4, 2, 16, 24, 13, 30),
        (Form::Winograd2, 1, 20, 16, 9, 7),
        (Form::Direct { size: 3, stride: 1, pad: 1 }, 1, 16, 16, 6, 6),
    ] {
        let values = noise(images * c * height * width, 1);
        let (kernel, bias) = (noise(n * c * 9, 2), noise(n, 3));
        let (head, head_bias) = (noise(48 * n, 4), noise(48, 5));
        let weights = Weights { kernel: &kernel, bias: Some(&bias), outputs: n };
        let features =
            expected(form, &[Naive::new([images, c, height, width], &values)], weights).finish(None, true);
        let last = Weights { kernel: &head, bias: Some(&head_bias), outputs: 48 };
        let out = features.conv(last, 1, 1, 0);
        // Pixel-major.
        let pixels = Naive::map([images, height * width, 48, 1], |i, p, c, _| {
            out.at(i, c as usize, (p / width) as isize, (p % width) as isize)
        });
        let input = Blocked::from_nchw(&values, images, c, height, width).unwrap();
        for isa in all() {
            let conv = Conv::new(isa, form, &[Source::Plain(c)], weights).unwrap();
            let head = Head::new(isa, &head, &head_bias, n).unwrap();
            let mut aligned = AlignedBuf::zeros(images * height * width * 48);
            conv.run_with_head(&[&input], &head, &mut aligned).unwrap();
            // Two layers, the first of which may be F(4, 3).
            assert!(pixels.error(&aligned) < 2.0 * tolerance(isa), "{} {form:?}", isa.name());
            let mut odd = vec![0.0; images * height * width * 48 + 1];
            conv.run_with_head(&[&input], &head, &mut odd[1..]).unwrap();
            assert_eq!(odd[1..], aligned[..]);
        }
    }
}

#[test]
fn wrong_shapes_are_refused() {
    let isa = Isa::best();
    let kernel = noise(16 * 16 * 9, 1);
    let weights = Weights { kernel: &kernel, bias: None, outputs: 16 };
    assert!(Conv::new(isa, Form::Winograd4, &[Source::Plain(17)], weights).is_err());
    assert!(
        Conv::new(isa, Form::Winograd4, &[Source::Plain(16)], Weights { bias: Some(&[0.0]), ..weights })
            .is_err()
    );
    let split = Weights { kernel: &kernel[..16 * 4 * 9], ..weights };
    for form in
        [Form::Winograd2, Form::Winograd4, Form::UpDirect, Form::Direct { size: 3, stride: 1, pad: 1 }]
    {
        assert!(Conv::new(isa, form, &[Source::Split(4)], split).is_err(), "{form:?} reads no split source");
    }
    let still = Form::Direct { size: 3, stride: 0, pad: 1 };
    assert!(Conv::new(isa, still, &[Source::Plain(16)], weights).is_err());
    assert!(Blocked::from_nchw(&[], 1 << 59, 16, 2, 2).is_err());
    assert!(Picture::default().fill(&[], [1 << 58, 1, 8, 8], 3).is_err());
    assert!(Picture::default().fill(&[], [1 << 62, 1, 0, 0], 3).is_err());
    let conv = Conv::new(isa, Form::Winograd4, &[Source::Plain(16)], weights).unwrap();
    let (good, bad) = (Blocked::zeros(1, 16, 8, 8), Blocked::zeros(1, 32, 8, 8));
    let mut workspace = Workspace::default();
    let mut output = Blocked::default();
    assert!(conv.run(&[&bad], Add::Nothing, true, &mut output, &mut workspace).is_err());
    assert!(conv.run(&[&good, &good], Add::Nothing, true, &mut output, &mut workspace).is_err());
    assert!(conv.run(&[&good], Add::Maps(&bad), true, &mut output, &mut workspace).is_err());
    assert!(conv.run(&[&good], Add::Output, true, &mut output, &mut workspace).is_err());
    assert!(Head::new(isa, &[0.0; 20], &[0.0; 10], 2).is_err());
    let head = Head::new(isa, &[0.0; 16 * 16], &[0.0; 16], 16).unwrap();
    assert!(conv.run_with_head(&[&good], &head, &mut [0.0; 7]).is_err());
    let of_another = Head::new(Isa::PORTABLE, &[0.0; 16 * 16], &[0.0; 16], 16).unwrap();
    let (same, mut pixels) = (isa == Isa::PORTABLE, vec![0.0; 16 * 64]);
    assert_eq!(conv.run_with_head(&[&good], &of_another, &mut pixels).is_ok(), same);
}
