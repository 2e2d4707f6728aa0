//! Settings of the physics engine, and their valid ranges.

use nalgebra::{ComplexField, Vector3};
use rapier3d_f64::dynamics::{FrictionModel, IntegrationParameters, SpringCoefficients};
use serde::{Deserialize, Serialize};
use trocar_dynamics::rigid_world::{WorldSettings, check_setting};

use crate::EngineError;

/// Rapier's length unit \[m\]: its tolerances are proportional to it.
pub(crate) const LENGTH_UNIT: f64 = 0.01;

/// Jaw force up to which the settings of peg transfer hold \[N\].
const EASY_FORCE: f64 = 2.0;
/// Most iterations and sweeps of strong jaws, in those of weak ones.
const EFFORT_MAX: f64 = 3.0;

/// A jaw force in units of what is easily held; at least 1.
fn strength(jaw_force_max: f64) -> f64 {
    (jaw_force_max / EASY_FORCE).max(1.0)
}

/// How the world is stepped. Grasping a 5 g ring by friction was measured with the defaults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EngineSettings {
    /// Length of one step of the solver \[s\].
    pub substep_secs: f64,
    /// Solver iterations per step, for bodies that no instrument touches.
    pub solver_iterations: usize,
    /// Additional iterations for bodies that an instrument of up to 2 N jaw force touches; strong jaws take up to three
    /// times as many.
    pub grasp_iterations: usize,
    /// Additional sweeps over all constraints in each of those iterations: they balance hinge, drive and contact of a
    /// jaw (with 0 a held ring creeps by 0.5 mm/s). Strong jaws take up to three times as many.
    pub grasp_sweeps: usize,
    /// Acceleration of gravity in world \[m/s²\].
    pub gravity_in_world: Vector3<f64>,
    /// Height of the floor that catches bodies that fall off the boards \[m\]; absent: no floor.
    pub floor_height: Option<f64>,
    /// Maximum force of the virtual coupling between a hand and its instrument \[N\].
    pub coupling_force_max: f64,
    /// Maximum rate at which the jaw drive opens or closes the jaws \[rad/s\].
    pub jaw_rate_max: f64,
    /// Maximum time for which a target is extrapolated along its velocity when no newer one arrives \[s\].
    pub extrapolation_secs_max: f64,
    /// Stiffness of contacts whose detector reports no force \[N/m\].
    pub penalty_stiffness: f64,
    /// Whether the engine claims the poses of all entities rather than of those that are dynamic at its start, so that
    /// bodies may be spawned while it runs.
    pub claims_all_poses: bool,
    /// Names of instruments whose [`LocalContactModel`](trocar_scene::LocalContactModel) another controller writes:
    /// haptics render that model, and the instruments are kept on its surface.
    pub contact_models_by_others: Vec<String>,
}

impl Default for EngineSettings {
    fn default() -> Self {
        let shared = WorldSettings::default();
        Self {
            substep_secs: shared.substep_secs,
            solver_iterations: 4,
            grasp_iterations: 4,
            grasp_sweeps: 1,
            gravity_in_world: shared.gravity_in_world,
            floor_height: shared.floor_height,
            coupling_force_max: shared.coupling_force_max,
            jaw_rate_max: shared.jaw_rate_max,
            extrapolation_secs_max: shared.extrapolation_secs_max,
            penalty_stiffness: 500.0,
            claims_all_poses: shared.claims_all_poses,
            contact_models_by_others: shared.contact_models_by_others,
        }
    }
}

impl EngineSettings {
    /// Rejects values that the solver cannot work with.
    ///
    /// # Errors
    /// [`EngineError::InvalidSetting`] names the first setting that is out of range.
    pub fn check(&self) -> Result<(), EngineError> {
        self.shared().check()?;
        check_setting("solver_iterations", self.solver_iterations as f64, 1.0..=128.0, "1 to 128")?;
        check_setting("grasp_iterations", self.grasp_iterations as f64, 0.0..=128.0, "0 to 128")?;
        check_setting("grasp_sweeps", self.grasp_sweeps as f64, 0.0..=32.0, "0 to 32")?;
        check_setting("penalty_stiffness", self.penalty_stiffness, 1.0..=1e5, "1 to 100,000 N/m")
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

    /// Additional iterations, and sweeps in each of them, for bodies that jaws of this force \[N\] touch.
    ///
    /// In each iteration, the jaws of a light body gain and lose a speed in proportion to their force. The more there is
    /// to balance, the more sweeps it takes until friction and hinge hold what the contacts push.
    pub(crate) fn grasp_effort(&self, jaw_force_max: f64) -> (usize, usize) {
        let times = strength(jaw_force_max).min(EFFORT_MAX);
        let more = |count: usize| (count as f64 * times).ceil() as usize;
        (more(self.grasp_iterations), more(self.grasp_sweeps))
    }

    /// Rapier's own parameters, for a world whose strongest jaws have this force \[N\].
    ///
    /// With its defaults (30 Hz contact softness, metre-sized tolerances) jaws sink millimetres into a ring. A contact of
    /// Rapier is a spring of stiffness m (2π f)², with the mass m of what touches, and it pushes apart at a bounded
    /// speed: jaws whose force is above what this speed can bear close through the body. Stiffness and speed therefore
    /// grow with the force, so that jaws of any force sink in by the same depth. The contact is never harder than it must
    /// be: it is its softness that spreads a pad's load over all of its points. Where one corner carries all, nothing
    /// keeps the body from turning about it.
    pub(crate) fn integration_parameters(&self, jaw_force_max: f64) -> IntegrationParameters {
        let times = strength(jaw_force_max);
        let root = ComplexField::sqrt(times);
        let stiff = SpringCoefficients { natural_frequency: 1000.0 * root, damping_ratio: 10.0 / root };
        IntegrationParameters {
            normalized_max_corrective_velocity: if jaw_force_max > 0.0 { 12.0 * times * root } else { 3.0 },
            dt: self.substep_secs,
            min_ccd_dt: self.substep_secs / 100.0,
            contact_softness: stiff,
            static_contact_softness: stiff,
            length_unit: LENGTH_UNIT,
            num_solver_iterations: self.solver_iterations,
            friction_model: FrictionModel::Coulomb,
            // 1 mm: no body moves further than that within a step, so that contacts exist before any penetration.
            normalized_prediction_distance: 0.1,
            // Four points per plane do not support a ring that rolls flat: its far side sinks in by 0.15 mm.
            contact_clustering: false,
            // 20 µm: reuse a manifold only while the bodies rest on each other; tubes roll on blades.
            normalized_contact_recycle_distance: 0.002,
            ..IntegrationParameters::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid() {
        assert_eq!(EngineSettings::default().check(), Ok(()));
    }

    #[test]
    fn out_of_range_is_named() {
        for (settings, field) in [
            (EngineSettings { substep_secs: f64::NAN, ..Default::default() }, "substep_secs"),
            (EngineSettings { substep_secs: 0.0, ..Default::default() }, "substep_secs"),
            (EngineSettings { solver_iterations: 0, ..Default::default() }, "solver_iterations"),
            (EngineSettings { coupling_force_max: -1.0, ..Default::default() }, "coupling_force_max"),
            (EngineSettings { floor_height: Some(f64::INFINITY), ..Default::default() }, "floor_height"),
        ] {
            let error = settings.check().unwrap_err();
            assert!(matches!(&error, EngineError::InvalidSetting { field: named, .. } if *named == field));
            assert!(error.to_string().contains(field));
        }
    }
}
