//! Internal state of an instrument's mechanism, kept in the scene so that a restarted controller continues without a
//! jump.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::components::InstrumentTarget;
use trocar_scene::{Component, RecordPolicy};

/// Internal state of an instrument's jaws and coupling.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mechanism_state", record = RecordPolicy::sampled(20.0, 2.5e-7))]
#[serde(default, deny_unknown_fields)]
pub struct MechanismState {
    /// Angle between the jaws' bisector and the shaft's axis, about +y \[rad\].
    pub tilt: f64,
    /// Its rate \[rad/s\].
    pub tilt_rate: f64,
    /// Current set point of the jaw drive \[rad\].
    pub drive_reference: f64,
    /// The target sample before the newest.
    #[schemars(skip)]
    pub previous_target: Option<InstrumentTarget>,
    /// The newest target sample.
    #[schemars(skip)]
    pub newest_target: Option<InstrumentTarget>,
}
