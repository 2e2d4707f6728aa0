//! New components: a vessel that bleeds, and the pool under it.
//!
//! A component is plain data on an entity. Deriving [`Component`] is enough: scenario files can then contain it, it
//! is checked whatever its source, recorded and replayed, is part of the state hash, and every controller can read it.

mod bleeder;

pub use bleeder::Bleeder;
use schemars::JsonSchema;
use trocar::prelude::*;

/// A vessel that bleeds into the field.
// This sentence is shown by `trocar list components` and by editors with the schema, as are those of the fields.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
// The name is used in files, hashes and messages. It must never change: recordings are read by it. `schema` allows the
// component in scenarios, and describes it to editors and `trocar schema`.
#[component(name = "bleeding", check = Self::ranges, schema)]
// Unknown keys are refused: in a scenario, an ignored key is worse than an error.
#[serde(default, deny_unknown_fields)]
pub struct Bleeding {
    /// Flow out of the vessel \[m³/s\]; 1 ml/min is 1.67e-8.
    pub flow: f64,
    /// Volume that has been lost so far \[m³\].
    pub lost: f64,
    /// Share of the vessel that is closed, 0 (open) to 1 (sealed).
    pub sealed: f64,
}

impl Default for Bleeding {
    fn default() -> Self {
        Self { flow: 1e-7, lost: 0.0, sealed: 0.0 }
    }
}

impl Bleeding {
    /// Called before a value is used, whether from a scenario, a controller, a recording or the network, once NaN and
    /// infinities are ruled out. A refused value never reaches a snapshot, so readers need not check again.
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("flow", self.flow, 0.0..=1e-4, "0 to 1e-4 m³/s")?;
        ComponentError::range("lost", self.lost, 0.0..=0.01, "0 to 0.01 m³")?;
        ComponentError::range("sealed", self.sealed, 0.0..=1.0, "0 to 1")
    }
}

/// The pool of blood around a vessel, for viewers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Component)]
// It can be computed from `Bleeding`, so it is not recorded, and is not part of the state hash.
#[component(name = "blood_pool", record = RecordPolicy::Derived)]
pub struct BloodPool {
    /// Its radius \[m\].
    pub radius: f64,
}

/// Trocar with this crate's additions.
pub fn app() -> App {
    App::new()
        .component::<Bleeding>()
        .component::<BloodPool>()
        .controller::<Bleeder>("bleeder")
        .about("bleeder", KindInfo::new("lets vessels bleed, and spreads the pools around them", 50.0))
}
