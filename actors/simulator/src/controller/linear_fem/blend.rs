//! A linear organ between two inverses: what a new one says is blended in, so that a hand does not feel the change. What has
//! burned away is out of both; what the new one brings is what coagulation has stiffened meanwhile, and what was too much to
//! be corrected for.
//!
//! Both answer the same contacts, and what is felt goes from the one's forces to the other's, in each tick by no more than a
//! share of what is felt. Nothing of it is in the scene: another life begins with the new inverse.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::TetMesh;

use super::contacts::Answer;
use super::warm_start::Holding;
use crate::linear_fem::{Attachment, LinearFem, LinearFemError};

/// Change of what is felt in a tick, as a share of it.
const CHANGE: f64 = 0.02;
/// What is felt at least, for that \[N\].
const FELT_MIN: f64 = 1e-3;
/// Smallest and largest step towards the new inverse: 500 ticks at most.
const STEP: [f64; 2] = [0.002, 0.25];

/// Tells an inverse of what has come apart since it was computed: the body has this mesh now, of which the last nodes were those
/// of `parents`.
pub(crate) fn catch_up(
    solver: &mut LinearFem,
    mesh: &TetMesh,
    parents: &[u32],
) -> Result<(), LinearFemError> {
    let missing = mesh.rest().len().saturating_sub(solver.mesh().rest().len());
    match parents.len().checked_sub(missing) {
        Some(known) if missing > 0 => solver.come_apart(mesh, &parents[known..]),
        _ => Ok(()),
    }
}

/// An inverse that fades.
pub(crate) struct Fading {
    old: Box<LinearFem>,
    /// Of the new inverse in what is felt.
    share: f64,
    /// What the old one holds of the answers, and what that takes.
    holding: Holding,
    forces: Vec<Vector3<f64>>,
    /// Size of what is felt, and by how much the two inverses differ in it \[N\].
    felt: f64,
    change: f64,
    moved: Vec<Vector3<f64>>,
}

impl Fading {
    /// Of an inverse that a new one has just replaced.
    pub fn new(old: Box<LinearFem>) -> Self {
        let (holding, forces, moved) = (Holding::default(), Vec::new(), Vec::new());
        Self { old, share: 0.0, holding, forces, felt: 0.0, change: 0.0, moved }
    }

    /// Takes elements out of the old one, too, so many at most and as far as it bears that: what it does not, fades with it.
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

    /// Lets the old one follow a body that has come apart, by so many nodes at most.
    pub fn come_apart(&mut self, mesh: &TetMesh, parents: &[u32], most: usize) -> Result<(), LinearFemError> {
        catch_up(&mut self.old, mesh, parents)?;
        self.old.release_nodes(most).map(drop)
    }

    /// Nodes that go with the ones that they were still, where nothing of the new one is felt yet.
    pub fn waiting(&self) -> Option<usize> {
        self.is_unfelt().then(|| self.old.waiting())
    }

    /// Whether nothing of the new one is felt yet.
    pub fn is_unfelt(&self) -> bool {
        self.share == 0.0
    }

    /// Whether nothing of the new one is felt yet, and the element is out of the old one.
    pub fn hides(&self, tet: u32) -> bool {
        self.is_unfelt() && self.old.is_out(tet)
    }

    /// Lets go of everything that is not held from the last tick on, as [`Holding::keep`] says.
    pub fn keep<'a>(&mut self, wanted: impl Iterator<Item = &'a Attachment>) -> Result<(), LinearFemError> {
        self.holding.keep(&mut self.old, wanted)
    }

    /// Holds what the new one holds, too.
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

    /// Blends the old one's forces into answers that have the new one's.
    pub fn blend_forces(&mut self, answers: &mut [Answer]) -> Result<(), LinearFemError> {
        (self.felt, self.change) = (0.0, 0.0);
        self.holding.forces(&mut self.old, &mut self.forces)?;
        for (place, (answer, old)) in answers.iter_mut().zip(&self.forces).enumerate() {
            if !self.holding.holds(place) {
                continue;
            }
            let new = answer.force;
            answer.force = old.lerp(&new, self.share);
            self.felt += answer.force.norm();
            self.change += (new - old).norm();
        }
        Ok(())
    }

    /// Blends in where the old one has nodes of its surface, of which the new one has `nodes`, ascending.
    pub fn blend_surface(&mut self, nodes: &[u32], rest: &[Point3<f64>], positions: &mut [Point3<f64>]) {
        self.old.surface_displacements(&mut self.moved);
        for (node, moved) in self.old.nodes().iter().zip(&self.moved) {
            if nodes.binary_search(node).is_ok() {
                let (node, new) = (*node as usize, positions[*node as usize]);
                positions[node] = (rest[node] + moved).lerp(&new, self.share);
            }
        }
    }

    /// How far all nodes are moved by the two, of which the new one is `solver`.
    pub fn displacements(&mut self, solver: &mut LinearFem, moved: &mut Vec<Vector3<f64>>) {
        if self.is_unfelt() {
            self.old.displacements(moved);
            return;
        }
        solver.displacements(moved);
        self.old.displacements(&mut self.moved);
        for (new, old) in moved.iter_mut().zip(&self.moved) {
            *new = old.lerp(new, self.share);
        }
    }

    /// Goes on for the next tick; whether nothing of the old one is left.
    pub fn is_over(&mut self) -> bool {
        let [least, most] = STEP;
        let step = CHANGE * self.felt.max(FELT_MIN) / self.change.max(f64::MIN_POSITIVE);
        self.share += step.clamp(least, most);
        self.share >= 1.0
    }
}
