//! Compliance on demand: displacements of all nodes per force at requested nodes, on the surface or inside. A node
//! costs a sparse solve when it is first requested; later evaluations are a sum of a few numbers.
//!
//! The path of a needle cannot be known beforehand and touches a few hundred nodes at most: so nothing is precomputed
//! but the factor, and everything stays in f64.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::compliance::{Boundary, Limits, PrecomputeError, factor};
use crate::linear_algebra::SupernodalCholesky;
use crate::stiffness::Bonds;

/// Columns of the inverse, computed on demand.
pub struct Columns {
    boundary: Boundary,
    factor: SupernodalCholesky,
    /// Start of the three columns of each node, if computed.
    of: Vec<Option<u32>>,
    values: Vec<f64>,
    nodes_max: usize,
}

impl Columns {
    /// Factorises the stiffness of a mesh with fixed nodes, for at most `nodes_max` requested nodes.
    ///
    /// # Errors
    /// As [`Compliance::precompute`](super::Compliance::precompute).
    pub fn new(
        mesh: &TetMesh,
        material: &Elastic,
        fixed: &[u32],
        nodes_max: usize,
    ) -> Result<Self, PrecomputeError> {
        let boundary = Boundary::new(mesh, fixed)?;
        // No dense surface part is stored.
        let limits = Limits { bytes_max: u64::MAX, ..Limits::default() };
        let factor = factor(mesh, material, &[], &Bonds::default(), &boundary, &limits)?;
        Ok(Self { of: vec![None; mesh.rest().len()], values: Vec::new(), boundary, factor, nodes_max })
    }

    /// Whether a node is free to move.
    #[must_use]
    pub fn is_free(&self, node: u32) -> bool {
        self.boundary.numbers[node as usize].is_some()
    }

    /// Number of nodes with columns.
    #[must_use]
    pub fn known(&self) -> usize {
        self.values.len() / (9 * self.boundary.free()).max(1)
    }

    /// Computes the columns of a node unless they exist; `false` when there is no room for more.
    ///
    /// # Panics
    /// When there is no such node.
    pub fn name(&mut self, node: u32) -> bool {
        let Some(number) = self.boundary.numbers[node as usize] else { return true };
        if self.of[node as usize].is_some() {
            return true;
        }
        if self.known() >= self.nodes_max {
            return false;
        }
        let rows = 3 * self.boundary.free();
        let begin = self.values.len();
        self.values.resize(begin + 3 * rows, 0.0);
        for axis in 0..3 {
            self.values[begin + axis * rows + 3 * number as usize + axis] = 1.0;
        }
        self.factor.solve(&mut self.values[begin..]);
        self.of[node as usize] = Some((begin / (3 * rows)) as u32);
        true
    }

    /// Displacement of `node` per force on the named node `by` \[m/N\]; zero for fixed nodes.
    #[must_use]
    pub fn between(&self, node: u32, by: u32) -> Matrix3<f64> {
        let (Some(row), Some(index)) = (self.boundary.numbers[node as usize], self.of[by as usize]) else {
            return Matrix3::zeros();
        };
        let rows = 3 * self.boundary.free();
        let column = |axis: usize| {
            let from = (3 * index as usize + axis) * rows + 3 * row as usize;
            Vector3::from_column_slice(&self.values[from..from + 3])
        };
        Matrix3::from_columns(&[column(0), column(1), column(2)])
    }

    /// Displacement of a node under forces \[N\] on named nodes \[m\].
    #[must_use]
    pub fn displacement(&self, node: u32, forces: &[(u32, Vector3<f64>)]) -> Vector3<f64> {
        forces.iter().map(|(by, force)| self.between(node, *by) * force).sum()
    }

    /// Displacements of all nodes under forces \[N\] on named nodes \[m\].
    pub fn displacements(
        &self,
        forces: &[(u32, Vector3<f64>)],
        full: &mut Vec<f64>,
        out: &mut Vec<Vector3<f64>>,
    ) {
        let rows = 3 * self.boundary.free();
        full.clear();
        full.resize(rows, 0.0);
        for (by, force) in forces {
            let Some(index) = self.of[*by as usize] else { continue };
            for axis in 0..3 {
                let column = &self.values[(3 * index as usize + axis) * rows..][..rows];
                let factor = force[axis];
                full.iter_mut().zip(column).for_each(|(to, from)| *to += factor * from);
            }
        }
        out.clear();
        out.extend(self.boundary.numbers.iter().map(|number| {
            number
                .map_or_else(Vector3::zeros, |row| Vector3::from_column_slice(&full[3 * row as usize..][..3]))
        }));
    }
}
