//! Who is within the support of whom, as flat lists: for each particle those about it, and how steep the kernel is between
//! them. Particles lie in the order of their cells, so that lists point to places that are near in memory.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::kernel::Kernel;
use super::near::{About, Axes, DRY, Near, Scene, Walls};
use super::neighbours::{CellGrid, CellStarts};
use crate::wide::wide;

/// Rows that are computed together.
const BLOCK: usize = 512;
/// Fewer rows are not worth a second thread.
const PARALLEL: usize = 4 * BLOCK;

/// Computes a list block by block, on the rayon pool where it is long; what one row becomes does not depend on where.
fn in_blocks<T: Send>(list: &mut [T], each: impl Fn(usize, &mut [T]) + Sync) {
    if list.len() >= PARALLEL && rayon::current_num_threads() > 1 {
        list.par_chunks_mut(BLOCK).enumerate().for_each(|(index, part)| each(index, part));
    } else {
        list.chunks_mut(BLOCK).enumerate().for_each(|(index, part)| each(index, part));
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
    /// Places, from the middle of what there is \[m\].
    centred: Vec<[f32; 4]>,
    /// Sum of the gradients of each row \[1/m\].
    pulls: Vec<[f32; 4]>,
    /// Of each row, the pressure times its place, and the pressure.
    lifted: Vec<[f32; 4]>,
}

/// Some rows that follow one another.
#[derive(Clone, Debug, Default)]
struct Block {
    /// Where the list of each row begins; one more than there are rows.
    starts: Vec<u32>,
    /// Row of each neighbour: particles first, then walls.
    others: Vec<u32>,
    /// Factor of the way to the row from the neighbour in the gradient that the two have in common: volume of what is not a
    /// plain particle of the two, times the kernel's slope \[1/m²\]. Ways come anew from the places, which are near in
    /// memory: products with the operator wait for what they read.
    factors: Vec<f32>,
    /// Compression and diagonal of each row.
    sums: Vec<[f32; 2]>,
    /// Sum of the gradients of each.
    pulls: Vec<[f32; 4]>,
    beside_walls: Vec<u32>,
    near: Near,
    about: About,
}

/// Links of a row.
#[derive(Clone, Copy)]
pub(super) struct Links<'a> {
    /// Place of the row, from the corner of the box \[m\].
    place: &'a [f32; 4],
    places: &'a [[f32; 4]],
    others: &'a [u32],
    factors: &'a [f32],
}

impl<'a> Links<'a> {
    /// Those to particles.
    #[inline(always)]
    pub(super) fn liquid(self, particles: usize) -> Self {
        let liquid = match self.others.last() {
            Some(last) if *last as usize >= particles => {
                self.others.partition_point(|other| (*other as usize) < particles)
            }
            _ => self.others.len(),
        };
        Self { others: &self.others[..liquid], factors: &self.factors[..liquid], ..self }
    }

    /// Neighbours, and the gradients that the row has in common with them \[1/m\], the factor of the way last.
    #[inline(always)]
    pub(super) fn gradients(self) -> impl Iterator<Item = (usize, [f32; 4])> + 'a {
        self.others.iter().zip(self.factors).map(move |(other, factor)| {
            let place = &self.places[*other as usize];
            let way = |axis: usize| factor * (self.place[axis] - place[axis]);
            (*other as usize, [way(0), way(1), way(2), *factor])
        })
    }

    /// Adds up vectors over the links, in double precision, so that what one gives another takes; the fourth of their
    /// numbers does not count.
    #[inline(always)]
    pub(super) fn sum(self, vector: impl Fn(usize, &[f32; 4]) -> [f32; 4]) -> Vector3<f64> {
        let mut sum = [0.0_f64; 4];
        for (other, gradient) in self.gradients() {
            let vector = vector(other, &gradient);
            (0..4).for_each(|axis| sum[axis] += f64::from(vector[axis]));
        }
        Vector3::new(sum[0], sum[1], sum[2])
    }

    /// Adds up what belongs to the neighbours, times the factors: in four sums, of which none waits for another.
    #[inline(always)]
    fn weighted(self, of: &[[f32; 4]]) -> [f32; 4] {
        let [mut a, mut b, mut c, mut d] = [[0.0_f32; 4]; 4];
        let (fours, factors) = (self.others.chunks_exact(4), self.factors.chunks_exact(4));
        for (other, factor) in fours.remainder().iter().zip(factors.remainder()) {
            add(&mut a, *factor, &of[*other as usize]);
        }
        for (four, factors) in fours.zip(factors) {
            add(&mut a, factors[0], &of[four[0] as usize]);
            add(&mut b, factors[1], &of[four[1] as usize]);
            add(&mut c, factors[2], &of[four[2] as usize]);
            add(&mut d, factors[3], &of[four[3] as usize]);
        }
        std::array::from_fn(|axis| (a[axis] + b[axis]) + (c[axis] + d[axis]))
    }
}

#[inline(always)]
fn add(sum: &mut [f32; 4], factor: f32, of: &[f32; 4]) {
    for axis in 0..4 {
        sum[axis] += factor * of[axis];
    }
}

/// What rows are built from.
struct Parts<'a> {
    scene: Scene<'a>,
    kernel: &'a Kernel,
    places: &'a [[f32; 4]],
    wet: &'a [u32],
    particles: usize,
    beside: f32,
}

impl Parts<'_> {
    #[inline(always)]
    fn fill(&self, block: &mut Block, rows: Range<usize>) {
        let volume = self.scene.volume;
        let square = (self.kernel.support * self.kernel.support) as f32;
        let own = volume * self.kernel.value_and_slope(0.0).0 as f32;
        block.starts.clear();
        block.others.clear();
        block.factors.clear();
        block.sums.clear();
        block.pulls.clear();
        block.beside_walls.clear();
        let mut known = None;
        for row in rows {
            let place = &self.places[row];
            let cell = self.scene.grid.cell_of(place);
            if known != Some(cell) {
                known = Some(cell);
                block.about.gather(&self.scene, cell);
            }
            let Block { starts, others, factors, sums, pulls, beside_walls, near, about } = block;
            if row < self.particles {
                near.find(place, square, about, about.rows.len(), about.place_of(row));
                let (value, squares, pull) = near.weigh(place, about, self.kernel, None);
                let [x, y, z, _] = pull;
                pulls.push(pull);
                sums.push([own + value, squares + (x * x + y * y + z * z)]);
                if near.has_walls() {
                    beside_walls.push(row as u32);
                }
            } else {
                let wall = self.scene.walls.volumes[self.wet[row - self.particles] as usize];
                near.find(place, square, about, about.liquid, None);
                let (value, squares, pull) = near.weigh(place, about, self.kernel, Some(wall));
                pulls.push(pull);
                sums.push([1.0 - self.beside * wall / volume + value, squares]);
            }
            starts.push(others.len() as u32);
            others.extend(near.hits().iter().map(|at| about.rows[*at as usize]));
            factors.extend_from_slice(near.factors());
        }
        block.starts.push(block.others.len() as u32);
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
        let (axes, row_of_wall) = (&self.axes, &self.row_of_wall);
        let scene = Scene { grid, cells, walls, places: &self.places, axes, row_of_wall, volume };
        let parts = Parts { scene, kernel, places: &self.places, wet: &self.wet, particles, beside };
        let blocks = count.div_ceil(BLOCK);
        if self.blocks.len() < blocks {
            self.blocks.resize_with(blocks, Block::default);
        }
        let fill = |(index, block): (usize, &mut Block)| {
            wide(
                #[inline(always)]
                || parts.fill(block, index * BLOCK..count.min((index + 1) * BLOCK)),
            );
        };
        if count >= PARALLEL && rayon::current_num_threads() > 1 {
            self.blocks[..blocks].par_iter_mut().enumerate().for_each(fill);
        } else {
            self.blocks[..blocks].iter_mut().enumerate().for_each(fill);
        }
        self.compression.clear();
        self.diagonal.clear();
        self.pulls.clear();
        self.beside_walls.clear();
        for block in &self.blocks[..blocks] {
            self.compression.extend(block.sums.iter().map(|sums| sums[0]));
            self.diagonal.extend(block.sums.iter().map(|sums| sums[1]));
            self.pulls.extend_from_slice(&block.pulls);
            self.beside_walls.extend_from_slice(&block.beside_walls);
        }
        let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
        for place in &self.places {
            for axis in 0..4 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        let middle: [f32; 4] = std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]));
        self.centred.clear();
        let places = self.places.iter();
        self.centred.extend(places.map(|place| std::array::from_fn(|axis| place[axis] - middle[axis])));
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

    /// Links of a row.
    #[inline]
    pub(super) fn of(&self, row: usize) -> Links<'_> {
        let Block { starts, others, factors, .. } = &self.blocks[row / BLOCK];
        let range = starts[row % BLOCK] as usize..starts[row % BLOCK + 1] as usize;
        let (place, places) = (&self.places[row], &self.places);
        Links { place, places, others: &others[range.clone()], factors: &factors[range] }
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> usize {
        self.of(row).others.len()
    }

    /// Computes something of the first rows from their links; what is asked for has to be inlined.
    #[inline]
    pub(super) fn each<T: Send>(&self, out: &mut [T], each: impl Fn(usize, Links<'_>, &mut T) + Sync) {
        in_blocks(out, |index, out| {
            let Block { starts, others, factors, .. } = &self.blocks[index];
            wide(
                #[inline(always)]
                || {
                    for ((row, out), ends) in (index * BLOCK..).zip(out).zip(starts.windows(2)) {
                        let range = ends[0] as usize..ends[1] as usize;
                        let (place, places) = (&self.places[row], &self.places);
                        let (others, factors) = (&others[range.clone()], &factors[range]);
                        each(row, Links { place, places, others, factors }, out);
                    }
                },
            );
        });
    }

    /// How fast each row is compressed \[1/s\] by what pressures over density \[m²/s²\] make of the particles' velocities in a
    /// second: the divergence of the gradient, of which each is the other's transpose; walls stand still. `velocities` is
    /// room.
    ///
    /// With the places x, the factors f and R for the sum of f (xᵢ - xⱼ) over j, the sum of f (pᵢ + pⱼ) (xᵢ - xⱼ) is
    /// R pᵢ + xᵢ Σ f pⱼ - Σ f pⱼ xⱼ, and that of f (xᵢ - xⱼ)·(vᵢ - vⱼ) is R·vᵢ - xᵢ·Σ f vⱼ + Σ f xⱼ·vⱼ: of a neighbour no
    /// more is asked for than four numbers. What is lost by differences of sums is little for a solver; what moves particles
    /// is computed as it stands.
    pub(super) fn product(&mut self, pressures: &[f32], velocities: &mut [[f32; 4]], rates: &mut [f32]) {
        self.lifted.clear();
        self.lifted
            .extend(self.centred.iter().zip(pressures).map(|(at, p)| [at[0] * p, at[1] * p, at[2] * p, *p]));
        let Self { centred, pulls, lifted, particles, .. } = &*self;
        self.each(
            &mut velocities[..*particles],
            #[inline(always)]
            |_, links, sum| *sum = links.weighted(lifted),
        );
        let rows = centred.iter().zip(pulls).zip(lifted);
        for (sum, ((at, pull), lifted)) in velocities[..*particles].iter_mut().zip(rows) {
            let way = |axis: usize| pull[axis] * lifted[3] + (at[axis] * sum[3] - sum[axis]);
            let [x, y, z] = [way(0), way(1), way(2)];
            *sum = [x, y, z, x * at[0] + y * at[1] + z * at[2]];
        }
        velocities[*particles..].fill([0.0; 4]);
        let velocities = &*velocities;
        self.each(
            rates,
            #[inline(always)]
            |row, links, rate| {
                let sum = links.weighted(velocities);
                let (at, pull, velocity) = (&centred[row], &pulls[row], &velocities[row]);
                let own = pull[0] * velocity[0] + pull[1] * velocity[1] + pull[2] * velocity[2];
                *rate = own + (sum[3] - (at[0] * sum[0] + at[1] * sum[1] + at[2] * sum[2]));
            },
        );
    }

    /// How fast each row is being compressed by velocities \[1/s\], of which the fourth number is 0.
    pub(super) fn compression_rate(&self, velocities: &[[f32; 4]], out: &mut [f32]) {
        self.each(
            out,
            #[inline(always)]
            |row, links, out| {
                let velocity = velocities[row];
                let mut sum = [0.0_f32; 4];
                for (other, gradient) in links.gradients() {
                    let its = &velocities[other];
                    (0..4).for_each(|axis| sum[axis] += gradient[axis] * (velocity[axis] - its[axis]));
                }
                *out = (sum[0] + sum[1]) + (sum[2] + sum[3]);
            },
        );
    }
}
