//! Stale factor: after a cut, a body reuses the factor of its former mesh until the new one is ready.
//!
//! The quasi-Newton method needs an inverse Hessian only as an initial guess. The former factor covers all motions in
//! which new nodes move with their parents; the local effect of the cut is added (`local_correction.rs`; an additive
//! Schwarz method, Dryja and Widlund 1987). Steps converge to the same tolerance as with the new factor, so that
//! nothing jumps when it arrives.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidResponse;
use trocar_dynamics::tet_mesh::{NodeOrigin, TetMesh};

use super::config::DynamicFemError;
use super::incremental_potential::{Coupling, Inputs};
use super::local_correction::{CutNeighbourhood, NearCut};
use super::solver::{DynamicFem, FactoredAt};
use super::state::DynamicFemState;
use crate::linear_algebra::{BlockMatrix, FactorError, SupernodalCholesky};

/// A factor with its node numbering.
pub struct Analysis {
    /// Row of each node in elimination order; `None` for fixed ones.
    numbers: Vec<Option<u32>>,
    hessian: BlockMatrix,
    factor: SupernodalCholesky,
    factored_at: FactoredAt,
}

/// How nodes unknown to the factor move with its nodes.
pub(super) struct StaleFactor {
    births: Vec<NodeOrigin>,
    /// The factor's nodes that each new node moves with, and their weights.
    parents: Vec<Vec<(u32, f64)>>,
    near: NearCut,
}

/// The original nodes that each new one moves with.
fn parents(known: usize, births: &[NodeOrigin]) -> Vec<Vec<(u32, f64)>> {
    let mut parents: Vec<Vec<(u32, f64)>> = Vec::with_capacity(births.len());
    for birth in births {
        let mut own: Vec<(u32, f64)> = Vec::new();
        for (node, share) in [(birth.of[0], 1.0 - birth.share), (birth.of[1], birth.share)] {
            let of = match (node as usize).checked_sub(known) {
                Some(born) => parents.get(born).cloned().unwrap_or_default(),
                None => vec![(node, 1.0)],
            };
            for (node, weight) in of.into_iter().filter(|_| share != 0.0) {
                match own.iter_mut().find(|(known, _)| *known == node) {
                    Some((_, sum)) => *sum += weight * share,
                    None => own.push((node, weight * share)),
                }
            }
        }
        parents.push(own);
    }
    parents
}

impl DynamicFem {
    /// Whether it still uses the factor of its former mesh.
    #[must_use]
    pub fn has_stale_factor(&self) -> bool {
        self.lent.is_some()
    }

    /// Whether there is a factor to reuse after a cut.
    #[must_use]
    pub fn has_factor(&self) -> bool {
        !self.factored_at.positions.is_empty()
    }

    /// Number of symbolic factorisations done during steps.
    #[must_use]
    pub fn analysed(&self) -> u32 {
        self.analysed
    }

    /// Computes its factor at these node positions \[m\], for steps of `dt` seconds, with these couplings.
    ///
    /// # Errors
    /// Lists of other lengths; the matrix could not be factorised.
    pub fn factor_at(
        &mut self,
        positions: &[Point3<f64>],
        dt: f64,
        couplings: &[Coupling],
    ) -> Result<(), DynamicFemError> {
        if positions.len() != self.positions.len() || !(dt > 0.0 && dt <= 1.0) {
            return Err(DynamicFemError::State("what its factor is to be computed from is of another body"));
        }
        let (positions, couplings) = (positions.to_vec(), couplings.to_vec());
        let at = FactoredAt { positions, dt, couplings };
        Ok(self.refactor(at, &Inputs::default(), &RigidResponse::default())?)
    }

    /// Extracts the factor.
    #[must_use]
    pub fn into_analysis(self) -> Analysis {
        let Self { numbers, hessian, factor, factored_at, .. } = self;
        Analysis { numbers, hessian, factor, factored_at }
    }

    /// Replaces the mesh after a cut: these of its nodes are fixed, new nodes come after the former ones, and `change`
    /// repeats the alterations of its elements. The former factor is reused until another is taken over.
    ///
    /// # Errors
    /// Not enough memory for a symbolic factorisation, which is needed at once where there is no former factor.
    pub fn split_nodes(
        &mut self,
        mesh: TetMesh,
        fixed: &[u32],
        born: &[NodeOrigin],
        change: impl FnOnce(&mut Self),
    ) -> Result<(), FactorError> {
        let lends = self.has_factor();
        let factored_at = std::mem::take(&mut self.factored_at);
        for birth in born {
            let mix = |a: &Vector3<f64>, b: &Vector3<f64>, share: f64| a + (b - a) * share;
            self.positions.push(birth.mix(&self.positions, |a, b, share| a + (b - a) * share));
            self.velocities.push(birth.mix(&self.velocities, mix));
            self.accelerations.push(birth.mix(&self.accelerations, mix));
        }
        let mut births = self.lent.take().map_or_else(Vec::new, |lent| lent.births);
        births.extend_from_slice(born);
        let known = mesh.rest().len() - births.len();
        self.mesh = mesh;
        self.derive_from_mesh(fixed);
        change(self);
        if !lends {
            return self.settle();
        }
        self.factored_at = factored_at;
        self.numbers.truncate(known);
        self.reuse_factor(births)
    }

    /// Continues from a state whose factor is the current or the reused one.
    pub fn resume(&mut self, state: &DynamicFemState) {
        self.positions.clone_from(&state.positions);
        self.velocities.clone_from(&state.velocities);
        self.accelerations.clone_from(&state.accelerations);
        self.debt = state.debt;
    }

    fn reuse_factor(&mut self, births: Vec<NodeOrigin>) -> Result<(), FactorError> {
        let known = self.numbers.len();
        self.numbers.resize(self.positions.len(), None);
        self.work.flat.clear();
        self.work.flat.resize(self.factor.rows(), 0.0);
        if births.is_empty() {
            return Ok(());
        }
        let parents = parents(known, &births);
        // Where the factor was computed, so that a restored body does the same.
        let mut places = self.factored_at.positions.clone();
        for birth in &births {
            places.push(birth.mix(&places, |a, b, share| a + (b - a) * share));
        }
        let about = CutNeighbourhood {
            element_forces: self.element_forces(self.factored_at.dt, &[]),
            masses: &self.mass.lumped,
            is_fixed: &self.fixed,
            known,
            parents: &parents,
        };
        let near = NearCut::new(&about, &places).or_else(|_| NearCut::new(&about, self.mesh.rest()));
        match near {
            Ok(near) => self.lent = Some(StaleFactor { births, parents, near }),
            // Too distorted for the former factor.
            Err(_) => self.settle()?,
        }
        Ok(())
    }

    /// Takes over a factor of its mesh before these nodes were added; of its current mesh if there are none.
    ///
    /// # Errors
    /// Not enough memory.
    pub fn take_over(&mut self, analysis: Analysis, births: &[NodeOrigin]) -> Result<(), FactorError> {
        let Analysis { numbers, hessian, factor, factored_at } = analysis;
        (self.numbers, self.hessian, self.factor) = (numbers, hessian, factor);
        (self.factored_at, self.debt, self.lent) = (factored_at, 0, None);
        self.reuse_factor(births.to_vec())
    }

    /// Does the symbolic factorisation of the current mesh at once; the factor is still to be computed.
    ///
    /// # Errors
    /// Not enough memory.
    pub(super) fn settle(&mut self) -> Result<(), FactorError> {
        let (numbers, hessian, factor) = Self::analyse(&self.mesh, &self.fixed)?;
        (self.numbers, self.hessian, self.factor) = (numbers, hessian, factor);
        (self.factored_at, self.lent) = (FactoredAt::default(), None);
        self.analysed += 1;
        self.reuse_factor(Vec::new())
    }
}

/// Applies the approximate inverse Hessian to vectors of the nodes.
pub(super) fn solve(
    factor: &mut SupernodalCholesky,
    numbers: &[Option<u32>],
    lent: Option<&mut StaleFactor>,
    flat: &mut [f64],
    vector: &mut [Vector3<f64>],
) {
    let known = numbers.len() - lent.as_ref().map_or(0, |lent| lent.births.len());
    for (node, number) in numbers.iter().enumerate() {
        if let Some(number) = number {
            flat[3 * *number as usize..][..3].copy_from_slice(vector[node].as_slice());
        }
    }
    let of_born = lent.iter().flat_map(|lent| &lent.parents).zip(&vector[known..]);
    for (parents, own) in of_born {
        for &(node, share) in parents {
            let Some(number) = numbers[node as usize] else { continue };
            (0..3).for_each(|axis| flat[3 * number as usize + axis] += own[axis] * share);
        }
    }
    factor.solve(flat);
    let of = |number: u32| Vector3::from_column_slice(&flat[3 * number as usize..][..3]);
    let of_node = |node: u32| numbers[node as usize].map_or_else(Vector3::zeros, of);
    let Some(lent) = lent else {
        (0_u32..).zip(vector).for_each(|(node, own)| *own = of_node(node));
        return;
    };
    lent.near.load(vector);
    for (node, own) in (0_u32..).zip(vector.iter_mut()) {
        *own = match (node as usize).checked_sub(known) {
            Some(born) => lent.parents[born].iter().map(|&(node, share)| of_node(node) * share).sum(),
            None => of_node(node),
        };
    }
    lent.near.add(vector);
}
