//! What of an instrument's mechanism only those know who move it, kept in the scene so that another life of theirs
//! continues without a jolt.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::component::Component;
use trocar_scene::components::InstrumentTarget;

/// Inner state of an instrument's jaws and coupling.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MechanismState {
    /// How far the bisector of the jaws is off the shaft's axis, about +y \[rad\].
    pub tilt: f64,
    /// Its rate \[rad/s\].
    pub tilt_rate: f64,
    /// Where the drive of the jaws is on its way to its target \[rad\].
    pub drive_reference: f64,
    /// The sample of the hand before the newest one.
    #[schemars(skip)]
    pub previous_target: Option<InstrumentTarget>,
    /// The newest sample of the hand.
    #[schemars(skip)]
    pub newest_target: Option<InstrumentTarget>,
}

impl Component for MechanismState {
    const NAME: &'static str = "mechanism_state";
}
