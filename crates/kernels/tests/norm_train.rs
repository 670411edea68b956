//! Batch-norms of training and their gradients against the textbook's formulas in f64, on every isa, over odd sizes.

use proptest::prelude::*;
use where2act_kernels::Isa;
use where2act_kernels::norm_train::planes::{self, Followed};
use where2act_kernels::norm_train::{Affine, Gradients, Moments, pool, rows};

const EPSILON: f32 = 1e-5;
/// Of the largest value: what sums of a few thousand products in f32 may be off by.
const TOLERANCE: f64 = 2e-5;

/// Values in (-1, 1) times `scale`, plus `offset`.
fn noise(len: usize, seed: u64, scale: f32, offset: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = move || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((state >> 40) as f32 / 8_388_608.0 - 1.0) * scale + offset
    };
    (0..len).map(|_| next()).collect()
}

/// Whether all values are the expected ones but for rounding, of `scale` where terms cancel that are larger than any result.
#[track_caller]
fn close(what: &str, isa: Isa, found: &[f32], expected: &[f64], scale: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(scale, |m: f64, v| m.max(v.abs()));
    for (i, (a, b)) in found.iter().zip(expected).enumerate() {
        let error = (f64::from(*a) - b).abs();
        assert!(error <= TOLERANCE * scale, "{what} on {}, value {i}: {a}, expected {b}", isa.name());
    }
}

/// What the formulas say, with the channel of every value given.
struct Textbook {
    channels: Vec<usize>,
    mean: Vec<f64>,
    variance: Vec<f64>,
    normal: Vec<f64>,
    /// How much more than [`TOLERANCE`] a normalised value may be off where few values lie close together: rounding the
    /// mean costs half an ulp of it, which the division by their small deviation magnifies.
    magnified: f64,
}

impl Textbook {
    fn new(x: &[f32], count: usize, channel: impl Fn(usize) -> usize) -> Self {
        let channels: Vec<usize> = (0..x.len()).map(channel).collect();
        let per = (x.len() / count) as f64;
        let average = |values: &mut dyn Iterator<Item = f64>| {
            let mut sums = vec![0.0; count];
            values.zip(&channels).for_each(|(v, c)| sums[*c] += v / per);
            sums
        };
        let mean = average(&mut x.iter().map(|v| f64::from(*v)));
        let apart = |i: usize| f64::from(x[i]) - mean[channels[i]];
        let variance = average(&mut (0..x.len()).map(|i| apart(i) * apart(i)));
        let normal =
            (0..x.len()).map(|i| apart(i) / (variance[channels[i]] + f64::from(EPSILON)).sqrt()).collect();
        let ulps = |(m, v): (&f64, &f64)| f64::from(f32::EPSILON) * m.abs() / (v + f64::from(EPSILON)).sqrt();
        let magnified = 1.0 + mean.iter().zip(&variance).map(ulps).fold(0.0, f64::max) / TOLERANCE;
        Self { channels, mean, variance, normal, magnified }
    }

    fn forward(&self, gamma: &[f32], beta: &[f32]) -> Vec<f64> {
        let line = |(n, &c): (&f64, &usize)| n * f64::from(gamma[c]) + f64::from(beta[c]);
        self.normal.iter().zip(&self.channels).map(line).collect()
    }

    /// Of the input, gamma and beta, for the gradient of the batch-norm's own result.
    fn backward(&self, gamma: &[f32], dy: &[f64]) -> [Vec<f64>; 3] {
        let (mut of_gamma, mut of_beta) = (vec![0.0; gamma.len()], vec![0.0; gamma.len()]);
        for (i, &c) in self.channels.iter().enumerate() {
            of_gamma[c] += dy[i] * self.normal[i];
            of_beta[c] += dy[i];
        }
        let per = (dy.len() / gamma.len()) as f64;
        let input = |i: usize| {
            let c = self.channels[i];
            let scale = f64::from(gamma[c]) / (self.variance[c] + f64::from(EPSILON)).sqrt();
            scale * (dy[i] - of_beta[c] / per - self.normal[i] * of_gamma[c] / per)
        };
        [(0..dy.len()).map(input).collect(), of_gamma, of_beta]
    }

    fn check(&self, isa: Isa, gamma: &[f32], dy: &[f64], found: &Gradients) {
        let [input, of_gamma, of_beta] = self.backward(gamma, dy);
        let scale = |(g, v): (&f32, &f64)| f64::from(g.abs()) / (v + f64::from(EPSILON)).sqrt();
        let steepest = gamma.iter().zip(&self.variance).map(scale).fold(1.0, f64::max);
        let most = dy.iter().fold(1.0, |m: f64, v| m.max(v.abs()));
        close("gradient of the input", isa, &found.input, &input, steepest * most * self.magnified);
        // Sums of thousands of terms that cancel: an ulp of their absolute values.
        let mut sums = vec![[0.0; 2]; gamma.len()];
        for (i, &c) in self.channels.iter().enumerate() {
            sums[c][0] += (dy[i] * self.normal[i]).abs();
            sums[c][1] += dy[i].abs();
        }
        let ulp =
            |k: usize| sums.iter().map(|s| s[k]).fold(0.0, f64::max) * f64::from(f32::EPSILON) / TOLERANCE;
        close("gradient of gamma", isa, &found.gamma, &of_gamma, self.magnified + ulp(0));
        close("gradient of beta", isa, &found.beta, &of_beta, 1.0 + ulp(1));
    }

    fn check_moments(&self, isa: Isa, found: &Moments) {
        close("mean", isa, &found.mean, &self.mean, 1.0);
        close("variance", isa, &found.variance, &self.variance, 1.0);
    }
}

/// The gradient where the result is positive, as the kernels see it: their own result decides about zero.
fn passed(dy: &[f32], y: &[f32]) -> Vec<f64> {
    dy.iter().zip(y).map(|(dy, y)| if *y > 0.0 { f64::from(*dy) } else { 0.0 }).collect()
}

fn check_planes(sizes @ [batch, channels, pixels]: [usize; 3], seed: u64) {
    let len = batch * channels * pixels;
    let (x, residual) = (noise(len, seed, 2.0, 3.0), noise(len, seed + 1, 1.0, 0.0));
    let (gamma, beta) = (noise(channels, seed + 2, 1.0, 0.5), noise(channels, seed + 3, 1.0, 0.0));
    let dy = noise(len, seed + 4, 1.0, 0.1);
    let affine = Affine { gamma: &gamma, beta: &beta, epsilon: EPSILON };
    let book = Textbook::new(&x, channels, |i| i / pixels % channels);
    for isa in Isa::available() {
        let moments = planes::moments(isa, sizes, &x).unwrap();
        book.check_moments(isa, &moments);
        for (relu, added) in [(false, None), (true, None), (true, Some(&residual[..]))] {
            let y = planes::forward(isa, sizes, &x, added, &affine, &moments, relu).unwrap();
            let mut expected = book.forward(&gamma, &beta);
            if let Some(residual) = added {
                expected.iter_mut().zip(residual).for_each(|(y, r)| *y += f64::from(*r));
            }
            if relu {
                expected.iter_mut().for_each(|y| *y = y.max(0.0));
            }
            close("result", isa, &y, &expected, book.magnified);
            let (followed, through) = match (relu, added) {
                (false, _) => (Followed::Nothing, dy.iter().map(|v| f64::from(*v)).collect()),
                (true, None) => (Followed::Relu(&y), passed(&dy, &y)),
                (true, Some(_)) => (Followed::AddRelu(&y), passed(&dy, &y)),
            };
            let (of, of_residual) =
                planes::backward(isa, sizes, &dy, &x, followed, &affine, &moments).unwrap();
            book.check(isa, &gamma, &through, &of);
            assert_eq!(of_residual.is_some(), added.is_some());
            if let Some(of_residual) = of_residual {
                close("gradient of the residual", isa, &of_residual, &through, 1.0);
            }
        }
    }
}

fn check_rows(count: usize, channels: usize, neighbours: usize, seed: u64) {
    let len = count * neighbours * channels;
    let x = noise(len, seed, 2.0, 3.0);
    let (gamma, beta) = (noise(channels, seed + 2, 1.0, 0.5), noise(channels, seed + 3, 1.0, 0.0));
    let affine = Affine { gamma: &gamma, beta: &beta, epsilon: EPSILON };
    let book = Textbook::new(&x, channels, |i| i % channels);
    let plain = book.forward(&gamma, &beta);
    for isa in Isa::available() {
        let moments = rows::moments(isa, channels, &x).unwrap();
        book.check_moments(isa, &moments);
        let y = rows::forward(isa, &x, &affine, &moments).unwrap();
        close("result", isa, &y, &plain.iter().map(|y| y.max(0.0)).collect::<Vec<_>>(), book.magnified);
        let dy = noise(len, seed + 4, 1.0, 0.1);
        let of = rows::backward(isa, &dy, &x, &affine, &moments).unwrap();
        book.check(isa, &gamma, &passed(&dy, &y), &of);

        let (greatest, which) = pool::forward(isa, neighbours, &x, &affine, &moments).unwrap();
        let dy = noise(greatest.len(), seed + 5, 1.0, 0.1);
        let mut through = vec![0.0; len];
        for (i, (&most, &k)) in greatest.iter().zip(&which).enumerate() {
            let (group, c) = (i / channels, i % channels);
            let at = |k: usize| (group * neighbours + k) * channels + c;
            let expected = (0..neighbours).map(|k| plain[at(k)]).fold(0.0, f64::max);
            let off = TOLERANCE * expected.max(book.magnified);
            assert!((f64::from(most) - expected).abs() <= off);
            assert!(plain[at(k.into())].max(0.0) >= expected - off);
            through[at(k.into())] = if most > 0.0 { f64::from(dy[i]) } else { 0.0 };
        }
        let of = pool::backward(isa, neighbours, &dy, &which, &x, &affine, &moments).unwrap();
        book.check(isa, &gamma, &through, &of);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn planes_follow_the_textbook(
        batch in 1usize..4, channels in 1usize..12, pixels in prop_oneof![2usize..80, 2000usize..4500], seed in 0u64..1000,
    ) {
        check_planes([batch, channels, pixels], seed);
    }

    #[test]
    fn rows_and_pools_follow_the_textbook(
        count in 2usize..60, channels in 1usize..40, neighbours in 1usize..36, seed in 0u64..1000,
    ) {
        check_rows(count, channels, neighbours, seed);
    }
}

/// Found by chance: two values 0.004 apart around 3, where the gradient is a difference of terms 100 times larger, and
/// 9,282 terms whose sum is a thousandth of them.
#[test]
fn what_cancels_follows_the_textbook() {
    check_planes([1, 1, 2], 884);
    check_planes([3, 1, 3094], 802);
}

#[test]
fn threads_do_not_change_a_bit() {
    let (sizes, neighbours) = ([3, 17, 2500], 20);
    let x = noise(sizes.iter().product(), 1, 2.0, 3.0);
    let (dy, gamma, beta) = (noise(x.len(), 2, 1.0, 0.1), noise(17, 3, 1.0, 0.5), noise(17, 4, 1.0, 0.0));
    let affine = Affine { gamma: &gamma, beta: &beta, epsilon: EPSILON };
    let run = |isa: Isa, threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let moments = planes::moments(isa, sizes, &x).unwrap();
            let y = planes::forward(isa, sizes, &x, None, &affine, &moments, true).unwrap();
            let of = planes::backward(isa, sizes, &dy, &x, Followed::AddRelu(&y), &affine, &moments).unwrap();
            let by_row = rows::moments(isa, 17, &x).unwrap();
            let of_rows = rows::backward(isa, &dy, &x, &affine, &by_row).unwrap();
            let (greatest, which) = pool::forward(isa, neighbours, &x, &affine, &by_row).unwrap();
            let dy = &dy[..greatest.len()];
            let of_pool = pool::backward(isa, neighbours, dy, &which, &x, &affine, &by_row).unwrap();
            (moments, y, of, by_row, of_rows, greatest, of_pool)
        })
    };
    for isa in Isa::available() {
        let one = run(isa, 1);
        for threads in [2, 5] {
            assert!(run(isa, threads) == one, "{threads} threads on {}", isa.name());
        }
    }
}

#[test]
fn wrong_sizes_are_errors() {
    let isa = Isa::best();
    let x = [0.5; 12];
    let affine = Affine { gamma: &[1.0; 3], beta: &[0.0; 3], epsilon: EPSILON };
    let moments = Moments { mean: vec![0.0; 3], variance: vec![1.0; 3] };
    let short = Moments { mean: vec![0.0; 2], variance: vec![1.0; 3] };
    assert!(planes::moments(isa, [2, 3, 3], &x).is_err());
    assert!(planes::forward(isa, [2, 3, 2], &x, Some(&x[1..]), &affine, &moments, true).is_err());
    assert!(planes::forward(isa, [2, 3, 2], &x, None, &affine, &short, true).is_err());
    let of = Followed::Relu(&x[1..]);
    assert!(planes::backward(isa, [2, 3, 2], &x, &x, of, &affine, &moments).is_err());
    assert!(rows::moments(isa, 5, &x).is_err() && rows::moments(isa, 0, &x).is_err());
    assert!(rows::forward(isa, &x[1..], &affine, &moments).is_err());
    assert!(rows::backward(isa, &x[3..], &x, &affine, &moments).is_err());
    assert!(pool::forward(isa, 3, &x, &affine, &moments).is_err(), "four rows are no groups of three");
    assert!(pool::forward(isa, 0, &x, &affine, &moments).is_err());
    assert!(pool::backward(isa, 2, &x[..6], &[2; 6], &x, &affine, &moments).is_err(), "no third neighbour");
    assert!(pool::backward(isa, 0, &[], &[], &[], &affine, &moments).is_err());
}
