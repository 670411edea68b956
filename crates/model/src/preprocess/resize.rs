//! Resizing of one plane: the mean over the area that a pixel covers when shrinking, linear in between when enlarging.

use where2act_core::ImageSize;

/// Which pixels of a line of `from` make up a pixel of a line of `to`, and how much each counts.
fn taps(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = from as f64 / to as f64;
    let weights = |i: usize| {
        if scale > 1.0 {
            let (start, end) = (i as f64 * scale, ((i + 1) as f64 * scale).min(from as f64));
            let first = start as usize;
            let last = (end.ceil() as usize).min(from).max(first + 1);
            let covered = |j: usize| ((j + 1) as f64).min(end) - (j as f64).max(start);
            let weights: Vec<f64> = (first..last).map(covered).collect();
            let sum: f64 = weights.iter().sum();
            (first, weights.iter().map(|w| (w / sum) as f32).collect())
        } else {
            let centre = ((i as f64 + 0.5) * scale - 0.5).clamp(0.0, (from - 1) as f64);
            let first = (centre as usize).min(from.saturating_sub(2));
            let right = (centre - first as f64) as f32;
            (first, if from == 1 { vec![1.0] } else { vec![1.0 - right, right] })
        }
    };
    (0..to).map(weights).collect()
}

/// `plane` of size `from`, row-major, at size `to`. Neither may be empty.
pub(super) fn resize(plane: &[f32], from: ImageSize, to: ImageSize) -> Vec<f32> {
    if from == to {
        return plane.to_vec();
    }
    let across = taps(from.width, to.width);
    let mut narrow = Vec::with_capacity(from.height * to.width);
    for line in plane.chunks_exact(from.width) {
        narrow.extend(
            across
                .iter()
                .map(|(first, weights)| line[*first..].iter().zip(weights).map(|(x, w)| x * w).sum::<f32>()),
        );
    }
    let mut small = vec![0.0; to.pixels()];
    for (line, (first, weights)) in small.chunks_exact_mut(to.width).zip(taps(from.height, to.height)) {
        for (from, weight) in narrow[first * to.width..].chunks_exact(to.width).zip(weights) {
            for (sum, x) in line.iter_mut().zip(from) {
                *sum += weight * x;
            }
        }
    }
    small
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_averages_and_nothing_changes_a_constant() {
        let size = |width, height| ImageSize { width, height };
        let plane: Vec<f32> = (0..16).map(|i| i as f32).collect();
        assert_eq!(resize(&plane, size(4, 4), size(2, 2)), vec![2.5, 4.5, 10.5, 12.5]);
        for (w, h) in [(1, 1), (3, 7), (100, 5), (224, 224)] {
            for (w2, h2) in [(1, 1), (2, 9), (224, 100)] {
                let small = resize(&vec![0.25; w * h], size(w, h), size(w2, h2));
                assert_eq!(small.len(), w2 * h2);
                assert!(small.iter().all(|x| (x - 0.25).abs() < 1e-6), "{w}x{h} -> {w2}x{h2}");
            }
        }
        assert_eq!(resize(&[0.0, 1.0], size(2, 1), size(4, 1)), vec![0.0, 0.25, 0.75, 1.0]);
    }
}
