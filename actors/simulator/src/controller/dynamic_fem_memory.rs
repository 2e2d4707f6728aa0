//! What a dynamic body needs to go on bit for bit besides where its vertices are and how they move.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError};

use crate::dynamic_fem::{Coupling, DynamicFem, DynamicFemState};
use crate::tet_mesh::Birth;

/// Where the last step ended beside its positions and velocities: where the next one begins to look, and from where the
/// factor is that it uses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DynamicFemMemory {
    /// Accelerations of the vertices in the last step \[m/s²\].
    pub accelerations: Arc<Vec<Vector3<f64>>>,
    /// Iterations that the factor has cost beyond those of a new one.
    pub debt: u32,
    /// Where the vertices were when the factor was computed \[m\]; empty if there is none.
    pub factor_positions: Arc<Vec<Point3<f64>>>,
    /// For which step \[s\].
    pub factor_dt: f64,
    /// With which springs and contacts.
    pub factor_couplings: Vec<Coupling>,
}

impl Component for DynamicFemMemory {
    const NAME: &'static str = "dynamic_fem_memory";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

impl DynamicFemMemory {
    /// Takes over what a solver has; lists that are as before are not copied.
    pub fn take(&mut self, solver: &DynamicFem) {
        let DynamicFemState { accelerations, debt, factor_positions, factor_dt, factor_couplings, .. } =
            solver.state();
        self.accelerations = Arc::new(accelerations);
        self.debt = debt;
        if *self.factor_positions != factor_positions {
            self.factor_positions = Arc::new(factor_positions);
        }
        self.factor_dt = factor_dt;
        self.factor_couplings = factor_couplings;
    }

    /// There are new vertices: the factor is none of this body any longer.
    pub fn split(&mut self, born: &[Birth]) {
        let accelerations = Arc::make_mut(&mut self.accelerations);
        for birth in born {
            accelerations.push(birth.mix(accelerations, |a, b, share| a + (b - a) * share));
        }
        *self = Self { accelerations: self.accelerations.clone(), ..Self::default() };
    }

    /// The state of a solver, with positions \[m\] and velocities \[m/s\] of the scene. A memory of another number of
    /// vertices is none.
    #[must_use]
    pub fn state(&self, positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> DynamicFemState {
        let fits = self.accelerations.len() == positions.len();
        let memory = if fits { self.clone() } else { Self::default() };
        let accelerations = match fits {
            true => memory.accelerations.to_vec(),
            false => vec![Vector3::zeros(); positions.len()],
        };
        DynamicFemState {
            positions: positions.to_vec(),
            velocities: velocities.to_vec(),
            accelerations,
            debt: memory.debt,
            factor_positions: memory.factor_positions.to_vec(),
            factor_dt: memory.factor_dt,
            factor_couplings: memory.factor_couplings,
        }
    }
}
