//! Linear elements solved directly in f64, as a reference for tests.
#![allow(dead_code)] // every test uses another part

use nalgebra::Vector3;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;
use trocar_simulator::linear_algebra::{BlockMatrix, SupernodalCholesky};
use trocar_simulator::stiffness::stiffness;

/// Numbers of the nodes that are not fixed.
pub fn numbers(mesh: &TetMesh, fixed: &[u32]) -> (Vec<Option<u32>>, usize) {
    let mut next = 0;
    let numbers = (0..mesh.rest().len() as u32).map(|node| {
        (!fixed.contains(&node)).then(|| {
            next += 1;
            next - 1
        })
    });
    (numbers.collect(), next as usize)
}

pub fn factored(matrix: &BlockMatrix) -> SupernodalCholesky {
    let mut factor = SupernodalCholesky::new(matrix.pattern(), 1).expect("room");
    factor.factor(matrix.pattern(), matrix.values()).expect("positive definite");
    factor
}

/// A direct f64 solve: displacements of all nodes.
pub fn direct(
    mesh: &TetMesh,
    material: &Elastic,
    fixed: &[u32],
    forces: &[Vector3<f64>],
) -> Vec<Vector3<f64>> {
    let (numbers, count) = numbers(mesh, fixed);
    let mut factor = factored(&stiffness(mesh, material, &numbers, count));
    let mut right = vec![0.0; 3 * count];
    for (number, force) in numbers.iter().zip(forces) {
        if let Some(number) = number {
            right[3 * *number as usize..][..3].copy_from_slice(force.as_slice());
        }
    }
    factor.solve(&mut right);
    let of = |number: &Option<u32>| {
        number.map_or_else(Vector3::zeros, |n| Vector3::from_column_slice(&right[3 * n as usize..][..3]))
    };
    numbers.iter().map(of).collect()
}

/// The same with the fixed nodes displaced by a field, and with `loads`: displacements of all nodes.
pub fn displaced(
    mesh: &TetMesh,
    material: &Elastic,
    fixed: &[u32],
    field: impl Fn(u32) -> Vector3<f64>,
    loads: &[Vector3<f64>],
) -> Vec<Vector3<f64>> {
    let (numbers, _) = numbers(mesh, fixed);
    let total = mesh.rest().len();
    let all: Vec<_> = (0..total as u32).map(Some).collect();
    let whole = stiffness(mesh, material, &all, total);
    let on_fixed = |node: u32| {
        if numbers[node as usize].is_none() { field(node) } else { Vector3::zeros() }
    };
    let mut displacements: Vec<_> = (0..total as u32).map(on_fixed).collect();
    // Forces of the displaced boundary on the interior: −K_ib u_b.
    let mut forces = vec![Vector3::zeros(); total];
    whole.multiply(&displacements, &mut forces);
    forces.iter_mut().zip(loads).for_each(|(force, load)| *force = load - *force);
    let inside = direct(mesh, material, fixed, &forces);
    displacements.iter_mut().zip(inside).for_each(|(all, inside)| *all += inside);
    displacements
}
