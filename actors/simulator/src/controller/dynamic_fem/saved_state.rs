//! State of a dynamic body that a bit-identical restart needs in addition to positions and velocities.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::{Component, RecordPolicy, SimTime};

use crate::dynamic_fem::{Coupling, DynamicFem, DynamicFemState};

/// Solver state after the last step, besides positions and velocities: the initial guess of the next step, and the
/// origin of the factor in use.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "dynamic_fem_memory", record = RecordPolicy::sampled(2.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct DynamicFemMemory {
    /// Accelerations of the vertices in the last step \[m/s²\].
    pub accelerations: Arc<Vec<Vector3<f64>>>,
    /// Additional iterations that the factor's age has cost, compared with a new one.
    pub debt: u32,
    /// Vertex positions at the factorisation \[m\]; empty if there is no factor.
    pub factor_positions: Arc<Vec<Point3<f64>>>,
    /// Step length of the factorisation \[s\].
    pub factor_dt: f64,
    /// Springs and contacts of the factorisation.
    pub factor_couplings: Vec<Coupling>,
    /// A factor of the mesh before a topology change, and the job for its successor.
    pub lent: Option<LentFactor>,
    /// Number of jobs so far.
    pub jobs: u64,
}

/// A factor that is still used after a topology change.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LentFactor {
    /// Its elements; its nodes are the first ones of the body.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Origins of all nodes added since.
    pub births: Arc<Vec<NodeOrigin>>,
    /// The factor in progress.
    pub wanted: Option<WantedFactor>,
}

/// A factor that a background job computes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WantedFactor {
    /// Its elements.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Node positions at the factorisation \[m\].
    pub positions: Arc<Vec<Point3<f64>>>,
    /// Step length \[s\].
    pub dt: f64,
    /// Time from which it is used, if it is ready.
    pub due: SimTime,
    /// Number of the job.
    pub key: u64,
}

impl DynamicFemMemory {
    /// Copies the state of a solver; unchanged lists are shared.
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
        if !solver.has_stale_factor() {
            self.lent = None;
        }
    }

    /// Adds new vertices: the factor is now one of the former mesh, with the elements `before` if it was up to date.
    pub fn split(&mut self, born: &[NodeOrigin], before: impl FnOnce() -> Vec<[u32; 4]>) {
        let lent =
            self.lent.get_or_insert_with(|| LentFactor { tets: Arc::new(before()), ..LentFactor::default() });
        Arc::make_mut(&mut lent.births).extend_from_slice(born);
    }

    /// Checks the factor's data against a body with this many nodes.
    #[must_use]
    pub fn fits(&self, nodes: usize) -> bool {
        let Some(lent) = &self.lent else { return false };
        let known = self.factor_positions.len();
        let is_of =
            |tets: &[[u32; 4]], nodes: usize| tets.iter().flatten().all(|node| (*node as usize) < nodes);
        let mut births = (known..).zip(lent.births.iter());
        let wanted = lent.wanted.as_ref().is_none_or(|wanted| {
            (known..=nodes).contains(&wanted.positions.len()) && is_of(&wanted.tets, wanted.positions.len())
        });
        known > 0
            && known + lent.births.len() == nodes
            && self.accelerations.len() == nodes
            && is_of(&lent.tets, known)
            && births.all(|(node, birth)| birth.of.iter().all(|of| (*of as usize) < node))
            && wanted
    }

    /// The state of a solver, with positions \[m\] and velocities \[m/s\] of the scene. A saved state with another
    /// number of vertices is ignored.
    #[must_use]
    pub fn state(&self, positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> DynamicFemState {
        let fits = self.accelerations.len() == positions.len();
        let mut memory = if fits { self.clone() } else { Self::default() };
        if memory.lent.is_some() {
            // Those of the former mesh.
            memory.factor_positions = Arc::default();
            memory.factor_couplings.clear();
        }
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
