//! State of heated tissue, to restart it.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use super::damage::ElementBurns;
use super::energy_balance::HeatLedger;
use super::error::ElectrosurgeryError;
use super::lattice_block::{Block, CELLS};
use super::{CutTissue, Electrosurgery, LatticeConfig, ThermalMaterial, Tissue};

/// A block of the lattice; cells in the order x, y, z, x fastest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlockState {
    /// Its position, in blocks from the origin.
    pub key: [i32; 3],
    /// Whether heat is conducted in it.
    pub is_active: bool,
    /// Largest excess \[K\].
    pub peak: f64,
    /// Temperatures above the mesh's \[K\].
    pub excess: Vec<f64>,
    /// Remaining water fractions.
    pub water: Vec<f64>,
    /// Parts ahead of drying fronts.
    #[serde(default)]
    pub ahead: Vec<f64>,
    /// Damage Ω.
    pub damage: Vec<f64>,
    /// Bits: tissue, removed, coagulated, charred, burst, boiling.
    pub flags: Vec<u8>,
}

/// State of tissue under electrodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ElectrosurgeryState {
    /// Temperatures of the mesh's vertices \[°C\].
    pub celsius: Vec<f64>,
    /// Ω of the mesh's vertices.
    pub damage: Vec<f64>,
    /// Remaining heat capacities of the mesh's vertices \[J/K\].
    pub capacity: Vec<f64>,
    /// Remaining perfusion loss \[W/K\].
    pub perfusion: Vec<f64>,
    /// Whether vertices have a prescribed temperature.
    pub held: Vec<bool>,
    /// Original volumes of the vertices \[m³\].
    #[serde(default)]
    pub whole: Vec<f64>,
    /// Removed, coagulated and charred volume of each element \[m³\].
    pub burns: Vec<[f64; 3]>,
    /// Volume of each element in removed cells \[m³\].
    pub touched: Vec<f64>,
    /// Volume removed from the lattice but not from the mesh \[m³\].
    pub owed: f64,
    /// Elements to be removed next.
    pub due: Vec<u32>,
    /// Removed elements, in order of removal.
    pub removed: Vec<u32>,
    /// Blocks in the order of their keys.
    pub blocks: Vec<BlockState>,
    /// Energy balance.
    pub ledger: HeatLedger,
}

/// Valid temperatures and differences \[°C\] \[K\]: far beyond vaporisation.
const CELSIUS: RangeInclusive<f64> = -273.15..=1e5;
const EXCESS: RangeInclusive<f64> = -1e5..=1e5;
/// Valid Ω; in charred tissue it grows beyond any useful value.
const OMEGA: RangeInclusive<f64> = 0.0..=1e300;
/// Valid energies \[J\], volumes \[m³\], capacities \[J/K\] and losses \[W/K\]: far beyond those of a body.
const EXTENT: RangeInclusive<f64> = 0.0..=1e12;
const BALANCE: RangeInclusive<f64> = -1e12..=1e12;

fn wrong<T>(what: impl Into<String>) -> Result<T, ElectrosurgeryError> {
    Err(ElectrosurgeryError::State(what.into()))
}

/// Checks length and range of a list, so that no computed result becomes infinite.
fn fits(
    name: &str,
    values: &[f64],
    count: usize,
    valid: &RangeInclusive<f64>,
) -> Result<(), ElectrosurgeryError> {
    if values.len() != count {
        return wrong(format!("{name}: {} values, {count} are valid", values.len()));
    }
    match values.iter().position(|value| !valid.contains(value)) {
        Some(at) => wrong(format!(
            "{name}: value {at} is {:?}, {} to {} is valid",
            values[at],
            valid.start(),
            valid.end()
        )),
        None => Ok(()),
    }
}

impl BlockState {
    fn of(block: &Block) -> Self {
        Self {
            key: block.key,
            is_active: block.is_active,
            peak: block.peak,
            excess: block.excess.to_vec(),
            water: block.water.to_vec(),
            ahead: block.ahead.to_vec(),
            damage: block.damage.to_vec(),
            flags: block.flags.to_vec(),
        }
    }

    fn check(&self) -> Result<(), ElectrosurgeryError> {
        let own = |what: &str| format!("block {:?}: {what}", self.key);
        fits(&own("excess"), &self.excess, CELLS, &EXCESS)?;
        fits(&own("water"), &self.water, CELLS, &(0.0..=1.0))?;
        if !self.ahead.is_empty() {
            fits(&own("ahead"), &self.ahead, CELLS, &(0.0..=1.0))?;
        }
        fits(&own("damage"), &self.damage, CELLS, &OMEGA)?;
        fits(&own("peak"), &[self.peak], 1, &(0.0..=*EXCESS.end()))?;
        if self.flags.len() != CELLS {
            return wrong(own(&format!("{CELLS} flags are valid")));
        }
        Ok(())
    }
}

impl Electrosurgery {
    /// The state.
    #[must_use]
    pub fn state(&self) -> ElectrosurgeryState {
        let ElementBurns { removed, coagulated, charred, .. } = &self.burns;
        ElectrosurgeryState {
            celsius: self.organ.celsius.clone(),
            damage: self.organ_damage.clone(),
            capacity: self.organ.capacity.clone(),
            perfusion: self.organ.perfusion.clone(),
            held: self.organ.held.clone(),
            whole: self.organ.whole.clone(),
            burns: (0..removed.len()).map(|e| [removed[e], coagulated[e], charred[e]]).collect(),
            touched: self.burns.touched.clone(),
            owed: self.burns.owed,
            due: self.burns.due.clone(),
            removed: self.burns.order.clone(),
            blocks: self.grid.blocks.iter().map(BlockState::of).collect(),
            ledger: self.ledger,
        }
    }

    /// Restores a tissue, which continues bit for bit.
    ///
    /// # Errors
    /// As [`Electrosurgery::new`]; a state of another tissue, or with invalid numbers.
    pub fn restore(
        tissue: &Tissue<'_>,
        material: ThermalMaterial,
        lattice: LatticeConfig,
        state: &ElectrosurgeryState,
    ) -> Result<Self, ElectrosurgeryError> {
        Self::restore_parted(tissue, None, material, lattice, state)
    }

    /// The same for cut tissue, possibly cut further since the state was taken.
    ///
    /// # Errors
    /// As [`Electrosurgery::restore`]; cuts that do not fit the original mesh.
    pub fn restore_parted(
        tissue: &Tissue<'_>,
        parted: Option<&CutTissue<'_>>,
        material: ThermalMaterial,
        lattice: LatticeConfig,
        state: &ElectrosurgeryState,
    ) -> Result<Self, ElectrosurgeryError> {
        let mut restored = Self::new(tissue, material, lattice)?;
        let (first, elements) = (restored.positions.len(), restored.elements.len());
        let now = parted.map_or(first, |parted| parted.tissue.positions().len());
        let vertices = state.celsius.len();
        if !(first..=now).contains(&vertices) {
            return wrong(format!("celsius: {vertices} values, {first} to {now} are valid"));
        }
        fits("celsius", &state.celsius, vertices, &CELSIUS)?;
        fits("damage", &state.damage, vertices, &OMEGA)?;
        fits("capacity", &state.capacity, vertices, &EXTENT)?;
        fits("perfusion", &state.perfusion, vertices, &EXTENT)?;
        if !state.whole.is_empty() || vertices != first {
            fits("whole", &state.whole, vertices, &EXTENT)?;
        }
        let HeatLedger { supplied, latent, steam, removed, perfusion, held, stored_before } = state.ledger;
        let ledger = [supplied, latent, steam, removed, perfusion, held, stored_before];
        fits("ledger", &ledger, ledger.len(), &BALANCE)?;
        if state.held.len() != vertices || state.burns.len() != elements {
            return wrong(format!("held and burns: {vertices} and {elements} are valid"));
        }
        let burns: Vec<f64> = state.burns.iter().flatten().copied().collect();
        fits("burns", &burns, 3 * elements, &BALANCE)?;
        fits("touched", &state.touched, elements, &EXTENT)?;
        fits("owed", &[state.owed], 1, &BALANCE)?;
        if let Some(alien) =
            state.removed.iter().chain(&state.due).find(|element| **element as usize >= elements)
        {
            return wrong(format!("removed or due: element {alien}, 0 to {elements} - 1 are valid"));
        }
        let is_sorted = state.blocks.windows(2).all(|pair| pair[0].key < pair[1].key);
        if !is_sorted || state.blocks.len() > lattice.blocks_max {
            return wrong(format!("blocks: at most {}, sorted by their keys, are valid", lattice.blocks_max));
        }
        let lost = (0..vertices).find(|&vertex| {
            let whole = state.whole.get(vertex).or(restored.organ.whole.get(vertex));
            state.capacity[vertex] <= 0.0 && whole.is_none_or(|whole| *whole > 0.0)
        });
        if let Some(vertex) = lost {
            return wrong(format!("capacity: vertex {vertex} has none"));
        }
        restored.ledger = state.ledger;
        for (element, [removed, coagulated, charred]) in state.burns.iter().enumerate() {
            restored.burns.removed[element] = *removed;
            restored.burns.coagulated[element] = *coagulated;
            restored.burns.charred[element] = *charred;
        }
        // In order of removal: sums keep their bits.
        for element in &state.removed {
            if std::mem::replace(&mut restored.burns.is_removed[*element as usize], true) {
                return wrong(format!("removed: element {element} is named twice"));
            }
        }
        restored.burns.order.clone_from(&state.removed);
        restored.burns.touched.clone_from(&state.touched);
        restored.burns.due.clone_from(&state.due);
        restored.burns.owed = state.owed;
        restored.restore_nodes(state, parted)?;
        for block in &state.blocks {
            block.check()?;
            let Some(kept) = restored.grid.remember(block.key) else {
                return wrong(format!("block {:?}: there is no tissue", block.key));
            };
            kept.excess.copy_from_slice(&block.excess);
            kept.water.copy_from_slice(&block.water);
            // A state from before fronts were stored: all that has dried is behind one.
            kept.ahead.copy_from_slice(if block.ahead.is_empty() { &block.water } else { &block.ahead });
            kept.damage.copy_from_slice(&block.damage);
            // The tissue flag comes from the mesh.
            for (kept, flag) in kept.flags.iter_mut().zip(&block.flags) {
                if *kept != 0 {
                    *kept = *flag | super::lattice_block::TISSUE;
                }
            }
            (kept.is_active, kept.peak) = (block.is_active, block.peak);
        }
        Ok(restored)
    }
}
