//! Settings of the impulse world.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::rigid_world::{WorldError, WorldSettings, check_setting};

use crate::rigid::{ContactConfig, Integrator};

/// Settings; the defaults are those of the measured grasp of a 5 g ring by friction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RigidSettings {
    /// Length of one step \[s\].
    pub substep_secs: f64,
    /// Time integrator.
    pub integrator: Integrator,
    /// Maximum solver iterations per island and step: with 30 a held ring creeps out of the jaws.
    pub iterations: u32,
    /// Convergence: the iteration ends when no velocity changes by more than this \[m/s\].
    pub tolerance: f64,
    /// Acceleration of gravity in world \[m/s²\].
    pub gravity_in_world: Vector3<f64>,
    /// Height of the floor that catches objects falling off the boards \[m\]; no floor when absent.
    pub floor_height: Option<f64>,
    /// Force limit of the coupling between a hand and its instrument \[N\].
    pub coupling_force_max: f64,
    /// Largest opening or closing rate of the jaw drive \[rad/s\].
    pub jaw_rate_max: f64,
    /// How long a target is extrapolated at its velocity when no newer one arrives \[s\].
    pub extrapolation_secs_max: f64,
    /// Whether it claims the poses of all entities instead of those that are dynamic at its start, so that bodies may
    /// be spawned at run time.
    pub claims_all_poses: bool,
    /// Names of instruments whose [`LocalContactModel`](trocar_scene::LocalContactModel) another actor writes.
    pub contact_models_by_others: Vec<String>,
}

impl Default for RigidSettings {
    fn default() -> Self {
        let shared = WorldSettings::default();
        Self {
            substep_secs: shared.substep_secs,
            integrator: Integrator::Symplectic,
            iterations: 120,
            tolerance: 1e-6,
            gravity_in_world: shared.gravity_in_world,
            floor_height: shared.floor_height,
            coupling_force_max: shared.coupling_force_max,
            jaw_rate_max: shared.jaw_rate_max,
            extrapolation_secs_max: shared.extrapolation_secs_max,
            claims_all_poses: shared.claims_all_poses,
            contact_models_by_others: shared.contact_models_by_others,
        }
    }
}

impl RigidSettings {
    /// Rejects invalid settings.
    ///
    /// # Errors
    /// [`WorldError::InvalidSetting`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), WorldError> {
        self.shared().check()?;
        check_setting("iterations", f64::from(self.iterations), 1.0..=1000.0, "1 to 1000")?;
        check_setting("tolerance", self.tolerance, 0.0..=1.0, "0 to 1 m/s")
    }

    /// Those of them that every world has.
    pub(crate) fn shared(&self) -> WorldSettings {
        WorldSettings {
            substep_secs: self.substep_secs,
            gravity_in_world: self.gravity_in_world,
            floor_height: self.floor_height,
            coupling_force_max: self.coupling_force_max,
            jaw_rate_max: self.jaw_rate_max,
            extrapolation_secs_max: self.extrapolation_secs_max,
            claims_all_poses: self.claims_all_poses,
            contact_models_by_others: self.contact_models_by_others.clone(),
        }
    }

    pub(super) fn contacts(&self) -> ContactConfig {
        ContactConfig { iterations: self.iterations, tolerance: self.tolerance, ..ContactConfig::default() }
    }
}
