//! A block of the thermal lattice: 8 × 8 × 8 cells.

use nalgebra::Point3;

use super::voxelisation::{CellLocation, EDGE, PADDED, Raster};

/// Cells of a block.
pub(super) const CELLS: usize = EDGE * EDGE * EDGE;

/// Cell flags: tissue.
pub(super) const TISSUE: u8 = 1;
pub(super) const REMOVED: u8 = 2;
pub(super) const COAGULATED: u8 = 4;
pub(super) const CHARRED: u8 = 8;
/// It burst whole while boiling; other removed cells vaporised gradually.
pub(super) const BURST: u8 = 16;
/// Its water boils: set once per step, so that neighbours agree.
pub(super) const BOILING: u8 = 32;

/// Directions of the six neighbours: the axis, and −1 or +1.
pub(super) const SIDES: [(usize, i32); 6] = [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)];

/// Cells in the order x, y, z, x fastest.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Its position, in blocks from the origin.
    pub key: [i32; 3],
    pub raster: Raster,
    /// Temperature above that of the organ's mesh there \[K\].
    pub excess: Box<[f64; CELLS]>,
    /// Remaining water fraction of each cell.
    pub water: Box<[f64; CELLS]>,
    /// Part of each cell that is ahead of a drying front, which heat from dry neighbours drives: it holds all of the water,
    /// evenly. A current dries a cell without a front.
    pub ahead: Box<[f64; CELLS]>,
    /// Damage Ω.
    pub damage: Box<[f64; CELLS]>,
    pub flags: Box<[u8; CELLS]>,
    /// Whether heat is conducted in it. Otherwise every excess is 0.
    pub is_active: bool,
    /// Largest excess in the last step \[K\].
    pub peak: f64,
}

#[inline]
pub(super) fn xyz(cell: usize) -> [usize; 3] {
    [cell % EDGE, cell / EDGE % EDGE, cell / (EDGE * EDGE)]
}

/// Index of a cell in an array with a halo layer.
#[inline]
pub(super) fn padded(cell: usize) -> usize {
    let [x, y, z] = xyz(cell);
    x + 1 + PADDED * (y + 1 + PADDED * (z + 1))
}

/// The neighbouring index in an array with a halo layer.
#[inline]
pub(super) fn beside(at: usize, (axis, way): (usize, i32)) -> usize {
    let step = [1, PADDED, PADDED * PADDED][axis];
    if way < 0 { at - step } else { at + step }
}

/// The cells along each of the [`SIDES`].
static SIDE_CELLS: [[(u16, u16, u16); EDGE * EDGE]; 6] = {
    let mut table = [[(0, 0, 0); EDGE * EDGE]; 6];
    let (steps, halo_steps) = ([1, EDGE, EDGE * EDGE], [1, PADDED, PADDED * PADDED]);
    let mut side = 0;
    while side < 6 {
        let (axis, is_above) = (side / 2, side % 2 == 1);
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let (own, halo, beyond) = if is_above { (EDGE - 1, PADDED - 1, 0) } else { (0, 0, EDGE - 1) };
        let mut at = 0;
        while at < EDGE * EDGE {
            let (i, j) = (at / EDGE, at % EDGE);
            let along = i * steps[a] + j * steps[b];
            let halo_along = (i + 1) * halo_steps[a] + (j + 1) * halo_steps[b];
            table[side][at] = (
                (own * steps[axis] + along) as u16,
                (halo * halo_steps[axis] + halo_along) as u16,
                (beyond * steps[axis] + along) as u16,
            );
            at += 1;
        }
        side += 1;
    }
    table
};

/// The cells along a side: in the block, in the halo, and in the neighbouring block.
#[inline]
pub(super) fn side_cells((axis, way): (usize, i32)) -> impl Iterator<Item = (usize, usize, usize)> {
    let side = 2 * axis + usize::from(way > 0);
    SIDE_CELLS[side]
        .iter()
        .map(|(own, halo, beyond)| (usize::from(*own), usize::from(*halo), usize::from(*beyond)))
}

impl Block {
    pub(super) fn new(key: [i32; 3], raster: Raster) -> Self {
        let mut flags = Box::new([0; CELLS]);
        for (cell, flag) in flags.iter_mut().enumerate() {
            if raster.share[padded(cell)] > 0.0 {
                *flag = TISSUE;
            }
        }
        Self {
            key,
            raster,
            excess: Box::new([0.0; CELLS]),
            water: Box::new([1.0; CELLS]),
            ahead: Box::new([1.0; CELLS]),
            damage: Box::new([0.0; CELLS]),
            flags,
            is_active: false,
            peak: 0.0,
        }
    }

    #[inline]
    pub(super) fn is_tissue(&self, cell: usize) -> bool {
        self.flags[cell] & (TISSUE | REMOVED) == TISSUE
    }

    #[inline]
    pub(super) fn share(&self, cell: usize) -> f64 {
        f64::from(self.raster.share[padded(cell)])
    }

    #[inline]
    pub(super) fn site(&self, cell: usize) -> &CellLocation {
        &self.raster.sites[cell]
    }

    /// Whether a cut separates a cell from its neighbour.
    #[inline]
    pub(super) fn is_cut_off(&self, cell: usize, (axis, way): (usize, i32)) -> bool {
        let own = padded(cell);
        let first = if way < 0 { beside(own, (axis, way)) } else { own };
        self.raster.cut.get(first).is_some_and(|cut| cut & (1 << axis) != 0)
    }

    /// Part of a cell ahead of its drying front.
    #[inline]
    pub(super) fn ahead_of_front(&self, cell: usize) -> f64 {
        // Never less than its water: heat for the front may have gone on to cooler neighbours.
        self.ahead[cell].max(self.water[cell])
    }

    /// Advances the front in a boiling cell by heat that vaporises this fraction of a full cell's water, if that is still
    /// there.
    pub(super) fn advance_front(&mut self, cell: usize, vaporises: f64) {
        let water = self.water[cell];
        let left = if vaporises < water { 1.0 - vaporises / water } else { 0.0 };
        self.ahead[cell] = self.ahead_of_front(cell) * left;
    }

    /// Whether it is unchanged, so that it need not be stored.
    pub(super) fn is_pristine(&self) -> bool {
        !self.is_active
            && self.damage.iter().all(|damage| *damage == 0.0)
            && self.water.iter().all(|water| *water == 1.0)
    }

    /// Centre of a cell for this spacing, in the tissue's rest frame \[m\].
    pub(super) fn middle(&self, cell: usize, spacing: f64) -> Point3<f64> {
        let within = xyz(cell);
        let at =
            |axis: usize| (f64::from(self.key[axis]) * EDGE as f64 + within[axis] as f64 + 0.5) * spacing;
        Point3::new(at(0), at(1), at(2))
    }

    /// Key of the neighbouring block.
    pub(super) fn beyond(&self, (axis, way): (usize, i32)) -> [i32; 3] {
        let mut key = self.key;
        key[axis] += way;
        key
    }
}

#[cfg(test)]
mod tests {
    use super::super::Tissue;
    use super::super::testing::bar;
    use super::super::voxelisation::TissueLattice;
    use super::*;

    #[test]
    fn a_front_passes_a_cell_with_its_water_and_one_that_a_current_half_dried_with_half_the_heat() {
        let (positions, tets) = bar([1, 1, 1], 10e-3);
        let tissue = Tissue::Volume { positions: &positions, tets: &tets };
        let raster = TissueLattice::new(&tissue, 1e-3).expect("a lattice").raster([0; 3]).expect("tissue");
        for by_current in [0.0, 0.5, 0.9] {
            let mut block = Block::new([0; 3], raster.clone());
            block.water[0] -= by_current;
            assert_eq!(block.ahead_of_front(0), 1.0, "a current makes no front");
            let part = 0.1 * block.water[0];
            for passed in 1..=10 {
                block.advance_front(0, part);
                block.water[0] = (block.water[0] - part).max(0.0);
                assert!((block.ahead_of_front(0) - (1.0 - 0.1 * f64::from(passed))).abs() < 1e-12);
            }
        }
    }
}
