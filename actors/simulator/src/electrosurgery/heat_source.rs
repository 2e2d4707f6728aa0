//! Heat deposition of an electrode on the lattice: which cells it heats and how much, in substeps so short that the
//! overshoot of a vaporising cell is negligible.

use super::electrode::{Electrode, Mode, REACH, profile};
use super::electrode_contact::{Contact, FacedCell};
use super::energy_balance::HeatReport;
use super::enthalpy_lattice::{LatticeOutputs, ThermalGrid};
use super::error::HeatStepError;
use super::lattice_block::CELLS;
use super::voxelisation::EDGE;

/// Largest fraction of a cell's vaporisation heat deposited in one substep.
const PART: f64 = 0.05;
/// Maximum substeps of a step.
const PARTS_MAX: u32 = 4096;

/// A cell within an electrode's heated region.
#[derive(Clone, Copy, Debug)]
struct NearCell {
    block: usize,
    cell: usize,
    /// Distance of its centre from the tip \[m\].
    distance: f64,
    /// Distance of its nearest point from the tip \[m\]: 0 where the tip is in it.
    outside: f64,
    /// Its share of the total heat.
    share: f64,
}

/// The cells around an electrode; reused buffer.
#[derive(Clone, Debug, Default)]
pub(super) struct HeatedCells {
    near: Vec<NearCell>,
    /// Their number when the contact was computed.
    faced: usize,
    /// Contact area facing them \[m²\].
    pub area: f64,
}

impl HeatedCells {
    /// Activates the blocks around the electrode; an error where a step needs too many substeps.
    pub(super) fn prepare(
        &mut self,
        grid: &mut ThermalGrid,
        electrode: &Electrode,
        dt: f64,
        outputs: &mut LatticeOutputs<'_>,
    ) -> Result<f64, HeatStepError> {
        self.near.clear();
        if electrode.power == 0.0 {
            return Ok(f64::INFINITY);
        }
        self.gather(grid, electrode, outputs.report);
        let gap = self.aim(grid, electrode, outputs.material.dry_current);
        let energy = electrode.power * electrode.efficiency(gap) * dt;
        let density = self.density(grid);
        let parts = energy * density / (PART * grid.enthalpy.vaporisation());
        if parts > f64::from(PARTS_MAX) {
            return Err(HeatStepError::TooStrong { dt, parts: parts.ceil(), most: PARTS_MAX });
        }
        Ok(gap)
    }

    /// Computes an electrode's contact; activates the blocks around it.
    pub(super) fn contact(
        &mut self,
        grid: &mut ThermalGrid,
        electrode: &Electrode,
        report: &mut HeatReport,
    ) -> Contact {
        self.gather(grid, electrode, report);
        self.facing(grid, electrode)
    }

    fn facing(&self, grid: &ThermalGrid, electrode: &Electrode) -> Contact {
        let cells = self.near.iter().map(|near| {
            let block = &grid.blocks[near.block];
            FacedCell { middle: grid.centre(block, near.cell), water: block.water[near.cell] }
        });
        Contact::with_cells(electrode, grid.spacing, cells)
    }

    /// Collects the tissue cells around an electrode.
    pub(super) fn gather(&mut self, grid: &mut ThermalGrid, electrode: &Electrode, report: &mut HeatReport) {
        self.near.clear();
        self.faced = usize::MAX;
        let reach = REACH * electrode.radius(electrode.contact_area)
            + electrode.contact_radius()
            + electrode.mode.spark()
            + grid.spacing;
        let edge = EDGE as f64 * grid.spacing;
        let tip = electrode.tip_in_rest;
        let [low, high] =
            [-reach, reach].map(|by| [tip.x, tip.y, tip.z].map(|x| ((x + by) / edge).floor() as i32));
        let keys = (low[0]..=high[0]).flat_map(move |x| {
            (low[1]..=high[1]).flat_map(move |y| (low[2]..=high[2]).map(move |z| [x, y, z]))
        });
        for key in keys.clone() {
            grid.activate(key, report);
        }
        for key in keys {
            let Ok(index) = grid.find(key) else { continue };
            let block = &grid.blocks[index];
            if !block.is_active {
                continue;
            }
            for cell in (0..CELLS).filter(|cell| block.is_tissue(*cell)) {
                let from = grid.centre(block, cell) - tip;
                let distance = from.norm();
                if distance <= reach {
                    let outside = from.map(|x| (x.abs() - 0.5 * grid.spacing).max(0.0)).norm();
                    self.near.push(NearCell { block: index, cell, distance, outside, share: 0.0 });
                }
            }
        }
    }

    /// Heat density at the hottest cell per joule in total \[1/m³\].
    fn density(&self, grid: &ThermalGrid) -> f64 {
        let volume = grid.cell_volume();
        let of = |near: &NearCell| near.share / (volume * grid.blocks[near.block].share(near.cell));
        self.near.iter().map(of).fold(0.0, f64::max)
    }

    /// Shares of the remaining cells; returns the gap from the tip to the nearest \[m\].
    fn aim(&mut self, grid: &ThermalGrid, electrode: &Electrode, dry: f64) -> f64 {
        self.near.retain(|near| grid.blocks[near.block].is_tissue(near.cell));
        if self.near.len() != self.faced {
            self.faced = self.near.len();
            self.area = self.facing(grid, electrode).area(electrode);
        }
        let radius = electrode.radius(self.area);
        let first = self.near.iter().min_by(|a, b| a.distance.total_cmp(&b.distance));
        let nearest = first.map_or(f64::INFINITY, |first| first.distance);
        // From the metal, a sphere with the contact's radius, to the nearest cell: not from its centre, which is farther
        // where the tip is at a corner of cells. A burned surface
        // recedes cell by cell, each of which vaporises when its centre reaches the temperature: the true surface
        // passes through the nearest remaining centres, and anything that protrudes is an artefact of the lattice.
        let is_bared = |near: &NearCell| grid.is_bared_by_fire(&grid.blocks[near.block], near.cell);
        let is_wall = electrode.mode == Mode::Coagulate && first.is_some_and(is_bared);
        let outside = self.near.iter().map(|near| near.outside).fold(f64::INFINITY, f64::min);
        let away = if is_wall && outside > 0.0 { nearest } else { outside };
        let gap = away - electrode.contact_radius();
        let reach = REACH * radius;
        let mut sum = 0.0;
        for near in &mut self.near {
            let beyond = near.distance - nearest;
            near.share = if beyond > reach {
                0.0
            } else {
                let block = &grid.blocks[near.block];
                // When cutting, the arc in the steam strikes the nearest tissue; cells burst before they insulate.
                let conducts = match electrode.mode {
                    Mode::Cut => 1.0,
                    Mode::Coagulate => dry + (1.0 - dry) * block.water[near.cell],
                };
                profile(beyond, radius) * block.share(near.cell) * conducts
            };
            sum += near.share;
        }
        if sum > 0.0 {
            self.near.iter_mut().for_each(|near| near.share /= sum);
        }
        gap.max(0.0)
    }

    /// Deposits heat for `dt` as prepared; returns the absorbed energy \[J\].
    pub(super) fn heat(
        &mut self,
        grid: &mut ThermalGrid,
        electrode: &Electrode,
        dt: f64,
        outputs: &mut LatticeOutputs<'_>,
    ) -> f64 {
        let volume = grid.cell_volume();
        let limit = PART * grid.enthalpy.vaporisation();
        let (mut left, mut arrived) = (dt, 0.0);
        for _ in 0..4 * PARTS_MAX {
            let gap = self.aim(grid, electrode, outputs.material.dry_current);
            let power = electrode.power * electrode.efficiency(gap);
            if left <= 0.0 || self.near.is_empty() || power == 0.0 {
                break;
            }
            let part = left.min(limit / (power * self.density(grid)));
            for index in 0..self.near.len() {
                let NearCell { block, cell, share, .. } = self.near[index];
                if share == 0.0 {
                    continue;
                }
                let at = &mut grid.blocks[block];
                let capacity = grid.enthalpy.capacity(at.water[cell]) * at.share(cell) * volume;
                at.excess[cell] += power * part * share / capacity;
                grid.settle_cell(block, cell, outputs);
            }
            arrived += power * part;
            left -= part;
        }
        outputs.ledger.supplied += arrived;
        arrived
    }
}
