//! Fine lattice for heat near the electrode: blocks of 8 × 8 × 8 cells, activated where the tip or the heat arrives,
//! and deactivated once it has dissipated.
//!
//! A cell stores its temperature excess above the mesh there. Conduction is linear in the temperature, so that the two
//! fields evolve separately and their sum obeys the heat equation; fields that vary within an element need no refined
//! mesh, and no continuity has to be enforced between lattice and mesh. Heat passes from the lattice to the mesh when a
//! cooled block is deactivated, and at the rim of the active blocks.

use super::bioheat_fem::OrganHeat;
use super::damage::{CellEvent, ElementBurns, cell_number};
use super::energy_balance::{HeatLedger, HeatReport};
use super::enthalpy::Enthalpy;
use super::lattice_block::{BOILING, BURST, Block, CELLS, CHARRED, COAGULATED, REMOVED, SIDES, side_cells};
use super::lattice_conduction::{ConductionBuffers, HeldPlane};
use super::material::ThermalMaterial;
use super::voxelisation::{CellLocation, TissueLattice};

/// Excess at a side that activates the neighbouring block \[K\].
const ARRIVES: f64 = 1.0;
/// Largest excess at which a block is deactivated \[K\].
const LEAVES: f64 = 0.5;
/// Maximum number of blocks remembered as empty.
const EMPTY_MAX: usize = 16_384;
/// Fraction of the stable step that is used.
const SAFETY: f64 = 0.9;
/// A cell that has lost water boils within this margin below the boiling point \[K\].
const BOILS: f64 = 1.0;
/// Excess at a side from which the cells beyond are known \[K\].
const KNOWS: f64 = 1e-3;

/// Blocks used so far, sorted by key.
#[derive(Clone, Debug)]
pub(super) struct ThermalGrid {
    pub spacing: f64,
    pub blocks: Vec<Block>,
    blocks_max: usize,
    pub enthalpy: Enthalpy,
    lattice: TissueLattice,
    /// Requested blocks without tissue, sorted: rasterising them again would be slow.
    empty: Vec<[i32; 3]>,
    /// Planes held at a temperature.
    pub planes: Vec<HeldPlane>,
    pub(super) buffers: ConductionBuffers,
    wanted: Vec<[i32; 3]>,
    kept: Vec<[i32; 3]>,
}

/// Outputs of a step on the lattice.
pub(super) struct LatticeOutputs<'a> {
    pub material: &'a ThermalMaterial,
    pub organ: &'a mut OrganHeat,
    pub burns: &'a mut ElementBurns,
    pub ledger: &'a mut HeatLedger,
    pub report: &'a mut HeatReport,
    /// Whether drying cells burst and are removed.
    pub bursts: bool,
    /// Where tissue was last removed \[cells\], as the origin of smoke: a sum weighted by volume.
    pub plume: &'a mut nalgebra::Vector4<f64>,
}

impl ThermalGrid {
    pub(super) fn new(
        lattice: TissueLattice,
        spacing: f64,
        blocks_max: usize,
        material: &ThermalMaterial,
    ) -> Self {
        Self {
            spacing,
            blocks: Vec::new(),
            blocks_max,
            enthalpy: Enthalpy::new(material),
            lattice,
            empty: Vec::new(),
            planes: Vec::new(),
            buffers: ConductionBuffers::default(),
            wanted: Vec::new(),
            kept: Vec::new(),
        }
    }

    pub(super) fn find(&self, key: [i32; 3]) -> Result<usize, usize> {
        self.blocks.binary_search_by_key(&key, |block| block.key)
    }

    /// Volume of a full cell \[m³\].
    pub(super) fn cell_volume(&self) -> f64 {
        self.spacing.powi(3)
    }

    /// Longest step for which diffusion on the lattice is stable \[s\].
    pub(super) fn step_max(&self) -> f64 {
        let diffusivity = self.enthalpy.diffusivity_max();
        if diffusivity > 0.0 { SAFETY * self.spacing.powi(2) / (6.0 * diffusivity) } else { f64::INFINITY }
    }

    /// Excess heat in the cells, relative to the mesh \[J\].
    pub(super) fn stored(&self) -> f64 {
        let of = |block: &Block| {
            let cells = (0..CELLS).filter(|cell| block.is_tissue(*cell));
            let heat = cells.map(|cell| {
                self.enthalpy.capacity(block.water[cell]) * block.share(cell) * block.excess[cell]
            });
            heat.sum::<f64>() * self.cell_volume()
        };
        self.blocks.iter().filter(|block| block.is_active).map(of).sum()
    }

    /// Activates a block. Returns whether there is tissue, and room for it.
    pub(super) fn activate(&mut self, key: [i32; 3], report: &mut HeatReport) -> bool {
        if let Ok(at) = self.find(key) {
            self.blocks[at].is_active = true;
            return true;
        }
        let Err(unasked) = self.empty.binary_search(&key) else { return false };
        let Some(raster) = self.lattice.raster(key) else {
            if self.empty.len() < EMPTY_MAX {
                self.empty.insert(unasked, key);
            }
            return false;
        };
        if self.blocks.len() >= self.blocks_max {
            // An unchanged block need not be stored.
            let Some(pristine) = self.blocks.iter().position(Block::is_pristine) else {
                report.refused_blocks += 1;
                return false;
            };
            self.blocks.remove(pristine);
        }
        let (Ok(at) | Err(at)) = self.find(key);
        self.blocks.insert(at, Block { is_active: true, ..Block::new(key, raster) });
        true
    }

    /// Adds a saved block at the end of the list; `None` without tissue at its place.
    pub(super) fn remember(&mut self, key: [i32; 3]) -> Option<&mut Block> {
        let raster = self.lattice.raster(key)?;
        self.blocks.push(Block::new(key, raster));
        self.blocks.last_mut()
    }

    /// Updates to a cut: cells have other locations in the mesh, and some are separated from their neighbours. They
    /// keep their tissue, and their element of the original mesh.
    pub(super) fn part(&mut self, lattice: TissueLattice) {
        self.lattice = lattice;
        for block in &mut self.blocks {
            let Some(raster) = self.lattice.raster(block.key) else { continue };
            for (site, now) in block.raster.sites.iter_mut().zip(raster.sites.iter()) {
                if now.nodes != [0; 4] {
                    *site = CellLocation {
                        element: site.element,
                        other: site.other,
                        others: site.others,
                        ..*now
                    };
                }
            }
            block.raster.cut = raster.cut;
        }
    }

    /// Boiling, damage and removal after conduction for `dt`; activates and deactivates blocks.
    pub(super) fn settle(&mut self, dt: f64, outputs: &mut LatticeOutputs<'_>) {
        for index in 0..self.blocks.len() {
            if !self.blocks[index].is_active {
                continue;
            }
            let mut peak: f64 = 0.0;
            for cell in 0..CELLS {
                if !self.blocks[index].is_tissue(cell) {
                    continue;
                }
                let celsius = self.settle_cell(index, cell, outputs);
                let block = &mut self.blocks[index];
                let has_boiled = block.water[cell] > 0.0 && block.water[cell] < 1.0;
                let boils = has_boiled && celsius > self.enthalpy.boiling - BOILS;
                block.flags[cell] = (block.flags[cell] & !BOILING) | if boils { BOILING } else { 0 };
                outputs.report.hottest = outputs.report.hottest.max(celsius);
                if celsius >= outputs.material.damage.threshold && block.is_tissue(cell) {
                    block.damage[cell] += dt * outputs.material.damage.rate(celsius);
                    if block.damage[cell] >= super::arrhenius::COAGULATED {
                        self.coagulate(index, cell, outputs);
                    }
                }
                peak = peak.max(self.blocks[index].excess[cell].abs());
            }
            // What is held stays on the lattice.
            if self.planes.iter().any(|plane| self.touches(index, plane)) {
                peak = peak.max(ARRIVES);
            }
            self.blocks[index].peak = peak;
        }
        self.spread(outputs);
        self.know_beyond(outputs.report);
    }

    /// Makes known, but not active, the blocks that heat is about to enter, so that it enters the mesh where it is.
    fn know_beyond(&mut self, report: &mut HeatReport) {
        let mut wanted = std::mem::take(&mut self.wanted);
        wanted.clear();
        for block in self.blocks.iter().filter(|block| block.is_active && block.peak > KNOWS) {
            for side in SIDES.into_iter().filter(|side| self.find(block.beyond(*side)).is_err()) {
                let is_near = |(cell, halo, _): (usize, usize, usize)| {
                    block.excess[cell].abs() > KNOWS && block.raster.share[halo] > 0.0
                };
                if side_cells(side).any(is_near) {
                    wanted.push(block.beyond(side));
                }
            }
        }
        for key in &wanted {
            if self.find(*key).is_err()
                && self.blocks.len() < self.blocks_max
                && self.activate(*key, report)
                && let Ok(at) = self.find(*key)
            {
                self.blocks[at].is_active = false;
            }
        }
        self.wanted = wanted;
    }

    /// Boils excess heat in a cell and removes it where due; returns its temperature \[°C\].
    pub(super) fn settle_cell(&mut self, index: usize, cell: usize, outputs: &mut LatticeOutputs<'_>) -> f64 {
        let volume = self.cell_volume();
        let block = &mut self.blocks[index];
        let below = block.site(cell).interpolate(&outputs.organ.celsius);
        let mut celsius = below + block.excess[cell];
        if celsius <= self.enthalpy.boiling {
            return celsius;
        }
        let volume = volume * block.share(cell);
        if block.water[cell] > 0.0 {
            let (boiled, after) = self.enthalpy.boil(celsius, block.water[cell]);
            block.water[cell] = (block.water[cell] - boiled.water).max(0.0);
            celsius = after;
            block.excess[cell] = celsius - below;
            outputs.ledger.latent += boiled.latent * volume;
            let with_mesh = outputs.organ.shrink(block.site(cell), boiled.capacity * volume);
            outputs.ledger.steam += boiled.capacity * volume * (self.enthalpy.boiling - below) + with_mesh;
            outputs.report.steam_rate +=
                boiled.water * outputs.material.water * outputs.material.density * volume;
        }
        let is_dry = block.water[cell] == 0.0;
        if is_dry && celsius >= outputs.material.charring && block.flags[cell] & CHARRED == 0 {
            block.flags[cell] |= CHARRED;
            let number = cell_number(block.key, cell);
            outputs.burns.book(number, block.site(cell), volume, CellEvent::Charred);
        }
        if is_dry && (outputs.bursts || celsius >= outputs.material.ablation) {
            self.remove(index, cell, outputs);
        }
        celsius
    }

    fn coagulate(&mut self, index: usize, cell: usize, outputs: &mut LatticeOutputs<'_>) {
        let cell_volume = self.cell_volume();
        let block = &mut self.blocks[index];
        if block.flags[cell] & COAGULATED != 0 {
            return;
        }
        block.flags[cell] |= COAGULATED;
        let volume = cell_volume * block.share(cell);
        let site = block.site(cell);
        outputs.organ.stop_perfusion(site, volume * outputs.material.perfusion_loss());
        outputs.burns.book(cell_number(block.key, cell), site, volume, CellEvent::Coagulated);
    }

    fn remove(&mut self, index: usize, cell: usize, outputs: &mut LatticeOutputs<'_>) {
        let cell_volume = self.cell_volume();
        let block = &mut self.blocks[index];
        let volume = cell_volume * block.share(cell);
        let capacity = self.enthalpy.capacity(block.water[cell]) * volume;
        let (was_coagulated, was_charred) =
            (block.flags[cell] & COAGULATED != 0, block.flags[cell] & CHARRED != 0);
        let site = *block.site(cell);
        if !was_coagulated {
            outputs.organ.stop_perfusion(&site, volume * outputs.material.perfusion_loss());
        }
        outputs.ledger.removed += capacity * block.excess[cell] + outputs.organ.shrink(&site, capacity);
        block.excess[cell] = 0.0;
        block.flags[cell] |= REMOVED | if outputs.bursts { BURST } else { 0 };
        // Vaporised tissue is always coagulated.
        block.damage[cell] = block.damage[cell].max(super::arrhenius::COAGULATED);
        let number = cell_number(block.key, cell);
        outputs.burns.book(number, &site, volume, CellEvent::Removed { was_coagulated, was_charred });
        let dry = outputs.material.density * (1.0 - outputs.material.water) * volume;
        outputs.report.smoke_rate += dry * outputs.material.smoke;
        outputs.report.removed_cells += 1;
        outputs.report.removed_volume += volume;
        let [x, y, z] = number.map(|index| (f64::from(index) + 0.5) * self.spacing * volume);
        *outputs.plume += nalgebra::Vector4::new(x, y, z, volume);
    }

    /// Activates blocks that heat reaches and deactivates those that have cooled.
    fn spread(&mut self, outputs: &mut LatticeOutputs<'_>) {
        let (mut wanted, mut kept) = (std::mem::take(&mut self.wanted), std::mem::take(&mut self.kept));
        wanted.clear();
        kept.clear();
        for block in self.blocks.iter().filter(|block| block.is_active && block.peak > LEAVES) {
            for side in SIDES {
                let through = side_cells(side).filter(|(cell, halo, _)| {
                    block.raster.share[*halo] > 0.0 && !block.is_cut_off(*cell, side)
                });
                let most = through.map(|(cell, _, _)| block.excess[cell].abs()).fold(0.0, f64::max);
                if most > ARRIVES {
                    wanted.push(block.beyond(side));
                }
                if most > LEAVES {
                    kept.push(block.beyond(side));
                }
            }
        }
        for key in &wanted {
            if !self.find(*key).is_ok_and(|at| self.blocks[at].is_active) {
                self.activate(*key, outputs.report);
            }
        }
        kept.sort_unstable();
        let volume = self.cell_volume();
        let spacing = self.spacing;
        for block in self.blocks.iter_mut().filter(|block| block.is_active && block.peak < LEAVES) {
            // Heat is about to reach some of them.
            if kept.binary_search(&block.key).is_ok() {
                continue;
            }
            for cell in 0..CELLS {
                if block.is_tissue(cell) && block.excess[cell] != 0.0 {
                    let capacity = self.enthalpy.capacity(block.water[cell]) * block.share(cell) * volume;
                    let joules = capacity * block.excess[cell];
                    outputs.ledger.held +=
                        outputs.organ.deposit_later(block.site(cell), &block.middle(cell, spacing), joules);
                }
                block.excess[cell] = 0.0;
            }
            (block.is_active, block.peak) = (false, 0.0);
        }
        outputs.organ.take_deposits();
        (self.wanted, self.kept) = (wanted, kept);
    }
}
