//! Settings that every world of rigid bodies has, their defaults and their ranges.

use std::ops::RangeInclusive;

use nalgebra::Vector3;
use trocar_scene::Detection;

use super::{Scheduling, WorldError};

/// Settings that every world has. A world lists them among its own, because a scenario has all of them in one table and
/// an error has to name the line.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldSettings {
    /// Length of one step \[s\].
    pub substep_secs: f64,
    /// Acceleration of gravity in world \[m/s²\].
    pub gravity_in_world: Vector3<f64>,
    /// Height of the floor that catches bodies that fall off the boards \[m\]; absent: no floor.
    pub floor_height: Option<f64>,
    /// Maximum force of the coupling between a hand and its instrument \[N\].
    pub coupling_force_max: f64,
    /// Maximum rate at which the jaw drive opens or closes the jaws \[rad/s\].
    pub jaw_rate_max: f64,
    /// Maximum time for which a target is extrapolated along its velocity when no newer one arrives \[s\].
    pub extrapolation_secs_max: f64,
    /// Whether the world claims the poses of all entities rather than of those that are dynamic at its start.
    pub claims_all_poses: bool,
    /// Names of instruments whose contacts another controller models.
    pub contact_models_by_others: Vec<String>,
}

impl Default for WorldSettings {
    fn default() -> Self {
        Self {
            substep_secs: 0.001,
            gravity_in_world: Vector3::new(0.0, 0.0, -9.81),
            floor_height: Some(-0.05),
            coupling_force_max: 20.0,
            jaw_rate_max: 6.0,
            extrapolation_secs_max: 0.02,
            claims_all_poses: false,
            contact_models_by_others: Vec::new(),
        }
    }
}

impl WorldSettings {
    /// Rejects values that no world can work with.
    ///
    /// # Errors
    /// [`WorldError::InvalidSetting`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), WorldError> {
        check_setting("substep_secs", self.substep_secs, 1e-5..=0.005, "1e-5 to 0.005 s")?;
        for axis in self.gravity_in_world.iter() {
            check_setting("gravity_in_world", *axis, -100.0..=100.0, "-100 to 100 m/s²")?;
        }
        if let Some(height) = self.floor_height {
            check_setting("floor_height", height, -100.0..=100.0, "-100 to 100 m")?;
        }
        check_setting("coupling_force_max", self.coupling_force_max, 0.1..=200.0, "0.1 to 200 N")?;
        check_setting("jaw_rate_max", self.jaw_rate_max, 0.01..=100.0, "0.01 to 100 rad/s")?;
        check_setting("extrapolation_secs_max", self.extrapolation_secs_max, 0.0..=0.1, "0 to 0.1 s")
    }

    /// What the controller of a world needs of them, for a world whose contacts are found by `method`.
    #[must_use]
    pub fn scheduling(self, method: Detection) -> Scheduling {
        Scheduling {
            substep_secs: self.substep_secs,
            method,
            claims_all_poses: self.claims_all_poses,
            contact_models_by_others: self.contact_models_by_others,
        }
    }
}

/// Rejects a setting outside its range; a NaN is outside of any.
///
/// # Errors
/// [`WorldError::InvalidSetting`], with the range in words.
pub fn check_setting(
    field: &'static str,
    value: f64,
    range: RangeInclusive<f64>,
    valid: &'static str,
) -> Result<(), WorldError> {
    if range.contains(&value) { Ok(()) } else { Err(WorldError::InvalidSetting { field, value, valid }) }
}
