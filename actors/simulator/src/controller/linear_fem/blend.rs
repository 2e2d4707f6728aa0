//! Blends a linear organ from one inverse to the next, so that the hand feels no jump. Burned elements are out of both;
//! the new inverse adds the stiffness of coagulated elements, and the changes that were too large for a low-rank
//! correction.
//!
//! Both inverses answer the same contacts, and the blend moves from the old forces to the new ones, in each tick by at
//! most a fraction of the contact force. The blend is not saved in the scene: after a restart the new inverse is used
//! at once.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::TetMesh;

use super::contacts::ConstraintReaction;
use super::warm_start::HeldConstraints;
use crate::linear_fem::{Attachment, LinearFem, LinearFemError};

/// Maximum change of the contact force per tick, relative to it.
const CHANGE: f64 = 0.02;
/// Minimum contact force for that limit \[N\].
const CONTACT_FORCE_MIN: f64 = 1e-3;
/// Minimum and maximum blend step: 500 ticks at most.
const STEP: [f64; 2] = [0.002, 0.25];

/// Applies the topology changes since its computation to an inverse: the body has this mesh now, whose last nodes
/// duplicate `parents`.
pub(crate) fn catch_up(
    solver: &mut LinearFem,
    mesh: &TetMesh,
    parents: &[u32],
) -> Result<(), LinearFemError> {
    let missing = mesh.rest().len().saturating_sub(solver.mesh().rest().len());
    match parents.len().checked_sub(missing) {
        Some(known) if missing > 0 => solver.split_nodes(mesh, &parents[known..]),
        _ => Ok(()),
    }
}

/// An old inverse that is blended out.
pub(crate) struct InverseBlend {
    old: Box<LinearFem>,
    /// Weight of the new inverse.
    share: f64,
    /// The old inverse's held places and their factor.
    holding: HeldConstraints,
    forces: Vec<Vector3<f64>>,
    /// Magnitude of the contact force, and its difference between the two inverses \[N\].
    contact_force: f64,
    change: f64,
    moved: Vec<Vector3<f64>>,
}

impl InverseBlend {
    /// From an inverse that was just replaced.
    pub fn new(old: Box<LinearFem>) -> Self {
        let (holding, forces, moved) = (HeldConstraints::default(), Vec::new(), Vec::new());
        Self { old, share: 0.0, holding, forces, contact_force: 0.0, change: 0.0, moved }
    }

    /// Removes elements from the old inverse too, at most this many and as far as it can be corrected; the others are
    /// blended out with it.
    pub fn remove(&mut self, tets: &[u32], most: usize) -> Result<(), LinearFemError> {
        let left = tets.iter().copied().filter(|tet| !self.old.is_out(*tet));
        let left: Vec<u32> = left.take(most).collect();
        let mut left = &left[..];
        while !left.is_empty() {
            match self.old.remove(left) {
                Err(LinearFemError::Apart { tet }) => {
                    let at = left.iter().position(|of| *of == tet).map_or(left.len(), |at| at + 1);
                    left = &left[at..];
                }
                Ok(()) | Err(LinearFemError::TooManyRemoved) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Applies a topology change to the old inverse, by at most this many nodes.
    pub fn split_nodes(
        &mut self,
        mesh: &TetMesh,
        parents: &[u32],
        most: usize,
    ) -> Result<(), LinearFemError> {
        catch_up(&mut self.old, mesh, parents)?;
        self.old.release_nodes(most).map(drop)
    }

    /// Nodes still joined to their parents, while the new inverse has no weight.
    pub fn waiting(&self) -> Option<usize> {
        self.has_no_weight().then(|| self.old.waiting())
    }

    /// Whether the new inverse has no weight yet.
    pub fn has_no_weight(&self) -> bool {
        self.share == 0.0
    }

    /// Whether the new inverse has no weight yet, and the element is out of the old one.
    pub fn hides(&self, tet: u32) -> bool {
        self.has_no_weight() && self.old.is_out(tet)
    }

    /// Releases everything that is not kept from the last tick, as [`HeldConstraints::keep`] does.
    pub fn keep<'a>(&mut self, wanted: impl Iterator<Item = &'a Attachment>) -> Result<(), LinearFemError> {
        self.holding.keep(&mut self.old, wanted)
    }

    /// Holds the same as the new inverse.
    pub fn hold(
        &mut self,
        place: usize,
        attachment: &Attachment,
        target: Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        self.holding.hold(&mut self.old, place, attachment, target)
    }

    /// Moves what is held.
    pub fn set_target(&mut self, place: usize, target: Vector3<f64>) -> Result<(), LinearFemError> {
        self.holding.set_target(&mut self.old, place, target)
    }

    /// Blends the old inverse's forces into the new inverse's answers.
    pub fn blend_forces(&mut self, answers: &mut [ConstraintReaction]) -> Result<(), LinearFemError> {
        (self.contact_force, self.change) = (0.0, 0.0);
        self.holding.forces(&mut self.old, &mut self.forces)?;
        for (place, (answer, old)) in answers.iter_mut().zip(&self.forces).enumerate() {
            if !self.holding.holds(place) {
                continue;
            }
            let new = answer.force;
            answer.force = old.lerp(&new, self.share);
            self.contact_force += answer.force.norm();
            self.change += (new - old).norm();
        }
        Ok(())
    }

    /// Blends in the surface positions of the old inverse; `nodes`: surface nodes of the new one, ascending.
    pub fn blend_surface(&mut self, nodes: &[u32], rest: &[Point3<f64>], positions: &mut [Point3<f64>]) {
        self.old.surface_displacements(&mut self.moved);
        for (node, moved) in self.old.nodes().iter().zip(&self.moved) {
            if nodes.binary_search(node).is_ok() {
                let (node, new) = (*node as usize, positions[*node as usize]);
                positions[node] = (rest[node] + moved).lerp(&new, self.share);
            }
        }
    }

    /// Blended displacements of all nodes; `solver` is the new inverse.
    pub fn displacements(&mut self, solver: &mut LinearFem, moved: &mut Vec<Vector3<f64>>) {
        if self.has_no_weight() {
            self.old.displacements(moved);
            return;
        }
        solver.displacements(moved);
        self.old.displacements(&mut self.moved);
        for (new, old) in moved.iter_mut().zip(&self.moved) {
            *new = old.lerp(new, self.share);
        }
    }

    /// Advances to the next tick; returns whether the blend is complete.
    pub fn is_over(&mut self) -> bool {
        let [least, most] = STEP;
        let step = CHANGE * self.contact_force.max(CONTACT_FORCE_MIN) / self.change.max(f64::MIN_POSITIVE);
        self.share += step.clamp(least, most);
        self.share >= 1.0
    }
}
