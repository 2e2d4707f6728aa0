//! Geometry of the fine lattice: the cell at a vertex, the cells beside a cell, centres and temperatures of cells.

use nalgebra::Point3;

use super::bioheat_fem::OrganHeat;
use super::enthalpy_lattice::ThermalGrid;
use super::lattice_block::{BURST, Block, REMOVED, SIDES, TISSUE, beside, padded, xyz};
use super::voxelisation::EDGE;

impl ThermalGrid {
    /// The cell at a vertex: the nearest tissue cell, else the nearest removed one; near cuts, preferably on the
    /// vertex's side. Block and cell.
    pub(super) fn cell_near(&self, point: &Point3<f64>, vertex: u32) -> Option<(usize, usize)> {
        /// Distance from a cell's side within which the cell beyond it is as near \[cells\].
        const ON_SIDE: f64 = 1e-9;
        let at = (point.coords / self.spacing).into();
        // Nothing is nearer than the cell that contains the vertex, and those that share a side on which it lies.
        let around = |x: f64| {
            let within = x - x.floor();
            [if within <= ON_SIDE { -1 } else { 0 }, if within >= 1.0 - ON_SIDE { 1 } else { 0 }]
        };
        match self.best_cell(at, at.map(around), vertex) {
            Some(((false, false), place)) => Some(place),
            _ => self.best_cell(at, [[-1, 1]; 3], vertex).map(|(_, place)| place),
        }
    }

    /// The best cell for a vertex at `at` (in cells) among those from the first to the second offset along each axis:
    /// whether it is removed and whether a cut separates it from the vertex, and its block and cell.
    fn best_cell(
        &self,
        at: [f64; 3],
        [xs, ys, zs]: [[i32; 2]; 3],
        vertex: u32,
    ) -> Option<((bool, bool), (usize, usize))> {
        let number = at.map(|x| x.floor() as i32);
        let mut best: Option<((bool, bool), f64, usize, usize)> = None;
        let offsets = (zs[0]..=zs[1])
            .flat_map(|z| (ys[0]..=ys[1]).flat_map(move |y| (xs[0]..=xs[1]).map(move |x| [x, y, z])));
        for offset in offsets {
            let near: [i32; 3] = std::array::from_fn(|axis| number[axis] + offset[axis]);
            let Ok(index) = self.find(near.map(|cell| cell.div_euclid(EDGE as i32))) else { continue };
            let within = near.map(|cell| cell.rem_euclid(EDGE as i32) as usize);
            let cell = within[0] + EDGE * (within[1] + EDGE * within[2]);
            if self.blocks[index].flags[cell] & TISSUE == 0 {
                continue;
            }
            let block = &self.blocks[index];
            let is_beyond = !block.raster.cut.is_empty() && !block.site(cell).nodes.contains(&vertex);
            let is_gone = !block.is_tissue(cell);
            let distance = (0..3).map(|axis| (f64::from(near[axis]) + 0.5 - at[axis]).powi(2)).sum();
            let now = ((is_gone, is_beyond), distance, index, cell);
            if best.is_none_or(|best| (now.0, now.1) < (best.0, best.1)) {
                best = Some(now);
            }
        }
        best.map(|(state, _, index, cell)| (state, (index, cell)))
    }

    /// Number of a cell's sides without tissue beyond.
    pub(super) fn bare_sides(&self, block: &Block, cell: usize) -> u32 {
        let bare = SIDES.into_iter().filter(|side| {
            let (found, beyond) = self.beside(block, cell, *side);
            // For a block never activated, its neighbour's halo tells.
            !found.map_or_else(
                || block.raster.share[beside(padded(cell), *side)] > 0.0,
                |found| found.is_tissue(beyond),
            )
        });
        bare.count() as u32
    }

    /// Whether a neighbour of the cell vaporised.
    pub(super) fn is_bared_by_fire(&self, block: &Block, cell: usize) -> bool {
        SIDES.into_iter().any(|side| {
            let (found, beyond) = self.beside(block, cell, side);
            found.is_some_and(|found| found.flags[beyond] & (REMOVED | BURST) == REMOVED)
        })
    }

    /// The neighbouring cell, and its block if ever activated.
    fn beside(&self, block: &Block, cell: usize, (axis, way): (usize, i32)) -> (Option<&Block>, usize) {
        let own = xyz(cell).map(|at| at as i32);
        let mut at: [i32; 3] = std::array::from_fn(|axis| block.key[axis] * EDGE as i32 + own[axis]);
        at[axis] += way;
        let within = at.map(|cell| cell.rem_euclid(EDGE as i32) as usize);
        let found = self.find(at.map(|cell| cell.div_euclid(EDGE as i32)));
        (found.ok().map(|index| &self.blocks[index]), within[0] + EDGE * (within[1] + EDGE * within[2]))
    }

    /// Centre of a cell, in the tissue's rest frame \[m\].
    pub(super) fn centre(&self, block: &Block, cell: usize) -> Point3<f64> {
        block.middle(cell, self.spacing)
    }

    /// Temperature of a cell \[°C\].
    pub(super) fn celsius(&self, block: &Block, cell: usize, organ: &OrganHeat) -> f64 {
        block.site(cell).interpolate(&organ.celsius) + block.excess[cell]
    }
}
