//! Altered bodies: removed elements, and elements stiffened and shrunk by heat. Their inverse is computed as for any
//! body, over the same nodes, for the new surface.

use nalgebra::Vector3;
use trocar_dynamics::elasticity::{Alteration, Elastic};
use trocar_dynamics::tet_mesh::{TetMesh, surface};

use super::bounds::REMNANT;
use super::compliance::{Boundary, Compliance, Limits, factor};
use super::error::LinearFemError;
use super::node_split::bond;
use super::solver::LinearFem;
use crate::stiffness::Bonds;

impl LinearFem {
    /// Precomputes a body with one alteration per element, which begins at rest, contracted by the shrunk elements.
    /// Removed elements keep a remnant stiffness as in [`LinearFem::remove`].
    ///
    /// # Errors
    /// As [`Compliance::precompute`]; a number of alterations other than that of elements, or one out of range.
    pub fn altered(
        mesh: TetMesh,
        material: &Elastic,
        alterations: &[Alteration],
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, LinearFemError> {
        Self::parted(mesh, material, alterations, &[], fixed, limits, progress)
    }

    /// The same for a body with split nodes: its last nodes are copies of those in `parents`. Bonds to these, of a
    /// millionth of its stiffness, hold parts that are otherwise free.
    ///
    /// # Errors
    /// As [`Self::altered`]; a parent that is no earlier node.
    pub fn parted(
        mesh: TetMesh,
        material: &Elastic,
        alterations: &[Alteration],
        parents: &[u32],
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, LinearFemError> {
        let first = mesh.rest().len().checked_sub(parents.len()).ok_or(LinearFemError::OtherMesh)?;
        let between: Vec<[u32; 2]> =
            (first as u32..).zip(parents).map(|(node, &parent)| [node, parent]).collect();
        if between.iter().any(|[node, parent]| parent >= node) {
            return Err(LinearFemError::OtherMesh);
        }
        let bonds = Bonds { between: &between, stiffness: bond(&mesh, material) };
        let count = mesh.tets().len();
        if alterations.len() != count {
            return Err(LinearFemError::Alterations { found: alterations.len(), tets: count });
        }
        let fits =
            |of: &Alteration| (0.0..=1e6).contains(&of.stiffness) && (0.01..=100.0).contains(&of.length);
        if let Some(tet) = alterations.iter().position(|of| !fits(of)) {
            return Err(LinearFemError::Alteration { tet: tet as u32 });
        }
        let there = |tet: &usize| alterations[*tet].stiffness > 0.0;
        let left: Vec<[u32; 4]> = (0..count).filter(there).map(|tet| mesh.tets()[tet]).collect();
        let mut outside: Vec<u32> = surface(&left).into_iter().flatten().collect();
        outside.sort_unstable();
        outside.dedup();
        let weights: Vec<f64> = alterations.iter().map(|of| of.stiffness.max(REMNANT)).collect();
        let boundary = Boundary::touched(&mesh, fixed, &outside, &between)?;
        let factor = factor(&mesh, material, &weights, &bonds, &boundary, limits)?;
        // Not for a cache file: alterations differ from run to run.
        let compliance = Compliance::from_factor(0, &boundary, &factor, progress)?;
        let mut body = Self::assembled(mesh, *material, boundary, factor, compliance);
        body.correction.weights = weights;
        body.shrink(alterations)?;
        Ok(body)
    }

    /// Contracts the body by its shrunk elements, one alteration per element, with the element stiffness in its
    /// inverse, so that a new inverse changes little. Replaces the dead load; one sparse solve.
    ///
    /// # Errors
    /// A number of alterations other than that of elements.
    pub fn shrink(&mut self, alterations: &[Alteration]) -> Result<(), LinearFemError> {
        let count = self.mesh.tets().len();
        if alterations.len() != count {
            return Err(LinearFemError::Alterations { found: alterations.len(), tets: count });
        }
        let modulus = 3.0 * self.material.lambda() + 2.0 * self.material.mu();
        let mut forces = vec![Vector3::zeros(); self.mesh.rest().len()];
        for (tet, of) in alterations.iter().enumerate() {
            if of.length == 1.0 || self.correction.is_out(tet as u32) {
                continue;
            }
            // The stress of the shrinkage strain, (3λ + 2μ)(l − 1).
            let stress = modulus * self.correction.weight(tet as u32) * (of.length - 1.0);
            let pull = stress * self.mesh.volumes()[tet];
            for (node, gradient) in self.mesh.tets()[tet].iter().zip(self.mesh.gradients(tet)) {
                forces[*node as usize] += gradient * pull;
            }
        }
        self.set_dead_load(&forces)
    }
}
