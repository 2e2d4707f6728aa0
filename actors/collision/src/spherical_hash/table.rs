//! Hash table: cells of direction and radius around a centre, with the triangles in each.

use nalgebra::{Point3, Vector3};

use crate::primitive::{Triangle, closest_on_triangle};
use crate::uniform_grid::Box3;

/// Triangles over more cells than this are tested by every query, which costs less than hashing them.
const CELLS_OF_ONE_MAX: usize = 512;
/// Largest number of cells along a side of the cube of directions.
const SIDE_MAX: usize = 64;
/// Largest number of radial layers.
const SHELLS_MAX: usize = 64;
/// Widening of a range, as a share of the side of the cube: more than the rounding of a quotient.
const ROUNDING: f64 = 1e-12;

/// Cells of one face of the cube of directions, first and last: along its two axes, and outwards.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CellRange {
    face: usize,
    spans: [[usize; 2]; 3],
}

impl CellRange {
    fn count(&self) -> usize {
        self.spans.iter().map(|[from, to]| to + 1 - from).product()
    }
}

/// Up to one range for each face of the cube.
struct CellRanges {
    ranges: [CellRange; 6],
    count: usize,
}

impl CellRanges {
    fn each(&self) -> &[CellRange] {
        &self.ranges[..self.count]
    }

    fn cells(&self) -> usize {
        self.each().iter().map(CellRange::count).sum()
    }
}

/// Triangles by direction and distance from a centre.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    pub centre: Point3<f64>,
    side: usize,
    shells: usize,
    innermost: f64,
    outermost: f64,
    shells_per_metre: f64,
    starts: Vec<u32>,
    members: Vec<u32>,
    large: Vec<u32>,
    ranges: Vec<(CellRange, u32)>,
    radii: Vec<[f64; 2]>,
}

impl Table {
    /// Refills the table with triangles, seen from `centre`.
    pub fn rebuild(&mut self, centre: Point3<f64>, triangles: &[Triangle]) {
        self.centre = centre;
        self.radii.clear();
        self.radii.extend(triangles.iter().map(|triangle| radii(&centre, triangle)));
        self.choose_cells(triangles.len());
        self.large.clear();
        self.ranges.clear();
        let cells = 6 * self.side * self.side * self.shells;
        self.starts.clear();
        self.starts.resize(cells + 1, 0);
        for (index, triangle) in triangles.iter().enumerate() {
            let found = self.ranges_of(&Box3::of(triangle), self.radii[index]);
            if found.cells() > CELLS_OF_ONE_MAX {
                self.large.push(index as u32);
                continue;
            }
            for range in found.each() {
                self.ranges.push((*range, index as u32));
                each_cell(range, self.side, self.shells, |cell| self.starts[cell + 1] += 1);
            }
        }
        for cell in 0..cells {
            self.starts[cell + 1] += self.starts[cell];
        }
        self.members.clear();
        self.members.resize(self.starts[cells] as usize, 0);
        // Each start advances to the end of its cell, which is the start of the next; shifted back afterwards.
        for (range, index) in &self.ranges {
            each_cell(range, self.side, self.shells, |cell| {
                self.members[self.starts[cell] as usize] = *index;
                self.starts[cell] += 1;
            });
        }
        for cell in (0..cells).rev() {
            self.starts[cell + 1] = self.starts[cell];
        }
        self.starts[0] = 0;
    }

    /// Chooses cells about as large as evenly spread triangles: two triangles per direction.
    fn choose_cells(&mut self, triangles: usize) {
        self.outermost = self.radii.iter().map(|[_, far]| *far).fold(0.0, f64::max);
        self.innermost = self.radii.iter().map(|[near, _]| *near).fold(self.outermost, f64::min);
        self.side = ((triangles as f64 / 12.0).sqrt().ceil() as usize).clamp(1, SIDE_MAX);
        let mean =
            self.radii.iter().map(|[near, far]| 0.5 * (near + far)).sum::<f64>() / (triangles.max(1)) as f64;
        let width = mean * std::f64::consts::FRAC_PI_2 / self.side as f64;
        let depth = self.outermost - self.innermost;
        let shells = depth / width;
        (self.shells, self.shells_per_metre) = if shells.is_finite() && depth > 0.0 {
            let shells = (shells.ceil() as usize).clamp(1, SHELLS_MAX);
            (shells, shells as f64 / depth)
        } else {
            (1, 0.0)
        };
    }

    /// Width of a cell at a distance from the centre \[m\].
    pub fn width(&self, radius: f64) -> f64 {
        radius * std::f64::consts::FRAC_PI_2 / self.side.max(1) as f64
    }

    fn shell(&self, radius: f64) -> usize {
        // A cast of what is negative or not a number gives 0.
        (((radius - self.innermost) * self.shells_per_metre) as usize).min(self.shells - 1)
    }

    /// The cells that a box at these distances from the centre may overlap.
    fn ranges_of(&self, of: &Box3, [near, far]: [f64; 2]) -> CellRanges {
        let (min, max) = (of.min - self.centre, of.max - self.centre);
        let rounding = ROUNDING * (1.0 + far);
        let shells = [self.shell(near - rounding), self.shell(far + rounding)];
        let mut found = CellRanges { ranges: [CellRange { face: 0, spans: [[0; 2]; 3] }; 6], count: 0 };
        for face in 0..6 {
            let (axis, outwards) = (face / 2, face % 2 == 0);
            let [low, high] = if outwards { [min[axis], max[axis]] } else { [-max[axis], -min[axis]] };
            if high < 0.0 {
                continue;
            }
            let span = |axis: usize| span(min[axis], max[axis], low, high, self.side);
            if let (Some(first), Some(second)) = (span((axis + 1) % 3), span((axis + 2) % 3)) {
                found.ranges[found.count] = CellRange { face, spans: [first, second, shells] };
                found.count += 1;
            }
        }
        found
    }

    /// Visits every triangle that may overlap a box, some more than once.
    pub fn around(&self, of: &Box3, mut found: impl FnMut(u32)) {
        if self.starts.is_empty() {
            return;
        }
        let nearest = self.centre.sup(&of.min).inf(&of.max);
        let farthest = (of.min - self.centre).abs().sup(&(of.max - self.centre).abs());
        let radii = [(nearest - self.centre).norm(), farthest.norm()];
        let rounding = ROUNDING * (1.0 + radii[1]);
        if radii[0] > self.outermost + rounding || radii[1] < self.innermost - rounding {
            return;
        }
        let ranges = self.ranges_of(of, radii);
        if ranges.cells() > self.radii.len() {
            (0..self.radii.len() as u32).for_each(found);
            return;
        }
        self.large.iter().copied().for_each(&mut found);
        for range in ranges.each() {
            each_cell(range, self.side, self.shells, |cell| {
                let members = self.starts[cell] as usize..self.starts[cell + 1] as usize;
                self.members[members].iter().copied().for_each(&mut found);
            });
        }
    }

    /// Visits every triangle that a ray from the centre may hit at `radius` \[m\] or further out, some more than once.
    pub fn along(&self, direction: &Vector3<f64>, radius: f64, mut found: impl FnMut(u32)) {
        if self.starts.is_empty() || radius > self.outermost {
            return;
        }
        self.large.iter().copied().for_each(&mut found);
        let axis = direction.iamax();
        let outwards = direction[axis] > 0.0;
        let length = direction[axis].abs();
        let span = |axis: usize| span(direction[axis], direction[axis], length, length, self.side);
        if let (Some(first), Some(second)) = (span((axis + 1) % 3), span((axis + 2) % 3)) {
            let face = 2 * axis + usize::from(!outwards);
            let range = CellRange { face, spans: [first, second, [self.shell(radius), self.shells - 1]] };
            each_cell(&range, self.side, self.shells, |cell| {
                let members = self.starts[cell] as usize..self.starts[cell + 1] as usize;
                self.members[members].iter().copied().for_each(&mut found);
            });
        }
    }

    /// Nearest and farthest distance of a triangle from the centre \[m\].
    pub fn radii(&self, triangle: u32) -> [f64; 2] {
        self.radii[triangle as usize]
    }
}

fn radii(centre: &Point3<f64>, triangle: &Triangle) -> [f64; 2] {
    let far = triangle.iter().map(|corner| (corner - centre).norm()).fold(0.0, f64::max);
    let near = (closest_on_triangle(centre, triangle).point - centre).norm();
    // The nearest point of a thin triangle is inaccurate; no point is nearer than the farthest distance minus its
    // length.
    [near - 1e-7 * far, far]
}

/// First and last cell of an object with one coordinate in `[from, to]` and a distance `[low, high]` in front of the
/// centre, on a face of the cube that spans -1 to 1 at the distance 1; `None` beside the face.
fn span(from: f64, to: f64, low: f64, high: f64, side: usize) -> Option<[usize; 2]> {
    if from > high || to < -high {
        return None;
    }
    let quotient = |coordinate: f64, ahead: f64, otherwise: f64| {
        if ahead > 0.0 { coordinate / ahead } else { otherwise }
    };
    let first = if from >= 0.0 { quotient(from, high, 0.0) } else { quotient(from, low, -1.0) };
    let last = if to >= 0.0 { quotient(to, low, 1.0) } else { quotient(to, high, 0.0) };
    // An object that also reaches behind the centre covers all cells.
    let (first, last) = if high > 0.0 { (first, last) } else { (-1.0, 1.0) };
    let cell = |place: f64| ((0.5 * (place + 1.0) * side as f64) as usize).min(side - 1);
    Some([cell(first - 2.0 * ROUNDING), cell(last + 2.0 * ROUNDING)])
}

fn each_cell(range: &CellRange, side: usize, shells: usize, mut visit: impl FnMut(usize)) {
    let [first, second, outwards] = range.spans;
    for v in second[0]..=second[1] {
        for u in first[0]..=first[1] {
            let direction = (range.face * side + v) * side + u;
            for shell in outwards[0]..=outwards[1] {
                visit(direction * shells + shell);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    #[test]
    fn whatever_is_in_a_box_or_on_a_ray_is_offered() {
        let mut random = Pcg64Mcg::seed_from_u64(11);
        let vector =
            |random: &mut Pcg64Mcg, size: f64| Vector3::from_fn(|_, _| random.random_range(-size..=size));
        let mut table = Table::default();
        let (mut offered, mut needed) = (0, 0);
        for round in 0..40 {
            let centre = Point3::from(vector(&mut random, 0.3));
            let size = if round % 4 == 0 { 1.5 } else { 0.1 };
            let triangles: Vec<Triangle> = (0..random.random_range(0..500))
                .map(|_| {
                    let middle = vector(&mut random, 1.0);
                    std::array::from_fn(|_| Point3::from(middle + vector(&mut random, size)))
                })
                .collect();
            table.rebuild(centre, &triangles);
            for _ in 0..100 {
                // Points of triangles, and of boxes around them.
                let far = if random.random_bool(0.1) { 1e-9 } else { 1.5 };
                let asked = centre + vector(&mut random, far);
                let around = Box3::of([&asked]).grown(random.random_range(0.0..0.2));
                let mut found = vec![false; triangles.len()];
                table.around(&around, |triangle| found[triangle as usize] = true);
                let mut on_ray = vec![false; triangles.len()];
                table.along(&(asked - centre), 0.0, |triangle| on_ray[triangle as usize] = true);
                offered += found.iter().filter(|found| **found).count();
                for (index, triangle) in triangles.iter().enumerate() {
                    let [a, b, c] = triangle.map(|corner| corner - centre);
                    for _ in 0..4 {
                        let weights = [random.random_range(0.0..1.0), random.random_range(0.0..1.0)];
                        let point = a + (b - a) * weights[0] + (c - b) * (weights[0] * weights[1]);
                        let place = centre + point;
                        if around.overlaps(&Box3::of([&place])) {
                            needed += 1;
                            assert!(found[index], "{place} of {triangle:?} in {around:?}");
                        }
                    }
                    let direction = asked - centre;
                    let signs = [
                        direction.cross(&a).dot(&b),
                        direction.cross(&b).dot(&c),
                        direction.cross(&c).dot(&a),
                    ];
                    let ahead = a.cross(&b) + b.cross(&c) + c.cross(&a);
                    let t = ahead.dot(&a) / ahead.dot(&direction);
                    let meets = signs.iter().all(|sign| *sign > 0.0) || signs.iter().all(|sign| *sign < 0.0);
                    assert!(!(meets && t > 0.0) || on_ray[index], "{direction} {triangle:?}");
                }
            }
        }
        assert!(needed > 1_000 && offered < 40 * 100 * 250, "{needed} {offered}");
    }
}
