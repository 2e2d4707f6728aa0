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
/// Softens what slows down where particles meet, as a share of the square of the support (Monaghan 2005).
const SOFT: f64 = 0.01;
/// No wall.
pub(super) const DRY: u32 = u32::MAX;

/// Samples of walls, sorted by cells.
pub(super) struct Walls<'a> {
    pub cells: &'a CellStarts,
    pub places: &'a [[f32; 4]],
    pub volumes: &'a [f32],
}

/// What there is to be near to.
pub(super) struct Scene<'a> {
    pub grid: &'a CellGrid,
    pub cells: &'a CellStarts,
    pub walls: &'a Walls<'a>,
    /// Of the particles.
    pub places: &'a [[f32; 4]],
    pub row_of_wall: &'a [u32],
    /// Of a particle \[m³\].
    pub volume: f32,
}

/// What lies about a cell, side by side: particles first, then walls that are wet.
#[derive(Clone, Debug, Default)]
pub(super) struct About {
    /// Filled up to whole words with what is far.
    places: Vec<[f32; 4]>,
    /// The same, an axis at a time.
    axes: [Vec<f32>; 3],
    pub rows: Vec<u32>,
    volumes: Vec<f32>,
    /// How many particles.
    pub liquid: usize,
    /// Which particles, and where they begin.
    ranges: Vec<(Range<usize>, usize)>,
}

impl About {
    /// All that is about a cell.
    #[inline(always)]
    pub(super) fn gather(&mut self, scene: &Scene<'_>, cell: usize) {
        self.axes.iter_mut().for_each(Vec::clear);
        self.places.clear();
        self.rows.clear();
        self.volumes.clear();
        self.ranges.clear();
        for (from, to) in scene.grid.rows_about(cell) {
            let range = scene.cells.range(from, to);
            self.ranges.push((range.clone(), self.rows.len()));
            self.places.extend_from_slice(&scene.places[range.clone()]);
            self.rows.extend(range.map(|row| row as u32));
        }
        self.liquid = self.rows.len();
        self.volumes.resize(self.liquid, scene.volume);
        let walls = scene.walls;
        for (from, to) in scene.grid.rows_about(cell) {
            // At the very edge of its reach a wall may be dry.
            for wall in walls.cells.range(from, to).filter(|wall| scene.row_of_wall[*wall] != DRY) {
                self.places.push(walls.places[wall]);
                self.rows.push(scene.row_of_wall[wall]);
                self.volumes.push(walls.volumes[wall]);
            }
        }
        let whole = self.rows.len().next_multiple_of(WORD);
        self.places.resize(whole, [FAR; 4]);
        for (axis, list) in self.axes.iter_mut().enumerate() {
            list.extend(self.places.iter().map(|place| place[axis]));
        }
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
}

/// What belongs to a link, beside who it is.
#[derive(Clone, Debug, Default)]
pub(super) struct Weights {
    /// Factor of the way to the row from the neighbour in the gradient that the two have in common: volume of what is not a
    /// plain particle of the two, times the kernel's slope \[1/m²\]. Ways come anew from the places, which are near in
    /// memory: products with the operator wait for what they read.
    pub factors: Vec<f32>,
    /// The factors over the squares of the ways, softened: what slows down is that times the way, twice \[1/m⁴\].
    pub drags: Vec<f32>,
}

/// Sums over what is near.
pub(super) struct Sums {
    /// Of kernels times volumes.
    pub value: f32,
    /// Of the squares of the gradients to particles.
    pub squares: f32,
    /// Of the gradients \[1/m\].
    pub pull: [f32; 4],
}

impl Near {
    /// Places of what was found, among what is about: particles first.
    pub(super) fn hits(&self) -> &[u32] {
        &self.hits[..self.found]
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
        if self.hits.len() < count + LANES {
            self.hits.resize(count + LANES, 0);
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
    /// one asks. Adds a weight for each.
    #[inline(always)]
    pub(super) fn weigh(
        &mut self,
        place: &[f32; 4],
        about: &About,
        kernel: &Kernel,
        volume: Option<f32>,
        weights: &mut Weights,
    ) -> Sums {
        let Self { hits, found, liquid, .. } = self;
        let (found, liquid) = (*found, *liquid);
        // What fills up the lanes weighs nothing.
        let last = found.checked_sub(1).map_or(0, |last| hits[last]);
        hits[found..found.next_multiple_of(LANES)].fill(last);
        let own = volume.or(about.volumes.first().copied()).unwrap_or(0.0);
        let volume_of = |at: usize, hit: u32| match volume {
            _ if at >= found => 0.0,
            Some(volume) => volume,
            None => about.volumes[hit as usize],
        };
        let kernel = *kernel;
        let soft = (SOFT * kernel.support * kernel.support) as f32;
        let [mut value, mut squares, mut px, mut py, mut pz] = [[0.0_f32; LANES]; 5];
        let begin = weights.factors.len();
        for (group, hits) in hits[..found.next_multiple_of(LANES)].chunks_exact(LANES).enumerate() {
            let first = group * LANES;
            let [mut x, mut y, mut z] = [[0.0_f32; LANES]; 3];
            for k in 0..LANES {
                let its = &about.places[hits[k] as usize];
                (x[k], y[k], z[k]) = (place[0] - its[0], place[1] - its[1], place[2] - its[2]);
            }
            let is_plain = first + LANES <= liquid;
            let volumes: [f32; LANES] =
                if is_plain { [own; LANES] } else { std::array::from_fn(|k| volume_of(first + k, hits[k])) };
            // Walls do not give way.
            let gives: [f32; LANES] = if is_plain {
                [1.0; LANES]
            } else {
                std::array::from_fn(|k| f32::from(u8::from(first + k < liquid)))
            };
            let [mut factor, mut drag] = [[0.0_f32; LANES]; 2];
            for k in 0..LANES {
                let square = x[k] * x[k] + y[k] * y[k] + z[k] * z[k];
                let of = kernel.value_and_slope_single(square.sqrt());
                factor[k] = volumes[k] * of.1;
                drag[k] = factor[k] / (square + soft);
                value[k] += volumes[k] * of.0;
                squares[k] += gives[k] * (factor[k] * factor[k] * square);
                px[k] += factor[k] * x[k];
                py[k] += factor[k] * y[k];
                pz[k] += factor[k] * z[k];
            }
            weights.factors.extend_from_slice(&factor);
            weights.drags.extend_from_slice(&drag);
        }
        weights.factors.truncate(begin + found);
        weights.drags.truncate(begin + found);
        let [value, squares, x, y, z] = [value, squares, px, py, pz].map(|lanes| folded(&lanes));
        Sums { value, squares, pull: [x, y, z, 0.0] }
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

/// The sum of all lanes.
#[inline(always)]
fn folded(sums: &[f32; LANES]) -> f32 {
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
