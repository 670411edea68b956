//! How good scores are: threshold metrics, ranking, calibration, and intervals for rates.

use nalgebra::{Matrix2, Vector2};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal};
use statrs::statistics::{Data, OrderStatistics};

/// Share of successes with a 95 % Wilson interval (Wilson, 1927), which stays sensible for few tries and for rates near 0 and
/// 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// Successes.
    pub successes: u64,
    /// Tries.
    pub tries: u64,
    /// Successes / tries; 0 without tries.
    pub rate: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Rate {
    /// From counts of tries that have nothing to do with each other.
    #[must_use]
    pub fn new(successes: u64, tries: u64) -> Self {
        Self::worth(successes, tries, tries as f64)
    }

    /// From (successes, tries) of each of some objects. Tries on one object end alike, so that all of them together are worth
    /// fewer that have nothing to do with each other: as many as would let the rate vary as much as it does from object to
    /// object (the design effect; Kish, 1965), and no more than there are. Where all end the same way, one each object.
    #[must_use]
    pub fn of_objects(objects: &[[u64; 2]]) -> Self {
        let objects = objects.iter().filter(|[_, tries]| *tries > 0);
        let [successes, tries] = objects.clone().fold([0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        let (count, n) = (objects.clone().count() as f64, tries as f64);
        let p = successes as f64 / n;
        if count < 2.0 || successes == 0 || successes == tries {
            return Self::worth(successes, tries, count);
        }
        let residual = |[successes, tries]: &[u64; 2]| (*successes as f64 - p * *tries as f64).powi(2);
        let variance = count / (count - 1.0) * objects.map(residual).sum::<f64>() / (n * n);
        Self::worth(successes, tries, (p * (1.0 - p) / variance).min(n))
    }

    /// From counts of tries that are worth `n` that have nothing to do with each other.
    fn worth(successes: u64, tries: u64, n: f64) -> Self {
        if tries == 0 {
            return Self { successes, tries, rate: 0.0, low: 0.0, high: 1.0 };
        }
        let z = Normal::standard().inverse_cdf(0.975);
        let p = successes as f64 / tries as f64;
        let centre = (p + z * z / (2.0 * n)) / (1.0 + z * z / n);
        let half = z / (1.0 + z * z / n) * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
        Self { successes, tries, rate: p, low: (centre - half).max(0.0), high: (centre + half).min(1.0) }
    }

    /// `62.5 % (48.1-75.0, 25/40)`.
    #[must_use]
    pub fn show(&self) -> String {
        if self.tries == 0 {
            return "-".to_owned();
        }
        let Self { successes, tries, rate, low, high } = self;
        format!("{:.1} % ({:.1}-{:.1}, {successes}/{tries})", 100.0 * rate, 100.0 * low, 100.0 * high)
    }
}

/// Metrics of predicted scores against outcomes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ScoreMetrics {
    /// Number of trials.
    pub trials: u64,
    /// Number of successes among them.
    pub successes: u64,
    /// Of those called successes, the share that are. 0 if none was called so.
    pub precision: f64,
    /// Of the successes, the share called so.
    pub recall: f64,
    /// Harmonic mean of the two: the published F-score, at threshold 0.5.
    pub f_score: f64,
    /// Area under the precision-recall curve as a step function, independent of any threshold.
    pub average_precision: f64,
    /// The best F-score that any threshold has on these trials: what calibration could gain.
    pub best_f_score: f64,
    /// The threshold whose F-score on more such trials is the best to be expected: as if the logit of success were linear
    /// in that of the score. The best on these very trials hangs on a handful of them.
    pub best_threshold: f64,
}

impl ScoreMetrics {
    /// Threshold of the published F-score.
    pub const THRESHOLD: f32 = 0.5;

    /// From (score, outcome) pairs; scores in [0, 1].
    #[must_use]
    pub fn new(scored: &[(f32, bool)]) -> Self {
        let successes = scored.iter().filter(|(_, y)| *y).count();
        let called = |t: f32| scored.iter().filter(|(s, _)| *s > t).count();
        let hits = |t: f32| scored.iter().filter(|(s, y)| *s > t && *y).count();
        let share = |part: usize, whole: usize| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
        let (called, hits) = (called(Self::THRESHOLD), hits(Self::THRESHOLD));
        let (average_precision, best_f_score) = ranking(scored, successes);
        Self {
            trials: scored.len() as u64,
            successes: successes as u64,
            precision: share(hits, called),
            recall: share(hits, successes),
            f_score: share(2 * hits, called + successes),
            average_precision,
            best_f_score,
            best_threshold: expected_best_threshold(scored, successes),
        }
    }
}

/// 95 % interval of the F-score over objects like these: percentiles of as many objects drawn with replacement (the bootstrap,
/// Efron, 1979). Trials on one object end alike, so that intervals which took them for independent would be too narrow.
/// `[low, high]`; all there is without trials.
#[must_use]
pub fn f_score_interval(objects: &[Vec<(f32, bool)>], rng: &mut ChaCha8Rng) -> [f64; 2] {
    const DRAWS: usize = 2000;
    if objects.iter().all(Vec::is_empty) {
        return [0.0, 1.0];
    }
    // Twice the hits, and what the F-score divides that by.
    let parts: Vec<[usize; 2]> = objects
        .iter()
        .map(|scored| {
            let of = |(score, success): &(f32, bool)| (*score > ScoreMetrics::THRESHOLD, *success);
            scored.iter().map(of).fold([0, 0], |[twice, whole], (called, success)| {
                [
                    twice + 2 * usize::from(called && success),
                    whole + usize::from(called) + usize::from(success),
                ]
            })
        })
        .collect();
    let mut draw = || {
        let drawn = (0..parts.len()).map(|_| parts[rng.random_range(0..parts.len())]);
        let [twice, whole] = drawn.fold([0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
        if whole == 0 { 0.0 } else { twice as f64 / whole as f64 }
    };
    let mut scores = Data::new((0..DRAWS).map(|_| draw()).collect::<Vec<f64>>());
    [0.025, 0.975].map(|share| scores.quantile(share))
}

/// Average precision and best F-score over all distinct scores as thresholds.
fn ranking(scored: &[(f32, bool)], successes: usize) -> (f64, f64) {
    let mut sorted: Vec<_> = scored.to_vec();
    sorted.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut hits, mut seen, mut recall_before, mut area) = (0usize, 0usize, 0.0, 0.0);
    let mut best = 0.0f64;
    for tie in sorted.chunk_by(|a, b| a.0 == b.0) {
        hits += tie.iter().filter(|(_, y)| *y).count();
        seen += tie.len();
        let (precision, recall) = (hits as f64 / seen as f64, hits as f64 / successes.max(1) as f64);
        area += (recall - recall_before) * precision;
        recall_before = recall;
        best = best.max(2.0 * hits as f64 / (seen + successes) as f64);
    }
    (area, best)
}

/// The threshold of [`ScoreMetrics::best_threshold`]; 1 if all trials end the same way.
fn expected_best_threshold(scored: &[(f32, bool)], successes: usize) -> f64 {
    if successes == 0 || successes == scored.len() {
        return 1.0;
    }
    let logit = |score: f32| {
        let p = f64::from(score).clamp(1e-6, 1.0 - 1e-6);
        (p / (1.0 - p)).ln()
    };
    let line = logistic_fit(&scored.iter().map(|(s, y)| (logit(*s), *y)).collect::<Vec<_>>());
    let mut sorted: Vec<f32> = scored.iter().map(|(score, _)| *score).collect();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let likely = |score: &f32| sigmoid(line.x + line.y * logit(*score));
    let all: f64 = sorted.iter().map(likely).sum();
    let (mut hits, mut best) = (0.0, (0.0, 1.0));
    for (passed, score) in (1u32..).zip(&sorted) {
        hits += likely(score);
        let f = 2.0 * hits / (f64::from(passed) + all);
        if f > best.0 {
            best = (f, f64::from(*score));
        }
    }
    best.1
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

/// Intercept and slope of the logistic regression of outcomes on `x`, by Newton's method. A slope of 1, which leaves scores
/// as they are, is worth one observation: it keeps outcomes that a threshold divides without error from having no bounds.
fn logistic_fit(observed: &[(f64, bool)]) -> Vector2<f64> {
    const STEPS: usize = 50;
    let mut line = Vector2::new(0.0, 1.0);
    for _ in 0..STEPS {
        let mut gradient = Vector2::new(0.0, 1.0 - line.y);
        let mut curvature = Matrix2::new(1e-9, 0.0, 0.0, 1.0);
        for (x, outcome) in observed {
            let at = Vector2::new(1.0, *x);
            let p = sigmoid(line.dot(&at));
            gradient += at * (f64::from(u8::from(*outcome)) - p);
            curvature += at * at.transpose() * (p * (1.0 - p));
        }
        let Some(step) = curvature.try_inverse().map(|inverse| inverse * gradient) else { break };
        // Far from the solution a whole step may lead away from it.
        line += step * (2.0 / step.norm()).min(1.0);
        if step.norm() < 1e-9 {
            break;
        }
    }
    line
}

/// One row of a reliability table: trials whose score fell into a tenth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reliability {
    /// Lower end of the tenth.
    pub from: f64,
    /// Mean score of its trials; 0 if there are none.
    pub mean_score: f64,
    /// What happened.
    pub outcome: Rate,
}

/// Of the trials on each of some objects: ten rows, scores 0.0-0.1 to 0.9-1.0, and the expected calibration error, the mean
/// distance between score and outcome, weighted by trials.
#[must_use]
pub fn reliability(objects: &[Vec<(f32, bool)>]) -> (Vec<Reliability>, f64) {
    let tenth = |score: f32| ((score * 10.0) as usize).min(9);
    let rows: Vec<Reliability> = (0..10)
        .map(|row| {
            let of_row = |scored: &Vec<(f32, bool)>| {
                let mine = || scored.iter().filter(|(s, _)| tenth(*s) == row);
                [mine().filter(|(_, y)| *y).count() as u64, mine().count() as u64]
            };
            let outcome = Rate::of_objects(&objects.iter().map(of_row).collect::<Vec<_>>());
            let scores = objects.iter().flatten().map(|(s, _)| *s).filter(|s| tenth(*s) == row);
            let mean_score = scores.map(f64::from).sum::<f64>() / outcome.tries.max(1) as f64;
            Reliability { from: row as f64 / 10.0, mean_score, outcome }
        })
        .collect();
    let total = objects.iter().map(Vec::len).sum::<usize>().max(1) as f64;
    let error =
        rows.iter().map(|r| r.outcome.tries as f64 / total * (r.mean_score - r.outcome.rate).abs()).sum();
    (rows, error)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sixteen trials with ties.
    const SCORED: [(f32, bool); 16] = [
        (0.95, true),
        (0.9, true),
        (0.9, false),
        (0.8, true),
        (0.75, false),
        (0.7, true),
        (0.6, true),
        (0.55, false),
        (0.5, true),
        (0.45, false),
        (0.4, false),
        (0.3, true),
        (0.3, false),
        (0.2, false),
        (0.1, false),
        (0.05, false),
    ];

    /// Expected values from scikit-learn 1.9.1: precision_recall_fscore_support(y, s > 0.5, average="binary") and
    /// average_precision_score(y, s).
    #[test]
    fn metrics_equal_scikit_learn() {
        let m = ScoreMetrics::new(&SCORED);
        assert!((m.precision - 0.625).abs() < 1e-9, "{m:?}");
        assert!((m.recall - 0.714_285_714_285_714_3).abs() < 1e-9, "{m:?}");
        assert!((m.f_score - 0.666_666_666_666_666_6).abs() < 1e-9, "{m:?}");
        assert!((m.average_precision - 0.714_678_178_963_893_2).abs() < 1e-9, "{m:?}");
        assert!(m.best_f_score >= m.f_score);
    }

    #[test]
    fn two_lucky_trials_do_not_set_the_threshold() {
        // The two highest scores of ten successes are right, the others lie anywhere in the upper half.
        let lucky = [(0.99, true), (0.98, true)].into_iter();
        let rest = (0..50).map(|i| (0.9 - 0.01 * i as f32, i % 6 == 5));
        let m = ScoreMetrics::new(&lucky.chain(rest).collect::<Vec<_>>());
        assert_eq!(m.successes, 10);
        assert!(m.best_threshold < 0.9 && m.best_f_score > 0.33, "{m:?}");
    }

    #[test]
    fn a_threshold_from_a_few_successes_serves_other_trials_almost_as_well_as_their_own() {
        use rand_distr::{Distribution, Normal as Gaussian};
        let logits = Gaussian::new(-6.0, 3.0).unwrap();
        let mut rng = where2act_core::Seed(7).rng();
        // Scores of a network that takes everything for seven times as likely as it is.
        let mut draw = |n: usize| -> Vec<(f32, bool)> {
            let one = |_| {
                let logit: f32 = logits.sample(&mut rng);
                let success = rand::RngExt::random::<f32>(&mut rng) < 1.0 / (1.0 + (-logit).exp());
                (1.0 / (1.0 + (-logit - 2.0).exp()), success)
            };
            (0..n).map(one).collect()
        };
        let f_at = |trials: &[(f32, bool)], threshold: f64| {
            let called = trials.iter().filter(|(s, _)| f64::from(*s) >= threshold);
            let (called, hits) = called.fold((0, 0), |(n, hits), (_, y)| (n + 1, hits + usize::from(*y)));
            2.0 * hits as f64 / (called + trials.iter().filter(|(_, y)| *y).count()) as f64
        };
        let many = draw(20_000);
        let best = ScoreMetrics::new(&many).best_f_score;
        let losses: Vec<f64> =
            (0..20).map(|_| best - f_at(&many, ScoreMetrics::new(&draw(500)).best_threshold)).collect();
        let mean = losses.iter().sum::<f64>() / losses.len() as f64;
        assert!(mean < 0.02 && losses.iter().all(|loss| *loss < 0.08), "{losses:?} of {best}");
    }

    /// Expected values from scikit-learn 1.9.1: LogisticRegression(penalty=None) on the logits of the scores; the one
    /// observation that pulls the slope towards 1 moves it by less than a tenth.
    #[test]
    fn a_line_through_outcomes() {
        let logit = |(score, outcome): &(f32, bool)| (f64::from(score / (1.0 - score)).ln(), *outcome);
        let line = logistic_fit(&SCORED.iter().map(logit).collect::<Vec<_>>());
        let expected = Vector2::new(-0.451_426, 0.766_070);
        assert!((line - expected).norm() < 0.1, "{line}");
        let divided: Vec<(f64, bool)> = (-5..5).map(|x| (f64::from(x), x >= 0)).collect();
        assert!(logistic_fit(&divided).iter().all(|x| x.is_finite() && x.abs() < 20.0));
    }

    /// Expected values from statsmodels 0.15.0: proportion_confint(k, n, method="wilson").
    #[test]
    fn intervals_equal_statsmodels() {
        for (k, n, low, high) in [
            (0, 10, 0.0, 0.277_532_799_862_889_26),
            (5, 10, 0.236_593_090_512_563_94, 0.763_406_909_487_436_1),
            (97, 100, 0.915_480_635_709_472_4, 0.9897454759759611),
            (25, 40, 0.470_324_391_373_010_96, 0.757_770_208_327_673_1),
        ] {
            let r = Rate::new(k, n);
            assert!((r.low - low).abs() < 1e-9 && (r.high - high).abs() < 1e-9, "{r:?}");
        }
        assert_eq!(Rate::new(0, 0).high, 1.0);
    }

    #[test]
    fn five_tries_that_end_alike_are_worth_one() {
        let of = |objects: &[[u64; 2]]| Rate::of_objects(objects);
        let width = |rate: Rate| rate.high - rate.low;
        let alike: Vec<[u64; 2]> = (0..40).map(|i| if i % 4 == 0 { [5, 5] } else { [0, 5] }).collect();
        let single: Vec<[u64; 2]> = alike.iter().map(|[successes, _]| [successes / 5, 1]).collect();
        assert_eq!((of(&alike).successes, of(&alike).tries), (50, 200));
        for (found, expected) in [(of(&alike), Rate::new(10, 40)), (of(&single), Rate::new(10, 40))] {
            assert!((width(found) / width(expected) - 1.0).abs() < 0.02, "{found:?} {expected:?}");
        }
        // As many as there are where each object has its share, and one each where nothing differs.
        assert_eq!(of(&[[1, 4]; 10]), Rate::new(10, 40));
        assert_eq!(of(&[[0, 5]; 10]).high, Rate::new(0, 10).high);
        assert_eq!(of(&[[3, 5], [0, 0]]).high, Rate::worth(3, 5, 1.0).high);
        assert_eq!(of(&[]), Rate::new(0, 0));
    }

    /// Where every trial is called a success, the F-score is 2 s / (n + s), and s of n objects with one trial each, a quarter
    /// of which succeed, is binomial.
    #[test]
    fn an_interval_for_the_f_score_is_that_of_objects_drawn_again() {
        use statrs::distribution::{Binomial, DiscreteCDF};
        let trials: Vec<(f32, bool)> = (0..40).map(|i| (0.9, i % 4 == 0)).collect();
        let interval = |trials: &[(f32, bool)], each: usize| {
            let objects: Vec<_> = trials.chunks(each).map(<[_]>::to_vec).collect();
            f_score_interval(&objects, &mut where2act_core::Seed(1).rng())
        };
        let binomial = Binomial::new(0.25, 40).unwrap();
        for (found, share) in interval(&trials, 1).into_iter().zip([0.025, 0.975]) {
            let successes = binomial.inverse_cdf(share) as f64;
            let expected = 2.0 * successes / (40.0 + successes);
            assert!((found - expected).abs() < 0.035, "{found} {expected}");
        }
        // Objects that are all alike leave no doubt; ten trials that end alike are no ten objects.
        assert_eq!(interval(&trials, 4), [0.4, 0.4]);
        let mut sorted = trials.clone();
        sorted.sort_by_key(|(_, success)| *success);
        let [low, high] = interval(&sorted, 10);
        assert!(low == 0.0 && high > 0.8, "{low} {high}");
    }

    #[test]
    fn nothing_to_judge_gives_zeros_not_nan() {
        let m = ScoreMetrics::new(&[]);
        assert_eq!((m.precision, m.recall, m.f_score, m.average_precision), (0.0, 0.0, 0.0, 0.0));
        assert_eq!(reliability(&[]).1, 0.0);
        let mut rng = where2act_core::Seed(1).rng();
        assert_eq!(f_score_interval(&[], &mut rng), [0.0, 1.0]);
        assert_eq!(f_score_interval(&[vec![]], &mut rng), [0.0, 1.0]);
        assert_eq!(f_score_interval(&[vec![(0.1, false)]], &mut rng), [0.0, 0.0]);
    }

    #[test]
    fn a_calibrated_score_has_no_calibration_error() {
        let scored: Vec<_> = (0..100).map(|i| (0.25, i % 4 == 0)).collect();
        assert!(reliability(std::slice::from_ref(&scored)).1 < 1e-9);
        // Of a hundred objects with a trial each it is as certain as Wilson's interval, of one object hardly at all.
        let apart: Vec<_> = scored.iter().map(|trial| vec![*trial]).collect();
        let width = |objects: &[Vec<(f32, bool)>]| {
            let row = reliability(objects).0[2].outcome;
            row.high - row.low
        };
        assert!(width(&apart) < 0.2 && width(&[scored]) > 0.5);
    }
}
