//! Energy balance of electrosurgery.

use serde::{Deserialize, Serialize};

/// Heat since the beginning \[J\]. Supplied heat equals the increase of stored heat plus all losses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeatLedger {
    /// Supplied by electrodes.
    pub supplied: f64,
    /// Latent heat of vaporised water.
    pub latent: f64,
    /// Sensible heat of vaporised water.
    pub steam: f64,
    /// Heat of removed tissue.
    pub removed: f64,
    /// Loss to perfusion.
    pub perfusion: f64,
    /// Loss to vertices held at a temperature.
    pub held: f64,
    /// Stored at the beginning, above body temperature.
    pub stored_before: f64,
}

impl HeatLedger {
    /// Error of the balance \[J\] at this stored heat: rounding.
    #[must_use]
    pub fn missing(&self, stored: f64) -> f64 {
        let left = self.latent + self.steam + self.removed + self.perfusion + self.held;
        self.supplied + self.stored_before - stored - left
    }
}

/// Statistics of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeatReport {
    /// Power absorbed by tissue \[W\].
    pub absorbed: f64,
    /// Gap from the metal of the nearest active electrode to tissue \[m\]; infinite where there is none in reach.
    pub gap: f64,
    /// Contact area at the beginning of the step \[m²\], of all active electrodes.
    pub contact_area: f64,
    /// Volume of tissue removed \[m³\].
    pub removed_volume: f64,
    /// Removed lattice cells.
    pub removed_cells: u32,
    /// Vaporised water \[kg/s\].
    pub steam_rate: f64,
    /// Smoke \[kg/s\].
    pub smoke_rate: f64,
    /// Hottest tissue on the lattice \[°C\].
    pub hottest: f64,
    /// Blocks with conduction.
    pub active_blocks: u32,
    /// Blocks that heat should have reached, but exceeded the limit.
    pub refused_blocks: u32,
}
