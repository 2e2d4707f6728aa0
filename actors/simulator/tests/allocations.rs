//! A warmed step of a solver allocates nothing.

#[path = "../../../tests/support/counting.rs"]
mod counting;

use counting::peak_of;
use nalgebra::{Point3, Vector3};
use trocar_simulator::dynamic_fem::{Config, Constitution, DynamicFem, Inputs};
use trocar_simulator::elasticity::Elastic;
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem};
use trocar_simulator::mass_spring::{
    self, Input, Integrator, LinearSolver, MassSpring, Network, SurfaceMaterial, TooLarge,
};
use trocar_simulator::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig, XpbdInput};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// Long enough for every list to have had its largest size.
const WARM: usize = 100;

/// Takes steps until it is warm, and as many again without a single byte.
fn allocates_nothing(what: &str, mut step: impl FnMut()) {
    let ((), bytes) = peak_of(|| drop(vec![0_u8; 1000]));
    assert_eq!(bytes, 1000, "the allocator counts");
    (0..WARM).for_each(|_| step());
    let ((), bytes) = peak_of(|| (0..WARM).for_each(|_| step()));
    assert_eq!(bytes, 0, "{what}");
}

/// A beam, and its nodes at x = 0.
fn beam(cells: [usize; 3]) -> (TetMesh, Vec<u32>) {
    let size = Vector3::new(0.1, 0.02, 0.02);
    let (nodes, tets) = box_cells(&BoxCells { cells, size, origin: Point3::origin() });
    let wall = (0..nodes.len() as u32).filter(|&node| nodes[node as usize].x < 1e-9).collect();
    (TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh"), wall)
}

#[test]
fn a_cloth_steps_without_allocating() {
    let n = 12_u32;
    let at = |i: u32| 0.1 * f64::from(i) / f64::from(n);
    let points: Vec<_> = (0..=n).flat_map(|j| (0..=n).map(move |i| Point3::new(at(i), at(j), 0.0))).collect();
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|j| (0..n).map(move |i| j * (n + 1) + i))
        .flat_map(|a| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]])
        .collect();
    let material = SurfaceMaterial { membrane_stiffness: 500.0, bending_stiffness: 1e-6, density: 0.15 };
    let gradients = LinearSolver::ConjugateGradients { tolerance: 1e-4, iterations_max: 200 };
    for integrator in [
        Integrator::Explicit { too_large: TooLarge::Divide { most: 100 } },
        Integrator::Implicit { solver: gradients, newton: 1 },
        Integrator::Implicit { solver: LinearSolver::Cholesky, newton: 1 },
    ] {
        let network = Network::from_surface(&points, &triangles, &material).expect("a surface");
        let config = mass_spring::Config { integrator, damping: 1.0, ..mass_spring::Config::default() };
        let mut cloth = MassSpring::new(network, points.clone(), &[0, n], config).expect("a cloth");
        let input = Input { gravity: GRAVITY, ..Input::default() };
        allocates_nothing(&format!("{integrator:?}"), || {
            cloth.step(1e-3, &input).expect("a step");
        });
    }
}

#[test]
fn finite_elements_step_without_allocating() {
    let (mesh, wall) = beam([10, 2, 2]);
    let material = Elastic::new(1e5, 0.3).expect("a material");
    for constitution in [Constitution::Corotational, Constitution::NeoHookean] {
        let config = Config { constitution, stiffness_damping: 1e-3, ..Config::default() };
        let mut body = DynamicFem::new(mesh.clone(), &material, &config, &wall).expect("a body");
        let inputs = Inputs { acceleration: GRAVITY, ..Inputs::default() };
        allocates_nothing(&format!("{constitution:?}"), || {
            body.step(1e-3, &inputs).expect("a step");
        });
    }
    let mut body = LinearFem::new(mesh, &material, &wall, &Limits::default(), &mut |_| true).expect("a body");
    let nodes = body.compliance().nodes().to_vec();
    let held: Vec<_> = nodes[nodes.len() - 4..]
        .iter()
        .map(|&node| body.hold(Attachment::node(node, Hold::Point)).expect("held"))
        .collect();
    let (mut out, mut phase) = (Vec::new(), 0.0_f64);
    allocates_nothing("linear", || {
        phase += 0.1;
        for handle in &held {
            body.set_target(*handle, Vector3::new(0.0, 0.0, 1e-3 * phase.sin())).expect("held");
        }
        body.solve(&[]).expect("solved");
        body.surface_displacements(&mut out);
    });
}

#[test]
fn position_based_bodies_step_without_allocating() {
    let (mesh, wall) = beam([8, 2, 2]);
    let elasticity = Some(Elasticity { young_modulus: 1e5, poisson_ratio: 0.3, density: 1000.0 });
    let body = Body { rest: mesh.rest(), tets: mesh.tets(), elasticity, ..Body::default() };
    let config = XpbdConfig { parts: 1, iterations: 5, damping: 1.0, ..XpbdConfig::default() };
    let mut solver = Xpbd::new(&body, &wall, config).expect("a body");
    let input = XpbdInput { gravity: GRAVITY, ..XpbdInput::default() };
    allocates_nothing("xpbd", || {
        solver.step(1e-3, &input).expect("a step");
    });
}
