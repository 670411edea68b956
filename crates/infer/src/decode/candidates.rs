//! Candidate places: the most actionable ones that keep a distance from each other.

use std::collections::HashMap;

/// Where features are, for non-maximum suppression: rows of the feature matrix with a position each.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    /// Rows of the feature matrix that lie on the object.
    rows: Vec<u32>,
    /// Position of each, in pixels of the network's picture or in network units.
    positions: Vec<[f32; 3]>,
    /// Which square or cube of side `radius` each lies in.
    cells: Vec<u32>,
    cell_count: usize,
    radius: f32,
}

impl Places {
    /// `radius` is the least distance between candidates.
    pub(crate) fn new(places: impl Iterator<Item = (u32, [f32; 3])>, radius: f32) -> Self {
        let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
        let (mut rows, mut positions, mut cells) = (vec![], vec![], vec![]);
        let mut last = ([i32::MIN; 3], 0);
        for (row, position) in places {
            let cell = position.map(|x| (x / radius).floor() as i32);
            // Neighbours in a picture share a cell more often than not.
            if cell != last.0 {
                let next = numbers.len() as u32;
                last = (cell, *numbers.entry(cell).or_insert(next));
            }
            rows.push(row);
            positions.push(position);
            cells.push(last.1);
        }
        Self { rows, positions, cells, cell_count: numbers.len(), radius }
    }

    /// Rows on the object.
    pub(crate) fn rows(&self) -> &[u32] {
        &self.rows
    }

    /// The up to `count` best rows by `value(row)`: local maxima first, best first, then, if there are fewer, the best
    /// of the others; no two nearer than the radius. Ties go to the earlier place. One place per cell stands for it,
    /// so a plateau gives as many candidates as a mountain range.
    pub(crate) fn best(&self, value: impl Fn(u32) -> f32, count: usize) -> Vec<u32> {
        let mut peaks = vec![(f32::NEG_INFINITY, usize::MAX); self.cell_count];
        for (place, (&row, &cell)) in self.rows.iter().zip(&self.cells).enumerate() {
            let value = value(row);
            if let Some(peak) = peaks.get_mut(cell as usize)
                && value > peak.0
            {
                *peak = (value, place);
            }
        }
        peaks.retain(|peak| peak.1 != usize::MAX);
        peaks.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let places: Vec<usize> = peaks.into_iter().map(|(_, place)| place).collect();

        let mut maxima = Vec::new();
        let mut others = Vec::new();
        for (i, &place) in places.iter().enumerate() {
            if maxima.len() == count {
                break;
            }
            // What beats a slope is near it in space and in value: look there first.
            let beaten = places.iter().take(i).rev().any(|&better| self.near(better, place));
            if beaten { others.push(place) } else { maxima.push(place) }
        }
        for place in others {
            if maxima.len() == count {
                break;
            }
            if !maxima.iter().any(|&chosen| self.near(chosen, place)) {
                maxima.push(place);
            }
        }
        maxima.into_iter().filter_map(|place| self.rows.get(place).copied()).collect()
    }

    /// Whether two places are nearer than the radius.
    fn near(&self, a: usize, b: usize) -> bool {
        let (Some(a), Some(b)) = (self.positions.get(a), self.positions.get(b)) else { return false };
        let squared: f32 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        squared < self.radius * self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(side: u32, radius: f32) -> Places {
        Places::new((0..side * side).map(|i| (i, [(i % side) as f32, (i / side) as f32, 0.0])), radius)
    }

    #[test]
    fn the_peak_comes_first_and_its_neighbours_do_not() {
        let peaks = [(20.0, 20.0, 1.0), (24.0, 20.0, 0.9), (50.0, 9.0, 0.5)];
        let value = |i: u32| {
            let (x, y) = ((i % 64) as f32, (i / 64) as f32);
            peaks.iter().map(|(px, py, h)| h - 0.05 * (x - px).hypot(y - py)).fold(f32::MIN, f32::max)
        };
        let best = grid(64, 8.0).best(value, 5);
        assert_eq!(best[0], 20 * 64 + 20);
        let distance =
            |a: u32, b: u32| ((a % 64) as f32 - (b % 64) as f32).hypot((a / 64) as f32 - (b / 64) as f32);
        for (i, a) in best.iter().enumerate() {
            assert!(best[i + 1..].iter().all(|b| distance(*a, *b) >= 8.0));
        }
        assert!(best.contains(&(9 * 64 + 50)), "the second mountain is found: {best:?}");
    }

    #[test]
    fn a_plateau_gives_as_many_as_asked_for_and_nothing_gives_none() {
        assert_eq!(grid(64, 8.0).best(|_| 1.0, 32).len(), 32);
        assert!(Places::new(std::iter::empty(), 1.0).best(|_| 1.0, 32).is_empty());
    }
}
