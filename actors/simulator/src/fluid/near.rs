//! What is within the support of a place, among what lies about its cell, and how steep the kernel is there. Numbers of a
//! kind lie side by side, so that as many are computed at once as the machine has room for.

use std::ops::Range;

use super::kernel::Kernel;
use super::neighbours::{CellGrid, CellStarts};

/// Places that are looked at together: one bit each.
const WORD: usize = 64;
/// Numbers that are added up beside each other.
pub(super) const LANES: usize = 8;
/// A number of a place that is near to nothing \[m\]; its square is a number still.
const FAR: f32 = 1e15;
/// No wall.
pub(super) const DRY: u32 = u32::MAX;

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

/// Samples of walls, sorted by cells.
pub(super) struct Walls<'a> {
    pub cells: &'a CellStarts,
    pub places: &'a [[f32; 4]],
    pub axes: &'a Axes,
    pub volumes: &'a [f32],
}

/// What there is to be near to.
pub(super) struct Scene<'a> {
    pub grid: &'a CellGrid,
    pub cells: &'a CellStarts,
    pub walls: &'a Walls<'a>,
    /// Of the particles.
    pub places: &'a [[f32; 4]],
    pub axes: &'a Axes,
    pub row_of_wall: &'a [u32],
    /// Of a particle \[m³\].
    pub volume: f32,
}

/// What lies about a cell, side by side: particles first, then walls that are wet.
#[derive(Clone, Debug, Default)]
pub(super) struct About {
    /// Filled up to whole words with what is far.
    axes: [Vec<f32>; 3],
    places: Vec<[f32; 4]>,
    pub rows: Vec<u32>,
    volumes: Vec<f32>,
    /// How many particles.
    pub liquid: usize,
    /// Which particles, and where they begin.
    ranges: Vec<(Range<usize>, usize)>,
}

impl About {
    /// All that is about a cell.
    pub(super) fn gather(&mut self, scene: &Scene<'_>, cell: usize) {
        self.axes.iter_mut().for_each(Vec::clear);
        self.places.clear();
        self.rows.clear();
        self.volumes.clear();
        self.ranges.clear();
        for (from, to) in scene.grid.rows_about(cell) {
            let range = scene.cells.range(from, to);
            self.ranges.push((range.clone(), self.rows.len()));
            for (list, axis) in self.axes.iter_mut().zip(&scene.axes.0) {
                list.extend_from_slice(&axis[range.clone()]);
            }
            self.places.extend_from_slice(&scene.places[range.clone()]);
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
                self.places.push(walls.places[wall]);
                self.rows.push(scene.row_of_wall[wall]);
                self.volumes.push(walls.volumes[wall]);
            }
        }
        let whole = self.rows.len().next_multiple_of(WORD);
        self.axes.iter_mut().for_each(|axis| axis.resize(whole, FAR));
    }

    /// Where a particle stands.
    pub(super) fn place_of(&self, row: usize) -> Option<usize> {
        self.ranges.iter().find(|(range, _)| range.contains(&row)).map(|(range, at)| at + row - range.start)
    }
}

/// What is near to a place.
#[derive(Clone, Debug, Default)]
pub(super) struct Near {
    /// Places among what is about; only so many of them as were found.
    hits: Vec<u32>,
    found: usize,
    /// How many particles.
    liquid: usize,
    /// Ways to the place \[m\].
    ways: Vec<[f32; 4]>,
    volumes: Vec<f32>,
    /// Kernel and its slope, times volume.
    values: Vec<f32>,
    factors: Vec<f32>,
    /// Of the gradients.
    squares: Vec<f32>,
}

impl Near {
    /// Places of what was found, among what is about: particles first.
    pub(super) fn hits(&self) -> &[u32] {
        &self.hits[..self.found]
    }

    /// The kernel's slope times the volume for each of them.
    pub(super) fn factors(&self) -> &[f32] {
        &self.factors[..self.found]
    }

    /// Whether walls are among them.
    pub(super) fn has_walls(&self) -> bool {
        self.liquid < self.found
    }

    /// Which of the first `count` about it are within a distance of a place, but for the one that stands at `own`.
    #[inline(always)]
    pub(super) fn find(
        &mut self,
        place: &[f32; 4],
        square: f32,
        about: &About,
        count: usize,
        own: Option<usize>,
    ) {
        if self.hits.len() < count {
            self.hits.resize(count, 0);
        }
        let mut found = 0;
        for first in (0..count).step_by(WORD) {
            let mut mask =
                within(place, square, about.axes.each_ref().map(|axis| &axis[first..first + WORD]));
            if let Some(lane) = own.and_then(|own| own.checked_sub(first)).filter(|lane| *lane < WORD) {
                mask &= !(1 << lane);
            }
            if count - first < WORD {
                mask &= (1 << (count - first)) - 1;
            }
            while mask != 0 {
                self.hits[found] = first as u32 + mask.trailing_zeros();
                found += 1;
                mask &= mask - 1;
            }
        }
        self.found = found;
        self.liquid = if about.liquid < about.rows.len() {
            self.hits().partition_point(|at| (*at as usize) < about.liquid)
        } else {
            found
        };
    }

    /// Kernels and gradients, the factor times the way \[1/m\], of all that was found; all have the volume of a wall, where
    /// one asks. The sum of kernels times volumes, of the squares of the gradients to particles, and of all gradients.
    #[inline(always)]
    pub(super) fn weigh(
        &mut self,
        place: &[f32; 4],
        about: &About,
        kernel: &Kernel,
        volume: Option<f32>,
    ) -> (f32, f32, [f32; 4]) {
        let Self { hits, found, liquid, ways, volumes, values, factors, squares } = self;
        let hits = &hits[..*found];
        // What is beyond the last weighs nothing.
        let whole = found.next_multiple_of(LANES);
        ways.resize(whole, [0.0; 4]);
        for (way, at) in ways.iter_mut().zip(hits) {
            let its = &about.places[*at as usize];
            *way = std::array::from_fn(|axis| place[axis] - its[axis]);
        }
        ways[hits.len()..].fill([0.0; 4]);
        volumes.clear();
        match volume {
            Some(volume) => volumes.resize(hits.len(), volume),
            None => {
                let own = about.volumes.first().copied().unwrap_or(0.0);
                volumes.resize(*liquid, own);
                volumes.extend(hits[*liquid..].iter().map(|at| about.volumes[*at as usize]));
            }
        }
        volumes.resize(whole, 0.0);
        for list in [&mut *values, factors, squares] {
            list.resize(whole, 0.0);
        }
        let (ways, volumes) = (&ways[..whole], &volumes[..whole]);
        let (values, factors, squares) = (&mut values[..whole], &mut factors[..whole], &mut squares[..whole]);
        let kernel = *kernel;
        for k in 0..whole {
            let way = &ways[k];
            let square = way[0] * way[0] + way[1] * way[1] + way[2] * way[2];
            let of = kernel.value_and_slope_single(square.sqrt());
            let factor = volumes[k] * of.1;
            (values[k], factors[k], squares[k]) = (volumes[k] * of.0, factor, factor * factor * square);
        }
        // Walls do not give way.
        squares[*liquid..].fill(0.0);
        let (mut even, mut odd) = ([0.0; 4], [0.0; 4]);
        for (ways, factors) in ways.chunks_exact(2).zip(factors.chunks_exact(2)) {
            for axis in 0..4 {
                even[axis] += factors[0] * ways[0][axis];
                odd[axis] += factors[1] * ways[1][axis];
            }
        }
        (sum(values), sum(squares), std::array::from_fn(|axis| even[axis] + odd[axis]))
    }
}

/// Which of the places are within a distance of one: a bit each.
#[inline(always)]
fn within(place: &[f32; 4], square: f32, axes: [&[f32]; 3]) -> u64 {
    let [low, high] = [0, WORD / 2].map(|first| axes.map(|axis| &axis[first..first + WORD / 2]));
    u64::from(half_within(place, square, low)) | u64::from(half_within(place, square, high)) << (WORD / 2)
}

#[inline(always)]
fn half_within(place: &[f32; 4], square: f32, [xs, ys, zs]: [&[f32]; 3]) -> u32 {
    let mut bits = [0_u32; LANES];
    let axes = xs.chunks_exact(LANES).zip(ys.chunks_exact(LANES)).zip(zs.chunks_exact(LANES));
    for (part, ((xs, ys), zs)) in axes.enumerate() {
        for k in 0..LANES {
            let [dx, dy, dz] = [place[0] - xs[k], place[1] - ys[k], place[2] - zs[k]];
            let is_near = dx * dx + dy * dy + dz * dz < square;
            bits[k] |= u32::from(is_near) << (part * LANES + k);
        }
    }
    bits.iter().fold(0, |all, bits| all | bits)
}

/// The sum of whole lanes.
#[inline(always)]
fn sum(list: &[f32]) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for part in list.chunks_exact(LANES) {
        for k in 0..LANES {
            sums[k] += part[k];
        }
    }
    let four: [f32; 4] = std::array::from_fn(|k| sums[k] + sums[k + 4]);
    (four[0] + four[1]) + (four[2] + four[3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    #[test]
    fn a_bit_stands_for_each_place_within_the_distance_and_for_no_other() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(11);
        let axes: [Vec<f32>; 3] =
            std::array::from_fn(|_| (0..WORD).map(|_| random.random_range(0.0..1.0)).collect());
        let place = [0.5, 0.4, 0.6, 0.0];
        let mask = within(&place, 0.16, axes.each_ref().map(Vec::as_slice));
        let [xs, ys, zs] = &axes;
        for (lane, ((x, y), z)) in xs.iter().zip(ys).zip(zs).enumerate() {
            let square = (x - place[0]).powi(2) + (y - place[1]).powi(2) + (z - place[2]).powi(2);
            assert_eq!(mask >> lane & 1 == 1, square < 0.16, "{lane}: {square}");
        }
        assert!((8..56).contains(&mask.count_ones()), "{mask:b}");
    }
}
