//! New components: a vessel that bleeds, and the pool under it.
//!
//! A component is plain data on an entity. Implementing [`Component`] is all there is to it: from then on it can
//! stand in scenario files, is checked wherever it comes from, is recorded and replayed, stands in the state hash
//! and can be read by everybody.

mod bleeder;

pub use bleeder::Bleeder;
use schemars::JsonSchema;
use trocar::prelude::*;
use trocar::scene::finite;

/// A vessel that bleeds into the field.
//  This sentence is what `trocar list components` says, and an editor that knows the schema; so are the fields'.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
// Unknown keys are refused: in a scenario, a key that is ignored is worse than one that is wrong.
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

impl Component for Bleeding {
    /// In files, hashes and messages. It never changes: recordings are read by it.
    const NAME: &'static str = "bleeding";

    /// Called before a value gets anywhere: from a scenario, a controller, a recording, the network. What is
    /// refused here never reaches a snapshot, so nobody who reads one has to doubt it.
    fn check(&self) -> Result<(), ComponentError> {
        // An override has to look for NaN and infinities itself, as the default does.
        finite::check(self)?;
        ComponentError::range("flow", self.flow, 0.0..=1e-4, "0 to 1e-4 m³/s")?;
        ComponentError::range("lost", self.lost, 0.0..=0.01, "0 to 0.01 m³")?;
        ComponentError::range("sealed", self.sealed, 0.0..=1.0, "0 to 1")
    }

    /// What may be written in a scenario, for editors and `trocar schema`.
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

/// The pool of blood around a vessel, for whoever draws it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BloodPool {
    /// Its radius \[m\].
    pub radius: f64,
}

impl Component for BloodPool {
    const NAME: &'static str = "blood_pool";
    /// It follows from [`Bleeding`], so it need not be recorded, and does not count in the state hash.
    const RECORD: RecordPolicy = RecordPolicy::Derived;
}

/// Trocar, and what this crate adds to it.
pub fn app() -> App {
    App::new()
        .component::<Bleeding>()
        .component::<BloodPool>()
        .controller::<Bleeder>("bleeder")
        .about("bleeder", KindInfo::new("lets vessels bleed, and spreads the pools around them", 50.0))
}
