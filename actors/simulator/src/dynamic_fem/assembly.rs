//! Data derived from the mesh of a body: elimination order, sparsity pattern, elements and masses.

use nalgebra::Vector3;
use trocar_dynamics::tet_mesh::TetMesh;

use super::config::MassMatrix;
use super::incremental_potential::{Mass, elements};
use super::lbfgs::Memory;
use super::solver::DynamicFem;
use crate::linear_algebra::{BlockMatrix, FactorError, SupernodalCholesky, minimum_degree};
use crate::stiffness::{consistent_mass, pattern};

impl DynamicFem {
    /// Elimination order of the free nodes, sparsity pattern, and symbolic factor.
    pub(super) fn analyse(
        mesh: &TetMesh,
        is_fixed: &[bool],
    ) -> Result<(Vec<Option<u32>>, BlockMatrix, SupernodalCholesky), FactorError> {
        let nodes = mesh.rest().len();
        let members: Vec<u32> = (0..nodes as u32).filter(|&node| !is_fixed[node as usize]).collect();
        let mut local = vec![None; nodes];
        members.iter().enumerate().for_each(|(index, &node)| local[node as usize] = Some(index as u32));
        let edges = mesh.tets().iter().flat_map(|tet| {
            let own = tet.map(|node| local[node as usize]);
            (0..4).flat_map(move |i| (0..i).filter_map(move |j| Some((own[i]?, own[j]?))))
        });
        let order = minimum_degree(members.len(), edges);
        let mut numbers = vec![None; nodes];
        for (row, &index) in order.iter().enumerate() {
            numbers[members[index as usize] as usize] = Some(row as u32);
        }
        let hessian = BlockMatrix::zeros(pattern(mesh, &numbers, members.len()));
        let factor = SupernodalCholesky::new(hessian.pattern(), 1)?;
        Ok((numbers, hessian, factor))
    }

    /// Derives everything from the mesh except the factor.
    pub(super) fn derive_from_mesh(&mut self, fixed: &[u32]) {
        let (mesh, density) = (&self.mesh, self.config.density);
        let nodes = mesh.rest().len();
        let consistent = (self.config.mass == MassMatrix::Consistent).then(|| {
            let all: Vec<_> = (0..nodes as u32).map(Some).collect();
            consistent_mass(mesh, density, &all, nodes)
        });
        let [lambda, mu] = self.lame;
        let stiff = lambda.abs() + 2.0 * mu;
        let extent = mesh.rest().iter().map(|point| point.coords.amax()).fold(0.0, f64::max);
        let springs = mesh.inverse_shapes().iter().zip(mesh.volumes());
        let squares: f64 =
            springs.map(|(shape, volume)| (shape.norm_squared() * volume * stiff).powi(2)).sum();
        self.rounding = 1e-14 * stiff * mesh.volume();
        self.floor = 2.0 * f64::EPSILON * extent * squares.sqrt();
        self.elements = elements(mesh);
        self.mass = Mass { lumped: mesh.lumped_masses(density), consistent };
        self.around = vec![0; nodes];
        mesh.tets().iter().flatten().for_each(|&node| self.around[node as usize] += 1);
        self.fixed = vec![false; nodes];
        for &node in fixed {
            if let Some(is_fixed) = self.fixed.get_mut(node as usize) {
                *is_fixed = true;
            }
        }
        self.memory = Memory::new(nodes);
        self.work.product = vec![Vector3::zeros(); nodes];
    }
}
