//! Where the heat went.

use serde::{Deserialize, Serialize};

/// Heat since the beginning \[J\]. What was supplied is what is stored more than at the beginning and what left.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeatLedger {
    /// What electrodes put into tissue.
    pub supplied: f64,
    /// What turned water into steam.
    pub latent: f64,
    /// What steam took along as warm water.
    pub steam: f64,
    /// What tissue took along that was removed.
    pub removed: f64,
    /// What blood carried away.
    pub perfusion: f64,
    /// What vertices took that are held at a temperature.
    pub held: f64,
    /// What was stored at the beginning, above the body's temperature.
    pub stored_before: f64,
}

impl HeatLedger {
    /// What is not accounted for \[J\], when so much is stored: rounding.
    #[must_use]
    pub fn missing(&self, stored: f64) -> f64 {
        let left = self.latent + self.steam + self.removed + self.perfusion + self.held;
        self.supplied + self.stored_before - stored - left
    }
}

/// What was given off in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeatReport {
    /// Power that arrived in tissue \[W\].
    pub absorbed: f64,
    /// From the metal of the nearest electrode that is on to tissue \[m\]; infinite where there is none in reach.
    pub gap: f64,
    /// Area of metal that is in contact with tissue when the step begins \[m²\], of all electrodes that are on.
    pub contact_area: f64,
    /// Volume of tissue removed \[m³\].
    pub removed_volume: f64,
    /// Cells of the lattice removed.
    pub removed_cells: u32,
    /// Water turned into steam \[kg/s\].
    pub steam_rate: f64,
    /// Smoke \[kg/s\].
    pub smoke_rate: f64,
    /// Hottest tissue on the lattice \[°C\].
    pub hottest: f64,
    /// Blocks in which heat moves.
    pub active_blocks: u32,
    /// Blocks that heat should have reached, but that there was no room for.
    pub refused_blocks: u32,
}
