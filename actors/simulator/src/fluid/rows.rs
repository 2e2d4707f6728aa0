//! Who is within the support of whom, as flat lists: for each particle those about it, and how steep the kernel is between
//! them. Particles lie in the order of their cells, so that lists point to places that are near in memory.

use std::ops::Range;

use nalgebra::Vector3;
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

/// Which neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Among {
    All,
    Liquid,
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
    /// Row of each neighbour: particles first, then walls.
    others: Vec<u32>,
    /// The gradient that a row and its neighbour have in common: volume of what is not a plain particle of the two, times the
    /// kernel's slope, times the way to the row from the neighbour \[1/m\]; its fourth number is the factor of the way. Kept
    /// whole, since every product with the operator asks for it.
    gradients: Vec<[f32; 4]>,
    /// Compression and diagonal of each row.
    sums: Vec<[f32; 2]>,
    beside_walls: Vec<u32>,
    near: Near,
    about: About,
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

/// What lies about a cell, side by side: particles first, then walls that are wet.
#[derive(Clone, Debug, Default)]
struct About {
    axes: [Vec<f32>; 3],
    rows: Vec<u32>,
    volumes: Vec<f32>,
    /// How many particles.
    liquid: usize,
    /// Which particles, and where they begin.
    ranges: Vec<(Range<usize>, usize)>,
}

impl About {
    /// All that is about a cell.
    fn gather(&mut self, scene: &Scene<'_>, cell: usize) {
        self.axes.iter_mut().for_each(Vec::clear);
        self.rows.clear();
        self.volumes.clear();
        self.ranges.clear();
        for (from, to) in scene.grid.rows_about(cell) {
            let range = scene.cells.range(from, to);
            self.ranges.push((range.clone(), self.rows.len()));
            for (list, axis) in self.axes.iter_mut().zip(&scene.axes.0) {
                list.extend_from_slice(&axis[range.clone()]);
            }
            self.rows.extend(range.map(|row| row as u32));
        }
        self.liquid = self.rows.len();
        self.volumes.resize(self.liquid, scene.volume);
        let walls = scene.walls;
        for (from, to) in scene.grid.rows_about(cell) {
            // At the very edge of its reach a wall may be dry.
            for wall in walls.cells.range(from, to).filter(|wall| scene.row_of_wall[*wall] != DRY) {
                for (list, axis) in self.axes.iter_mut().zip(&walls.axes.0) {
                    list.push(axis[wall]);
                }
                self.rows.push(scene.row_of_wall[wall]);
                self.volumes.push(walls.volumes[wall]);
            }
        }
    }

    /// Where a particle stands.
    fn place_of(&self, row: usize) -> Option<usize> {
        self.ranges.iter().find(|(range, _)| range.contains(&row)).map(|(range, at)| at + row - range.start)
    }
}

/// What is near to a place, a kind of number at a time, so that several are computed at once.
#[derive(Clone, Debug, Default)]
struct Near {
    /// Places among what is about.
    hits: Vec<u32>,
    /// How many particles.
    liquid: usize,
    gradients: Vec<[f32; 4]>,
    squares: Vec<f32>,
    volumes: Vec<f32>,
    /// Kernel and its slope, times volume.
    values: Vec<f32>,
    factors: Vec<f32>,
}

impl Near {
    /// Which of the first `count` about it are within a distance of a place, but for the one that stands at `own`.
    fn find(&mut self, place: &[f32; 4], square: f32, about: &About, count: usize, own: Option<usize>) {
        self.hits.clear();
        self.hits.resize(count + 1, 0);
        let mut found = 0;
        let mut first = 0;
        while first < count {
            let lanes = (count - first).min(LANES);
            let [xs, ys, zs] = [0, 1, 2].map(|axis: usize| &about.axes[axis][first..first + lanes]);
            let mut squares = [f32::INFINITY; LANES];
            for (((square, x), y), z) in squares.iter_mut().zip(xs).zip(ys).zip(zs) {
                let [dx, dy, dz] = [place[0] - x, place[1] - y, place[2] - z];
                *square = dx * dx + dy * dy + dz * dz;
            }
            if let Some(lane) = own.and_then(|own| own.checked_sub(first)).filter(|lane| *lane < LANES) {
                squares[lane] = f32::INFINITY;
            }
            // Most are too far, and which ones nobody could foresee: written down without asking, then kept or not.
            for (lane, distance) in squares[..lanes].iter().enumerate() {
                self.hits[found] = (first + lane) as u32;
                found += usize::from(*distance < square);
            }
            first += lanes;
        }
        self.hits.truncate(found);
        self.liquid = self.hits.partition_point(|at| (*at as usize) < about.liquid);
    }

    /// Kernels and gradients of all that was found; all have the volume of a wall, where one asks.
    fn weigh(&mut self, place: &[f32; 4], about: &About, kernel: &Kernel, volume: Option<f32>) {
        let Self { hits, gradients, squares, volumes, values, factors, .. } = self;
        let [xs, ys, zs] = &about.axes;
        gradients.clear();
        gradients.extend(hits.iter().map(|at| {
            let at = *at as usize;
            [place[0] - xs[at], place[1] - ys[at], place[2] - zs[at], 1.0]
        }));
        squares.clear();
        squares.extend(gradients.iter().map(|way| way[0] * way[0] + way[1] * way[1] + way[2] * way[2]));
        volumes.clear();
        match volume {
            Some(volume) => volumes.resize(hits.len(), volume),
            None => volumes.extend(hits.iter().map(|at| about.volumes[*at as usize])),
        }
        for list in [&mut *values, factors] {
            list.clear();
            list.resize(hits.len(), 0.0);
        }
        for ((value, factor), (square, volume)) in
            values.iter_mut().zip(factors.iter_mut()).zip(squares.iter().zip(volumes.iter()))
        {
            let of = kernel.value_and_slope_single(square.sqrt());
            (*value, *factor) = (volume * of.0, volume * of.1);
        }
        for (gradient, factor) in gradients.iter_mut().zip(factors.iter()) {
            gradient.iter_mut().for_each(|way| *way *= factor);
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
        block.others.clear();
        block.gradients.clear();
        block.sums.clear();
        block.beside_walls.clear();
        let mut known = None;
        for row in rows {
            let place = self.places[row];
            let cell = self.grid.cell_of(&place);
            if known != Some(cell) {
                known = Some(cell);
                block.about.gather(self, cell);
            }
            let Block { near, about, .. } = block;
            if row < self.particles {
                near.find(&place, square, about, about.rows.len(), about.place_of(row));
                near.weigh(&place, about, self.kernel, None);
                block.add(row, own, true);
            } else {
                let volume = self.walls.volumes[self.wet[row - self.particles] as usize];
                near.find(&place, square, about, about.liquid, None);
                near.weigh(&place, about, self.kernel, Some(volume));
                block.add(row, 1.0 - self.beside * volume / self.volume, false);
            }
        }
        block.starts.push(block.others.len() as u32);
    }
}

impl Block {
    /// The row whose neighbours were found; walls among them do not give way.
    fn add(&mut self, row: usize, own: f32, is_particle: bool) {
        self.starts.push(self.others.len() as u32);
        let Near { hits, liquid, gradients, values, .. } = &self.near;
        let liquid = *liquid;
        self.others.extend(hits.iter().map(|at| self.about.rows[*at as usize]));
        self.gradients.extend_from_slice(gradients);
        let squares = two_sums(&gradients[..liquid], |sum, of| {
            (0..4).for_each(|axis| sum[axis] += of[axis] * of[axis]);
        });
        let mut diagonal = squares[0] + squares[1] + squares[2];
        if is_particle {
            let sum = two_sums(gradients, |sum, of| (0..4).for_each(|axis| sum[axis] += of[axis]));
            diagonal += sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2];
        }
        let fours = values.chunks_exact(4);
        let rest: f32 = fours.remainder().iter().sum();
        let four = fours.fold([0.0_f32; 4], |sum, of| std::array::from_fn(|k| sum[k] + of[k]));
        self.sums.push([own + (four[0] + four[1]) + (four[2] + four[3]) + rest, diagonal]);
        if liquid < hits.len() {
            self.beside_walls.push(row as u32);
        }
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

    fn links_of(&self, row: usize) -> (&[u32], &[[f32; 4]]) {
        let Block { starts, others, gradients, .. } = &self.blocks[row / BLOCK];
        let range = starts[row % BLOCK] as usize..starts[row % BLOCK + 1] as usize;
        (&others[range.clone()], &gradients[range])
    }

    /// Neighbours of a row, and the gradients that it has in common with them, the factor of the way last.
    #[inline]
    pub(super) fn of(&self, row: usize) -> impl Iterator<Item = (usize, &[f32; 4])> + '_ {
        let (others, gradients) = self.links_of(row);
        others.iter().map(|other| *other as usize).zip(gradients)
    }

    /// As [`Self::of`], of particles only.
    fn liquid_of(&self, row: usize) -> (&[u32], &[[f32; 4]]) {
        let (others, gradients) = self.links_of(row);
        let liquid = match others.last() {
            Some(last) if *last as usize >= self.particles => {
                others.partition_point(|other| (*other as usize) < self.particles)
            }
            _ => others.len(),
        };
        (&others[..liquid], &gradients[..liquid])
    }

    /// Adds up vectors over the links of a row, in double precision, so that what one gives another takes; the fourth of
    /// their numbers does not count.
    #[inline]
    pub(super) fn sum(
        &self,
        row: usize,
        of: Among,
        vector: impl Fn(usize, &[f32; 4]) -> [f32; 4],
    ) -> Vector3<f64> {
        let (others, gradients) = match of {
            Among::All => self.links_of(row),
            Among::Liquid => self.liquid_of(row),
        };
        let mut sum = [0.0_f64; 4];
        for (other, gradient) in others.iter().zip(gradients) {
            let vector = vector(*other as usize, gradient);
            (0..4).for_each(|axis| sum[axis] += f64::from(vector[axis]));
        }
        Vector3::new(sum[0], sum[1], sum[2])
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> usize {
        self.links_of(row).0.len()
    }

    /// What pressures over density \[m²/s²\] make of each particle's acceleration, against it: G p \[m/s²\].
    pub(super) fn gradient(&self, pressures: &[f32], out: &mut [[f32; 4]]) {
        in_blocks(&mut out[..self.particles], |first, out| {
            for (row, out) in (first..).zip(out) {
                let pressure = pressures[row];
                let sum = self.links_sum(row, |sum, other, gradient| {
                    let times = pressure + pressures[other];
                    (0..4).for_each(|axis| sum[axis] += times * gradient[axis]);
                });
                // The fourth is no part of a way.
                *out = [sum[0], sum[1], sum[2], 0.0];
            }
        });
    }

    /// How fast each row is being compressed by velocities \[1/s\]: the transpose of [`Self::gradient`] where walls stand
    /// still. The fourth number of a velocity is 0.
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        in_blocks(out, |first, out| {
            for (row, out) in (first..).zip(out) {
                let velocity = velocities[row];
                let sum = self.links_sum(row, |sum, other, gradient| {
                    let its = velocities[other];
                    (0..4).for_each(|axis| sum[axis] += gradient[axis] * (velocity[axis] - its[axis]));
                });
                *out = sum.iter().sum();
            }
        });
    }

    /// Adds up over the links of a row in two sums, of which neither waits for the other.
    #[inline]
    fn links_sum(&self, row: usize, add: impl Fn(&mut [f32; 4], usize, &[f32; 4])) -> [f32; 4] {
        let (others, gradients) = self.links_of(row);
        let (mut even, mut odd) = ([0.0; 4], [0.0; 4]);
        let (pairs, ways) = (others.chunks_exact(2), gradients.chunks_exact(2));
        if let ([last], [way]) = (pairs.remainder(), ways.remainder()) {
            add(&mut even, *last as usize, way);
        }
        for (pair, way) in pairs.zip(ways) {
            add(&mut even, pair[0] as usize, &way[0]);
            add(&mut odd, pair[1] as usize, &way[1]);
        }
        std::array::from_fn(|axis| even[axis] + odd[axis])
    }
}

/// Adds up in two sums, of which neither waits for the other.
#[inline]
fn two_sums(list: &[[f32; 4]], add: impl Fn(&mut [f32; 4], &[f32; 4])) -> [f32; 4] {
    let (mut even, mut odd) = ([0.0; 4], [0.0; 4]);
    let pairs = list.chunks_exact(2);
    if let [last] = pairs.remainder() {
        add(&mut even, last);
    }
    for pair in pairs {
        add(&mut even, &pair[0]);
        add(&mut odd, &pair[1]);
    }
    std::array::from_fn(|axis| even[axis] + odd[axis])
}
