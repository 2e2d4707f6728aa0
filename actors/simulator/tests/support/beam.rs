//! The reference beam: 0.1 × 0.02 × 0.02 m, E 1e5 Pa, ν 0.3, ρ 1000 kg/m³, clamped at x = 0, loaded downwards by 0.01 N
//! distributed evenly over its end.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};

/// Length and width \[m\].
pub const SIZE: [f64; 3] = [0.1, 0.02, 0.02];

/// The mesh of a beam with this many cells.
pub fn mesh(cells: [usize; 3]) -> TetMesh {
    let grid = BoxCells { cells, size: SIZE.into(), origin: Point3::origin() };
    let (nodes, tets) = box_cells(&grid);
    TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
}

/// Nodes at an x \[m\].
pub fn nodes_at(mesh: &TetMesh, x: f64) -> Vec<u32> {
    let at = |node: &u32| (mesh.rest()[*node as usize].x - x).abs() < 1e-9;
    (0..mesh.rest().len() as u32).filter(at).collect()
}

/// E 1e5 Pa, ν 0.3.
pub fn material() -> Elastic {
    Elastic::new(1e5, 0.3).expect("a material")
}

/// Forces on all nodes: 0.01 N downwards, evenly over the area of the end.
pub fn end_traction(mesh: &TetMesh) -> Vec<Vector3<f64>> {
    let mut forces = vec![Vector3::zeros(); mesh.rest().len()];
    let end = |node: &u32| (mesh.rest()[*node as usize].x - SIZE[0]).abs() < 1e-9;
    for triangle in mesh.surface().iter().filter(|triangle| triangle.iter().all(end)) {
        let [a, b, c] = triangle.map(|node| mesh.rest()[node as usize]);
        let area = (b - a).cross(&(c - a)).norm() / 2.0;
        for &node in triangle {
            forces[node as usize].z -= 0.01 * area / (SIZE[1] * SIZE[2]) / 3.0;
        }
    }
    forces
}

/// Mean deflection over the end face \[m\], downwards: the work-conjugate of the traction.
pub fn end_deflection(mesh: &TetMesh, displacements: &[Vector3<f64>]) -> f64 {
    end_traction(mesh).iter().zip(displacements).map(|(force, u)| force.dot(u)).sum::<f64>() / 0.01
}
