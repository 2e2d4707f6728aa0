//! Neighbour lists of SPH as flat arrays, with kernel gradients. Particles are sorted by cell, so that lists refer to
//! nearby memory, and eight consecutive ones share a list with a factor each: sums over neighbours are computed for
//! eight at once, as with the clusters of Páll and Hess, *A flexible algorithm for calculating pair interactions on
//! SIMD architectures*, 2013.

use std::ops::Range;

use rayon::prelude::*;

use super::cell_grid::{CellGrid, CellStarts};
use super::kernel::Kernel;
use super::neighbour_clusters::{Links, Sweep};
use super::neighbour_search::{DRY, FAR, LANES, Lanes, NeighbourRows, Packed, Sorted, Sums};
use crate::simd::f32x8::{Eight, ForEight, with_eight};

/// Number of rows per parallel block.
const BLOCK: usize = 64 * LANES;
/// Fewer rows are computed sequentially.
const PARALLEL: usize = 4 * BLOCK;
/// Largest quantised factor: slightly below the 16-bit limit.
const UNITS: f64 = 65_530.0;
/// Distance from the first of a cluster, in supports, beyond which another cluster begins.
const APART: f64 = 2.0;

/// Computes a list block by block, on the rayon pool where it is long; the result of a row does not depend on the
/// block.
fn in_blocks<T: Send>(list: &mut [T], each: impl Fn(usize, &mut [T]) + Sync) {
    if list.len() >= PARALLEL && rayon::current_num_threads() > 1 {
        list.par_chunks_mut(BLOCK).enumerate().for_each(|(index, part)| each(index, part));
    } else {
        list.chunks_mut(BLOCK).enumerate().for_each(|(index, part)| each(index, part));
    }
}

/// Wall samples, sorted by cell.
pub(super) struct Walls<'a> {
    pub cells: &'a CellStarts,
    /// Positions relative to the corner of the box \[m\], and volumes represented \[m³\].
    pub places: &'a [[f32; 4]],
    /// Whether each is a sample of a smooth wall, which has no row.
    pub smooth: &'a [bool],
}

/// A particle and a nearby wall sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct WallLink {
    pub particle: u32,
    /// Index in the order of the samples' cells.
    pub wall: u32,
    /// Kernel factor as in the links \[1/m²\].
    pub factor: f32,
}

/// Neighbours of every particle, then of every wall sample near a particle. Rows come in clusters of eight, padded with
/// unused rows.
#[derive(Clone, Debug, Default)]
pub(super) struct Rows {
    blocks: Vec<ClusterBlock>,
    /// Particle positions sorted by cell, relative to the corner of the box \[m\], and volumes \[m³\].
    pub liquid: Vec<[f32; 4]>,
    /// Row of each particle, increasing with its index.
    pub row_of: Vec<u32>,
    /// Number of particle rows, padding included; the others are walls.
    pub particles: usize,
    /// Quantisation unit of the factors \[1/m²\].
    unit: f32,
    /// Wall samples near a particle, in the order of their cells.
    pub wet: Vec<u32>,
    /// Images of particles beyond the ends of a liquid that goes on there, in the order of their cells: the particle, and
    /// its shifted position relative to the corner of the box \[m\] and volume \[m³\].
    pub images: Vec<(u32, [f32; 4])>,
    /// The first row of images, which come last.
    first_image: usize,
    /// Row of each wall sample, if any.
    pub row_of_wall: Vec<u32>,
    /// Pairs of nearby particles and wall samples.
    pub wall_links: Vec<WallLink>,
    /// Relative density: sums of kernels times volumes, 1 at rest.
    pub compression: Vec<f32>,
    /// Diagonal of the divergence of the gradient \[1/m²\].
    pub diagonal: Vec<f32>,
    /// Number of neighbours of each row.
    pub degree: Vec<f32>,
    /// Particle or sample of each row, if any.
    owner: Vec<u32>,
    /// Cells of the first and of the last row of each cluster.
    cells: Vec<(u32, u32)>,
    /// Positions relative to the corner of the box \[m\], and volumes \[m³\].
    pub(super) places: Vec<[f32; 4]>,
    /// The same positions by cluster and axis.
    pub(super) axes: Vec<[Lanes; 3]>,
    /// The same relative to the centre of the rows \[m\].
    pub(super) centred: Vec<[Lanes; 3]>,
    /// Sum of the gradients of each row \[1/m\].
    pub(super) pulls: Vec<[Lanes; 3]>,
    /// For each row, the pressure times its position, and the pressure.
    pub(super) lifted: Vec<[f32; 4]>,
}

/// Some consecutive clusters.
#[derive(Clone, Debug, Default)]
struct ClusterBlock {
    /// Start of each cluster's list, and its number of particles, which come first.
    starts: Vec<(u32, u32)>,
    /// Row of each neighbour: particles first, then walls.
    others: Vec<u32>,
    factors: Vec<Packed>,
    sums: Vec<Sums>,
    wall_links: Vec<WallLink>,
    near: NeighbourRows,
}

/// Inputs for building rows.
struct RowInputs<'a> {
    grid: &'a CellGrid,
    kernel: &'a Kernel,
    liquid: Sorted<'a>,
    walls: Sorted<'a>,
    images: Option<Sorted<'a>>,
    first_image: usize,
    owner: &'a [u32],
    cells: &'a [(u32, u32)],
    axes: &'a [[Lanes; 3]],
    places: &'a [[f32; 4]],
    particles: usize,
    unit: f32,
    volume: f32,
    beside: f32,
}

/// Outputs of building rows.
struct RowFill<'a> {
    parts: &'a RowInputs<'a>,
    block: &'a mut ClusterBlock,
    clusters: Range<usize>,
}

impl ForEight for RowFill<'_> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) {
        self.parts.fill(eight, self.block, self.clusters);
    }
}

impl RowInputs<'_> {
    #[inline(always)]
    fn fill<E: Eight>(&self, eight: E, block: &mut ClusterBlock, clusters: Range<usize>) {
        let square = (self.kernel.support * self.kernel.support) as f32;
        let ClusterBlock { starts, others, factors, sums, wall_links, near } = block;
        starts.clear();
        others.clear();
        factors.clear();
        sums.clear();
        wall_links.clear();
        for cluster in clusters {
            let (axes, row) = (&self.axes[cluster], cluster * LANES);
            let (first, last) = self.cells[cluster];
            let cells = (self.grid, first as usize, last as usize);
            let begin = factors.len();
            if row >= self.first_image {
                near.clear();
                sums.push(Sums::default());
            } else if row < self.particles {
                near.find(eight, axes, square, cells, [Some(self.liquid), self.images], Some(self.walls));
                let mut found = near.weigh(eight, axes, (self.kernel, self.unit), None, factors);
                let [px, py, pz] = &found.pull;
                for k in 0..LANES {
                    found.squares.0[k] += px.0[k] * px.0[k] + py.0[k] * py.0[k] + pz.0[k] * pz.0[k];
                }
                sums.push(found);
                let to_walls = near.rows().iter().zip(&factors[begin..]).skip(near.liquid());
                for (other, factor) in to_walls {
                    let wall = self.owner[*other as usize];
                    for (particle, factor) in self.owner[row..row + LANES].iter().zip(factor.0) {
                        if factor != 0 {
                            let factor = self.unit * f32::from(factor);
                            wall_links.push(WallLink { particle: *particle, wall, factor });
                        }
                    }
                }
            } else {
                let volumes = Lanes(std::array::from_fn(|k| self.places[row + k][3]));
                near.find(eight, axes, square, cells, [Some(self.liquid), self.images], None);
                let mut found = near.weigh(eight, axes, (self.kernel, self.unit), Some(&volumes), factors);
                for k in 0..LANES {
                    found.value.0[k] += 1.0 - self.beside * volumes.0[k] / self.volume;
                }
                sums.push(found);
            }
            starts.push((others.len() as u32, near.liquid() as u32));
            others.extend_from_slice(near.rows());
        }
        starts.push((others.len() as u32, 0));
    }
}

impl Rows {
    /// Number of rows, padding included.
    pub(super) fn count(&self) -> usize {
        self.places.len()
    }

    /// Builds the rows of a liquid (filled in by the caller, in cell order) and of nearby walls. `beside` is a wall's
    /// kernel sum over adjacent particles of `volume` at rest, in terms of their volume.
    pub(super) fn build(
        &mut self,
        grid: &CellGrid,
        [cells, image_cells]: [&CellStarts; 2],
        walls: &Walls<'_>,
        kernel: &Kernel,
        volume: f32,
        beside: f32,
    ) {
        self.find_wet(grid, [cells, image_cells], walls, (kernel.support * kernel.support) as f32);
        self.arrange(grid, walls, (APART * kernel.support) as f32);
        let clusters = self.cells.len();
        let image_places: Vec<[f32; 4]> = self.images.iter().map(|(_, place)| *place).collect();
        let image_rows: Vec<u32> =
            (0..self.images.len()).map(|image| (self.first_image + image) as u32).collect();
        let images = Sorted { cells: image_cells, places: &image_places, rows: &image_rows };
        // From the largest possible factor.
        let largest = walls.places.iter().map(|place| place[3]).fold(volume, f32::max);
        self.unit = (kernel.steepest() / UNITS) as f32 * largest;
        let parts = RowInputs {
            grid,
            kernel,
            liquid: Sorted { cells, places: &self.liquid, rows: &self.row_of },
            walls: Sorted { cells: walls.cells, places: walls.places, rows: &self.row_of_wall },
            images: (!self.images.is_empty()).then_some(images),
            first_image: self.first_image,
            owner: &self.owner,
            cells: &self.cells,
            axes: &self.axes,
            places: &self.places,
            particles: self.particles,
            unit: self.unit,
            volume,
            beside,
        };
        let blocks = self.places.len().div_ceil(BLOCK);
        if self.blocks.len() < blocks {
            self.blocks.resize_with(blocks, ClusterBlock::default);
        }
        let each = BLOCK / LANES;
        let fill = |(index, block): (usize, &mut ClusterBlock)| {
            let clusters = index * each..clusters.min((index + 1) * each);
            with_eight(RowFill { parts: &parts, block, clusters });
        };
        if self.places.len() >= PARALLEL && rayon::current_num_threads() > 1 {
            self.blocks[..blocks].par_iter_mut().enumerate().for_each(fill);
        } else {
            self.blocks[..blocks].iter_mut().enumerate().for_each(fill);
        }
        self.compression.clear();
        self.diagonal.clear();
        self.degree.clear();
        self.pulls.clear();
        self.wall_links.clear();
        for block in &self.blocks[..blocks] {
            for Sums { value, squares, pull, count } in &block.sums {
                self.compression.extend_from_slice(&value.0);
                self.diagonal.extend_from_slice(&squares.0);
                // Except itself.
                self.degree.extend(count.0.map(|count| count - 1.0));
                self.pulls.push(*pull);
            }
            self.wall_links.extend_from_slice(&block.wall_links);
        }
    }

    /// Assigns rows to particles and wet wall samples, in clusters of neighbours in a row of cells.
    fn arrange(&mut self, grid: &CellGrid, walls: &Walls<'_>, apart: f32) {
        self.owner.clear();
        self.places.clear();
        self.cells.clear();
        self.row_of.clear();
        for particle in 0..self.liquid.len() {
            let place = self.liquid[particle];
            let row = self.next_row(grid, apart, place, particle as u32);
            self.row_of.push(row);
        }
        self.end_cluster();
        self.particles = self.places.len();
        for at in 0..self.wet.len() {
            let wall = self.wet[at];
            let row = self.next_row(grid, apart, walls.places[wall as usize], wall);
            self.row_of_wall[wall as usize] = row;
        }
        self.end_cluster();
        self.first_image = self.places.len();
        if !self.images.is_empty() {
            let whole = (self.first_image + self.images.len()).next_multiple_of(LANES);
            self.places.extend(self.images.iter().map(|(_, place)| *place));
            self.places.resize(whole, [FAR, FAR, FAR, 0.0]);
            // No link refers to an owner of theirs, except for the position.
            self.owner.extend(self.images.iter().map(|(particle, _)| *particle));
            self.owner.resize(whole, DRY);
            self.cells.resize(whole / LANES, (0, 0));
        }
        let (mut low, mut high) = ([f32::INFINITY; 4], [f32::NEG_INFINITY; 4]);
        for place in &self.liquid {
            for axis in 0..4 {
                low[axis] = low[axis].min(place[axis]);
                high[axis] = high[axis].max(place[axis]);
            }
        }
        let middle: [f32; 3] = std::array::from_fn(|axis| 0.5 * (low[axis] + high[axis]));
        self.axes.clear();
        self.centred.clear();
        for (places, owners) in self.places.chunks_exact(LANES).zip(self.owner.chunks_exact(LANES)) {
            let axes = std::array::from_fn(|axis| Lanes(std::array::from_fn(|k| places[k][axis])));
            self.axes.push(axes);
            self.centred.push(std::array::from_fn(|axis| {
                let centred = |k: usize| if owners[k] == DRY { 0.0 } else { axes[axis].0[k] - middle[axis] };
                Lanes(std::array::from_fn(centred))
            }));
        }
    }

    /// The next row, in the last cluster if near enough.
    fn next_row(&mut self, grid: &CellGrid, apart: f32, place: [f32; 4], owner: u32) -> u32 {
        let cell = grid.cell_of(&place);
        let begun = self.places.len() % LANES;
        if begun > 0
            && let Some((first, _)) = self.cells.last()
        {
            let from = self.places[self.places.len() - begun][0];
            if grid.line_of(*first as usize) != grid.line_of(cell) || place[0] - from > apart {
                self.end_cluster();
            }
        }
        if self.places.len().is_multiple_of(LANES) {
            self.cells.push((cell as u32, cell as u32));
        } else if let Some((_, last)) = self.cells.last_mut() {
            *last = cell as u32;
        }
        self.places.push(place);
        self.owner.push(owner);
        self.places.len() as u32 - 1
    }

    /// Pads the last cluster with unused rows.
    fn end_cluster(&mut self) {
        let whole = self.places.len().next_multiple_of(LANES);
        self.places.resize(whole, [FAR, FAR, FAR, 0.0]);
        self.owner.resize(whole, DRY);
    }

    /// Finds the wall samples with a particle within the support.
    fn find_wet(
        &mut self,
        grid: &CellGrid,
        [cells, image_cells]: [&CellStarts; 2],
        walls: &Walls<'_>,
        square: f32,
    ) {
        self.wet.clear();
        self.row_of_wall.clear();
        self.row_of_wall.resize(walls.places.len(), DRY);
        for (wall, place) in walls.places.iter().enumerate().filter(|(wall, _)| !walls.smooth[*wall]) {
            let is_within = |other: &[f32; 4]| {
                let [dx, dy, dz] = std::array::from_fn(|axis| other[axis] - place[axis]);
                dx * dx + dy * dy + dz * dz < square
            };
            let is_near = |particle: usize| is_within(&self.liquid[particle]);
            let is_image_near = |image: usize| is_within(&self.images[image].1);
            let mut about = grid.rows_about(grid.cell_of(place));
            if about.any(|(from, to)| {
                cells.range(from, to).any(is_near)
                    || (!self.images.is_empty() && image_cells.range(from, to).any(is_image_near))
            }) {
                self.wet.push(wall as u32);
            }
        }
    }

    /// Copies the values of particles to the rows of their images.
    pub(super) fn copy_to_images<T: Copy>(&self, list: &mut [T]) {
        for (image, (particle, _)) in self.images.iter().enumerate() {
            list[self.first_image + image] = list[self.row_of[*particle as usize] as usize];
        }
    }

    /// The same for sums over positions: the fourth number is a value times the position, or, where `is_pressure`, the
    /// first three are the fourth times the position.
    pub(super) fn lift_images(&self, list: &mut [[f32; 4]], is_pressure: bool) {
        for (image, (particle, _)) in self.images.iter().enumerate() {
            let row = self.first_image + image;
            let own = list[self.row_of[*particle as usize] as usize];
            let at = std::array::from_fn::<f32, 3, _>(|axis| self.centred[row / LANES][axis].0[row % LANES]);
            list[row] = if is_pressure {
                [at[0] * own[3], at[1] * own[3], at[2] * own[3], own[3]]
            } else {
                [own[0], own[1], own[2], own[0] * at[0] + own[1] * at[1] + own[2] * at[2]]
            };
        }
    }

    /// Adds to the gradient of a row \[1/m\].
    pub(super) fn pull(&mut self, row: usize, by: [f32; 3]) {
        let pull = &mut self.pulls[row / LANES];
        for (axis, by) in by.into_iter().enumerate() {
            let own = &mut pull[axis].0[row % LANES];
            self.diagonal[row] += by * (by + 2.0 * *own);
            *own += by;
        }
    }

    /// Computes a value for each of the first rows, eight at a time, from their links.
    #[inline]
    pub(super) fn each<T: Send>(&self, out: &mut [T], sweep: &(impl Sweep<T> + Sync)) {
        in_blocks(out, |index, out| with_eight(RowSweep { rows: self, index, out, sweep }));
    }
}

/// Context of computing a block's rows.
struct RowSweep<'a, T, S> {
    rows: &'a Rows,
    index: usize,
    out: &'a mut [T],
    sweep: &'a S,
}

impl<T, S: Sweep<T>> ForEight for RowSweep<'_, T, S> {
    type Output = ();

    #[inline(always)]
    fn run<E: Eight>(self, eight: E) {
        let Self { rows, index, out, sweep } = self;
        let block = &rows.blocks[index];
        let clusters = block.starts.windows(2).zip(index * BLOCK / LANES..);
        for (out, (ends, cluster)) in out.chunks_exact_mut(LANES).zip(clusters) {
            let range = ends[0].0 as usize..ends[1].0 as usize;
            let links = Links {
                row: cluster * LANES,
                axes: &rows.axes[cluster],
                places: &rows.places,
                others: &block.others[range.clone()],
                factors: &block.factors[range],
                unit: rows.unit,
                liquid: ends[0].1 as usize,
            };
            sweep.sweep(eight, links, out);
        }
    }
}
