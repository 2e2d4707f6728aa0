//! Electrosurgery: an electrode heats tissue, which dries, coagulates, chars and vaporises.
//!
//! | Concept | File |
//! |---|---|
//! | Voxelisation of the tissue at rest | `voxelisation.rs` |
//! | Thermal material | `material.rs` |
//! | Boiling: the enthalpy method | `enthalpy.rs` |
//! | Thermal damage | `arrhenius.rs` |
//! | Electrode, its contact with tissue, heat deposition | `electrode.rs`, `electrode_contact.rs`, `heat_source.rs` |
//! | Fine lattice near the tip | `enthalpy_lattice.rs`, `lattice_block.rs`, `lattice_conduction.rs` |
//! | Bioheat equation on the organ's mesh | `bioheat_fem.rs` |
//! | Damage of the elements | `damage.rs` |
//! | Cuts as barriers to heat | `cut_barrier.rs` |
//! | Energy balance | `energy_balance.rs` |

pub mod arrhenius;
pub(crate) mod bioheat_fem;
pub(crate) mod cut_barrier;
pub(crate) mod damage;
mod electrode;
pub(crate) mod electrode_contact;
pub(crate) mod energy_balance;
mod enthalpy;
pub(crate) mod enthalpy_lattice;
mod error;
pub(crate) mod heat_source;
pub(crate) mod lattice_block;
mod lattice_conduction;
mod lattice_geometry;
mod material;
mod state;
#[cfg(test)]
pub(crate) mod testing;
pub(crate) mod voxelisation;

use nalgebra::{Point3, Vector4};

pub use arrhenius::Arrhenius;
pub use cut_barrier::CutTissue;
pub use electrode::{Electrode, Mode};
pub use electrode_contact::{Contact, shares};
pub use energy_balance::{HeatLedger, HeatReport};
pub use error::{ElectrosurgeryError, HeatStepError};
pub use lattice_conduction::HeldPlane;
pub use material::{BODY, ThermalMaterial};
pub use state::{BlockState, ElectrosurgeryState};
pub use voxelisation::Tissue;

use bioheat_fem::OrganHeat;
use cut_barrier::OriginalBoundary;
use damage::ElementBurns;
use enthalpy_lattice::{LatticeOutputs, ThermalGrid};
use heat_source::HeatedCells;
use lattice_block::{Block, CELLS, CHARRED};
use voxelisation::TissueLattice;

/// Maximum number of active electrodes.
const ELECTRODES_MAX: usize = 16;

/// Longest time of heating before conduction is computed \[s\].
const TURN: f64 = 0.01;

/// Lattice settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatticeConfig {
    /// Edge of a cell \[m\]: 0.5 mm or less resolves the tip's field.
    pub spacing: f64,
    /// Maximum number of stored blocks of 8 × 8 × 8 cells, 36 kB each.
    pub blocks_max: usize,
}

impl Default for LatticeConfig {
    fn default() -> Self {
        Self { spacing: 0.5e-3, blocks_max: 1024 }
    }
}

/// Effect of heat on an element, for a mechanical solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ElementFactors {
    /// Stiffness factor.
    pub stiffness: f64,
    /// Rest length factor.
    pub length: f64,
    /// Charred fraction.
    pub charred: f64,
    /// Whether it was removed.
    pub is_removed: bool,
}

/// A lattice cell in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeatCell {
    /// Its centre, in the tissue's rest frame \[m\].
    pub middle_in_rest: Point3<f64>,
    /// Its original tissue volume \[m³\].
    pub volume: f64,
    /// Temperature \[°C\].
    pub celsius: f64,
    /// Ω; 1 means coagulated.
    pub damage: f64,
    /// Remaining water fraction.
    pub water: f64,
    /// Whether it is charred.
    pub is_charred: bool,
    /// Whether it was removed.
    pub is_removed: bool,
    /// Its tetrahedron or triangle.
    pub element: u32,
}

/// Tissue under electrodes.
#[derive(Clone, Debug)]
pub struct Electrosurgery {
    material: ThermalMaterial,
    positions: Vec<Point3<f64>>,
    /// Corners and conduction of each element of the present mesh, to remove them.
    elements: Vec<([u32; 4], [[f64; 4]; 4])>,
    /// Original elements with the present elements that are parts of them, sorted.
    parts: Vec<(u32, u32)>,
    /// Boundary of the original mesh.
    rim: OriginalBoundary,
    corners: usize,
    organ: OrganHeat,
    organ_damage: Vec<f64>,
    grid: ThermalGrid,
    burns: ElementBurns,
    ledger: HeatLedger,
    source: HeatedCells,
    plume_in_rest: Option<Point3<f64>>,
}

impl Electrosurgery {
    /// Tissue at body temperature.
    ///
    /// # Errors
    /// A parameter out of range; all invalid vertices or elements of the mesh.
    pub fn new(
        tissue: &Tissue<'_>,
        material: ThermalMaterial,
        lattice: LatticeConfig,
    ) -> Result<Self, ElectrosurgeryError> {
        material.check()?;
        error::parameter("spacing", lattice.spacing, 1e-5..=1e-2, "1e-5 to 0.01 m")?;
        error::parameter("blocks_max", lattice.blocks_max as f64, 1.0..=65_536.0, "1 to 65536")?;
        tissue.check()?;
        let elements: Vec<_> = (0..tissue.element_count())
            .map(|element| {
                let mut corners = [0; 4];
                let found = tissue.corners(element);
                corners[..found.len()].copy_from_slice(found);
                (corners, bioheat_fem::element_conduction(tissue, element, material.conductivity))
            })
            .collect();
        let cells = TissueLattice::new(tissue, lattice.spacing)?;
        Ok(Self {
            material,
            positions: tissue.positions().to_vec(),
            parts: (0..elements.len() as u32).map(|element| (element, element)).collect(),
            rim: OriginalBoundary::of(tissue),
            elements,
            corners: tissue.corners(0).len(),
            organ: OrganHeat::new(tissue, &material),
            organ_damage: vec![0.0; tissue.positions().len()],
            grid: ThermalGrid::new(cells, lattice.spacing, lattice.blocks_max, &material),
            burns: ElementBurns::new(tissue, lattice.spacing)?,
            ledger: HeatLedger::default(),
            source: HeatedCells::default(),
            plume_in_rest: None,
        })
    }

    /// Heats, conducts, boils and removes for `dt` \[s\], 1 µs to 1 s. Electrode positions are in the tissue's rest
    /// frame: deforming tissue carries its heat along.
    ///
    /// # Errors
    /// An input out of range, or a source too strong for so long a step; temperatures, damage and ledger are unchanged.
    pub fn step(&mut self, dt: f64, electrodes: &[Electrode]) -> Result<HeatReport, HeatStepError> {
        error::input("dt", dt, 1e-6..=1.0, "1e-6 to 1 s")?;
        if electrodes.len() > ELECTRODES_MAX {
            return Err(HeatStepError::Electrodes(electrodes.len()));
        }
        electrodes.iter().try_for_each(Electrode::check)?;
        let mut report = HeatReport { gap: f64::INFINITY, ..HeatReport::default() };
        let mut plume = Vector4::zeros();
        self.burns.gone.clear();
        let mut outputs = LatticeOutputs {
            material: &self.material,
            organ: &mut self.organ,
            burns: &mut self.burns,
            ledger: &mut self.ledger,
            report: &mut report,
            bursts: false,
            plume: &mut plume,
        };
        let active = || electrodes.iter().filter(|electrode| electrode.power > 0.0);
        // All that can fail comes first.
        for electrode in active() {
            let gap = self.source.prepare(&mut self.grid, electrode, dt, &mut outputs)?;
            outputs.report.gap = outputs.report.gap.min(gap);
            outputs.report.contact_area += self.source.area;
        }
        let organ = outputs.organ.step(dt)?;
        outputs.ledger.perfusion += organ.perfusion;
        outputs.ledger.held += organ.held;
        // Heating and conduction alternate, so that no long step accumulates heat at the tip.
        let longest = if active().next().is_some() { TURN } else { f64::INFINITY };
        let parts = (dt / self.grid.step_max().min(longest)).ceil().max(1.0);
        for _ in 0..parts as u32 {
            for electrode in active() {
                self.source.gather(&mut self.grid, electrode, outputs.report);
                outputs.bursts = electrode.mode == Mode::Cut;
                let joules = self.source.heat(&mut self.grid, electrode, dt / parts, &mut outputs);
                outputs.report.absorbed += joules / dt;
            }
            outputs.bursts = active().any(|electrode| electrode.mode == Mode::Cut);
            self.grid.diffuse(dt / parts, &mut outputs);
            self.grid.settle(dt / parts, &mut outputs);
        }
        outputs.burns.settle();
        for (damage, celsius) in self.organ_damage.iter_mut().zip(&self.organ.celsius) {
            *damage += dt * self.material.damage.rate(*celsius);
        }
        for index in 0..self.burns.gone.len() {
            self.disconnect(self.burns.gone[index]);
        }
        report.steam_rate /= dt;
        report.smoke_rate /= dt;
        report.active_blocks = self.grid.blocks.iter().filter(|block| block.is_active).count() as u32;
        self.plume_in_rest = (plume.w > 0.0).then(|| Point3::from(plume.xyz() / plume.w));
        Ok(report)
    }

    /// Contact of an electrode with this tissue, for [`shares`]; none for an invalid electrode.
    pub fn contact(&mut self, electrode: &Electrode) -> Contact {
        if electrode.check().is_err() {
            return Contact::NONE;
        }
        self.source.contact(&mut self.grid, electrode, &mut HeatReport::default())
    }

    /// Elements (tetrahedra or triangles) removed in the last step, in order of removal.
    #[must_use]
    pub fn removed_in_step(&self) -> &[u32] {
        &self.burns.gone
    }

    /// Where tissue was removed in the last step, in its rest frame \[m\]: the origin of smoke.
    #[must_use]
    pub fn plume_in_rest(&self) -> Option<Point3<f64>> {
        self.plume_in_rest
    }

    /// Whether each element was removed.
    #[must_use]
    pub fn removed(&self) -> &[bool] {
        &self.burns.is_removed
    }

    /// Effect of heat on an element; neutral for one that does not exist.
    #[must_use]
    pub fn factors(&self, element: u32) -> ElementFactors {
        let element = element as usize;
        if element >= self.burns.is_removed.len() {
            return ElementFactors { stiffness: 1.0, length: 1.0, charred: 0.0, is_removed: false };
        }
        let (coagulated, charred) = self.burns.shares(element);
        ElementFactors {
            stiffness: 1.0 + (self.material.coagulated_stiffness - 1.0) * coagulated,
            length: 1.0 - self.material.coagulated_shrinkage * coagulated,
            charred,
            is_removed: self.burns.is_removed[element],
        }
    }

    /// Temperature \[°C\] and Ω of a vertex: from its lattice cell where one is in use, else from the mesh.
    #[must_use]
    pub fn vertex(&self, vertex: u32) -> Option<(f64, f64)> {
        let at = vertex as usize;
        let (celsius, damage) = (*self.organ.celsius.get(at)?, self.organ_damage[at]);
        if self.organ.held[at] {
            return Some((celsius, damage));
        }
        Some(match self.grid.cell_near(&self.positions[at], vertex) {
            Some((block, cell)) => {
                let block = &self.grid.blocks[block];
                (celsius + block.excess[cell], damage.max(block.damage[cell]))
            }
            None => (celsius, damage),
        })
    }

    /// Whether a vertex lies in charred tissue.
    #[must_use]
    pub fn is_charred(&self, vertex: u32) -> bool {
        let place = self.positions.get(vertex as usize);
        place.and_then(|place| self.grid.cell_near(place, vertex)).is_some_and(|(block, cell)| {
            let block = &self.grid.blocks[block];
            block.flags[cell] & CHARRED != 0 && block.is_tissue(cell)
        })
    }

    /// Remaining charred cells, and their exposed area \[m²\].
    #[must_use]
    pub fn char(&self) -> (usize, f64) {
        let charred = |block: &Block, cell: usize| block.flags[cell] & CHARRED != 0 && block.is_tissue(cell);
        let all = self.grid.blocks.iter().flat_map(|block| (0..CELLS).map(move |cell| (block, cell)));
        let (mut cells, mut sides) = (0, 0.0);
        for (block, cell) in all.filter(|(block, cell)| charred(block, *cell)) {
            cells += 1;
            sides += f64::from(self.grid.bare_sides(block, cell));
        }
        (cells, sides * self.grid.spacing.powi(2))
    }

    /// Number of vertices, including those added by cuts.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.positions.len()
    }

    /// The lattice cells in use, including removed ones.
    pub fn cells(&self) -> impl Iterator<Item = HeatCell> + '_ {
        self.grid.blocks.iter().flat_map(move |block| {
            (0..CELLS).filter(|cell| block.flags[*cell] & lattice_block::TISSUE != 0).map(move |cell| {
                HeatCell {
                    middle_in_rest: self.grid.centre(block, cell),
                    volume: self.grid.cell_volume() * block.share(cell),
                    celsius: self.grid.celsius(block, cell, &self.organ),
                    damage: block.damage[cell],
                    water: block.water[cell],
                    is_charred: block.flags[cell] & CHARRED != 0,
                    is_removed: !block.is_tissue(cell),
                    element: block.site(cell).element,
                }
            })
        })
    }

    /// Temperatures of the lattice cells above the mesh \[K\], in the order of [`Self::cells`]: their heat is their own, that
    /// of the mesh is at its vertices.
    pub fn cell_excess(&self) -> impl Iterator<Item = f64> + '_ {
        self.grid.blocks.iter().flat_map(|block| {
            (0..CELLS)
                .filter(|cell| block.flags[*cell] & lattice_block::TISSUE != 0)
                .map(move |cell| block.excess[cell])
        })
    }

    /// Prescribes a vertex's temperature \[°C\], like that of a large vessel, or releases it. Returns whether vertex
    /// and temperature are valid.
    pub fn hold(&mut self, vertex: u32, celsius: Option<f64>) -> bool {
        let vertex = vertex as usize;
        let is_valid = celsius.is_none_or(|celsius| (-100.0..=1e4).contains(&celsius));
        if vertex >= self.positions.len() || !is_valid {
            return false;
        }
        if let Some(celsius) = celsius {
            let gain = self.organ.capacity[vertex] * (celsius - self.organ.celsius[vertex]);
            self.ledger.held -= gain;
            self.organ.celsius[vertex] = celsius;
        }
        self.organ.held[vertex] = celsius.is_some();
        true
    }

    /// Holds the tissue on the lattice, where that is active, at a temperature on these planes, as cooled or heated plates
    /// would; they replace those before, and are no part of the state. Returns whether all are valid.
    pub fn hold_planes(&mut self, planes: &[HeldPlane]) -> bool {
        let is_valid = |plane: &HeldPlane| {
            plane.axis < 3 && plane.at.abs() <= 1e3 && (-100.0..=1e4).contains(&plane.celsius)
        };
        let are_valid = planes.iter().all(is_valid);
        if are_valid {
            self.grid.planes = planes.to_vec();
        }
        are_valid
    }

    /// Computes the tissue in a box on the fine lattice, though nothing is hot there; returns the number of blocks. As
    /// everywhere, a block is given up when it has cooled.
    pub fn refine(&mut self, low: &Point3<f64>, high: &Point3<f64>) -> u32 {
        let edge = voxelisation::EDGE as f64 * self.grid.spacing;
        let [low, high] = [low, high].map(|at| [at.x, at.y, at.z].map(|x| (x / edge).floor() as i32));
        let mut report = HeatReport::default();
        let mut count = 0;
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                for z in low[2]..=high[2] {
                    count += u32::from(self.grid.activate([x, y, z], &mut report));
                    if report.refused_blocks > 0 {
                        return count;
                    }
                }
            }
        }
        count
    }

    /// Puts heat \[J\] into the tissue at a point, in the cell of the lattice there. Returns whether there is tissue.
    pub fn warm(&mut self, place: &Point3<f64>, joules: f64) -> bool {
        let is_place = place.iter().all(|x| x.abs() <= 1e3);
        if !is_place || !(-1e6..=1e6).contains(&joules) || self.refine(place, place) == 0 {
            return false;
        }
        let cell = [place.x, place.y, place.z].map(|x| (x / self.grid.spacing).floor() as i32);
        let edge = voxelisation::EDGE as i32;
        let Ok(index) = self.grid.find(cell.map(|x| x.div_euclid(edge))) else { return false };
        let [x, y, z] = cell.map(|x| x.rem_euclid(edge));
        let (cell, volume) = ((x + edge * (y + edge * z)) as usize, self.grid.cell_volume());
        let block = &mut self.grid.blocks[index];
        if !block.is_tissue(cell) {
            return false;
        }
        let capacity = self.grid.enthalpy.capacity(block.water[cell]) * block.share(cell) * volume;
        block.excess[cell] += joules / capacity;
        block.peak = block.peak.max(block.excess[cell].abs());
        self.ledger.supplied += joules;
        true
    }

    /// Temperatures \[°C\] and heat capacities \[J/K\] of the mesh at the vertices, without what is on the lattice.
    pub fn mesh_heat(&self) -> impl Iterator<Item = (f64, f64)> + '_ {
        self.organ.celsius.iter().copied().zip(self.organ.capacity.iter().copied())
    }

    /// Heat in the tissue above body temperature \[J\].
    #[must_use]
    pub fn stored(&self) -> f64 {
        self.organ.stored() + self.grid.stored()
    }

    /// Energy balance since the beginning.
    #[must_use]
    pub fn ledger(&self) -> &HeatLedger {
        &self.ledger
    }

    /// Properties of the tissue.
    #[must_use]
    pub fn material(&self) -> &ThermalMaterial {
        &self.material
    }
}
