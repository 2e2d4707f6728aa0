//! Neighbour search for eight adjacent rows among the particles in their surrounding cells, with kernel gradients. One
//! SIMD lane per row: a neighbour of one is mostly a neighbour of others, and is tested once for all.

use super::cell_grid::{CellGrid, CellStarts};
use super::kernel::Kernel;
use crate::simd::f32x8::Eight;
pub(super) use crate::simd::f32x8::LANES;

/// A coordinate for unused rows \[m\]; its square is finite.
pub(super) const FAR: f32 = 1e15;
/// Marks a missing row.
pub(super) const DRY: u32 = u32::MAX;

/// One number for each of eight adjacent rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(32))]
pub(super) struct Lanes(pub [f32; LANES]);

/// One factor for each of eight adjacent rows, quantised to 16 bits.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(align(16))]
pub(super) struct Packed(pub [u16; LANES]);

/// Positions and volumes: three coordinates relative to the corner of the box \[m\], and a volume \[m³\].
#[derive(Clone, Copy)]
pub(super) struct Sorted<'a> {
    pub cells: &'a CellStarts,
    pub places: &'a [[f32; 4]],
    /// Row of each, if any.
    pub rows: &'a [u32],
}

/// Neighbours of some rows.
#[derive(Clone, Debug, Default)]
pub(super) struct NeighbourRows {
    /// Their rows, truncated to the number found: particles first.
    rows: Vec<u32>,
    places: Vec<[f32; 4]>,
    found: usize,
    /// Number of particles.
    liquid: usize,
}

/// Sums over the neighbours of each row.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Kernels times volumes, the row itself included.
    pub value: Lanes,
    /// Squares of the gradients to particles \[1/m²\].
    pub squares: Lanes,
    /// Gradients \[1/m\].
    pub pull: [Lanes; 3],
    /// Number, the row itself included.
    pub count: Lanes,
}

impl NeighbourRows {
    /// Rows of the neighbours: particles first.
    pub(super) fn rows(&self) -> &[u32] {
        &self.rows[..self.found]
    }

    /// Number of particles among the neighbours.
    pub(super) fn liquid(&self) -> usize {
        self.liquid
    }

    /// Forgets all.
    pub(super) fn clear(&mut self) {
        (self.found, self.liquid) = (0, 0);
    }

    /// Finds everything within a distance of any of the positions, whose cells form a row from `first` to `last`.
    #[inline(always)]
    pub(super) fn find<E: Eight>(
        &mut self,
        eight: E,
        axes: &[Lanes; 3],
        square: f32,
        (grid, first, last): (&CellGrid, usize, usize),
        liquid: [Option<Sorted<'_>>; 2],
        walls: Option<Sorted<'_>>,
    ) {
        self.clear();
        for liquid in liquid.into_iter().flatten() {
            self.find_among(eight, axes, square, (grid, first, last), liquid);
        }
        self.liquid = self.found;
        if let Some(walls) = walls {
            self.find_among(eight, axes, square, (grid, first, last), walls);
        }
    }

    #[inline(always)]
    fn find_among<E: Eight>(
        &mut self,
        eight: E,
        axes: &[Lanes; 3],
        square: f32,
        (grid, first, last): (&CellGrid, usize, usize),
        sorted: Sorted<'_>,
    ) {
        let [x, y, z] = [eight.load(&axes[0].0), eight.load(&axes[1].0), eight.load(&axes[2].0)];
        let square = eight.all(square);
        for (from, to) in grid.rows_about_all(first, last) {
            let range = sorted.cells.range(from, to);
            if range.is_empty() {
                continue;
            }
            let (places, rows) = (&sorted.places[range.clone()], &sorted.rows[range]);
            let room = self.found + places.len();
            if self.rows.len() < room {
                self.rows.resize(2 * room, 0);
                self.places.resize(2 * room, [0.0; 4]);
            }
            let mut found = 0;
            let (rows_found, places_found) =
                (&mut self.rows[self.found..room], &mut self.places[self.found..room]);
            // Every candidate is written, and rejected ones overwritten by the next: without a branch.
            for (place, row) in places.iter().zip(rows) {
                let way = [
                    eight.sub(x, eight.all(place[0])),
                    eight.sub(y, eight.all(place[1])),
                    eight.sub(z, eight.all(place[2])),
                ];
                let near = eight.bits(eight.less(eight.dot(way, way), square));
                rows_found[found] = *row;
                places_found[found] = *place;
                found += usize::from((near != 0) & (*row != DRY));
            }
            self.found += found;
        }
    }

    /// Appends the factor of each neighbour in `unit`s \[1/m²\], rounded: the volume of whichever of the two is not a
    /// plain particle, `own` for the row, times the kernel's slope; multiplied by the vector to the row, it is the
    /// pair's common gradient.
    #[inline(always)]
    pub(super) fn weigh<E: Eight>(
        &self,
        eight: E,
        axes: &[Lanes; 3],
        (kernel, unit): (&Kernel, f32),
        own: Option<&Lanes>,
        factors: &mut Vec<Packed>,
    ) -> Sums {
        let (liquid, walls) = self.places[..self.found].split_at(self.liquid);
        let mut sums = Sums::default();
        // Made before they are computed: a list that may grow within the loop would keep its sums out of registers.
        let begin = factors.len();
        factors.resize(begin + self.found, Packed::default());
        let (to_liquid, to_walls) = factors[begin..].split_at_mut(self.liquid);
        weigh_each(eight, (liquid, to_liquid), axes, (kernel, unit), own, &mut sums);
        // Walls do not move.
        let squares = sums.squares;
        weigh_each(eight, (walls, to_walls), axes, (kernel, unit), own, &mut sums);
        Sums { squares, ..sums }
    }
}

/// Computes a factor for each of the positions, and adds its contribution to each row.
#[inline(always)]
fn weigh_each<E: Eight>(
    eight: E,
    (places, factors): (&[[f32; 4]], &mut [Packed]),
    axes: &[Lanes; 3],
    (kernel, unit): (&Kernel, f32),
    own: Option<&Lanes>,
    sums: &mut Sums,
) {
    let most = eight.all((kernel.support * kernel.support) as f32);
    let (zero, one) = (eight.all(0.0), eight.all(1.0));
    let (unit, units) = (eight.all(unit), eight.all(1.0 / unit));
    let own = own.map(|own| eight.load(&own.0));
    let [x, y, z] = [eight.load(&axes[0].0), eight.load(&axes[1].0), eight.load(&axes[2].0)];
    let Sums { value, squares, pull, count } = *sums;
    let (mut value, mut squares, mut count) =
        (eight.load(&value.0), eight.load(&squares.0), eight.load(&count.0));
    let (mut px, mut py, mut pz) = (eight.load(&pull[0].0), eight.load(&pull[1].0), eight.load(&pull[2].0));
    for (place, to) in places.iter().zip(factors) {
        let volumes = own.unwrap_or(eight.all(place[3]));
        let [x, y, z] = [
            eight.sub(x, eight.all(place[0])),
            eight.sub(y, eight.all(place[1])),
            eight.sub(z, eight.all(place[2])),
        ];
        let square = eight.dot([x, y, z], [x, y, z]);
        let (its, slope) = kernel.values_and_slopes(eight, eight.sqrt(square));
        // Coincident points have no direction.
        let exact = eight.choose(eight.less(zero, square), eight.mul(volumes, slope), zero);
        let packed = eight.pack(eight.mul(exact, units));
        *to = Packed(packed);
        // The rounded factor, as used from here on.
        let factor = eight.mul(eight.unpack(&packed), unit);
        value = eight.add(value, eight.mul(volumes, its));
        count = eight.add(count, eight.choose(eight.less(square, most), one, zero));
        squares = eight.add(squares, eight.mul3(factor, factor, square));
        px = eight.add(px, eight.mul(factor, x));
        py = eight.add(py, eight.mul(factor, y));
        pz = eight.add(pz, eight.mul(factor, z));
    }
    *sums = Sums {
        value: Lanes(eight.store(value)),
        squares: Lanes(eight.store(squares)),
        pull: [Lanes(eight.store(px)), Lanes(eight.store(py)), Lanes(eight.store(pz))],
        count: Lanes(eight.store(count)),
    };
}
