//! Elements that are taken out of a body whose inverse was precomputed: until there is a new inverse, the old one is
//! corrected. An element's stiffness has rank six, so that without it the inverse is, by the formula of Woodbury (1950),
//! K⁻¹ + Y S⁻¹ Yᵀ with Y = K⁻¹ U and S = 1 − Uᵀ Y, where U Uᵀ is the stiffness that was taken. This is no approximation;
//! it only becomes dearer with every element.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, SMatrix, SVector};

use super::compliance::Boundary;
use super::error::LinearFemError;
use super::solver::LinearFem;
use crate::elasticity::{Elastic, stiffness_block};
use crate::sparse::SparseCholesky;
use crate::tet_mesh::TetMesh;

/// Elements that can be taken out until a new inverse is due.
pub const REMOVED_MAX: usize = 64;
/// Share of its stiffness that an element leaves behind, so that nodes that lose their last element, and parts that hang
/// by one node, stay somewhere.
pub(super) const REMNANT: f64 = 1e-6;
/// Rank of an element's stiffness.
const RANK: usize = 6;

/// What has been taken out, and the correction that it is.
#[derive(Default)]
pub(super) struct Removal {
    /// Which, in the order in which they went.
    pub tets: Vec<u32>,
    /// Stiffness of each element in the factor, of what its material has; empty for all of it.
    pub weights: Vec<f64>,
    /// Rows and columns of U that are not zero: for every element its nodes' rows, six columns over them.
    columns: Vec<([Option<u32>; 4], SMatrix<f64, 12, RANK>)>,
    /// Y, over all free nodes, column after column.
    y: Vec<Vec<f64>>,
    s: Option<Cholesky<f64, Dyn>>,
}

/// A sparse force f as the correction sees it: Yᵀ f, and S⁻¹ of that. Between two forces the correction of the compliance is
/// the product of the one's parts and the other's shares.
#[derive(Clone, Debug)]
pub(super) struct Through {
    pub parts: DVector<f64>,
    pub shares: DVector<f64>,
}

impl Removal {
    /// Takes one more element out; `false`, and nothing has changed, where the body would not bear it.
    pub fn take(
        &mut self,
        tet: u32,
        mesh: &TetMesh,
        material: &Elastic,
        boundary: &Boundary,
        factor: &mut SparseCholesky,
    ) -> bool {
        let rows = mesh.tets()[tet as usize].map(|node| boundary.numbers[node as usize]);
        let u = root_of_stiffness(mesh, material, tet as usize) * self.weight(tet).sqrt();
        let count = 3 * boundary.free();
        let mut all = vec![0.0; RANK * count];
        for (column, y) in all.chunks_exact_mut(count).enumerate() {
            for (corner, row) in rows.iter().enumerate() {
                let Some(row) = row else { continue };
                for axis in 0..3 {
                    y[3 * *row as usize + axis] += u[(3 * corner + axis, column)];
                }
            }
        }
        factor.solve(&mut all);
        self.y.extend(all.chunks_exact(count).map(<[f64]>::to_vec));
        self.columns.push((rows, u));
        self.tets.push(tet);
        let size = self.y.len();
        let mut s = DMatrix::identity(size, size);
        for (column, y) in self.y.iter().enumerate() {
            for (element, part) in self.columns.iter().map(|parts| against(parts, y)).enumerate() {
                for (k, value) in part.iter().enumerate() {
                    s[(RANK * element + k, column)] -= value;
                }
            }
        }
        match Cholesky::new(s) {
            Some(factored) => {
                self.s = Some(factored);
                true
            }
            None => {
                self.y.truncate(size - RANK);
                self.columns.pop();
                self.tets.pop();
                false
            }
        }
    }

    /// Puts everything back that was taken out of the factor.
    pub fn put_back(&mut self) {
        *self = Self { weights: std::mem::take(&mut self.weights), ..Self::default() };
    }

    pub fn weight(&self, tet: u32) -> f64 {
        self.weights.get(tet as usize).copied().unwrap_or(1.0)
    }

    /// Whether an element is out, or was never in.
    pub fn is_out(&self, tet: u32) -> bool {
        self.weight(tet) <= REMNANT || self.tets.contains(&tet)
    }

    /// What a force does through what is missing. `None` where nothing is.
    pub fn through(&self, forces: impl Iterator<Item = (u32, [f64; 3])> + Clone) -> Option<Through> {
        let factored = self.s.as_ref()?;
        let parts = DVector::from_iterator(
            self.y.len(),
            self.y.iter().map(|y| {
                forces.clone().map(|(row, force)| dot(&y[3 * row as usize..][..3], &force)).sum::<f64>()
            }),
        );
        let shares = factored.solve(&parts);
        Some(Through { parts, shares })
    }

    /// Corrects what the factor has solved for, over all free nodes: x + Y S⁻¹ Uᵀ x.
    pub fn correct(&self, x: &mut [f64]) {
        let Some(factored) = self.s.as_ref() else { return };
        let parts =
            self.columns.iter().flat_map(|parts| against(parts, x).iter().copied().collect::<Vec<_>>());
        let mut right = DVector::from_iterator(self.y.len(), parts);
        factored.solve_mut(&mut right);
        for (y, share) in self.y.iter().zip(right.iter()) {
            x.iter_mut().zip(y).for_each(|(x, y)| *x += share * y);
        }
    }

    /// Adds Y times shares over the rows of the free surface nodes.
    pub fn add_to_surface(&self, boundary: &Boundary, shares: &DVector<f64>, to: &mut [f32]) {
        for (y, share) in self.y.iter().zip(shares.iter()) {
            for (to, row) in to.chunks_exact_mut(3).zip(boundary.rows_of_surface()) {
                (0..3).for_each(|axis| to[axis] += (share * y[3 * row + axis]) as f32);
            }
        }
    }
}

fn dot(a: &[f64], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Uᵀ x for one element.
fn against((rows, u): &([Option<u32>; 4], SMatrix<f64, 12, RANK>), x: &[f64]) -> SVector<f64, RANK> {
    let mut own = SVector::<f64, 12>::zeros();
    for (corner, row) in rows.iter().enumerate() {
        if let Some(row) = row {
            (0..3).for_each(|axis| own[3 * corner + axis] = x[3 * *row as usize + axis]);
        }
    }
    u.tr_mul(&own)
}

/// U of one element: its six modes that are no motion as a whole, times the roots of their stiffness.
fn root_of_stiffness(mesh: &TetMesh, material: &Elastic, tet: usize) -> SMatrix<f64, 12, RANK> {
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
    /// Elements that have been taken out, in the order in which they went.
    #[must_use]
    pub fn removed(&self) -> &[u32] {
        &self.removal.tets
    }

    /// Whether an element has been taken out, or was gone when the inverse was computed.
    #[must_use]
    pub fn is_out(&self, tet: u32) -> bool {
        self.removal.is_out(tet)
    }

    /// Takes elements out of the body, as a cut or a burn does; what is held stays held. Each costs six sparse solves, and
    /// makes what follows a little dearer: precompute a new body meanwhile, and swap.
    ///
    /// # Errors
    /// Elements that there are none of or that are gone already, more than [`REMOVED_MAX`], or one without which the body
    /// would fall apart in a way that rounding decides; those before it in the list are out then.
    pub fn remove(&mut self, tets: &[u32]) -> Result<(), LinearFemError> {
        let state = self.state();
        let mut done = Ok(());
        for &tet in tets {
            let count = self.mesh.tets().len();
            if tet as usize >= count || self.removal.is_out(tet) {
                done = Err(LinearFemError::NoElement { tet, tets: count });
            } else if self.removal.tets.len() == REMOVED_MAX {
                done = Err(LinearFemError::TooManyRemoved);
            } else if !self.removal.take(tet, &self.mesh, &self.material, &self.boundary, &mut self.factor) {
                done = Err(LinearFemError::Apart { tet });
            }
            if done.is_err() {
                break;
            }
        }
        self.enter_anew(&state)?;
        done
    }
}
