//! How our own world of rigid bodies is stepped.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::rigid_world::WorldError;

use crate::rigid::{ContactConfig, Integrator};

/// The defaults are those under which grasping a 5 g ring by friction was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RigidSettings {
    /// Length of one step \[s\].
    pub substep_secs: f64,
    /// How bodies are moved on.
    pub integrator: Integrator,
    /// Rounds over contacts that have to do with each other in a step at most: with 30 a held ring creeps out of the jaws.
    pub iterations: u32,
    /// A round that changes no speed by more than this is the last one \[m/s\].
    pub tolerance: f64,
    /// Acceleration of gravity in world \[m/s²\].
    pub gravity_in_world: Vector3<f64>,
    /// Height of the floor that catches what falls off the boards \[m\]; none when absent.
    pub floor_height: Option<f64>,
    /// Largest force of the coupling between a hand and its instrument \[N\].
    pub coupling_force_max: f64,
    /// Largest rate at which the drive of the jaws opens or closes them \[rad/s\].
    pub jaw_rate_max: f64,
    /// How far a target is carried on along its velocity when no newer one arrives \[s\].
    pub extrapolation_secs_max: f64,
    /// Whether it claims the poses of all entities rather than of those that are dynamic at its start, so that bodies may be
    /// spawned while it runs.
    pub claims_all_poses: bool,
    /// Names of instruments whose [`LocalContactModel`](trocar_scene::LocalContactModel) somebody else writes.
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
    /// Refuses what the solver cannot work with.
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
