//! Which of some points are near another: a uniform grid of buckets.

use nalgebra::Point3;

/// Most cells along an axis.
const MAX_CELLS: usize = 48;

/// Some of the points, at most so many, say where the grid is, ...
const SAMPLED: usize = 1024;
/// ... all but one in so many at either end along each axis: strays do not stretch it.
const STRAYS: usize = 64;

/// Points sorted into the cells of a grid over most of them; what is beside the grid belongs to the cell at its border.
pub(crate) struct NearestIndex {
    points: Vec<Point3<f32>>,
    origin: Point3<f32>,
    cell: f32,
    cells: [usize; 3],
    /// Points of cell c are `members[start[c]..start[c + 1]]`.
    start: Vec<u32>,
    members: Vec<u32>,
}

impl NearestIndex {
    /// `points` must be finite; there may be none.
    pub(crate) fn new(points: Vec<Point3<f32>>) -> Self {
        // An odd step, so that rows of an organised cloud are met in other columns every time.
        let mut sample: Vec<_> = points.iter().step_by(points.len().div_ceil(SAMPLED) | 1).collect();
        let strays = sample.len() / STRAYS;
        let mut ends = |axis: usize| {
            sample.sort_unstable_by(|a, b| a[axis].total_cmp(&b[axis]));
            let at = |i: usize| sample.get(i).map_or(0.0, |p| p[axis]);
            [at(strays), at((sample.len() - strays).saturating_sub(1))]
        };
        let [[x0, x1], [y0, y1], [z0, z1]] = [0, 1, 2].map(&mut ends);
        let (low, high) = (Point3::new(x0, y0, z0), Point3::new(x1, y1, z1));
        let extent = (high - low).amax().max(1e-6);
        // Points of a scan lie on surfaces: n cells squared hold a few points each.
        let along = ((points.len() as f32 / 4.0).sqrt() as usize).clamp(1, MAX_CELLS);
        let cell = extent / along as f32;
        let cells = [0, 1, 2]
            .map(|a| ((high[a] - low[a]).max(0.0) / cell) as usize + 1)
            .map(|n| n.min(MAX_CELLS + 1));
        let mut index = Self {
            points,
            origin: low,
            cell,
            cells,
            start: vec![0; cells.iter().product::<usize>() + 1],
            members: vec![],
        };
        let homes: Vec<usize> = index.points.iter().map(|p| index.cell_number(index.cell_of(p))).collect();
        for &home in &homes {
            if let Some(count) = index.start.get_mut(home + 1) {
                *count += 1;
            }
        }
        let mut sum = 0;
        for count in &mut index.start {
            sum += *count;
            *count = sum;
        }
        index.members = vec![0; index.points.len()];
        let mut next = index.start.clone();
        for (i, &home) in (0..).zip(&homes) {
            let Some(place) = next.get_mut(home) else { continue };
            if let Some(member) = index.members.get_mut(*place as usize) {
                *member = i;
            }
            *place += 1;
        }
        index
    }

    /// The up to `N` nearest points as (index, squared distance), nearest first; fewer if there are fewer points.
    pub(crate) fn nearest<const N: usize>(&self, to: &Point3<f32>) -> Vec<(u32, f32)> {
        let mut best: Vec<(u32, f32)> = Vec::with_capacity(N + 1);
        if self.points.is_empty() || !to.iter().all(|x| x.is_finite()) {
            return best;
        }
        let home = self.cell_of(to);
        let consider = |best: &mut Vec<(u32, f32)>, i: u32, p: &Point3<f32>| {
            let d = (p - to).norm_squared();
            if best.len() < N || best.last().is_some_and(|b| d < b.1) {
                let at = best.partition_point(|b| (b.1, b.0) < (d, i));
                best.insert(at, (i, d));
                best.truncate(N);
            }
        };
        let furthest = self.cells.into_iter().max().unwrap_or(1) as i64;
        let mut cells = 0;
        for ring in 0..=furthest {
            let reach = (ring - 1).max(0) as f32 * self.cell;
            if best.len() == N && best.last().is_some_and(|b| b.1 <= reach * reach) {
                break;
            }
            // A few points near and most of them far away, as a background is: cells are empty for longer than looking at every
            // point takes.
            cells += 24 * ring * ring + 2;
            if cells > self.points.len() as i64 {
                best.clear();
                (0..).zip(&self.points).for_each(|(i, p)| consider(&mut best, i, p));
                break;
            }
            self.for_ring(home, ring, |i, p| consider(&mut best, i, p));
        }
        best
    }

    /// The points less than `reach` from another. Where cells so near hold more than `most`, that many of these are looked at.
    pub(crate) fn within(&self, to: &Point3<f32>, reach: f32, most: usize) -> Vec<Point3<f32>> {
        let corner = |far: f32| self.cell_of(&to.map(|x| x + far));
        let ([x0, y0, z0], [x1, y1, z1]) = (corner(-reach), corner(reach));
        let lines = (z0..=z1).flat_map(|z| (y0..=y1).map(move |y| (y, z)));
        // Cells along x lie one after the other.
        let members = lines.filter_map(|(y, z)| {
            let [first, last] = [x0, x1].map(|x| self.cell_number([x, y, z]));
            let range = *self.start.get(first)? as usize..*self.start.get(last + 1)? as usize;
            self.members.get(range)
        });
        let members: Vec<&[u32]> = members.collect();
        let count: usize = members.iter().map(|line| line.len()).sum();
        let some = members.into_iter().flatten().step_by(count.div_ceil(most).max(1));
        let points = some.filter_map(|&i| self.points.get(i as usize));
        points.filter(|p| (*p - to).norm_squared() < reach * reach).copied().collect()
    }

    pub(crate) fn points(&self) -> &[Point3<f32>] {
        &self.points
    }

    fn cell_of(&self, p: &Point3<f32>) -> [i64; 3] {
        let along =
            |a: usize| (((p[a] - self.origin[a]) / self.cell) as i64).clamp(0, self.cells_along(a) - 1);
        [along(0), along(1), along(2)]
    }

    fn cells_along(&self, axis: usize) -> i64 {
        self.cells.get(axis).copied().unwrap_or(1) as i64
    }

    fn cell_number(&self, [x, y, z]: [i64; 3]) -> usize {
        let [nx, ny, _] = self.cells;
        (z as usize * ny + y as usize) * nx + x as usize
    }

    /// Visits the points of the cells at Chebyshev distance `ring` from `home`.
    fn for_ring(&self, home: [i64; 3], ring: i64, mut visit: impl FnMut(u32, &Point3<f32>)) {
        let [hx, hy, hz] = home;
        let range = |h: i64, axis: usize| (h - ring).max(0)..=(h + ring).min(self.cells_along(axis) - 1);
        for z in range(hz, 2) {
            for y in range(hy, 1) {
                let shell = (z - hz).abs() == ring || (y - hy).abs() == ring;
                // Inside the shell only the two ends of the row belong to the ring.
                let step = if shell || ring == 0 { 1 } else { 2 * ring };
                let mut x = hx - ring;
                while x <= hx + ring {
                    if (0..self.cells_along(0)).contains(&x) {
                        self.for_cell(self.cell_number([x, y, z]), &mut visit);
                    }
                    x += step;
                }
            }
        }
    }

    fn for_cell(&self, cell: usize, visit: &mut impl FnMut(u32, &Point3<f32>)) {
        let (Some(&from), Some(&to)) = (self.start.get(cell), self.start.get(cell + 1)) else { return };
        for &i in self.members.get(from as usize..to as usize).unwrap_or_default() {
            if let Some(p) = self.points.get(i as usize) {
                visit(i, p);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn finds_what_a_search_through_all_finds(
            points in prop::collection::vec(prop::array::uniform3(-1.0f32..1.0), 0..200),
            flat in any::<bool>(),
            far in prop::sample::select(vec![0, 1, 200]),
            to in prop::array::uniform3(-2.0f32..2.0),
        ) {
            let mut points: Vec<_> =
                points.into_iter().map(|[x, y, z]| Point3::new(x, y, if flat { 0.5 } else { z })).collect();
            // Strays, and a background in which what is near fills one cell.
            points.extend((0..far).map(|i| Point3::new(i as f32, 200.0 - i as f32, 900.0)));
            let index = NearestIndex::new(points.clone());
            let to = Point3::from(to);
            let mut all: Vec<(f32, u32)> = (0..points.len()).map(|i| ((points[i] - to).norm_squared(), i as u32)).collect();
            all.sort_by(|a, b| a.partial_cmp(b).unwrap());
            let found: Vec<f32> = index.nearest::<3>(&to).into_iter().map(|(_, d)| d).collect();
            let expected: Vec<f32> = all.iter().take(3).map(|(d, _)| *d).collect();
            prop_assert_eq!(found, expected);
            for reach in [0.3, 1.7] {
                let near = all.iter().filter(|(d, _)| *d < reach * reach).count();
                prop_assert_eq!(index.within(&to, reach, usize::MAX).len(), near);
                prop_assert!(index.within(&to, reach, 7).len() <= near.min(7));
            }
        }
    }

    #[test]
    fn neither_strays_nor_rows_put_most_points_into_few_cells() {
        let place = |i: usize| Point3::new((i % 71) as f32, (i / 71) as f32, (i % 13) as f32) * 0.01;
        let points = (0..5000).map(place).chain([Point3::new(1e3, -2e3, 5e5)]).collect();
        let index = NearestIndex::new(points);
        let most = index.start.windows(2).map(|cell| cell[1] - cell[0]).max();
        assert!(most < Some(100), "{most:?}");
        assert_eq!(index.nearest::<1>(&Point3::new(999.0, -2e3, 5e5)), [(5000, 1.0)]);
        for side in [512, 1024] {
            let organised = |i: usize| Point3::new((i % side) as f32, (i / side) as f32, 0.0);
            let index = NearestIndex::new((0..side * side).map(organised).collect());
            let most = index.start.windows(2).map(|cell| cell[1] - cell[0]).max().unwrap() as usize;
            assert!(most < 4 * side * side / (MAX_CELLS * MAX_CELLS), "{most}");
        }
    }
}
