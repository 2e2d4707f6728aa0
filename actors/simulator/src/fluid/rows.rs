//! Who is within the support of whom, as flat lists: for each particle those about it, and how steep the kernel is between
//! them. Particles lie in the order of their cells, so that lists point to places that are near in memory.

use std::ops::Range;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::kernel::Kernel;
use super::near::{About, DRY, Near, Scene, Sums, Walls, Weights};
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
    weights: Weights,
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
    drags: &'a [f32],
}

impl<'a> Links<'a> {
    /// How many there are to particles, which come first.
    #[inline(always)]
    fn liquid(&self, particles: usize) -> usize {
        match self.others.last() {
            Some(last) if *last as usize >= particles => {
                self.others.partition_point(|other| (*other as usize) < particles)
            }
            _ => self.others.len(),
        }
    }

    /// Those to walls.
    #[inline(always)]
    pub(super) fn walls(self, particles: usize) -> Self {
        let from = self.liquid(particles);
        let (others, factors, drags) = (&self.others[from..], &self.factors[from..], &self.drags[from..]);
        Self { others, factors, drags, ..self }
    }

    /// Neighbours.
    pub(super) fn others(self) -> &'a [u32] {
        self.others
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
        in_pairs(
            self.others,
            self.factors,
            #[inline(always)]
            |sum, other, factor| {
                let place = &self.places[other as usize];
                let way = |axis: usize| factor * (self.place[axis] - place[axis]);
                let vector = vector(other as usize, &[way(0), way(1), way(2), factor]);
                (0..4).for_each(|axis| sum[axis] += f64::from(vector[axis]));
            },
        )
    }

    /// What viscosity makes of velocities: the sum over particles of what the two of them approach each other, along the way
    /// (Monaghan, *Smoothed particle hydrodynamics*, 2005), but for ten times the viscosity \[1/s/m²\].
    #[inline(always)]
    pub(super) fn drag(self, velocity: &[f32; 4], of: &[[f32; 4]], particles: usize) -> Vector3<f64> {
        let liquid = self.liquid(particles);
        in_pairs(
            &self.others[..liquid],
            &self.drags[..liquid],
            #[inline(always)]
            |sum, other, drag| {
                let (place, its) = (&self.places[other as usize], &of[other as usize]);
                let way: [f32; 4] = std::array::from_fn(|axis| self.place[axis] - place[axis]);
                let parts: [f32; 4] = std::array::from_fn(|axis| (velocity[axis] - its[axis]) * way[axis]);
                let push = drag * ((parts[0] + parts[1]) + parts[2]);
                (0..4).for_each(|axis| sum[axis] += f64::from(push * way[axis]));
            },
        )
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

/// Adds up what belongs to links, in two sums of which neither waits for the other.
#[inline(always)]
fn in_pairs(others: &[u32], weights: &[f32], add: impl Fn(&mut [f64; 4], u32, f32)) -> Vector3<f64> {
    let [mut even, mut odd] = [[0.0_f64; 4]; 2];
    let (others, weights) = (others.chunks_exact(2), weights.chunks_exact(2));
    for (other, weight) in others.remainder().iter().zip(weights.remainder()) {
        add(&mut even, *other, *weight);
    }
    for (others, weights) in others.zip(weights) {
        add(&mut even, others[0], weights[0]);
        add(&mut odd, others[1], weights[1]);
    }
    Vector3::new(even[0] + odd[0], even[1] + odd[1], even[2] + odd[2])
}

#[inline(always)]
fn dot(a: &[f32; 4], b: &[f32; 4]) -> f32 {
    let products: [f32; 4] = std::array::from_fn(|axis| a[axis] * b[axis]);
    (products[0] + products[2]) + (products[1] + products[3])
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
        block.weights.factors.clear();
        block.weights.drags.clear();
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
            let Block { starts, others, weights, sums, pulls, beside_walls, near, about } = block;
            if row < self.particles {
                near.find(place, square, about, about.rows.len(), about.place_of(row));
                let Sums { value, squares, pull } = near.weigh(place, about, self.kernel, None, weights);
                let [x, y, z, _] = pull;
                pulls.push(pull);
                sums.push([own + value, squares + (x * x + y * y + z * z)]);
                if near.has_walls() {
                    beside_walls.push(row as u32);
                }
            } else {
                let wall = self.scene.walls.volumes[self.wet[row - self.particles] as usize];
                near.find(place, square, about, about.liquid, None);
                let Sums { value, squares, pull } =
                    near.weigh(place, about, self.kernel, Some(wall), weights);
                pulls.push(pull);
                sums.push([1.0 - self.beside * wall / volume + value, squares]);
            }
            starts.push(others.len() as u32);
            others.extend(near.hits().iter().map(|at| about.rows[*at as usize]));
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
        self.places.extend(self.wet.iter().map(|wall| walls.places[*wall as usize]));
        let count = self.places.len();
        let row_of_wall = &self.row_of_wall;
        let scene = Scene { grid, cells, walls, places: &self.places, row_of_wall, volume };
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
        let block = &self.blocks[row / BLOCK];
        self.links(block, row, [block.starts[row % BLOCK], block.starts[row % BLOCK + 1]])
    }

    /// Links of a row that are a range of those of its block.
    #[inline(always)]
    fn links<'a>(&'a self, block: &'a Block, row: usize, [from, to]: [u32; 2]) -> Links<'a> {
        let range = from as usize..to as usize;
        let Weights { factors, drags } = &block.weights;
        let (others, factors) = (&block.others[range.clone()], &factors[range.clone()]);
        let (place, places) = (&self.places[row], &self.places);
        Links { place, places, others, factors, drags: &drags[range] }
    }

    /// How many neighbours a row has.
    pub(super) fn degree(&self, row: usize) -> usize {
        self.of(row).others.len()
    }

    /// Computes something of the first rows from their links; what is asked for has to be inlined.
    #[inline]
    pub(super) fn each<T: Send>(&self, out: &mut [T], each: impl Fn(usize, Links<'_>, &mut T) + Sync) {
        in_blocks(out, |index, out| {
            let block = &self.blocks[index];
            wide(
                #[inline(always)]
                || {
                    for ((row, out), ends) in (index * BLOCK..).zip(out).zip(block.starts.windows(2)) {
                        each(row, self.links(block, row, [ends[0], ends[1]]), out);
                    }
                },
            );
        });
    }

    /// The operator of the pressures, scaled from both sides: the divergence of the gradient, of which each is the other's
    /// transpose, and walls stand still. `image` is how fast each row is compressed \[1/s\] by what pressures over density of
    /// `scale` times `of` \[m²/s²\] make of the particles' velocities in a second, times `factor` and `scale`. `velocities` is
    /// room.
    ///
    /// With the places x, the factors f and R for the sum of f (xᵢ - xⱼ) over j, the sum of f (pᵢ + pⱼ) (xᵢ - xⱼ) is
    /// R pᵢ + xᵢ Σ f pⱼ - Σ f pⱼ xⱼ, and that of f (xᵢ - xⱼ)·(vᵢ - vⱼ) is R·vᵢ - xᵢ·Σ f vⱼ + Σ f xⱼ·vⱼ: of a neighbour no
    /// more is asked for than four numbers. What is lost by differences of sums is little for a solver; what moves particles
    /// is computed as it stands.
    pub(super) fn product(
        &mut self,
        (scale, factor): (&[f32], f32),
        of: &[f32],
        velocities: &mut [[f32; 4]],
        image: &mut [f32],
    ) {
        let pressures = of.iter().zip(scale).map(|(of, scale)| of * scale);
        let lifted = |(at, p): (&[f32; 4], f32)| [at[0] * p, at[1] * p, at[2] * p, p];
        self.lifted.clear();
        self.lifted.extend(self.centred.iter().zip(pressures).map(lifted));
        let Self { centred, pulls, lifted, particles, .. } = &*self;
        self.each(
            &mut velocities[..*particles],
            #[inline(always)]
            |row, links, velocity| {
                let sum = links.weighted(lifted);
                let (at, pull, pressure) = (&centred[row], &pulls[row], lifted[row][3]);
                // The fourth is what the fourth of the place makes of it, 0.
                *velocity =
                    std::array::from_fn(|axis| pull[axis] * pressure + (at[axis] * sum[3] - sum[axis]));
                velocity[3] = dot(velocity, at);
            },
        );
        velocities[*particles..].fill([0.0; 4]);
        let velocities = &*velocities;
        self.each(
            image,
            #[inline(always)]
            |row, links, image| {
                let sum = links.weighted(velocities);
                let (at, pull, velocity) = (&centred[row], &pulls[row], &velocities[row]);
                let parts = std::array::from_fn(|axis| pull[axis] * velocity[axis] - at[axis] * sum[axis]);
                *image = factor * scale[row] * (sum[3] + dot(&parts, &[1.0; 4]));
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
