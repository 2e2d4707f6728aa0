//! Who is within the support of whom, as flat lists: for each particle those about it, and how steep the kernel is between
//! them. Particles lie in the order of their cells, so that lists point to places that are near in memory.

use std::ops::Range;

use rayon::prelude::*;

use super::kernel::Kernel;
use super::neighbours::{CellGrid, CellStarts};

/// No wall.
const DRY: u32 = u32::MAX;
/// Rows that are computed together.
const BLOCK: usize = 512;
/// Fewer rows are not worth a second thread.
const PARALLEL: usize = 4 * BLOCK;

/// Computes a list block by block, on the rayon pool where it is long; what one row becomes does not depend on where.
pub(super) fn in_blocks<T: Send>(list: &mut [T], each: impl Fn(usize, &mut [T]) + Sync) {
    if list.len() >= PARALLEL && rayon::current_num_threads() > 1 {
        list.par_chunks_mut(BLOCK).enumerate().for_each(|(index, part)| each(index * BLOCK, part));
    } else {
        each(0, list);
    }
}

/// Neighbours of every particle, then of every sample of a wall that a particle is near to.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    blocks: Vec<Block>,
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
}

/// Some rows that follow one another.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Where the list of each row begins; one more than there are rows.
    starts: Vec<u32>,
    /// Row of each neighbour, and volume of what is not a plain particle of the two times the kernel's slope \[m³/m⁵\]: times
    /// the way from one to the other it is the gradient that the two have in common.
    links: Vec<(u32, f32)>,
    /// Compression and diagonal of each row.
    sums: Vec<[f32; 2]>,
    beside_walls: Vec<u32>,
    near: Near,
    /// Particles and walls about a cell.
    about: Vec<[Range<usize>; 2]>,
}

/// What all blocks are built from.
struct Scene<'a> {
    grid: &'a CellGrid,
    cells: &'a CellStarts,
    walls: &'a Walls<'a>,
    kernel: &'a Kernel,
    places: &'a [[f32; 4]],
    axes: &'a Axes,
    row_of_wall: &'a [u32],
    wet: &'a [u32],
    particles: usize,
    volume: f32,
    beside: f32,
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

impl Scene<'_> {
    fn fill(&self, block: &mut Block, rows: Range<usize>) {
        let square = (self.kernel.support * self.kernel.support) as f32;
        let own = self.volume * self.kernel.value_and_slope(0.0).0 as f32;
        block.starts.clear();
        block.links.clear();
        block.sums.clear();
        block.beside_walls.clear();
        let mut known = None;
        for row in rows {
            let place = self.places[row];
            let cell = self.grid.cell_of(&place);
            if known != Some(cell) {
                known = Some(cell);
                block.about.clear();
                let ranges = self.grid.rows_about(cell);
                block.about.extend(
                    ranges.map(|(from, to)| [self.cells.range(from, to), self.walls.cells.range(from, to)]),
                );
            }
            let near = &mut block.near;
            near.found.clear();
            if row < self.particles {
                for [particles, walls] in &block.about {
                    near.find(&place, square, self.axes, particles.clone(), |at| (at as u32, self.volume));
                    let of_wall = |at: usize| (self.row_of_wall[at], self.walls.volumes[at]);
                    near.find(&place, square, self.walls.axes, walls.clone(), of_wall);
                }
                // At the very edge of its reach a wall may be dry.
                near.found.retain(|found| found.row != row as u32 && found.row != DRY);
                near.weigh(self.kernel);
                block.add(row as u32, own, self.particles as u32);
            } else {
                let volume = self.walls.volumes[self.wet[row - self.particles] as usize];
                for [particles, _] in &block.about {
                    near.find(&place, square, self.axes, particles.clone(), |at| (at as u32, volume));
                }
                near.weigh(self.kernel);
                block.add(row as u32, 1.0 - self.beside * volume / self.volume, self.particles as u32);
            }
        }
        block.starts.push(block.links.len() as u32);
    }
}

impl Block {
    /// The row whose neighbours were found.
    fn add(&mut self, row: u32, own: f32, particles: u32) {
        self.starts.push(self.links.len() as u32);
        let (mut compression, mut squares, mut sum) = (own, 0.0_f32, [0.0_f32; 3]);
        let mut has_wall = false;
        for found in &self.near.found {
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
        self.links.extend(self.near.found.iter().map(|found| (found.row, found.factor)));
        if has_wall {
            self.beside_walls.push(row);
        }
        let own = if row < particles { sum.iter().map(|x| x * x).sum::<f32>() } else { 0.0 };
        self.sums.push([compression, squares + own]);
    }
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
        let particles = self.places.len();
        self.particles = particles;
        self.find_wet(grid, cells, walls, (kernel.support * kernel.support) as f32);
        self.axes.set(&self.places);
        self.places.extend(self.wet.iter().map(|wall| walls.places[*wall as usize]));
        let count = self.places.len();
        let scene = Scene {
            grid,
            cells,
            walls,
            kernel,
            places: &self.places,
            axes: &self.axes,
            row_of_wall: &self.row_of_wall,
            wet: &self.wet,
            particles,
            volume,
            beside,
        };
        let blocks = count.div_ceil(BLOCK);
        if self.blocks.len() < blocks {
            self.blocks.resize_with(blocks, Block::default);
        }
        let fill = |(index, block): (usize, &mut Block)| {
            scene.fill(block, index * BLOCK..count.min((index + 1) * BLOCK));
        };
        if count >= PARALLEL && rayon::current_num_threads() > 1 {
            self.blocks[..blocks].par_iter_mut().enumerate().for_each(fill);
        } else {
            self.blocks[..blocks].iter_mut().enumerate().for_each(fill);
        }
        self.compression.clear();
        self.diagonal.clear();
        self.beside_walls.clear();
        for block in &self.blocks[..blocks] {
            self.compression.extend(block.sums.iter().map(|sums| sums[0]));
            self.diagonal.extend(block.sums.iter().map(|sums| sums[1]));
            self.beside_walls.extend_from_slice(&block.beside_walls);
        }
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

    fn links_of(&self, row: usize) -> &[(u32, f32)] {
        let Block { starts, links, .. } = &self.blocks[row / BLOCK];
        &links[starts[row % BLOCK] as usize..starts[row % BLOCK + 1] as usize]
    }

    /// Neighbours of a row, and their factors.
    #[inline]
    pub(super) fn of(&self, row: usize) -> impl Iterator<Item = (usize, f32)> + '_ {
        self.links_of(row).iter().map(|(other, factor)| (*other as usize, *factor))
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> usize {
        self.links_of(row).len()
    }

    /// What pressures over density \[m²/s²\] make of each particle's acceleration, against it: G p \[m/s²\].
    pub(super) fn gradient(&self, pressures: &[f32], out: &mut [[f32; 4]]) {
        in_blocks(&mut out[..self.particles], |first, out| {
            for (row, out) in (first..).zip(out) {
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
        });
    }

    /// How fast each row is being compressed by velocities \[1/s\]: the transpose of [`Self::gradient`] where walls stand
    /// still. The fourth number of a velocity is 0.
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        in_blocks(out, |first, out| {
            for (row, out) in (first..).zip(out) {
                let (place, velocity) = (self.places[row], velocities[row]);
                let close = |sum: &mut [f32; 4], (other, factor): (u32, f32)| {
                    let (there, its) = (self.places[other as usize], velocities[other as usize]);
                    for axis in 0..4 {
                        sum[axis] += factor * ((place[axis] - there[axis]) * (velocity[axis] - its[axis]));
                    }
                };
                *out = two_sums(self.links_of(row), close).iter().sum();
            }
        });
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
