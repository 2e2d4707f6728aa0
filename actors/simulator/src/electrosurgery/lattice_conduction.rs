//! Conduction and perfusion on the fine lattice: within its blocks, from block to block, at what is held, and at the rim of
//! the active blocks, where heat passes to the mesh.

use super::bioheat_fem::OrganHeat;
use super::enthalpy::boiling_nearer;
use super::enthalpy_lattice::{LatticeOutputs, ThermalGrid};
use super::lattice_block::{
    BOILING, Block, CELLS, COAGULATED, SIDES, TISSUE, beside, padded, side_cells, xyz,
};
use super::voxelisation::{EDGE, PADDED};

/// Least distance from what is held, and tolerance of a plane at the face of a cell \[cells\].
const ON_FACE: f64 = 0.05;

/// A plane through tissue that is held at a temperature, like the face of a cooled or heated plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldPlane {
    /// The axis that it is across: 0, 1 or 2.
    pub axis: usize,
    /// Its place along that axis, in the tissue's rest frame \[m\].
    pub at: f64,
    /// Its temperature \[°C\].
    pub celsius: f64,
}

/// A cell next to what is held.
#[derive(Clone, Copy, Debug)]
struct HeldCell {
    cell: usize,
    /// The inverse of its distance \[1/cells\].
    nearness: f64,
    /// The temperature there, above the mesh \[K\].
    excess: f64,
}

/// A value for each cell of a block and of its halo.
type Padded = Box<[f64; PADDED * PADDED * PADDED]>;

/// Memory of a step of conduction, kept from step to step.
#[derive(Clone, Debug)]
pub(super) struct ConductionBuffers {
    /// The excess of each active block's cells at the end of the step \[K\].
    next: Vec<Box<[f64; CELLS]>>,
    /// Fronts to advance after all blocks: block, cell, and the fraction of a full cell's water.
    fronts: Vec<(usize, usize, f64)>,
    /// Of the block at hand.
    held_cells: Vec<HeldCell>,
    excess: Padded,
    conduction: Padded,
    /// Conduction of dry cells.
    dry: Padded,
    /// The conductance factor between dry and boiling cells.
    boiling: Padded,
}

impl Default for ConductionBuffers {
    fn default() -> Self {
        let zeros = || Box::new([0.0; PADDED * PADDED * PADDED]);
        Self {
            next: Vec::new(),
            fronts: Vec::new(),
            held_cells: Vec::new(),
            excess: zeros(),
            conduction: zeros(),
            dry: zeros(),
            boiling: zeros(),
        }
    }
}

impl ThermalGrid {
    /// Conduction and perfusion for a stable step.
    pub(super) fn diffuse(&mut self, dt: f64, outputs: &mut LatticeOutputs<'_>) {
        let volume = self.cell_volume();
        let blood = dt * outputs.material.perfusion_loss();
        let holds = outputs.organ.held.contains(&true);
        let mut fronts = std::mem::take(&mut self.buffers.fronts);
        let mut used = 0;
        for index in 0..self.blocks.len() {
            if !self.blocks[index].is_active {
                continue;
            }
            if self.buffers.next.len() == used {
                self.buffers.next.push(Box::new([0.0; CELLS]));
            }
            let (is_rim, boils) = self.gather(index);
            self.find_held(index, outputs.organ, holds);
            let (block, next) = (&self.blocks[index], &mut self.buffers.next[used]);
            used += 1;
            let (excess, conduction) = (&self.buffers.excess, &self.buffers.conduction);
            let (dry, boiling) = (&self.buffers.dry, &self.buffers.boiling);
            let scale = dt / (self.spacing * self.spacing);
            let mut lost = 0.0;
            let is_whole = block.raster.cut.is_empty();
            for cell in 0..CELLS {
                // A block at a surface is partly empty, one of a membrane mostly.
                if !block.is_tissue(cell) {
                    next[cell] = 0.0;
                    continue;
                }
                let at = padded(cell);
                let (own, through) = (excess[at], conduction[at]);
                let flow = |beyond: usize| {
                    if !boils {
                        return through.min(conduction[beyond]) * (excess[beyond] - own);
                    }
                    let to_boiling = (dry[at] * boiling[beyond]).max(dry[beyond] * boiling[at]);
                    let between = if to_boiling > 0.0 { to_boiling } else { through.min(conduction[beyond]) };
                    between * (excess[beyond] - own)
                };
                let flows = if is_whole {
                    flow(at - 1)
                        + flow(at + 1)
                        + flow(at - PADDED)
                        + flow(at + PADDED)
                        + flow(at - PADDED * PADDED)
                        + flow(at + PADDED * PADDED)
                } else {
                    let ways = SIDES.into_iter().filter(|side| !block.is_cut_off(cell, *side));
                    ways.fold(0.0, |sum, side| sum + flow(beside(at, side)))
                };
                let share = block.share(cell);
                if boils && boiling[at] > 0.0 {
                    let ways = SIDES.into_iter().filter(|side| is_whole || !block.is_cut_off(cell, *side));
                    let from_dry = ways.map(|side| beside(at, side)).filter(|beyond| dry[*beyond] > 0.0);
                    let joules = scale * from_dry.map(flow).sum::<f64>().max(0.0) / share;
                    fronts.push((index, cell, joules / self.enthalpy.latent));
                }
                let capacity = self.enthalpy.capacity(block.water[cell]) * share;
                let mut gain = scale * flows;
                if block.flags[cell] & COAGULATED == 0 {
                    let carried = blood * share * own;
                    gain -= carried;
                    lost += carried;
                }
                next[cell] = own + gain / capacity;
            }
            outputs.ledger.perfusion += lost * volume;
            // What is held has its temperature at the end of the step, so that any step is stable.
            for HeldCell { cell, nearness, excess: held } in &self.buffers.held_cells {
                let (cell, water) = (*cell, block.water[*cell]);
                let conducts = if block.flags[cell] & BOILING != 0 { 0.0 } else { water };
                let capacity = self.enthalpy.capacity(water);
                let pull = scale * self.enthalpy.conductivity(conducts) * nearness / capacity;
                let before = next[cell];
                next[cell] = (before + pull * held) / (1.0 + pull);
                outputs.ledger.held -= capacity * block.share(cell) * volume * (next[cell] - before);
                if block.flags[cell] & BOILING != 0 && next[cell] > before {
                    fronts.push((index, cell, capacity * (next[cell] - before) / self.enthalpy.latent));
                }
            }
            // Heat that leaves the active blocks enters the mesh, in the cells beyond: in those that it has left, it would have
            // gone less far than it has.
            for (side, _) in SIDES.iter().zip(is_rim).filter(|(_, is_rim)| *is_rim) {
                let beyond = self.find(block.beyond(*side)).ok().map(|index| &self.blocks[index]);
                for (cell, halo, other) in side_cells(*side).filter(|at| !block.is_cut_off(at.0, *side)) {
                    let flow = conduction[padded(cell)].min(conduction[halo]) * excess[padded(cell)];
                    if flow != 0.0 {
                        let joules = scale * flow * volume;
                        let site = beyond.filter(|beyond| beyond.flags[other] & TISSUE != 0);
                        let site = site.map_or(block.site(cell), |beyond| beyond.site(other));
                        outputs.ledger.held += outputs.organ.deposit(site, joules);
                    }
                }
            }
        }
        for (index, cell, vaporises) in fronts.drain(..) {
            self.blocks[index].advance_front(cell, vaporises);
        }
        self.buffers.fronts = fronts;
        let active = self.blocks.iter_mut().filter(|block| block.is_active);
        for (block, next) in active.zip(&mut self.buffers.next) {
            std::mem::swap(&mut block.excess, next);
        }
    }

    /// Collects excess and conduction of a block and its halo; returns which sides have no active neighbour, and whether
    /// a cell boils or is dry: only then is there more than conduction.
    fn gather(&mut self, index: usize) -> ([bool; 6], bool) {
        let block = &self.blocks[index];
        let around = SIDES.map(|side| self.find(block.beyond(side)).ok());
        let through = |block: &Block, cell: usize| {
            if block.is_tissue(cell) {
                self.enthalpy.conductivity(block.water[cell]) * block.share(cell)
            } else {
                0.0
            }
        };
        // Dry: its conduction; boiling: the conductance factor.
        let kind = |block: &Block, cell: usize, through: f64| {
            if block.water[cell] == 0.0 {
                (through, 0.0)
            } else if block.flags[cell] & BOILING != 0 {
                (0.0, boiling_nearer(block.ahead_of_front(cell)) * block.share(cell))
            } else {
                (0.0, 0.0)
            }
        };
        let (excess, conduction) = (&mut self.buffers.excess, &mut self.buffers.conduction);
        let (dry, boiling) = (&mut self.buffers.dry, &mut self.buffers.boiling);
        for cell in 0..CELLS {
            let at = padded(cell);
            excess[at] = block.excess[cell];
            conduction[at] = through(block, cell);
        }
        let is_special = |block: &Block| {
            block.water.contains(&0.0) || block.flags.iter().any(|flags| flags & BOILING != 0)
        };
        let mut boils = is_special(block);
        let is_rim = std::array::from_fn(|side| {
            let beyond = around[side].map(|at| &self.blocks[at]);
            let is_special = beyond.is_some_and(|beyond| beyond.is_active && is_special(beyond));
            boils |= is_special;
            let side = SIDES[side];
            for (_, halo, other) in side_cells(side) {
                (excess[halo], conduction[halo]) = match beyond {
                    Some(beyond) => (beyond.excess[other], through(beyond, other)),
                    None => (0.0, f64::from(block.raster.share[halo]) * self.enthalpy.conductivity(1.0)),
                };
                // At the rim, heat passes to the mesh by conduction alone.
                (dry[halo], boiling[halo]) = match beyond {
                    Some(beyond) if is_special => kind(beyond, other, conduction[halo]),
                    _ => (0.0, 0.0),
                };
            }
            beyond.is_none_or(|beyond| !beyond.is_active)
        });
        if boils {
            for cell in 0..CELLS {
                let at = padded(cell);
                (dry[at], boiling[at]) = kind(block, cell, conduction[at]);
            }
        }
        (is_rim, boils)
    }

    /// Whether a plane passes a block, or along its side.
    pub(super) fn touches(&self, index: usize, HeldPlane { axis, at, .. }: &HeldPlane) -> bool {
        let from = at / (EDGE as f64 * self.spacing) - f64::from(self.blocks[index].key[*axis]);
        (-ON_FACE..1.0 + ON_FACE).contains(&from)
    }

    /// Finds the cells of a block that are next to what is held: to a plane, or to the part of the mesh between vertices
    /// that are held.
    fn find_held(&mut self, index: usize, organ: &OrganHeat, holds: bool) {
        let mut found = std::mem::take(&mut self.buffers.held_cells);
        found.clear();
        let block = &self.blocks[index];
        for plane in self.planes.iter().filter(|plane| self.touches(index, plane)) {
            let HeldPlane { axis, at, celsius } = plane;
            for cell in (0..CELLS).filter(|cell| block.is_tissue(*cell)) {
                let distance = (self.centre(block, cell)[*axis] - at).abs() / self.spacing;
                if distance < 0.5 + ON_FACE {
                    let below = block.site(cell).interpolate(&organ.celsius);
                    // Of a boiling cell the part next to the plane has dried.
                    let boils = block.flags[cell] & BOILING != 0;
                    let distance = if boils { 1.0 - block.ahead_of_front(cell) } else { distance };
                    let nearness = 1.0 / distance.max(ON_FACE);
                    found.push(HeldCell { cell, nearness, excess: celsius - below });
                }
            }
        }
        if holds {
            let share = |cell: usize| block.site(cell).share_of(&organ.held);
            for cell in (0..CELLS).filter(|cell| block.is_tissue(*cell)) {
                let own = share(cell);
                if own == 0.0 {
                    continue;
                }
                // The part is where the share is 1: as far as its slope says.
                let at = xyz(cell);
                let mut slope: f64 = 0.0;
                for (axis, way) in SIDES {
                    let mut near = at.map(|x| x as i32);
                    near[axis] += way;
                    if (0..EDGE as i32).contains(&near[axis]) {
                        let [x, y, z] = near.map(|x| x as usize);
                        let near = x + EDGE * (y + EDGE * z);
                        if block.is_tissue(near) {
                            slope = slope.max((share(near) - own).abs());
                        }
                    }
                }
                if 1.0 - own < slope * (1.0 - ON_FACE) || own > 1.0 - 1e-9 {
                    let distance = if slope > 0.0 { (1.0 - own) / slope } else { 0.0 };
                    found.push(HeldCell { cell, nearness: 1.0 / distance.max(ON_FACE), excess: 0.0 });
                }
            }
        }
        self.buffers.held_cells = found;
    }
}

#[cfg(test)]
mod tests {
    use super::super::energy_balance::HeatReport;
    use super::super::material::ThermalMaterial;
    use super::super::testing::bar;
    use super::super::{BODY, Electrosurgery, LatticeConfig, Tissue};
    use super::*;

    /// A block of tissue completely on the lattice, warmer than the body by `excess` at each cell's centre \[K\].
    fn warmed(
        cells: [u32; 3],
        mesh: f64,
        spacing: f64,
        material: ThermalMaterial,
        excess: impl Fn([f64; 3]) -> f64,
    ) -> Electrosurgery {
        let (positions, tets) = bar(cells, mesh);
        let tissue = Tissue::Volume { positions: &positions, tets: &tets };
        let lattice = LatticeConfig { spacing, ..LatticeConfig::default() };
        let mut heat = Electrosurgery::new(&tissue, material, lattice).expect("tissue");
        let blocks = cells.map(|count| (f64::from(count) * mesh / spacing / EDGE as f64).ceil() as i32);
        let mut report = HeatReport::default();
        for key in (0..blocks.iter().product::<i32>())
            .map(|at| [at % blocks[0], at / blocks[0] % blocks[1], at / (blocks[0] * blocks[1])])
        {
            assert!(heat.grid.activate(key, &mut report), "tissue in block {key:?}");
        }
        for index in 0..heat.grid.blocks.len() {
            for cell in 0..CELLS {
                let middle = heat.grid.centre(&heat.grid.blocks[index], cell);
                let block = &mut heat.grid.blocks[index];
                if block.is_tissue(cell) {
                    block.excess[cell] = excess([middle.x, middle.y, middle.z]);
                }
            }
        }
        heat
    }

    /// Mean excess of the cells that touch a point \[K\].
    fn excess_at(heat: &Electrosurgery, place: [f64; 3]) -> f64 {
        let reach = heat.grid.spacing * 0.51;
        let near = heat
            .cells()
            .filter(|cell| (0..3).all(|axis| (cell.middle_in_rest[axis] - place[axis]).abs() <= reach));
        let (sum, count) =
            near.fold((0.0, 0.0), |(sum, count), cell| (sum + cell.celsius - BODY, count + 1.0));
        sum / count
    }

    /// A half space at 100 °C next to one at 37 °C: their interface stays at the mean, so that each half follows the
    /// error function of a half space with a fixed surface temperature, with half of the reference's rise.
    #[test]
    fn beyond_a_seam_at_a_constant_temperature_the_lattice_warms_as_the_error_function() {
        let bloodless = ThermalMaterial { perfusion: 0.0, ..ThermalMaterial::default() };
        for (depth, seconds, expected, spacing, half) in [
            (1e-3, 1.0, 40.4845, 0.125e-3, 8),
            (2e-3, 5.0, 42.4499, 0.25e-3, 8),
            (5e-3, 30.0, 42.0533, 0.5e-3, 16),
        ] {
            let seam = f64::from(half) * 1e-3;
            let warm = |[x, _, _]: [f64; 3]| if x < seam { 100.0 - BODY } else { 0.0 };
            let mut heat = warmed([2 * half, 1, 1], 1e-3, spacing, bloodless, warm);
            for _ in 0..(seconds / 0.02_f64).round() as u32 {
                heat.step(0.02, &[]).expect("a step");
            }
            let (rise, wanted) = (excess_at(&heat, [seam + depth, 0.5e-3, 0.5e-3]), (expected - BODY) / 2.0);
            // An almost cooled block passes its heat to the mesh, which is coarser.
            assert!(
                (rise / wanted - 1.0).abs() < 0.05,
                "{depth} m after {seconds} s: {rise} K, not {wanted} K"
            );
        }
    }

    /// A warm spot in perfused tissue: a Gaussian stays one, its variance grows by 2αt, and perfusion removes heat by
    /// Pennes' equation. At half the spacing, less than half of the error at the peak.
    #[test]
    fn a_warm_spot_spreads_and_is_cooled_by_blood_as_pennes_has_it() {
        let material = ThermalMaterial::default();
        let (variance, middle, seconds) = (1.44e-6, 6e-3, 4.0);
        let capacity = material.wet_capacity();
        let grown = variance + 2.0 * material.conductivity / capacity * seconds;
        let kept = (-material.perfusion_loss() / capacity * seconds).exp();
        let errors = [0.5e-3, 0.25e-3].map(|spacing| {
            let from =
                |[x, y, z]: [f64; 3]| (x - middle).powi(2) + (y - middle).powi(2) + (z - middle).powi(2);
            let warm = |at| 6.0 * (-from(at) / (2.0 * variance)).exp();
            let mut heat = warmed([6; 3], 2e-3, spacing, material, warm);
            for _ in 0..(seconds / 0.02) as u32 {
                heat.step(0.02, &[]).expect("a step");
            }
            // On the lines between cells, where four or eight of them meet.
            [0.0, 1e-3, 2e-3].map(|away| {
                let wanted = 6.0 * (variance / grown).powf(1.5) * kept * (-away * away / (2.0 * grown)).exp();
                excess_at(&heat, [middle + away, middle, middle]) / wanted - 1.0
            })
        });
        for (coarse, fine) in errors[0].iter().zip(errors[1]) {
            assert!(coarse.abs() < 0.03 && fine.abs() < 0.03, "{errors:?}");
        }
        assert!(errors[1][0].abs() < 0.5 * errors[0][0].abs(), "{errors:?}");
    }
}
