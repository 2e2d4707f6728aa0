//! Sparse stiffness and mass matrices of linear tetrahedra.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use crate::linear_algebra::{BlockMatrix, BlockPattern};

/// Force on node a per displacement of node b of an element \[N/m\], from its volume and the gradients of their shape
/// functions.
#[must_use]
pub fn stiffness_block(material: &Elastic, volume: f64, a: &Vector3<f64>, b: &Vector3<f64>) -> Matrix3<f64> {
    let (lambda, mu) = (material.lambda(), material.mu());
    let shear = Matrix3::from_diagonal_element(mu * a.dot(b));
    (a * b.transpose() * lambda + b * a.transpose() * mu + shear) * volume
}

/// Sparsity pattern of matrices over the numbered nodes of a mesh, by these numbers.
#[must_use]
pub fn pattern(mesh: &TetMesh, numbers: &[Option<u32>], count: usize) -> BlockPattern {
    BlockPattern::new(count, elements_of(mesh, numbers))
}

/// Pairs of numbered nodes that share an element.
fn elements_of(mesh: &TetMesh, numbers: &[Option<u32>]) -> impl Iterator<Item = (u32, u32)> {
    mesh.tets().iter().flat_map(|tet| {
        let own = tet.map(|node| numbers[node as usize]);
        (0..4).flat_map(move |i| (0..i).filter_map(move |j| Some((own[i]?, own[j]?))))
    })
}

/// Stiffness matrix over the numbered nodes; the others are fixed.
#[must_use]
pub fn stiffness(mesh: &TetMesh, material: &Elastic, numbers: &[Option<u32>], count: usize) -> BlockMatrix {
    weighted_stiffness(mesh, material, &[], numbers, count)
}

/// The same with a stiffness factor for each element; an empty slice for 1.
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

/// Springs of zero length between nodes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bonds<'a> {
    /// The two nodes of each.
    pub between: &'a [[u32; 2]],
    /// Stiffness of each \[N/m\].
    pub stiffness: f64,
}

/// The same with additional bonds between nodes.
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

/// Consistent mass matrix \[kg\] over the numbered nodes, for a density \[kg/m³\].
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

/// Blocks of an element's matrix in the lower triangle: number and corner of the row, of the column.
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
