//! What a dynamic body needs to go on bit for bit besides where its vertices are and how they move.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::tet_mesh::Birth;
use trocar_scene::{Component, ComponentError, SimTime};

use crate::dynamic_fem::{Coupling, DynamicFem, DynamicFemState};

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
    /// Where it is the factor of what the body was before it came apart: of what, and what is to follow.
    pub lent: Option<LentFactor>,
    /// Jobs so far.
    pub jobs: u64,
}

/// A factor that goes on serving a body that has come apart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LentFactor {
    /// The elements that it is of; its nodes are the first ones of the body.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Where all nodes come from that the body has besides.
    pub births: Arc<Vec<Birth>>,
    /// The one that is being computed.
    pub wanted: Option<WantedFactor>,
}

/// A factor that is computed beside the ticks.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WantedFactor {
    /// The elements that it is of.
    pub tets: Arc<Vec<[u32; 4]>>,
    /// Where the nodes were \[m\].
    pub positions: Arc<Vec<Point3<f64>>>,
    /// For which step \[s\].
    pub dt: f64,
    /// From when on it is to serve, if it is there.
    pub due: SimTime,
    /// The number of the job.
    pub key: u64,
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
        if !solver.is_lent() {
            self.lent = None;
        }
    }

    /// There are new vertices: the factor is one of what the body was, whose elements were `before` if it was whole.
    pub fn split(&mut self, born: &[Birth], before: impl FnOnce() -> Vec<[u32; 4]>) {
        let lent =
            self.lent.get_or_insert_with(|| LentFactor { tets: Arc::new(before()), ..LentFactor::default() });
        Arc::make_mut(&mut lent.births).extend_from_slice(born);
    }

    /// Whether what it tells of a factor can be of a body of so many nodes.
    #[must_use]
    pub fn lends_to(&self, nodes: usize) -> bool {
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

    /// The state of a solver, with positions \[m\] and velocities \[m/s\] of the scene. A memory of another number of
    /// vertices is none.
    #[must_use]
    pub fn state(&self, positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> DynamicFemState {
        let fits = self.accelerations.len() == positions.len();
        let mut memory = if fits { self.clone() } else { Self::default() };
        if memory.lent.is_some() {
            // Of what the body was.
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
