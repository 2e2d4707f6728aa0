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
    /// Row of each neighbour, and volume of what is not a plain particle of the two times the kernel's slope \[m³/m⁵\]: times
    /// the way from one to the other it is the gradient that the two have in common.
    links: Vec<(u32, f32)>,
    /// Places, from the corner of the box \[m\].
    pub places: Vec<[f32; 4]>,
    /// Particles that have a wall beside them.
    pub beside_walls: Vec<u32>,
    /// Sums of kernels times volumes: 1 is neither compressed nor thin.
    pub compression: Vec<f32>,
    /// Diagonal of the product of divergence and gradient \[1/m²\].
    pub diagonal: Vec<f32>,
    /// Rows of particles; the others are walls.
    pub particles: usize,
    /// Which sample each row of a wall is, in the order of their cells.
    pub wet: Vec<u32>,
    row_of_wall: Vec<u32>,
    axes: Axes,
    near: Near,
}

/// Places, an axis at a time.
#[derive(Clone, Debug, Default)]
pub(super) struct Axes([Vec<f32>; 3]);

impl Axes {
    pub(super) fn set(&mut self, places: &[[f32; 4]]) {
        for (axis, list) in self.0.iter_mut().enumerate() {
            list.clear();
            list.extend(places.iter().map(|place| place[axis]));
        }
    }
}

/// Places that are looked at together.
const LANES: usize = 32;

/// What is near to a place.
#[derive(Clone, Debug, Default)]
struct Near {
    found: Vec<Found>,
}

/// Row, volume, way and kernel's value and slope times volume of what is near.
#[derive(Clone, Copy, Debug, Default)]
struct Found {
    row: u32,
    volume: f32,
    apart: [f32; 3],
    square: f32,
    value: f32,
    factor: f32,
}

impl Near {
    /// Which of a range of places are within a distance of one; `row` says which row one is, and its volume.
    fn find(
        &mut self,
        place: &[f32; 4],
        square: f32,
        Axes([xs, ys, zs]): &Axes,
        range: std::ops::Range<usize>,
        row: impl Fn(usize) -> (u32, f32),
    ) {
        let mut first = range.start;
        while first < range.end {
            let count = (range.end - first).min(LANES);
            let [xs, ys, zs] = [xs, ys, zs].map(|axis| &axis[first..first + count]);
            let mut squares = [f32::INFINITY; LANES];
            for (((square, x), y), z) in squares.iter_mut().zip(xs).zip(ys).zip(zs) {
                let [dx, dy, dz] = [place[0] - x, place[1] - y, place[2] - z];
                *square = dx * dx + dy * dy + dz * dz;
            }
            // Most are too far: those that are not, as bits.
            let mut near = 0_u32;
            for (lane, distance) in squares.iter().enumerate() {
                near |= u32::from(*distance < square) << lane;
            }
            while near != 0 {
                let lane = near.trailing_zeros() as usize;
                near &= near - 1;
                let apart = [place[0] - xs[lane], place[1] - ys[lane], place[2] - zs[lane]];
                let (row, volume) = row(first + lane);
                self.found.push(Found { row, volume, apart, square: squares[lane], ..Found::default() });
            }
            first += count;
        }
    }

    /// Kernels of all that was found.
    fn weigh(&mut self, kernel: &Kernel) {
        for found in &mut self.found {
            let (value, slope) = kernel.value_and_slope_single(found.square.sqrt());
            (found.value, found.factor) = (found.volume * value, found.volume * slope);
        }
    }
}

/// Samples of walls as [`Rows`] meets them: sorted by cells.
pub(super) struct Walls<'a> {
    pub cells: &'a CellStarts,
    pub places: &'a [[f32; 4]],
    pub axes: &'a Axes,
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
        self.links.clear();
        self.beside_walls.clear();
        self.compression.clear();
        self.diagonal.clear();
        let square = (kernel.support * kernel.support) as f32;
        let own = volume * kernel.value_and_slope(0.0).0 as f32;
        self.find_wet(grid, cells, walls, square);
        self.axes.set(&self.places);
        let mut near = std::mem::take(&mut self.near);
        for cell in 0..grid.count() {
            for row in cells.range(cell, cell) {
                let place = self.places[row];
                near.found.clear();
                for (from, to) in grid.rows_about(cell) {
                    let of_particle = |at: usize| (at as u32, volume);
                    near.find(&place, square, &self.axes, cells.range(from, to), of_particle);
                    let beside = walls.cells.range(from, to);
                    if !beside.is_empty() {
                        let of_wall = |at: usize| (self.row_of_wall[at], walls.volumes[at]);
                        near.find(&place, square, walls.axes, beside, of_wall);
                    }
                }
                // At the very edge of its reach a wall may be dry.
                near.found.retain(|found| found.row != row as u32 && found.row != DRY);
                near.weigh(kernel);
                self.add_row(row as u32, own, &near);
            }
        }
        for index in 0..self.wet.len() {
            let wall = self.wet[index] as usize;
            let (place, own_volume) = (walls.places[wall], walls.volumes[wall]);
            self.places.push(place);
            near.found.clear();
            for (from, to) in grid.rows_about(grid.cell_of(&place)) {
                let of_particle = |at: usize| (at as u32, own_volume);
                near.find(&place, square, &self.axes, cells.range(from, to), of_particle);
            }
            near.weigh(kernel);
            self.add_row((count + index) as u32, 1.0 - beside * own_volume / volume, &near);
        }
        self.starts.push(self.links.len() as u32);
        self.near = near;
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

    fn add_row(&mut self, row: u32, own: f32, near: &Near) {
        self.starts.push(self.links.len() as u32);
        let particles = self.particles as u32;
        let (mut compression, mut squares, mut sum) = (own, 0.0_f32, [0.0_f32; 3]);
        let mut has_wall = false;
        for found in &near.found {
            compression += found.value;
            let gradient = found.apart.map(|apart| found.factor * apart);
            // Walls do not give way.
            if found.row < particles {
                squares += gradient.iter().map(|x| x * x).sum::<f32>();
            } else {
                has_wall = true;
            }
            (0..3).for_each(|axis| sum[axis] += gradient[axis]);
        }
        let links = near.found.iter();
        self.links.extend(links.map(|found| (found.row, found.factor)));
        if has_wall {
            self.beside_walls.push(row);
        }
        let is_wall = row >= particles;
        let own = if is_wall { 0.0 } else { sum.iter().map(|x| x * x).sum::<f32>() };
        self.compression.push(compression);
        self.diagonal.push(squares + own);
    }

    /// Neighbours of a row, and their factors.
    #[inline]
    pub(super) fn of(&self, row: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        let (from, to) = (self.starts[row] as usize, self.starts[row + 1] as usize);
        self.links[from..to].iter().map(|(other, factor)| (*other as usize, *factor))
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> u32 {
        self.starts[row + 1] - self.starts[row]
    }

    fn links_of(&self, row: usize) -> &[(u32, f32)] {
        &self.links[self.starts[row] as usize..self.starts[row + 1] as usize]
    }

    /// What pressures over density \[m²/s²\] make of each particle's acceleration, against it: G p \[m/s²\].
    pub(super) fn gradient(&self, pressures: &[f32], out: &mut [[f32; 4]]) {
        for (row, out) in out.iter_mut().enumerate().take(self.particles) {
            let (place, pressure) = (self.places[row], pressures[row]);
            let push = |sum: &mut [f32; 4], (other, factor): (u32, f32)| {
                let times = factor * (pressure + pressures[other as usize]);
                let there = self.places[other as usize];
                for axis in 0..4 {
                    sum[axis] += times * (place[axis] - there[axis]);
                }
            };
            *out = two_sums(self.links_of(row), push);
        }
    }

    /// How fast each row is being compressed by velocities \[1/s\]: the transpose of [`Self::gradient`] where walls stand
    /// still. The fourth number of a velocity is 0.
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        for (row, out) in out.iter_mut().enumerate() {
            let (place, velocity) = (self.places[row], velocities[row]);
            let close = |sum: &mut [f32; 4], (other, factor): (u32, f32)| {
                let (there, its) = (self.places[other as usize], velocities[other as usize]);
                for axis in 0..4 {
                    sum[axis] += factor * ((place[axis] - there[axis]) * (velocity[axis] - its[axis]));
                }
            };
            *out = two_sums(self.links_of(row), close).iter().sum();
        }
    }
}

/// Adds up over links in two sums, of which neither waits for the other.
#[inline]
fn two_sums(links: &[(u32, f32)], add: impl Fn(&mut [f32; 4], (u32, f32))) -> [f32; 4] {
    let (mut even, mut odd) = ([0.0; 4], [0.0; 4]);
    let pairs = links.chunks_exact(2);
    if let [last] = pairs.remainder() {
        add(&mut even, *last);
    }
    for pair in pairs {
        add(&mut even, pair[0]);
        add(&mut odd, pair[1]);
    }
    std::array::from_fn(|axis| even[axis] + odd[axis])
}
