//! Uniform grid over boxes, to find those that overlap another box: a broad phase for objects that move in each step,
//! where a tree would be built for a single use.

use nalgebra::{Point3, Vector3};

/// An axis-aligned box \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Box3 {
    pub min: Point3<f64>,
    pub max: Point3<f64>,
}

impl Box3 {
    /// The empty box.
    pub const EMPTY: Self = Self {
        min: Point3::new(f64::INFINITY, f64::INFINITY, f64::INFINITY),
        max: Point3::new(f64::NEG_INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY),
    };

    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f64>>) -> Self {
        points.into_iter().fold(Self::EMPTY, |bounds, point| bounds.with(point))
    }

    pub fn with(&self, point: &Point3<f64>) -> Self {
        Self { min: self.min.inf(point), max: self.max.sup(point) }
    }

    pub fn joined(&self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }

    pub fn grown(&self, by: f64) -> Self {
        let by = Vector3::repeat(by);
        Self { min: self.min - by, max: self.max + by }
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.max[axis] && other.min[axis] <= self.max[axis])
    }
}

/// Most cells per box.
const CELLS_PER_BOX: usize = 8;
/// Boxes over more cells than this are kept in a separate list and tested in each query: a few of them cost less than
/// their cells.
const CELLS_OF_ONE_MAX: usize = 64;

/// Boxes in a grid whose cells are as large as the mean box.
#[derive(Clone, Debug, Default)]
pub(crate) struct BoxGrid {
    boxes: Vec<(Box3, u32)>,
    origin: Point3<f64>,
    per_metre: f64,
    dims: [usize; 3],
    starts: Vec<u32>,
    members: Vec<u32>,
    large: Vec<u32>,
    /// First cell of each box, to report a pair in only one of their common cells.
    firsts: Vec<[u32; 3]>,
}

impl BoxGrid {
    /// Refills the grid with boxes and the ids to report for them.
    pub fn rebuild(&mut self, boxes: impl IntoIterator<Item = (Box3, u32)>) {
        self.boxes.clear();
        self.boxes.extend(boxes);
        self.choose_cells();
        let cells = self.dims.iter().product::<usize>();
        self.starts.clear();
        self.starts.resize(cells + 1, 0);
        self.large.clear();
        self.firsts.clear();
        for index in 0..self.boxes.len() {
            let range = self.range(&self.boxes[index].0);
            self.firsts.push(range.map(|[from, _]| from as u32));
            if count(&range) > CELLS_OF_ONE_MAX {
                self.large.push(index as u32);
            } else {
                each(&range, &self.dims, |cell, _| self.starts[cell + 1] += 1);
            }
        }
        for cell in 0..cells {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.members.clear();
        self.members.resize(self.starts[cells] as usize, 0);
        // Each start advances to the end of its cell, which is the start of the next; shifted back afterwards.
        for index in 0..self.boxes.len() {
            let range = self.range(&self.boxes[index].0);
            if count(&range) <= CELLS_OF_ONE_MAX {
                each(&range, &self.dims, |cell, _| {
                    self.members[self.starts[cell] as usize] = index as u32;
                    self.starts[cell] += 1;
                });
            }
        }
        for cell in (0..cells).rev() {
            self.starts[cell + 1] = self.starts[cell];
        }
        self.starts[0] = 0;
    }

    fn choose_cells(&mut self) {
        let bounds = self.boxes.iter().fold(Box3::EMPTY, |bounds, (other, _)| bounds.joined(other));
        (self.origin, self.per_metre, self.dims) = (bounds.min, 0.0, [1; 3]);
        let extent = bounds.max - bounds.min;
        if self.boxes.is_empty() || !extent.iter().all(|length| length.is_finite()) {
            self.origin = Point3::origin();
            return;
        }
        let mean = self.boxes.iter().map(|(bounds, _)| (bounds.max - bounds.min).max()).sum::<f64>()
            / self.boxes.len() as f64;
        let cells_max = CELLS_PER_BOX * self.boxes.len() + 64;
        let mut cell = mean.max(extent.max() / 1000.0);
        while cell > 0.0 && cell.is_finite() {
            self.per_metre = 1.0 / cell;
            self.dims = std::array::from_fn(|axis| (extent[axis] / cell) as usize + 1);
            if self.dims.iter().product::<usize>() <= cells_max {
                break;
            }
            cell *= 1.26;
        }
        if !self.per_metre.is_finite() {
            (self.per_metre, self.dims) = (0.0, [1; 3]);
        }
    }

    /// First and last cell on each axis; boxes outside belong to the border cells.
    fn range(&self, of: &Box3) -> [[usize; 2]; 3] {
        std::array::from_fn(|axis| {
            let cell = |place: f64| {
                // A cast of what is negative or not a number gives 0.
                (((place - self.origin[axis]) * self.per_metre) as usize).min(self.dims[axis] - 1)
            };
            [cell(of.min[axis]), cell(of.max[axis])]
        })
    }

    /// Visits every box that overlaps `asked`, once each; in the same order for the same boxes.
    pub fn overlapping(&self, asked: &Box3, mut found: impl FnMut(u32)) {
        let range = self.range(asked);
        let mut offer = |index: u32| {
            let (bounds, name) = &self.boxes[index as usize];
            if bounds.overlaps(asked) {
                found(*name);
            }
        };
        if count(&range) > self.boxes.len() {
            (0..self.boxes.len() as u32).for_each(offer);
            return;
        }
        self.large.iter().copied().for_each(&mut offer);
        let from = range.map(|[from, _]| from as u32);
        each(&range, &self.dims, |cell, place| {
            for &index in &self.members[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                let first = &self.firsts[index as usize];
                // Reported only in the first cell that both share.
                if (0..3).all(|axis| place[axis] == first[axis].max(from[axis])) {
                    offer(index);
                }
            }
        });
    }
}

fn count(range: &[[usize; 2]; 3]) -> usize {
    range.iter().map(|[from, to]| to + 1 - from).product()
}

fn each(range: &[[usize; 2]; 3], dims: &[usize; 3], mut visit: impl FnMut(usize, [u32; 3])) {
    for z in range[2][0]..=range[2][1] {
        for y in range[1][0]..=range[1][1] {
            let row = (z * dims[1] + y) * dims[0];
            for x in range[0][0]..=range[0][1] {
                visit(row + x, [x as u32, y as u32, z as u32]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn random_box(random: &mut Pcg64Mcg, large: f64) -> Box3 {
        let size = if random.random_bool(large) { 1.0 } else { 0.05 };
        let min = Point3::from(Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)));
        let extent =
            Vector3::from_fn(
                |_, _| {
                    if random.random_bool(0.1) { 0.0 } else { random.random_range(0.0..size) }
                },
            );
        Box3 { min, max: min + extent }
    }

    #[test]
    fn finds_what_overlaps_and_each_once() {
        let mut random = Pcg64Mcg::seed_from_u64(3);
        let mut grid = BoxGrid::default();
        for round in 0..60 {
            let flat = if round % 3 == 0 { 0.0 } else { 1.0 };
            let boxes: Vec<_> = (0..random.random_range(0..400))
                .map(|_| {
                    let mut of = random_box(&mut random, if round % 2 == 0 { 0.02 } else { 0.5 });
                    (of.min.z, of.max.z) = (of.min.z * flat, of.max.z * flat);
                    of
                })
                .collect();
            grid.rebuild(boxes.iter().enumerate().map(|(i, of)| (*of, 7 + i as u32)));
            for _ in 0..100 {
                let mut asked = random_box(&mut random, 0.2);
                if random.random_bool(0.5) && !boxes.is_empty() {
                    // Touching boxes overlap.
                    asked.min = boxes[random.random_range(0..boxes.len())].max;
                    asked.max = asked.min + Vector3::repeat(0.1);
                }
                let mut found = Vec::new();
                grid.overlapping(&asked, |name| found.push(name));
                found.sort_unstable();
                let expected: Vec<_> =
                    (0..boxes.len()).filter(|&i| boxes[i].overlaps(&asked)).map(|i| 7 + i as u32).collect();
                assert_eq!(found, expected);
            }
        }
    }

    #[test]
    fn points_empty_boxes_and_endless_ones_are_answered() {
        let mut grid = BoxGrid::default();
        let point = Box3::of([&Point3::new(1.0, 2.0, 3.0)]);
        let endless = Box3 { min: Point3::origin(), max: Point3::new(f64::INFINITY, 1.0, 1.0) };
        for boxes in [vec![point; 5], vec![Box3::EMPTY; 3], vec![endless, point], vec![point, Box3::EMPTY]] {
            grid.rebuild(boxes.iter().copied().zip(0..));
            for asked in boxes.iter().chain([&Box3::EMPTY]) {
                let mut found = Vec::new();
                grid.overlapping(asked, |name| found.push(name as usize));
                found.sort_unstable();
                let expected: Vec<_> = (0..boxes.len()).filter(|&i| boxes[i].overlaps(asked)).collect();
                assert_eq!(found, expected);
            }
        }
    }
}
