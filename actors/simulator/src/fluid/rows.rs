//! Who is within the support of whom, as flat lists: for each particle those about it, and how steep the kernel is between
//! them. Particles lie in the order of their cells, so that lists point to places that are near in memory.

use super::kernel::Kernel;
use super::neighbours::{CellGrid, CellStarts};

/// No wall.
const DRY: u32 = u32::MAX;

/// Neighbours of every particle, then of every sample of a wall that a particle is near to.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    /// Where the list of each row begins; one more than there are rows.
    pub starts: Vec<u32>,
    /// Rows of the neighbours.
    pub others: Vec<u32>,
    /// Volume of what is not a plain particle of the two, times the kernel's slope \[m³/m⁵\]: times the way from one to the
    /// other it is the gradient that the two have in common.
    pub factors: Vec<f32>,
    /// Places, from the corner of the box \[m\].
    pub places: Vec<[f32; 4]>,
    /// Sums of kernels times volumes: 1 is neither compressed nor thin.
    pub compression: Vec<f32>,
    /// Diagonal of the product of divergence and gradient \[1/m²\].
    pub diagonal: Vec<f32>,
    /// Rows of particles; the others are walls.
    pub particles: usize,
    /// Which sample each row of a wall is, in the order of their cells.
    pub wet: Vec<u32>,
    row_of_wall: Vec<u32>,
    candidates: Candidates,
}

/// What may be near to the particles of a cell.
#[derive(Clone, Debug, Default)]
struct Candidates {
    rows: Vec<u32>,
    volumes: Vec<f32>,
    axes: [Vec<f32>; 3],
    squares: Vec<f32>,
    near: Vec<u32>,
}

impl Candidates {
    fn clear(&mut self) {
        self.rows.clear();
        self.volumes.clear();
        self.axes.iter_mut().for_each(Vec::clear);
    }

    fn push(&mut self, row: u32, volume: f32, place: &[f32; 4]) {
        self.rows.push(row);
        self.volumes.push(volume);
        for (axis, x) in self.axes.iter_mut().zip(place) {
            axis.push(*x);
        }
    }

    /// Which of them are within a distance of a place; their squares of distance stand in `squares`.
    fn find(&mut self, place: &[f32; 4], square: f32) {
        let count = self.rows.len();
        self.squares.resize(count, 0.0);
        let [xs, ys, zs] = &self.axes;
        for (((square, x), y), z) in self.squares.iter_mut().zip(xs).zip(ys).zip(zs) {
            let [dx, dy, dz] = [place[0] - x, place[1] - y, place[2] - z];
            *square = dx * dx + dy * dy + dz * dz;
        }
        // Without branches: most are too far.
        self.near.resize(count + 1, 0);
        let mut found = 0;
        for (index, distance) in self.squares.iter().enumerate() {
            self.near[found] = index as u32;
            found += usize::from(*distance < square);
        }
        self.near.truncate(found);
    }
}

/// Samples of walls as [`Rows`] meets them: sorted by cells.
pub(super) struct Walls<'a> {
    pub cells: &'a CellStarts,
    pub places: &'a [[f32; 4]],
    pub volumes: &'a [f32],
}

impl Rows {
    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        self.compression.len()
    }

    /// Rows of a liquid at `places` (filled by the caller, in the order of their cells) and of the walls that it is near to.
    /// A wall that particles lie beside at rest has `beside` of its volume in kernels of theirs.
    pub(super) fn build(
        &mut self,
        grid: &CellGrid,
        cells: &CellStarts,
        walls: &Walls<'_>,
        kernel: &Kernel,
        volume: f32,
        beside: f32,
    ) {
        let count = self.places.len();
        self.particles = count;
        self.starts.clear();
        self.others.clear();
        self.factors.clear();
        self.compression.clear();
        self.diagonal.clear();
        let square = (kernel.support * kernel.support) as f32;
        let own = volume * kernel.value_and_slope(0.0).0 as f32;
        self.find_wet(grid, cells, walls, square);
        let mut candidates = std::mem::take(&mut self.candidates);
        for cell in 0..grid.count() {
            let inside = cells.range(cell, cell);
            if inside.is_empty() {
                continue;
            }
            candidates.clear();
            for (from, to) in grid.rows_about(cell) {
                for row in cells.range(from, to) {
                    candidates.push(row as u32, volume, &self.places[row]);
                }
                for wall in walls.cells.range(from, to) {
                    if self.row_of_wall[wall] != DRY {
                        candidates.push(self.row_of_wall[wall], walls.volumes[wall], &walls.places[wall]);
                    }
                }
            }
            for row in inside {
                let place = self.places[row];
                candidates.find(&place, square);
                self.add_row(kernel, row as u32, &place, own, &candidates);
            }
        }
        for index in 0..self.wet.len() {
            let wall = self.wet[index] as usize;
            let place = walls.places[wall];
            self.places.push(place);
            let share = walls.volumes[wall] / volume;
            candidates.clear();
            for (from, to) in grid.rows_about(grid.cell_of(&place)) {
                for row in cells.range(from, to) {
                    candidates.push(row as u32, walls.volumes[wall], &self.places[row]);
                }
            }
            candidates.find(&place, square);
            self.add_row(kernel, (count + index) as u32, &place, 1.0 - beside * share, &candidates);
        }
        self.starts.push(self.others.len() as u32);
        self.candidates = candidates;
    }

    /// Finds the samples of walls that have a particle within the support.
    fn find_wet(&mut self, grid: &CellGrid, cells: &CellStarts, walls: &Walls<'_>, square: f32) {
        let count = self.places.len();
        self.wet.clear();
        self.row_of_wall.clear();
        self.row_of_wall.resize(walls.places.len(), DRY);
        for (wall, place) in walls.places.iter().enumerate() {
            let is_near = |row: usize| {
                let [dx, dy, dz] = std::array::from_fn(|axis| self.places[row][axis] - place[axis]);
                dx * dx + dy * dy + dz * dz < square
            };
            let mut about = grid.rows_about(grid.cell_of(place));
            if about.any(|(from, to)| cells.range(from, to).any(is_near)) {
                self.row_of_wall[wall] = (count + self.wet.len()) as u32;
                self.wet.push(wall as u32);
            }
        }
    }

    fn add_row(&mut self, kernel: &Kernel, row: u32, place: &[f32; 4], own: f32, candidates: &Candidates) {
        self.starts.push(self.others.len() as u32);
        let is_wall = row as usize >= self.particles;
        let (mut compression, mut squares, mut sum) = (own, 0.0_f32, [0.0_f32; 3]);
        for &near in &candidates.near {
            let near = near as usize;
            let other = candidates.rows[near];
            if other == row {
                continue;
            }
            let (value, slope) = kernel.value_and_slope_single(candidates.squares[near].sqrt());
            let factor = candidates.volumes[near] * slope;
            compression += candidates.volumes[near] * value;
            let gradient: [f32; 3] =
                std::array::from_fn(|axis| factor * (place[axis] - candidates.axes[axis][near]));
            // Walls do not give way.
            if (other as usize) < self.particles {
                squares += gradient.iter().map(|x| x * x).sum::<f32>();
            }
            (0..3).for_each(|axis| sum[axis] += gradient[axis]);
            self.others.push(other);
            self.factors.push(factor);
        }
        let own = if is_wall { 0.0 } else { sum.iter().map(|x| x * x).sum::<f32>() };
        self.compression.push(compression);
        self.diagonal.push(squares + own);
    }

    /// Neighbours of a row, and their factors.
    #[inline]
    pub(super) fn of(&self, row: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (from, to) = (self.starts[row] as usize, self.starts[row + 1] as usize);
        self.others[from..to]
            .iter()
            .zip(&self.factors[from..to])
            .map(|(other, factor)| (*other as usize, *factor))
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> u32 {
        self.starts[row + 1] - self.starts[row]
    }

    /// What pressures over density \[m²/s²\] make of each particle's acceleration, against it: G p \[m/s²\].
    pub(super) fn gradient(&self, pressures: &[f32], out: &mut [[f32; 4]]) {
        for (row, out) in out.iter_mut().enumerate().take(self.particles) {
            let (place, pressure) = (self.places[row], pressures[row]);
            let mut sum = [0.0_f32; 4];
            for (other, factor) in self.of(row) {
                let times = factor * (pressure + pressures[other]);
                let there = &self.places[other];
                (0..4).for_each(|axis| sum[axis] += times * (place[axis] - there[axis]));
            }
            *out = sum;
        }
    }

    /// How fast each row is being compressed by velocities \[1/s\]: the transpose of [`Self::gradient`] where walls stand
    /// still. The fourth number of a velocity is 0.
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        for (row, out) in out.iter_mut().enumerate() {
            let (place, velocity) = (self.places[row], velocities[row]);
            let mut sum = [0.0_f32; 4];
            for (other, factor) in self.of(row) {
                let (there, its) = (&self.places[other], &velocities[other]);
                (0..4).for_each(|axis| {
                    sum[axis] += factor * (place[axis] - there[axis]) * (velocity[axis] - its[axis]);
                });
            }
            *out = sum.iter().sum();
        }
    }
}
