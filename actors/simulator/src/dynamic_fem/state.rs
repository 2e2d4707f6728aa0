//! State of a dynamic body, to restart it.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidResponse;

use super::config::DynamicFemError;
use super::incremental_potential::{Coupling, Inputs};
use super::solver::{DynamicFem, FactoredAt};

/// State between two steps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DynamicFemState {
    /// Node positions \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Velocities \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
    /// Accelerations in the last step \[m/s²\]: the initial guess of the next one.
    pub accelerations: Vec<Vector3<f64>>,
    /// Iterations that the factor has cost beyond those of a new one.
    pub debt: u32,
    /// Node positions where the factor was computed \[m\]; empty if there is none yet.
    pub factor_positions: Vec<Point3<f64>>,
    /// Its step \[s\].
    pub factor_dt: f64,
    /// Its springs and contacts: nodes and weights, and coupling stiffness \[N/m\].
    pub factor_couplings: Vec<Coupling>,
}

/// Motion of the nodes between two steps, to take back a step that was only tried.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    positions: Vec<Point3<f64>>,
    velocities: Vec<Vector3<f64>>,
    accelerations: Vec<Vector3<f64>>,
}

impl DynamicFem {
    /// Stores the motion of the nodes.
    pub fn store(&self, motion: &mut Motion) {
        motion.positions.clone_from(&self.positions);
        motion.velocities.clone_from(&self.velocities);
        motion.accelerations.clone_from(&self.accelerations);
    }

    /// Takes back the steps since a stored motion of the same nodes; the factor stays as it is.
    pub fn take_back(&mut self, motion: &Motion) {
        self.positions.clone_from(&motion.positions);
        self.velocities.clone_from(&motion.velocities);
        self.accelerations.clone_from(&motion.accelerations);
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> DynamicFemState {
        DynamicFemState {
            positions: self.positions.clone(),
            velocities: self.velocities.clone(),
            accelerations: self.accelerations.clone(),
            debt: self.debt,
            factor_positions: self.factored_at.positions.clone(),
            factor_dt: self.factored_at.dt,
            factor_couplings: self.factored_at.couplings.clone(),
        }
    }

    /// Continues from a state, bit for bit. Positions and velocities may be changed; then set accelerations to zero and
    /// leave out the factor.
    ///
    /// # Errors
    /// A state of another body, or with non-finite numbers; nothing has changed then.
    pub fn restore(&mut self, state: &DynamicFemState) -> Result<(), DynamicFemError> {
        let nodes = self.positions.len();
        let none = state.factor_positions.is_empty();
        let fits = state.positions.len() == nodes
            && state.velocities.len() == nodes
            && state.accelerations.len() == nodes
            && (none || state.factor_positions.len() == nodes);
        if !fits {
            return Err(DynamicFemError::State("it has another number of nodes"));
        }
        let points = state.positions.iter().chain(&state.factor_positions).map(|point| &point.coords);
        let vectors = points.chain(&state.velocities).chain(&state.accelerations);
        if !vectors.flatten().all(|x| x.is_finite()) {
            return Err(DynamicFemError::State("a number is not finite"));
        }
        let weights = || state.factor_couplings.iter().flat_map(|(weights, _)| weights);
        let coupled = weights()
            .all(|(node, weight)| weight.is_finite() && (*weight == 0.0 || (*node as usize) < nodes));
        let stiff = state.factor_couplings.iter().all(|(_, block)| block.iter().all(|x| x.is_finite()));
        if !(coupled && stiff && (none || (state.factor_dt > 0.0 && state.factor_dt <= 1.0))) {
            return Err(DynamicFemError::State("what its factor was computed from is out of range"));
        }
        if none {
            self.factored_at = FactoredAt::default();
        } else {
            let before = std::mem::take(&mut self.factored_at);
            let at = FactoredAt {
                positions: state.factor_positions.clone(),
                dt: state.factor_dt,
                couplings: state.factor_couplings.clone(),
            };
            if let Err(error) = self.refactor(at, &Inputs::default(), &RigidResponse::default()) {
                // The former state could be factorised.
                if !before.positions.is_empty() {
                    self.refactor(before, &Inputs::default(), &RigidResponse::default())?;
                }
                return Err(error.into());
            }
        }
        self.positions.clone_from(&state.positions);
        self.velocities.clone_from(&state.velocities);
        self.accelerations.clone_from(&state.accelerations);
        self.debt = state.debt;
        Ok(())
    }
}
