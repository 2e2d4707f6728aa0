//! A body that is no longer what it was: elements that are gone, elements that heat has stiffened and shrunk. Its inverse is
//! computed as that of any body, over the same nodes, with what touches the new surface.

use nalgebra::Vector3;

use super::compliance::{Boundary, Compliance, Limits, factor};
use super::error::LinearFemError;
use super::removal::REMNANT;
use super::solver::LinearFem;
use crate::elasticity::Elastic;
use crate::tet_mesh::{TetMesh, surface};

/// What has become of an element.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alteration {
    /// Times the stiffness it had; 0 when it is gone.
    pub stiffness: f64,
    /// Times the length at rest that it had.
    pub length: f64,
}

impl Alteration {
    /// As it was.
    pub const NONE: Self = Self { stiffness: 1.0, length: 1.0 };
    /// Gone.
    pub const GONE: Self = Self { stiffness: 0.0, length: 1.0 };
}

impl LinearFem {
    /// Precomputes a body of which each element is as `alterations` says, one per element, and begins at rest, pulled
    /// together by what has shrunk. What is gone leaves as little behind as [`LinearFem::remove`] does.
    ///
    /// # Errors
    /// As [`Compliance::precompute`]; another number of alterations than of elements, or one out of range.
    pub fn altered(
        mesh: TetMesh,
        material: &Elastic,
        alterations: &[Alteration],
        fixed: &[u32],
        limits: &Limits,
        progress: &mut dyn FnMut(f64) -> bool,
    ) -> Result<Self, LinearFemError> {
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
        let boundary = Boundary::touched(&mesh, fixed, &outside)?;
        let factor = factor(&mesh, material, &weights, &boundary, limits)?;
        // Of no file's: what burns today does not burn tomorrow.
        let compliance = Compliance::from_factor(0, &boundary, &factor, progress)?;
        let shrinking = shrinking(&mesh, material, alterations);
        let mut body = Self::assembled(mesh, *material, boundary, factor, compliance);
        body.removal.weights = weights;
        body.set_dead_load(&shrinking)?;
        Ok(body)
    }
}

/// Forces on all nodes of what would be shorter than it is held \[N\]: the stress of the missing strain, (3λ + 2μ)(l − 1),
/// over each element.
fn shrinking(mesh: &TetMesh, material: &Elastic, alterations: &[Alteration]) -> Vec<Vector3<f64>> {
    let mut forces = vec![Vector3::zeros(); mesh.rest().len()];
    let modulus = 3.0 * material.lambda() + 2.0 * material.mu();
    let changed = alterations.iter().enumerate().filter(|(_, of)| of.length != 1.0 && of.stiffness > 0.0);
    for (tet, of) in changed {
        let pressure = modulus * of.stiffness * (of.length - 1.0) * mesh.volumes()[tet];
        for (node, gradient) in mesh.tets()[tet].iter().zip(mesh.gradients(tet)) {
            forces[*node as usize] += gradient * pressure;
        }
    }
    forces
}
