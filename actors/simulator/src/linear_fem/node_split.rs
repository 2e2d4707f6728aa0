//! Splitting nodes of a body with a precomputed inverse: until there is a new inverse, the old one is corrected
//! (`low_rank_update.rs`), by three unknowns for each split node.
//!
//! Parts without other support are held in place by bonds from each copy to its original node, of a millionth of an
//! element's stiffness, in corrected and new inverses alike: a body without inertia cannot fall.

use nalgebra::Vector3;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::attachment::{Attachment, Handle, Hold};
use super::bounds::{BATCH, REMNANT, UNKNOWNS_MAX};
use super::error::LinearFemError;
use super::low_rank_update::{Change, Correction, CorrectionInputs};
use super::solver::LinearFem;

/// Stiffness of a bond \[N/m\]: a fraction of Young's modulus times an edge length that topology changes do not affect.
pub(super) fn bond(mesh: &TetMesh, material: &Elastic) -> f64 {
    let mean = mesh.volume() / mesh.tets().len().max(1) as f64;
    REMNANT * material.young_modulus() * mean.cbrt()
}

impl LinearFem {
    /// Runs a change of the correction with the current inverse.
    pub(super) fn corrected<T>(
        &mut self,
        change: impl FnOnce(&mut Correction, &mut CorrectionInputs<'_>) -> T,
    ) -> T {
        let Self { mesh, material, boundary, factor, correction, .. } = self;
        change(correction, &mut CorrectionInputs { mesh, material, boundary, factor })
    }

    /// The free surface nodes, ascending: those of its inverse, and their copies. Interior nodes exposed by a cut are
    /// included only in the next inverse.
    #[must_use]
    pub fn nodes(&self) -> &[u32] {
        &self.touched
    }

    /// Number of entries of its factor: a sparse solve reads each twice.
    #[must_use]
    pub fn factor_entries(&self) -> usize {
        self.factor.entries()
    }

    /// Whether its inverse is that of an earlier body, corrected.
    #[must_use]
    pub fn is_corrected(&self) -> bool {
        !self.correction.parents.is_empty() || self.correction.unknowns() > 0
    }

    /// Number of split nodes in the mesh that still move with their originals.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.correction.waiting()
    }

    /// Whether another of them can be released.
    #[must_use]
    pub fn can_release(&self) -> bool {
        self.waiting() > 0 && self.correction.unknowns() + 3 <= UNKNOWNS_MAX
    }

    /// Replaces the mesh by one with split nodes: the new nodes come after all others, are copies of the nodes in
    /// `parents`, each an earlier one, and lie at the same positions. They move with these until
    /// [`Self::release_nodes`], so that the response is unchanged at first. A dead load stays on its former nodes: set
    /// it anew.
    ///
    /// # Errors
    /// A mesh that is no such split of this body.
    pub fn split_nodes(&mut self, mesh: &TetMesh, parents: &[u32]) -> Result<(), LinearFemError> {
        let before = self.mesh.rest().len();
        let fits = mesh.rest().len() == before + parents.len()
            && mesh.tets().len() == self.mesh.tets().len()
            && (before..).zip(parents).all(|(node, parent)| (*parent as usize) < node);
        if !fits {
            return Err(LinearFemError::OtherMesh);
        }
        for (node, &parent) in (before as u32..).zip(parents) {
            if self.boundary.bear(parent) {
                self.touched.push(node);
            }
        }
        self.correction.bear(parents);
        self.mesh = mesh.clone();
        if !self.dead_load.is_empty() {
            self.dead_load.resize(mesh.rest().len(), Vector3::zeros());
        }
        Ok(())
    }

    /// Releases at most `most` split nodes, in the order in which they were added; constraints are kept. Each node
    /// costs three sparse solves and slows later steps slightly. Returns the number released: 0 when the inverse allows
    /// no more corrections and a new one is required.
    ///
    /// # Errors
    /// Only those of re-adding the existing constraints.
    pub fn release_nodes(&mut self, most: usize) -> Result<usize, LinearFemError> {
        if !self.can_release() {
            return Ok(0);
        }
        let state = self.state();
        let bond = bond(&self.mesh, &self.material);
        let mut done = 0;
        while done < most {
            match self.corrected(|correction, serving| correction.release(most - done, bond, serving)) {
                0 => break,
                more => done += more,
            }
        }
        self.enter_anew(&state)?;
        Ok(done)
    }

    /// Adds a constraint with a target \[m\]; where others already constrain the point partly, only in the remaining
    /// axes. Thus a detached piece follows a grasp at three points. No constraint is added where it would be redundant.
    ///
    /// # Errors
    /// As [`Self::hold`] and [`Self::set_target`], except redundancy.
    pub fn hold_at(
        &mut self,
        attachment: &Attachment,
        target: Vector3<f64>,
    ) -> Result<Vec<Handle>, LinearFemError> {
        let mut handles = Vec::new();
        match (self.hold(attachment.clone()), attachment.hold) {
            (Ok(handle), _) => handles.push(handle),
            (Err(LinearFemError::Dependent { .. }), Hold::Point) => {
                for axis in [Vector3::x_axis(), Vector3::y_axis(), Vector3::z_axis()] {
                    let along = Attachment { hold: Hold::Along(axis), ..attachment.clone() };
                    match self.hold(along) {
                        Ok(handle) => handles.push(handle),
                        Err(LinearFemError::Dependent { .. }) => {}
                        Err(error) => return Err(error),
                    }
                }
            }
            (Err(LinearFemError::Dependent { .. }), _) => {}
            (Err(error), _) => return Err(error),
        }
        handles.iter().try_for_each(|&handle| self.set_target(handle, target))?;
        Ok(handles)
    }

    /// Repeats the recorded changes of a body: from the mesh of its inverse to this one.
    pub(super) fn change_again(
        &mut self,
        parents: &[u32],
        tets: &[[u32; 4]],
        changes: &[Vec<Change>],
    ) -> Result<(), LinearFemError> {
        let known = self.correction.known;
        let (nodes, count) = (known + parents.len(), self.mesh.tets().len());
        let is_bad = (known..).zip(parents).any(|(node, parent)| *parent as usize >= node)
            || (!parents.is_empty() && tets.len() != count)
            || tets.iter().flatten().any(|node| *node as usize >= nodes);
        if is_bad {
            return Err(LinearFemError::State("its mesh is not one that this body becomes"));
        }
        let whole = self.mesh.tets().iter().map(|tet| tet.map(|node| self.correction.root(node))).collect();
        self.correction.put_back();
        self.boundary.forget(known);
        self.touched.truncate(self.boundary.surface.len());
        self.dead_load.clear();
        self.mesh = self.mesh.parted(known, &[], whole);
        if !parents.is_empty() {
            let mesh = self.mesh.parted(known, parents, tets.to_vec());
            self.split_nodes(&mesh, parents)?;
        }
        let bond = bond(&self.mesh, &self.material);
        let fails = || LinearFemError::State("its changes are not ones of this body");
        for batch in changes {
            if batch.len() > BATCH / 3 {
                return Err(fails());
            }
            let gone = batch.iter().map(|change| match change {
                Change::Gone(tet) if (*tet as usize) < count => Some(*tet),
                _ => None,
            });
            if let Some(gone) = gone.collect::<Option<Vec<u32>>>() {
                if self.corrected(|correction, serving| correction.take(&gone, serving)) < gone.len() {
                    return Err(fails());
                }
                continue;
            }
            let Some(&Change::Apart(last)) = batch.last() else { return Err(fails()) };
            let most = (last as usize + 1).saturating_sub(known + self.correction.released);
            self.corrected(|correction, serving| correction.release(most, bond, serving));
            if self.correction.changes().last() != Some(batch) {
                return Err(fails());
            }
        }
        Ok(())
    }
}
