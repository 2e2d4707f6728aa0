//! Cell grid for neighbour search: particles sorted by the cells of a uniform grid over the domain.

use nalgebra::Point3;

/// Cells of the grid over the domain.
#[derive(Clone, Debug)]
pub(super) struct CellGrid {
    min: Point3<f64>,
    inverse: f64,
    pub size: [usize; 3],
}

impl CellGrid {
    /// A grid over a box, with cells of this edge length.
    pub(super) fn new(min: Point3<f64>, max: Point3<f64>, edge: f64) -> Self {
        let size = std::array::from_fn(|axis| ((max[axis] - min[axis]) / edge).ceil().max(1.0) as usize);
        Self { min, inverse: 1.0 / edge, size }
    }

    pub(super) fn count(&self) -> usize {
        self.size.iter().product()
    }

    /// The cell of a point; points outside count as at the border.
    #[inline]
    pub(super) fn place(&self, point: &Point3<f64>) -> [usize; 3] {
        // The cast saturates.
        std::array::from_fn(|axis| {
            (((point[axis] - self.min[axis]) * self.inverse) as usize).min(self.size[axis] - 1)
        })
    }

    #[inline]
    pub(super) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    /// The cell of a position relative to the corner of the box.
    #[inline]
    pub(super) fn cell_of(&self, place: &[f32; 4]) -> usize {
        // The cast saturates.
        self.index(std::array::from_fn(|axis| {
            ((place[axis] * self.inverse as f32) as usize).min(self.size[axis] - 1)
        }))
    }

    /// The row of cells along x that contains a cell.
    pub(super) fn line_of(&self, cell: usize) -> usize {
        cell / self.size[0]
    }

    /// Rows of neighbouring cells, as index ranges, both ends included.
    pub(super) fn rows_about(&self, cell: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.rows_about_all(cell, cell)
    }

    /// The same for all cells of a row, from the first to the last.
    pub(super) fn rows_about_all(
        &self,
        first: usize,
        last: usize,
    ) -> impl Iterator<Item = (usize, usize)> + '_ {
        let (x, rest) = (first % self.size[0], first / self.size[0]);
        let (y, z) = (rest % self.size[1], rest / self.size[1]);
        let about = |at: usize, axis: usize| at.saturating_sub(1)..=(at + 1).min(self.size[axis] - 1);
        let (from, to) = (x.saturating_sub(1), (last % self.size[0] + 1).min(self.size[0] - 1));
        let columns = about(z, 2).flat_map(move |z| about(y, 1).map(move |y| (y, z)));
        columns.map(move |(y, z)| (self.index([from, y, z]), self.index([to, y, z])))
    }
}

/// Start index of each cell in the sorted particles.
#[derive(Clone, Debug, Default)]
pub(super) struct CellStarts {
    starts: Vec<u32>,
    /// Original index of each sorted particle.
    pub order: Vec<u32>,
    /// Cell of each particle, in original order.
    cell_of: Vec<u32>,
}

impl CellStarts {
    /// Sorts by cell, and within a cell by the first coordinate, so that neighbours in a row of cells are near in
    /// memory; the sort is stable.
    pub(super) fn sort(&mut self, grid: &CellGrid, points: &[Point3<f64>]) {
        let Self { starts, order, cell_of } = self;
        starts.clear();
        starts.resize(grid.count() + 1, 0);
        cell_of.clear();
        cell_of.extend(points.iter().map(|point| grid.index(grid.place(point)) as u32));
        for cell in &*cell_of {
            starts[*cell as usize + 1] += 1;
        }
        let mut sum = 0;
        for start in &mut *starts {
            sum += *start;
            *start = sum;
        }
        order.clear();
        order.resize(points.len(), 0);
        for (index, cell) in cell_of.iter().enumerate() {
            order[starts[*cell as usize] as usize] = index as u32;
            starts[*cell as usize] += 1;
        }
        starts.copy_within(..grid.count(), 1);
        starts[0] = 0;
        // Almost sorted from the previous step.
        for end in 1..order.len() {
            let particle = order[end] as usize;
            let mut at = end;
            while at > 0 {
                let before = order[at - 1] as usize;
                if cell_of[before] != cell_of[particle] || points[before].x <= points[particle].x {
                    break;
                }
                order[at] = before as u32;
                at -= 1;
            }
            order[at] = particle as u32;
        }
    }

    /// Sorted indices of the particles in a row of cells, from the first to the last.
    #[inline]
    pub(super) fn range(&self, from: usize, to: usize) -> std::ops::Range<usize> {
        self.starts[from] as usize..self.starts[to + 1] as usize
    }

    /// Calls with all of the sorted `points` within the support of one.
    #[inline]
    pub(super) fn around(
        &self,
        grid: &CellGrid,
        points: &[Point3<f64>],
        centre: &Point3<f64>,
        support: f64,
        mut found: impl FnMut(u32, f64),
    ) {
        for (from, to) in grid.rows_about(grid.index(grid.place(centre))) {
            for other in self.range(from, to) {
                let distance = (points[other] - centre).norm_squared();
                if distance < support * support {
                    found(other as u32, distance);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn each_pair_within_the_support_is_found_from_both_sides() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut coordinate = || random.random_range(-0.1..1.1);
        let points: Vec<Point3<f64>> =
            (0..400).map(|_| Point3::new(coordinate(), coordinate(), coordinate())).collect();
        let grid = CellGrid::new(Point3::origin(), Point3::new(1.0, 1.0, 1.0), 0.2);
        let mut cells = CellStarts::default();
        cells.sort(&grid, &points);
        let sorted: Vec<Point3<f64>> = cells.order.iter().map(|index| points[*index as usize]).collect();
        for a in 0..400 {
            let mut found = Vec::new();
            cells.around(&grid, &sorted, &sorted[a], 0.2, |other, _| found.push(other as usize));
            found.sort_unstable();
            // Border cells are larger than the support: nothing is missed there.
            let expected: Vec<usize> =
                (0..400).filter(|b| (sorted[a] - sorted[*b]).norm_squared() < 0.2 * 0.2).collect();
            assert_eq!(found, expected);
            let place = [sorted[a].x as f32, sorted[a].y as f32, sorted[a].z as f32, 0.0];
            assert_eq!(grid.cell_of(&place), grid.index(grid.place(&sorted[a])));
        }
    }
}
