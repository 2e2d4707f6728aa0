//! Virtual fixtures: forces that a behaviour adds to what a hand feels.

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::time::SimTime;
use crate::{Component, ComponentError};

/// A virtual fixture on a hand: guidance, a forbidden region, a resistance (Rosenberg 1993, "Virtual fixtures:
/// perceptual tools for telerobotic manipulation", IEEE VRAIS).
///
/// A behaviour puts it onto the entity of a hand, as often as it likes. Haptics evaluates `force + stiffness · (center −
/// tip) − damping · velocity` at the hand's own rate, and adds it to the force of the contacts. It fades when it is not
/// renewed for 0.1 s, and is gone after 0.2 s. All limits below haptics apply to the sum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "virtual_fixture", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct VirtualFixture {
    /// The constant part, on the hand at the instrument's tip, in world \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force: Vector3<f64>,
    /// Point to which the spring draws the tip, in world \[m\].
    #[schemars(with = "[f64; 3]")]
    pub center_in_world: Point3<f64>,
    /// Stiffness of the spring \[N/m\]; haptics lowers it to what the device renders stably.
    pub stiffness: f64,
    /// Damping of the tip \[N·s/m\]; lowered likewise.
    pub damping: f64,
    /// Time of the tick that wrote it: `Tick::time`.
    pub at: SimTime,
}

impl Default for VirtualFixture {
    fn default() -> Self {
        Self {
            force: Vector3::zeros(),
            center_in_world: Point3::origin(),
            stiffness: 0.0,
            damping: 0.0,
            at: SimTime::ZERO,
        }
    }
}

impl VirtualFixture {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("force", self.force.norm(), 0.0..=100.0, "0 to 100 N")?;
        ComponentError::range("stiffness", self.stiffness, 0.0..=1e5, "0 to 1e5 N/m")?;
        ComponentError::range("damping", self.damping, 0.0..=1e3, "0 to 1e3 N·s/m")
    }
}
