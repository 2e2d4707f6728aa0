//! Isotropic elasticity: its two constants, and the stiffness and mass of linear tetrahedra.
//!
//! Linear tetrahedra are over-stiff where they are coarse: a clamped beam five times as long as thick bends half as far as
//! it should with two layers of them, and four fifths as far with four (`tests/linear_fem_reference.rs`). What is to give
//! way as its modulus says takes some layers, or a modulus that was fitted on the mesh.

use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

use crate::sparse::{BlockMatrix, BlockPattern};
use crate::tet_mesh::TetMesh;

/// The largest ratio of Poisson that linear tetrahedra take: nearer to 0.5 they lock, that is, they bend far too little
/// because every element by itself keeps its volume (Hughes 2000, ch. 4).
pub const POISSON_MAX: f64 = 0.45;

/// Young's modulus and Poisson's ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elastic {
    young_modulus: f64,
    poisson_ratio: f64,
}

/// Constants that are no material's.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ElasticError {
    /// Not a positive number.
    #[error("Young's modulus is {0} Pa: above 0 is valid")]
    YoungModulus(f64),
    /// Outside what is stable, or where linear tetrahedra lock.
    #[error(
        "Poisson's ratio is {0}: above -1 and up to {POISSON_MAX} is valid; beyond it linear tetrahedra lock"
    )]
    PoissonRatio(f64),
}

impl Elastic {
    /// Young's modulus \[Pa\], above 0, and Poisson's ratio, above −1 and up to [`POISSON_MAX`].
    ///
    /// # Errors
    /// What is out of range.
    pub fn new(young_modulus: f64, poisson_ratio: f64) -> Result<Self, ElasticError> {
        if !(young_modulus > 0.0 && young_modulus.is_finite()) {
            return Err(ElasticError::YoungModulus(young_modulus));
        }
        if !(poisson_ratio > -1.0 && poisson_ratio <= POISSON_MAX) {
            return Err(ElasticError::PoissonRatio(poisson_ratio));
        }
        Ok(Self { young_modulus, poisson_ratio })
    }

    /// Young's modulus \[Pa\].
    #[must_use]
    pub fn young_modulus(&self) -> f64 {
        self.young_modulus
    }

    /// Poisson's ratio.
    #[must_use]
    pub fn poisson_ratio(&self) -> f64 {
        self.poisson_ratio
    }

    /// Lamé's first constant λ \[Pa\].
    #[must_use]
    pub fn lambda(&self) -> f64 {
        let nu = self.poisson_ratio;
        self.young_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    }

    /// The shear modulus μ \[Pa\].
    #[must_use]
    pub fn mu(&self) -> f64 {
        self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))
    }
}

/// The force on node a per displacement of node b of an element \[N/m\], from its volume and the gradients of their
/// shape functions.
#[must_use]
pub fn stiffness_block(material: &Elastic, volume: f64, a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let (lambda, mu) = (material.lambda(), material.mu());
    let shear = Matrix3::from_diagonal_element(mu * a.dot(b));
    (a * b.transpose() * lambda + b * a.transpose() * mu + shear) * volume
}

/// What has become of an element of tissue, a tetrahedron or a triangle.
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

/// Cauchy's stress \[Pa\] of a neo-Hookean material with Lamé's constants λ and μ \[Pa\] under a deformation gradient
/// (Bonet, Wood 1997): that of linear elasticity for small strains, whatever the rotation. Of what is turned inside out it is
/// that of what is pressed flat.
#[must_use]
pub fn cauchy_stress([lambda, mu]: [f64; 2], gradient: &Matrix3<f64>) -> Matrix3<f64> {
    let jacobian = gradient.determinant().max(1e-3);
    let left = gradient * gradient.transpose() - Matrix3::identity();
    (left * mu + Matrix3::from_diagonal_element(lambda * jacobian.ln())) / jacobian
}

/// The stress of linear elasticity \[Pa\], with Lamé's constants λ and μ \[Pa\], under a deformation gradient that is near to 1:
/// what it has of a rotation, which a linear displacement takes for a stretch, is left out.
#[must_use]
pub fn small_stress([lambda, mu]: [f64; 2], gradient: &Matrix3<f64>) -> Matrix3<f64> {
    let strain = (gradient + gradient.transpose()) * 0.5 - Matrix3::identity();
    strain * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * strain.trace())
}

/// The pattern of matrices over the nodes of a mesh for which `number` has one, and where they stand.
#[must_use]
pub fn pattern(mesh: &TetMesh, numbers: &[Option<u32>], count: usize) -> BlockPattern {
    BlockPattern::new(count, elements_of(mesh, numbers))
}

/// Pairs of nodes that have a number and an element in common.
fn elements_of(mesh: &TetMesh, numbers: &[Option<u32>]) -> impl Iterator<Item = (u32, u32)> {
    mesh.tets().iter().flat_map(|tet| {
        let own = tet.map(|node| numbers[node as usize]);
        (0..4).flat_map(move |i| (0..i).filter_map(move |j| Some((own[i]?, own[j]?))))
    })
}

/// The stiffness matrix over the nodes that have a number; the others are held.
#[must_use]
pub fn stiffness(mesh: &TetMesh, material: &Elastic, numbers: &[Option<u32>], count: usize) -> BlockMatrix {
    weighted_stiffness(mesh, material, &[], numbers, count)
}

/// The same where each element has so many times the stiffness of its material; an empty slice for once.
#[must_use]
pub fn weighted_stiffness(
    mesh: &TetMesh,
    material: &Elastic,
    weights: &[f64],
    numbers: &[Option<u32>],
    count: usize,
) -> BlockMatrix {
    bound_stiffness(mesh, material, weights, &Bonds::default(), numbers, count)
}

/// Springs of length 0 between nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bonds<'a> {
    /// The two nodes of each.
    pub between: &'a [[u32; 2]],
    /// Stiffness of each \[N/m\].
    pub stiffness: f64,
}

/// The same with bonds between nodes besides.
#[must_use]
pub fn bound_stiffness(
    mesh: &TetMesh,
    material: &Elastic,
    weights: &[f64],
    bonds: &Bonds<'_>,
    numbers: &[Option<u32>],
    count: usize,
) -> BlockMatrix {
    let of = |bond: &[u32; 2]| bond.map(|node| numbers[node as usize]);
    let pairs = bonds.between.iter().filter_map(|bond| Some((of(bond)[0]?, of(bond)[1]?)));
    let all = elements_of(mesh, numbers).chain(pairs);
    let mut matrix = BlockMatrix::zeros(BlockPattern::new(count, all));
    for bond in bonds.between {
        let [one, other] = of(bond);
        let block = Matrix3::from_diagonal_element(bonds.stiffness);
        [one, other].into_iter().flatten().for_each(|row| matrix.add(row, row, &block));
        if let (Some(one), Some(other)) = (one, other) {
            matrix.add(one.max(other), one.min(other), &-block);
        }
    }
    for (index, tet) in mesh.tets().iter().enumerate() {
        let gradients = mesh.gradients(index);
        let volume = mesh.volumes()[index] * weights.get(index).copied().unwrap_or(1.0);
        each_block(tet, numbers, |(row, i), (column, j)| {
            matrix.add(row, column, &stiffness_block(material, volume, &gradients[i], &gradients[j]));
        });
    }
    matrix
}

/// The consistent mass matrix \[kg\] over the nodes that have a number, for a density \[kg/m³\].
#[must_use]
pub fn consistent_mass(mesh: &TetMesh, density: f64, numbers: &[Option<u32>], count: usize) -> BlockMatrix {
    let mut matrix = BlockMatrix::zeros(pattern(mesh, numbers, count));
    for (tet, volume) in mesh.tets().iter().zip(mesh.volumes()) {
        each_block(tet, numbers, |(row, i), (column, j)| {
            let share = if i == j { 0.1 } else { 0.05 };
            matrix.add(row, column, &Matrix3::from_diagonal_element(share * density * volume));
        });
    }
    matrix
}

/// The blocks of an element's matrix in the lower triangle: number and corner of the row, of the column.
fn each_block(tet: &[u32; 4], numbers: &[Option<u32>], mut visit: impl FnMut((u32, usize), (u32, usize))) {
    for (i, node) in tet.iter().enumerate() {
        let Some(row) = numbers[*node as usize] else { continue };
        for (j, other) in tet.iter().enumerate() {
            if let Some(column) = numbers[*other as usize]
                && row >= column
            {
                visit((row, i), (column, j));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_checked_and_turned_into_lames() {
        let material = Elastic::new(1e5, 0.3).expect("in range");
        assert!((material.lambda() - 57_692.307_692_307_69).abs() < 1e-9);
        assert!((material.mu() - 38_461.538_461_538_46).abs() < 1e-9);
        for (young, poisson) in
            [(0.0, 0.3), (f64::NAN, 0.3), (f64::INFINITY, 0.3), (1e5, 0.46), (1e5, -1.0), (1e5, f64::NAN)]
        {
            assert!(Elastic::new(young, poisson).is_err(), "{young} {poisson}");
        }
        let error = Elastic::new(1e5, 0.49).expect_err("locks");
        assert!(error.to_string().contains("up to 0.45"), "{error}");
    }
}
