//! Removal of elements from a body with a precomputed inverse: until there is a new inverse, the old one is corrected
//! (`low_rank_update.rs`) by the six deformation modes of each element.

use nalgebra::SMatrix;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::bounds::{BATCH, RANK, REMNANT, UNKNOWNS_MAX};
use super::error::LinearFemError;
use super::solver::LinearFem;
use crate::stiffness::stiffness_block;

/// U of one element: its six deformation modes, scaled by the square roots of their stiffness.
pub(super) fn root_of_stiffness(mesh: &TetMesh, material: &Elastic, tet: usize) -> SMatrix<f64, 12, RANK> {
    let (gradients, volume) = (mesh.gradients(tet), mesh.volumes()[tet]);
    let mut whole = SMatrix::<f64, 12, 12>::zeros();
    for i in 0..4 {
        for j in 0..4 {
            let block = stiffness_block(material, volume, &gradients[i], &gradients[j]);
            whole.fixed_view_mut::<3, 3>(3 * i, 3 * j).copy_from(&block);
        }
    }
    let eigen = whole.symmetric_eigen();
    let mut order: Vec<usize> = (0..12).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let mut root = SMatrix::<f64, 12, RANK>::zeros();
    for (column, &mode) in order.iter().take(RANK).enumerate() {
        let size = (eigen.eigenvalues[mode].max(0.0) * (1.0 - REMNANT)).sqrt();
        root.set_column(column, &(eigen.eigenvectors.column(mode) * size));
    }
    root
}

impl LinearFem {
    /// Removed elements, in order of removal.
    #[must_use]
    pub fn removed(&self) -> &[u32] {
        &self.correction.tets
    }

    /// Whether an element has been removed, before or after the inverse was computed.
    #[must_use]
    pub fn is_out(&self, tet: u32) -> bool {
        self.correction.is_out(tet)
    }

    /// How many elements can still be removed until a new inverse is required.
    #[must_use]
    pub fn removable(&self) -> usize {
        (UNKNOWNS_MAX - self.correction.unknowns()) / RANK
    }

    /// Removes elements, as a burn does; constraints are kept. Each element costs six sparse solves and slows later
    /// steps slightly: precompute a new body meanwhile, and swap.
    ///
    /// # Errors
    /// Missing or already removed elements, more than [`REMOVED_MAX`](super::REMOVED_MAX), or an element whose removal
    /// makes the correction numerically singular; the elements before it in the list are removed then.
    pub fn remove(&mut self, tets: &[u32]) -> Result<(), LinearFemError> {
        let state = self.state();
        let count = self.mesh.tets().len();
        let mut wrong = Ok(());
        let mut fit = Vec::new();
        for &tet in tets {
            if tet as usize >= count || self.correction.is_out(tet) || fit.contains(&tet) {
                wrong = Err(LinearFemError::NoElement { tet, tets: count });
            } else if fit.len() == self.removable() {
                wrong = Err(LinearFemError::TooManyRemoved);
            }
            if wrong.is_err() {
                break;
            }
            fit.push(tet);
        }
        for batch in fit.chunks(BATCH / RANK) {
            let done = self.corrected(|correction, serving| correction.take(batch, serving));
            if let Some(&tet) = batch.get(done) {
                wrong = Err(LinearFemError::Apart { tet });
                break;
            }
        }
        self.enter_anew(&state)?;
        wrong
    }
}
