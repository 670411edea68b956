//! From all scored orientations to the few a caller sees.

use std::cmp::{Ordering, Reverse};
use std::collections::{BinaryHeap, HashMap};

use nalgebra::Rotation3;
use where2act_core::Pixel;

use crate::Options;

/// An orientation at a candidate, with its score.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scored {
    /// Which candidate.
    pub(crate) candidate: usize,
    /// Pixel of the input.
    pub(crate) pixel: Pixel,
    /// Hand rotation in the frame in which the network knows directions.
    pub(crate) rotation: Rotation3<f32>,
    /// What the score head says: higher is better, not a chance of success.
    pub(crate) score: f32,
}

/// The best by score that fit, at most so many per pixel, those of one pixel some angle apart. Ties go to the more
/// actionable candidate, which comes first. Only those about to be chosen are asked whether they fit.
pub(crate) fn select(all: &[Scored], options: &Options, fits: impl Fn(&Scored) -> bool) -> Vec<Scored> {
    let per_pixel = options.proposals_per_pixel();
    // A heap, because few of the best are looked at. Equal scores stay in the order of their candidates and samples.
    let good = all.iter().enumerate().filter(|(_, scored)| scored.score >= options.min_score);
    let mut best: BinaryHeap<Ranked<'_>> = good.map(|(i, scored)| Ranked(scored, Reverse(i))).collect();
    let mut chosen: Vec<Scored> = Vec::new();
    let mut by_pixel: HashMap<Pixel, Vec<Rotation3<f32>>> = HashMap::new();
    while chosen.len() < options.top_k
        && let Some(Ranked(&scored, _)) = best.pop()
    {
        let here = by_pixel.entry(scored.pixel).or_default();
        let other = |rotation: &Rotation3<f32>| rotation.angle_to(&scored.rotation) >= Options::MIN_ANGLE;
        if here.len() < per_pixel && here.iter().all(other) && fits(&scored) {
            here.push(scored.rotation);
            chosen.push(scored);
        }
    }
    chosen
}

/// Greater: to be looked at first.
struct Ranked<'a>(&'a Scored, Reverse<usize>);

impl Ord for Ranked<'_> {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.score.total_cmp(&other.0.score).then(self.1.cmp(&other.1))
    }
}

impl PartialOrd for Ranked<'_> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ranked<'_> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Ranked<'_> {}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn one_per_pixel_by_default_and_different_ones_at_a_pixel() {
        let scored = |u, angle: f32, score| Scored {
            candidate: u as usize,
            pixel: Pixel { u, v: 0 },
            rotation: Rotation3::from_axis_angle(&Vector3::z_axis(), angle),
            score,
        };
        let all = vec![scored(0, 0.0, 0.5), scored(0, 0.1, 0.9), scored(0, 1.0, 0.8), scored(1, 0.0, 0.85)];
        let scores = |o: &Options| select(&all, o, |_| true).iter().map(|s| s.score).collect::<Vec<_>>();
        assert_eq!(scores(&Options::default()), [0.9, 0.85]);
        assert_eq!(scores(&Options { per_pixel: Some(5), ..Options::default() }), [0.9, 0.85, 0.8]);
        assert_eq!(scores(&Options { min_score: 0.86, ..Options::default() }), [0.9]);
        assert_eq!(scores(&Options { top_k: 1, ..Options::default() }), [0.9]);
        let low = select(&all, &Options::default(), |s| s.score < 0.9);
        assert_eq!(low.iter().map(|s| s.score).collect::<Vec<_>>(), [0.85, 0.8], "what does not fit");
        let equal: Vec<Scored> = (0..50).map(|u| scored(u, 0.0, 0.5)).collect();
        let first: Vec<usize> =
            select(&equal, &Options::default(), |_| true).iter().map(|s| s.candidate).collect();
        assert_eq!(first, (0..10).collect::<Vec<_>>(), "ties");
    }
}
