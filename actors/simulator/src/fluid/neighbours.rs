//! Who is within the support of whom: particles sorted by the cells of a grid over the domain, each pair found once.

use nalgebra::Point3;

/// Cells of the grid over the domain.
#[derive(Clone, Debug)]
pub(super) struct CellGrid {
    min: Point3<f64>,
    inverse: f64,
    pub size: [usize; 3],
}

impl CellGrid {
    /// Cells of an edge over a box.
    pub(super) fn new(min: Point3<f64>, max: Point3<f64>, edge: f64) -> Self {
        let size = std::array::from_fn(|axis| ((max[axis] - min[axis]) / edge).ceil().max(1.0) as usize);
        Self { min, inverse: 1.0 / edge, size }
    }

    pub(super) fn count(&self) -> usize {
        self.size.iter().product()
    }

    /// The cell of a point; what lies outside counts as at the edge.
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

    /// The cells beside one in a row that lies by `dy` and `dz`, as a range of indices.
    #[inline]
    fn row(&self, [x, y, z]: [usize; 3], dy: isize, dz: isize, first: isize) -> Option<(usize, usize)> {
        let y = y.checked_add_signed(dy).filter(|y| *y < self.size[1])?;
        let z = z.checked_add_signed(dz).filter(|z| *z < self.size[2])?;
        let from = x.saturating_add_signed(first);
        let to = (x + 1).min(self.size[0] - 1);
        Some((self.index([from, y, z]), self.index([to, y, z])))
    }
}

/// Where the particles of each cell begin, of particles in the order of their cells.
#[derive(Clone, Debug, Default)]
pub(super) struct CellStarts {
    starts: Vec<u32>,
    /// Which particle comes at each place.
    pub order: Vec<u32>,
}

impl CellStarts {
    /// Sorts by cells; within a cell the order stays.
    pub(super) fn sort(&mut self, grid: &CellGrid, points: &[Point3<f64>]) {
        self.starts.clear();
        self.starts.resize(grid.count() + 1, 0);
        for point in points {
            self.starts[grid.index(grid.place(point)) + 1] += 1;
        }
        for cell in 0..grid.count() {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.order.clear();
        self.order.resize(points.len(), 0);
        for (index, point) in points.iter().enumerate() {
            let cell = grid.index(grid.place(point));
            self.order[self.starts[cell] as usize] = index as u32;
            self.starts[cell] += 1;
        }
        for cell in (1..=grid.count()).rev() {
            self.starts[cell] = self.starts[cell - 1];
        }
        self.starts[0] = 0;
    }

    /// For particles that lie in the order of their cells: calls with each pair once, the first index below the second.
    #[inline]
    pub(super) fn pairs(
        &self,
        grid: &CellGrid,
        points: &[Point3<f64>],
        support: f64,
        mut found: impl FnMut(u32, u32, f64),
    ) {
        const FORWARD: [(isize, isize, isize); 5] =
            [(0, 0, 0), (1, 0, -1), (-1, 1, -1), (0, 1, -1), (1, 1, -1)];
        let square = support * support;
        for (index, point) in points.iter().enumerate() {
            let cell = grid.place(point);
            for (dy, dz, first) in FORWARD {
                let Some((from, to)) = grid.row(cell, dy, dz, first) else { continue };
                let from = (self.starts[from] as usize).max(index + 1);
                let to = self.starts[to + 1] as usize;
                for (other, beside) in points.iter().enumerate().take(to).skip(from) {
                    let distance = (beside - point).norm_squared();
                    if distance < square {
                        found(index as u32, other as u32, distance);
                    }
                }
            }
        }
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
        let cell = grid.place(centre);
        for (dy, dz) in (-1..=1).flat_map(|dz| (-1..=1).map(move |dy| (dy, dz))) {
            let Some((from, to)) = grid.row(cell, dy, dz, -1) else { continue };
            let (from, to) = (self.starts[from] as usize, self.starts[to + 1] as usize);
            for (other, beside) in points.iter().enumerate().take(to).skip(from) {
                let distance = (beside - centre).norm_squared();
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
    fn each_pair_within_the_support_is_found_once() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut coordinate = || random.random_range(-0.1..1.1);
        let points: Vec<Point3<f64>> =
            (0..400).map(|_| Point3::new(coordinate(), coordinate(), coordinate())).collect();
        let grid = CellGrid::new(Point3::origin(), Point3::new(1.0, 1.0, 1.0), 0.2);
        let mut cells = CellStarts::default();
        cells.sort(&grid, &points);
        let sorted: Vec<Point3<f64>> = cells.order.iter().map(|index| points[*index as usize]).collect();
        let mut found = Vec::new();
        cells.pairs(&grid, &sorted, 0.2, |a, b, _| found.push((a, b)));
        let mut expected = Vec::new();
        for a in 0..400 {
            for b in a + 1..400 {
                // Beyond the edge a cell is larger than the support: nothing is missed there.
                if (sorted[a as usize] - sorted[b as usize]).norm() < 0.2 {
                    expected.push((a, b));
                }
            }
        }
        found.sort_unstable();
        assert_eq!(found, expected);
        let mut around = Vec::new();
        cells.around(&grid, &sorted, &sorted[7], 0.2, |other, _| around.push(other));
        let near = expected.iter().filter(|(a, b)| *a == 7 || *b == 7).count();
        assert_eq!(around.len(), near + 1);
    }
}
