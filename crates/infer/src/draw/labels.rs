//! Where labels go, so that they hide neither each other nor the hands.

use super::canvas::Xy;

/// Width and height, pixels.
pub(crate) type Extent = (f32, f32);

/// What is on a picture already.
#[derive(Default)]
pub(crate) struct Taken {
    /// Points of what is drawn.
    marks: Vec<Xy>,
    /// Upper left corners and sizes of labels.
    labels: Vec<(Xy, Extent)>,
}

impl Taken {
    /// Something is drawn along this line.
    pub(crate) fn line(&mut self, points: &[Xy]) {
        const BETWEEN: usize = 8;
        for pair in points.windows(2) {
            if let [(x0, y0), (x1, y1)] = *pair {
                let at = |i: usize| i as f32 / BETWEEN as f32;
                self.marks.extend((0..=BETWEEN).map(|i| (x0 + (x1 - x0) * at(i), y0 + (y1 - y0) * at(i))));
            }
        }
    }

    /// The upper left corner for a label about `anchor`, `gap` from it or a bit more, inside a canvas: the place that
    /// hides least of the other labels, then of what is drawn, then the nearest.
    pub(crate) fn place(&mut self, anchor: Xy, size: Extent, gap: f32, canvas: Extent) -> Xy {
        const DIRECTIONS: usize = 16;
        let (w, h) = size;
        let inside = |at: f32, extent: f32, side: f32| at.min(side - extent - 1.0).max(1.0);
        let mut best = (f32::INFINITY, (1.0, 1.0));
        for (far, distance) in [1.0, 1.6, 2.4, 3.4, 4.8, 6.5].into_iter().enumerate() {
            for turn in 0..DIRECTIONS {
                // From the lower right on, where a reader expects it.
                let angle = 0.25 * std::f32::consts::PI
                    + turn as f32 * 2.0 * std::f32::consts::PI / DIRECTIONS as f32;
                let centre = (
                    anchor.0 + angle.cos() * (distance * gap + 0.5 * w),
                    anchor.1 + angle.sin() * (distance * gap + 0.5 * h),
                );
                let corner =
                    (inside(centre.0 - 0.5 * w, w, canvas.0), inside(centre.1 - 0.5 * h, h, canvas.1));
                let cost = 1e3 * self.hidden_labels(corner, size)
                    + 10.0 * self.hidden_marks(corner, size) as f32
                    + 3.0 * far as f32
                    + 0.1 * turn as f32;
                if cost < best.0 {
                    best = (cost, corner);
                }
            }
        }
        self.labels.push((best.1, size));
        best.1
    }

    /// Share of a label of this size that others take.
    fn hidden_labels(&self, (x, y): Xy, (w, h): Extent) -> f32 {
        let overlap = |((left, top), (width, height)): &(Xy, Extent)| {
            let across = (x + w).min(left + width) - x.max(*left);
            let down = (y + h).min(top + height) - y.max(*top);
            across.max(0.0) * down.max(0.0) / (w * h)
        };
        self.labels.iter().map(overlap).sum()
    }

    fn hidden_marks(&self, (x, y): Xy, (w, h): Extent) -> usize {
        self.marks.iter().filter(|m| (x..=x + w).contains(&m.0) && (y..=y + h).contains(&m.1)).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_one_place_lie_beside_each_other_and_inside() {
        for anchor in [(100.0, 100.0), (0.0, 0.0), (199.0, 199.0)] {
            let mut taken = Taken::default();
            taken.line(&[(80.0, 110.0), (120.0, 110.0)]);
            let size = (60.0, 20.0);
            let corners: Vec<Xy> = (0..3).map(|_| taken.place(anchor, size, 10.0, (200.0, 200.0))).collect();
            for (i, a) in corners.iter().enumerate() {
                assert!(a.0 >= 1.0 && a.1 >= 1.0 && a.0 + 60.0 < 200.0 && a.1 + 20.0 < 200.0);
                let mark = (a.0..a.0 + 60.0).contains(&100.0) && (a.1..a.1 + 20.0).contains(&110.0);
                assert!(!mark, "{a:?} hides the line");
                for b in &corners[..i] {
                    assert!((a.0 - b.0).abs() >= 60.0 || (a.1 - b.1).abs() >= 20.0, "{corners:?}");
                }
            }
        }
    }
}
