//! Settings of the impulse world.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::rigid_world::WorldError;

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
        Self {
            substep_secs: 0.001,
            integrator: Integrator::Symplectic,
            iterations: 120,
            tolerance: 1e-6,
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

impl RigidSettings {
    /// Rejects invalid settings.
    ///
    /// # Errors
    /// [`WorldError::InvalidSetting`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), WorldError> {
        let within = |field, value: f64, low: f64, high: f64, valid| {
            // Written so that a NaN fails.
            if value >= low && value <= high {
                Ok(())
            } else {
                Err(WorldError::InvalidSetting { field, value, valid })
            }
        };
        within("substep_secs", self.substep_secs, 1e-5, 0.005, "1e-5 to 0.005 s")?;
        within("iterations", f64::from(self.iterations), 1.0, 1000.0, "1 to 1000")?;
        within("tolerance", self.tolerance, 0.0, 1.0, "0 to 1 m/s")?;
        for axis in self.gravity_in_world.iter() {
            within("gravity_in_world", *axis, -100.0, 100.0, "-100 to 100 m/s²")?;
        }
        if let Some(height) = self.floor_height {
            within("floor_height", height, -100.0, 100.0, "-100 to 100 m")?;
        }
        within("coupling_force_max", self.coupling_force_max, 0.1, 200.0, "0.1 to 200 N")?;
        within("jaw_rate_max", self.jaw_rate_max, 0.01, 100.0, "0.01 to 100 rad/s")?;
        within("extrapolation_secs_max", self.extrapolation_secs_max, 0.0, 0.1, "0 to 0.1 s")
    }

    pub(super) fn contacts(&self) -> ContactConfig {
        ContactConfig { iterations: self.iterations, tolerance: self.tolerance, ..ContactConfig::default() }
    }
}
