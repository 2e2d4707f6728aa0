//! After warming up, a solver's step allocates nothing.

use crate::support::suture::{jaws, pad, pose, straight, threaded, tissue};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_scene::JointKind;
use trocar_simulator::dynamic_fem::{Config, Constitution, DynamicFem, Inputs};
use trocar_simulator::fluid::{Fluid, FluidConfig};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem};
use trocar_simulator::mass_spring::{
    self, Input, Integrator, LinearSolver, MassSpring, Network, SurfaceMaterial, TooLarge,
};
use trocar_simulator::rigid::{self, BodyJoint, JointEnd, RigidBodies, RigidMass, RigidState};
use trocar_simulator::suture::{Resistance, StepInputs};
use trocar_simulator::suture_thread::{self, Obstacle, Shape, Surroundings, Thread, ThreadMaterial};
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig, XpbdInput};
use trocar_test_support::allocations::peak_of;

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
/// Enough steps for every list to reach its largest size.
const WARM: usize = 100;

/// Runs steps until warm, and as many again without allocating a single byte.
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
    let warped = LinearSolver::Warped { tolerance: 1e-4, iterations_max: 200 };
    for integrator in [
        Integrator::Explicit { too_large: TooLarge::Divide { most: 100 } },
        Integrator::Implicit { solver: gradients, newton: 1 },
        Integrator::Implicit { solver: warped, newton: 1 },
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

#[test]
fn a_thread_that_lies_on_itself_and_on_a_table_steps_without_allocating() {
    let on_coil = |turn: f64| Point3::new(3e-3 * turn.cos(), 3e-3 * turn.sin(), 4.9e-5 * turn);
    let points: Vec<_> = (0..=100).map(|i| on_coil(0.15 * f64::from(i))).collect();
    let mut thread = Thread::new(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    let table = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(table, Isometry3::translation(0.0, 0.0, -4e-4), 0.3)];
    let holds = [suture_thread::Hold::fixed(0, points[0]), suture_thread::Hold::fixed(100, points[100])];
    let around =
        Surroundings { gravity: GRAVITY, holds: &holds, obstacles: &obstacles, ..Surroundings::default() };
    let mut touched = 0;
    (0..500).for_each(|_| {
        thread.step(1e-3, &around).expect("a step");
    });
    allocates_nothing("a thread", || touched += thread.step(1e-3, &around).expect("a step").contacts);
    assert!(touched >= WARM, "{touched} contacts in all");
}

/// Links of a chain that swings, the light last ones so fast that their steps are taken in parts.
#[test]
fn joined_bodies_step_without_allocating() {
    let mass = |mass: f64| RigidMass { mass, inertia: Vector3::new(1e-6, 4e-5, 4e-5) * mass };
    let masses = [0.1, 0.01, 0.001, 0.001].map(mass);
    let state = |link: usize| RigidState {
        position: Point3::new(0.01 + 0.02 * link as f64, 0.0, 0.0),
        rotation: UnitQuaternion::identity(),
        momentum: Vector3::zeros(),
        angular_momentum: Vector3::zeros(),
    };
    let states = [0, 1, 2, 3].map(state);
    let end = |x: f64| Isometry3::translation(x, 0.0, 0.0);
    let joint = |link: usize| BodyJoint {
        body: link as u32,
        body_from_joint: end(-0.01),
        other: match link.checked_sub(1) {
            Some(before) => JointEnd::Body { body: before as u32, body_from_joint: end(0.01) },
            None => JointEnd::World([Isometry3::identity(); 2]),
        },
        kind: JointKind::Ball,
    };
    let (integrator, config) = (rigid::Integrator::Symplectic, rigid::ContactConfig::default());
    let mut bodies = RigidBodies::new(&masses, &states, GRAVITY, integrator, config).expect("bodies");
    bodies.set_joints(&[0, 1, 2, 3].map(joint)).expect("joints");
    (0..1000).for_each(|_| bodies.step(1e-3, &[], &[]).expect("a step"));
    allocates_nothing("joined bodies", || bodies.step(1e-3, &[], &[]).expect("a step"));
    assert!((0..4).all(|joint| bodies.joint_errors(joint)[0] < 1e-9));
}

/// A ring that lies flat on a table.
#[test]
fn a_closed_thread_on_a_table_steps_without_allocating() {
    let on_ring = |turn: f64| Point3::new(0.02 * turn.cos(), 0.02 * turn.sin(), 0.0);
    let points: Vec<_> = (0..80).map(|i| on_ring(std::f64::consts::TAU * f64::from(i) / 80.0)).collect();
    let mut thread = Thread::closed(ThreadMaterial::silk_2_0(), &points).expect("a thread");
    let table = Shape::HalfSpace { normal: Vector3::z() };
    let obstacles = [Obstacle::fixed(table, Isometry3::translation(0.0, 0.0, -2e-4), 0.3)];
    let around = Surroundings { gravity: GRAVITY, obstacles: &obstacles, ..Surroundings::default() };
    let mut touched = 0;
    (0..300).for_each(|_| {
        thread.step(1e-3, &around).expect("a step");
    });
    allocates_nothing("a closed thread", || touched += thread.step(1e-3, &around).expect("a step").contacts);
    assert!(touched >= WARM, "{touched} contacts in all");
}

#[test]
fn a_needle_in_tissue_steps_without_allocating() {
    let (shape, material) = (straight(), Resistance::default());
    let at = |depth: f64| pose(&shape, Point3::new(0.0, 0.0, 1e-3 - depth), -Vector3::z(), Vector3::y());
    let mut suture = threaded(&shape, &at(0.0), 20, 1e-3, material, tissue(pad()));
    let (mut from, mut time) = (at(0.0), 0.0_f64);
    let mut go = |depth: f64| {
        let to = at(depth);
        let grip = jaws(&shape, 0.5 * shape.length(), from, to);
        from = to;
        suture
            .step(1e-3, &StepInputs { grips: &[grip], gravity: GRAVITY, ..StepInputs::default() })
            .expect("a step");
        suture.state().channel.len()
    };
    let mut inside = 0;
    (0..200).for_each(|step| inside = go(6e-3 * f64::from(step) / 200.0));
    (0..500).for_each(|step| inside = go(6e-3 + 2e-4 * (0.1 * f64::from(step)).sin()));
    assert!(inside > 2, "{inside} places of the needle in the tissue");
    allocates_nothing("a suture", || {
        time += 0.1;
        go(6e-3 + 2e-4 * time.sin());
    });
}

#[test]
fn a_liquid_in_a_basin_steps_without_allocating() {
    let (spacing, n) = (2e-3, 8);
    let place = |i: i32, j: i32, k: i32| {
        Point3::new(f64::from(i) + 0.5, f64::from(j) + 0.5, f64::from(k) + 0.5) * spacing
    };
    let mut fluid =
        Fluid::new(FluidConfig { spacing, viscosity: 1e-5, ..FluidConfig::default() }).expect("a liquid");
    let cells = |from: i32, to: i32| {
        (from..to).flat_map(move |i| (from..to).flat_map(move |j| (from..to).map(move |k| (i, j, k))))
    };
    let is_wall = |(i, j, k): &(i32, i32, i32)| [*i, *j].iter().any(|at| *at == -1 || *at == n) || *k == -1;
    let walls: Vec<_> = cells(-1, n + 1).filter(is_wall).map(|(i, j, k)| place(i, j, k)).collect();
    fluid.set_walls(&walls, &vec![Vector3::zeros(); walls.len()]).expect("walls");
    for (i, j, k) in cells(0, n) {
        fluid.add(place(i, j, k), Vector3::zeros()).expect("in the box");
    }
    // Lists are longest while it comes to rest.
    (0..1000).for_each(|_| {
        fluid.step(4e-3).expect("a step");
    });
    allocates_nothing("a liquid", || {
        fluid.step(4e-3).expect("a step");
    });
}
