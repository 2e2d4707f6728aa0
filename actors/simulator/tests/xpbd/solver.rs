//! XPBD against closed forms, linear elements, and itself on other numbers of threads.

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_dynamics::particles::{State, StepError};
use trocar_simulator::mass_spring::{
    Config, Contact, Input, Integrator, LineMaterial, LinearSolver, MassSpring, Network, NodeForce,
    Prescribed,
};
use trocar_simulator::xpbd::{Body, Distance, Elasticity, Xpbd, XpbdConfig, XpbdInput, distances_of};

const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A cantilever rod deflects as the same springs and hinges do in equilibrium.
#[test]
fn a_rod_bends_by_its_stiffness_and_not_by_its_iterations() {
    let (segments, edge) = (10_u32, 0.01);
    let rest: Vec<_> = (0..=segments).map(|k| Point3::new(f64::from(k) * edge, 0.0, 0.0)).collect();
    let lines: Vec<_> = (0..segments).map(|k| [k, k + 1]).collect();
    let material = LineMaterial { axial_stiffness: 100.0, bending_stiffness: 2e-5, density: 2e-3 };
    let network = Network::from_line(&rest, &lines, &material).expect("a line");
    let integrator = Integrator::Implicit { solver: LinearSolver::Cholesky, newton: 4 };
    let config = Config { integrator, damping: 5.0, ..Config::default() };
    let mut exact = MassSpring::new(network.clone(), rest.clone(), &[0, 1], config).expect("a rod");
    for _ in 0..200 {
        exact.step(0.05, &Input { gravity: DOWN, ..Input::default() }).expect("a step");
    }
    let wanted = -exact.state().positions[segments as usize].z;
    assert!(wanted > 0.005, "{wanted}");
    let (distances, bends) = (distances_of(&network), &network.hinges);
    let body = Body { rest: &rest, masses: &network.masses, distances: &distances, bends, ..Body::default() };
    let drooped = |parts: u32| {
        let config = XpbdConfig { parts, damping: 20.0, ..XpbdConfig::default() };
        let mut solver = Xpbd::new(&body, &[0, 1], config).expect("a rod");
        for _ in 0..1000 {
            solver.step(1e-3, &XpbdInput { gravity: DOWN, ..XpbdInput::default() }).expect("a step");
        }
        -solver.state().positions[segments as usize].z / wanted - 1.0
    };
    let (coarse, fine) = (drooped(10), drooped(40));
    assert!(fine.abs() < 0.01, "{fine}");
    assert!(coarse.abs() >= fine.abs(), "{coarse} and {fine}");
}

/// The force on jaws that hold a hanging body is its weight, for every material.
#[test]
fn what_hangs_in_jaws_weighs_what_it_weighs() {
    let (points, tets) = beam([4, 2, 2], [0.04, 0.02, 0.02]);
    let volume = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let rest: Vec<_> = (0..=8).map(|k| Point3::new(0.01 * f64::from(k), 0.0, 0.0)).collect();
    let lines: Vec<_> = (0..8).map(|k| [k, k + 1]).collect();
    let material = LineMaterial { axial_stiffness: 100.0, bending_stiffness: 2e-5, density: 2e-3 };
    let network = Network::from_line(&rest, &lines, &material).expect("a line");
    let distances = distances_of(&network);
    let rod = Body {
        rest: &rest,
        masses: &network.masses,
        distances: &distances,
        bends: &network.hinges,
        ..Body::default()
    };
    // Half an edge's mass belongs to the held nodes.
    for (body, weight) in [(volume, 9.81 * 1000.0 * 1.6e-5), (rod, 9.81 * 2e-3 * 0.08)] {
        let held: Vec<Prescribed> = (0..body.rest.len() as u32)
            .filter(|&node| body.rest[node as usize].x < 0.011)
            .map(|node| Prescribed { node, position: body.rest[node as usize] })
            .collect();
        let nodes: Vec<u32> = held.iter().map(|driven| driven.node).collect();
        let config = XpbdConfig { parts: 20, damping: 20.0, ..XpbdConfig::default() };
        let mut solver = Xpbd::new(&body, &[], config).expect("a body");
        for _ in 0..1000 {
            let input = XpbdInput { gravity: DOWN, prescribed: &held, ..XpbdInput::default() };
            solver.step(1e-3, &input).expect("a step");
        }
        let own: f64 = 9.81 * nodes.iter().map(|&node| solver.masses()[node as usize]).sum::<f64>();
        let pull = -solver.pull_on(&nodes).z;
        assert!((pull / (weight - own) - 1.0).abs() < 1e-3, "{pull} N, not {} N", weight - own);
    }
}

#[test]
fn contacts_carry_and_friction_holds_below_its_angle() {
    let rest = [Point3::origin()];
    let body = Body { rest: &rest, masses: &[0.01], ..Body::default() };
    let slide = |degrees: f64| {
        let normal = Vector3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        let mut solver =
            Xpbd::new(&body, &[], XpbdConfig { parts: 4, ..XpbdConfig::default() }).expect("a mass");
        // At rest in the slope from the beginning.
        let sunk = 0.01 * 9.81 * normal.z / 1000.0;
        for _ in 0..1000 {
            let depth = sunk - solver.state().positions[0].coords.dot(&normal);
            let contact =
                Contact { friction: 0.5, damping: 1.0, ..Contact::at_node(0, normal, depth, 1000.0) };
            let input = XpbdInput { gravity: DOWN, contacts: &[contact], ..XpbdInput::default() };
            solver.step(1e-3, &input).expect("a step");
        }
        let carried = solver.contact_forces()[0].dot(&normal);
        assert!((carried / (0.01 * 9.81 * normal.z) - 1.0).abs() < 1e-3, "{carried} N");
        solver.state().positions[0].coords.norm()
    };
    // tan 26.57° = 0.5.
    assert!(slide(26.0) < 1e-6, "{}", slide(26.0));
    let (sin, cos) = 35.0_f64.to_radians().sin_cos();
    let wanted = 0.5 * 9.81 * (sin - 0.5 * cos);
    assert!((slide(35.0) / wanted - 1.0).abs() < 0.01, "{} m, not {wanted} m", slide(35.0));
}

/// Six tetrahedra to a cell, corners ordered i-major.
pub(super) fn beam(cells: [u32; 3], size: [f64; 3]) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    let side = cells.map(|count| count + 1);
    let at = |axis: usize, index: u32| size[axis] * f64::from(index) / f64::from(cells[axis]);
    let points = (0..side[0])
        .flat_map(|i| {
            (0..side[1])
                .flat_map(move |j| (0..side[2]).map(move |k| Point3::new(at(0, i), at(1, j), at(2, k))))
        })
        .collect();
    let six: [[u32; 4]; 6] =
        [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
    let mut tets = Vec::new();
    for i in 0..cells[0] {
        for j in 0..cells[1] {
            for k in 0..cells[2] {
                let corner =
                    |local: u32| ((i + local / 4) * side[1] + j + local / 2 % 2) * side[2] + k + local % 2;
                tets.extend(six.map(|tet| tet.map(corner)));
            }
        }
    }
    (points, tets)
}

const SOFT: Elasticity = Elasticity { young_modulus: 1e5, poisson_ratio: 0.3, density: 1000.0 };

#[test]
fn a_beam_bends_as_the_same_tetrahedra_do_in_linear_elasticity() {
    let (points, tets) = beam([10, 2, 2], [0.1, 0.02, 0.02]);
    let clamped: Vec<u32> = (0..points.len() as u32).filter(|&node| points[node as usize].x < 1e-9).collect();
    let ends: Vec<u32> =
        (0..points.len() as u32).filter(|&node| points[node as usize].x > 0.1 - 1e-9).collect();
    // Uniform traction: each triangle of the end face gives a third to each of its corners.
    let mut shares = vec![0.0; points.len()];
    for tet in &tets {
        let on_end: Vec<u32> = tet.iter().copied().filter(|node| ends.contains(node)).collect();
        if on_end.len() == 3 {
            on_end.iter().for_each(|&node| shares[node as usize] += 0.01 / 8.0 / 3.0);
        }
    }
    let forces: Vec<_> = ends
        .iter()
        .map(|&node| NodeForce { node, force: Vector3::new(0.0, 0.0, -shares[node as usize]) })
        .collect();
    assert!((shares.iter().sum::<f64>() - 0.01).abs() < 1e-12);
    let body = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let sunk_with = |parts: u32| {
        let config = XpbdConfig { parts, damping: 20.0, ..XpbdConfig::default() };
        let mut solver = Xpbd::new(&body, &clamped, config).expect("a body");
        for _ in 0..900 {
            solver.step(1e-3, &XpbdInput { forces: &forces, ..XpbdInput::default() }).expect("a step");
        }
        assert_eq!(solver.inverted().count, 0);
        let sunk = |node: &u32| points[*node as usize].z - solver.state().positions[*node as usize].z;
        ends.iter().map(sunk).sum::<f64>() / ends.len() as f64 / 1.306_239_43e-3 - 1.0
    };
    // Too soft in proportion to the squared substep, whatever the iterations: small steps are the method.
    let (coarse, fine) = (sunk_with(16), sunk_with(64));
    assert!((0.0..0.04).contains(&coarse), "{coarse}");
    assert!(fine.abs() < 0.004, "{fine}");
}

#[test]
fn a_body_turned_inside_out_recovers() {
    let (points, tets) = beam([3, 3, 3], [0.03; 3]);
    let body = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let config = XpbdConfig { parts: 20, damping: 10.0, speed_max: 1e4, ..XpbdConfig::default() };
    let middle = points.iter().fold(Vector3::zeros(), |sum, at| sum + at.coords) / points.len() as f64;
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let mut shaken = || Vector3::from_fn(|_, _| random.random_range(-5e-4..5e-4));
    // One node pulled through all others; everything in a plane, with half of the elements inverted by chance;
    // everything mirrored, every element inverted; everything in one point except for half a millimetre.
    let mut one = points.clone();
    one[0] = Point3::new(0.025, 0.025, 0.025);
    let mut drawn = |scale: Vector3<f64>| -> Vec<Point3<f64>> {
        points
            .iter()
            .map(|at| Point3::from(middle + (at.coords - middle).component_mul(&scale) + shaken()))
            .collect()
    };
    let all = tets.len();
    let flat = drawn(Vector3::new(1.0, 1.0, 0.0));
    let mirrored = drawn(Vector3::new(1.0, 1.0, -1.0));
    let heap = drawn(Vector3::zeros());
    for (what, positions, least) in
        [("one", one, 1), ("flat", flat, all / 4), ("mirrored", mirrored, all), ("heap", heap, all / 4)]
    {
        let mut solver = Xpbd::new(&body, &[], config).expect("a body");
        let state = State { positions, velocities: vec![Vector3::zeros(); points.len()] };
        solver.restore(state).expect("a state");
        let inverted = solver.inverted().count;
        assert!(inverted >= least, "{what}: {inverted} of {all}");
        for _ in 0..2000 {
            solver.step(1e-3, &XpbdInput::default()).expect("a step");
        }
        assert_eq!(solver.inverted().count, 0, "{what}");
        // Back in its shape, at any pose.
        let now = &solver.state().positions;
        for tet in &tets {
            for (a, b) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
                let [a, b] = [tet[a] as usize, tet[b] as usize];
                let ratio = (now[a] - now[b]).norm() / (points[a] - points[b]).norm();
                assert!((ratio - 1.0).abs() < 1e-3, "{what}: an edge is {ratio} times as long");
            }
        }
    }
}

#[test]
fn the_bits_are_the_same_on_any_number_of_threads_and_after_a_restart() {
    // Large enough: threads share colours of 512 packs of four tetrahedra, or 512 distances, and more.
    let (points, tets) = beam([34, 26, 20], [0.34, 0.26, 0.20]);
    let near = |node: &u32| (points[*node as usize] - points[*node as usize + 1]).norm() < 0.0101;
    let next_to = (0..points.len() as u32 - 1).filter(near);
    let distances: Vec<Distance> =
        next_to.map(|node| Distance { nodes: [node, node + 1], rest: 0.0099, compliance: 1e-3 }).collect();
    assert!(tets.len() > 100_000 && distances.len() > 10_000);
    let body =
        Body { rest: &points, tets: &tets, elasticity: Some(SOFT), distances: &distances, ..Body::default() };
    let driven = [Prescribed { node: 0, position: points[0] + Vector3::new(0.001, 0.002, 0.0) }];
    let input = XpbdInput { gravity: DOWN, prescribed: &driven, ..XpbdInput::default() };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
        pool.install(|| {
            let mut solver =
                Xpbd::new(&body, &[5], XpbdConfig { parts: 2, ..XpbdConfig::default() }).expect("a body");
            for _ in 0..2 {
                solver.step(1e-3, &input).expect("a step");
            }
            let text = serde_json::to_string(solver.state()).expect("text");
            let mut again =
                Xpbd::new(&body, &[5], XpbdConfig { parts: 2, ..XpbdConfig::default() }).expect("a body");
            again.restore(serde_json::from_str(&text).expect("a state")).expect("a state");
            for _ in 0..2 {
                solver.step(1e-3, &input).expect("a step");
                again.step(1e-3, &input).expect("a step");
            }
            assert_eq!(solver.state(), again.state());
            solver.state().clone()
        })
    };
    let one = run(1);
    assert_eq!(one.positions[0], driven[0].position);
    assert_eq!(one.positions[5], points[5]);
    assert!(one == run(2) && one == run(3));
}

#[test]
fn momentum_is_kept_and_nonsense_refused() {
    let (points, mut tets) = beam([2, 2, 2], [0.02; 3]);
    let body = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let mut solver = Xpbd::new(&body, &[], XpbdConfig::default()).expect("a body");
    let mut state = solver.state().clone();
    for (node, position) in state.positions.iter_mut().enumerate() {
        position.x += 1e-3 * (1.7 * node as f64).sin();
    }
    solver.restore(state).expect("a state");
    let middle = |solver: &Xpbd| {
        // Corners differ in mass by their number of tetrahedra.
        let mut sum = Vector3::zeros();
        for tet in &tets {
            tet.iter().for_each(|&node| sum += solver.state().positions[node as usize].coords);
        }
        sum / (4.0 * tets.len() as f64)
    };
    let began = middle(&solver);
    for _ in 0..200 {
        solver.step(1e-3, &XpbdInput::default()).expect("a step");
    }
    assert!((middle(&solver) - began).norm() < 1e-12);

    let before = solver.state().clone();
    let force = [NodeForce { node: 0, force: Vector3::new(f64::NAN, 0.0, 0.0) }];
    let refused = solver.step(1e-3, &XpbdInput { forces: &force, ..XpbdInput::default() });
    assert!(matches!(refused, Err(StepError::NotFinite { .. })), "{refused:?}");
    assert_eq!(*solver.state(), before);
    tets[1].swap(0, 1);
    tets[3] = [0, 1, 2, 2];
    let body = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let error = Xpbd::new(&body, &[], XpbdConfig::default()).expect_err("one node twice");
    assert!(error.to_string().ends_with("(there are 27): 3"), "{error}");
    tets[3] = tets[2];
    let body = Body { rest: &points, tets: &tets, elasticity: Some(SOFT), ..Body::default() };
    let error = Xpbd::new(&body, &[], XpbdConfig::default()).expect_err("turned over");
    assert_eq!(error.to_string(), "tetrahedrons without extent: 1");
}

#[test]
fn two_halves_that_have_grown_together_bend_as_one_and_keep_their_momentum() {
    use trocar_dynamics::coupling::external_nodes::{ExternalNodes, ExternalNodesState, OF_BODY, Tie};
    use trocar_simulator::xpbd::{Member, step_together};
    // A chain of 20 masses, whole or in two bodies that share a node, hanging from its first node in a side wind.
    let chain = |from: usize, to: usize| -> Vec<Point3<f64>> {
        (from..=to).map(|k| Point3::new(0.005 * k as f64, 0.0, 0.0)).collect()
    };
    let body = |rest: &[Point3<f64>], masses: &[f64], pinned: &[u32]| {
        let link = |k: usize| Distance { nodes: [k as u32, k as u32 + 1], rest: 0.005, compliance: 1e-4 };
        let distances: Vec<Distance> = (0..rest.len() - 1).map(link).collect();
        let made = Body { rest, masses, distances: &distances, ..Body::default() };
        let config = XpbdConfig { parts: 40, damping: 2.0, ..XpbdConfig::default() };
        Xpbd::new(&made, pinned, config).expect("a chain")
    };
    let gravity = Vector3::new(1.0, 3.0, -9.81);
    let input = XpbdInput { gravity, ..XpbdInput::default() };
    let mut whole = body(&chain(0, 19), &[1e-4; 20], &[0]);
    // The node in the middle has half of its mass in each body.
    let mut masses = [1e-4; 11];
    masses[10] = 0.5e-4;
    let mut first = body(&chain(0, 10), &masses, &[0]);
    let mut masses = [1e-4; 10];
    masses[0] = 0.5e-4;
    let mut second = body(&chain(10, 19), &masses, &[]);
    let of_second = |node: u32| OF_BODY + 11 + 1 + node;
    let ghost_nodes = [(of_second(0), 1.0), (of_second(1), 0.0), (of_second(2), 0.0), (of_second(3), 0.0)];
    let ties = [Tie { node: 10, ghost_nodes, stiffness: 1e5, damping: 0.0 }];
    let external_nodes = ExternalNodes { ties: &ties, ..ExternalNodes::default() };
    let mut state = ExternalNodesState::default();
    for _ in 0..600 {
        whole.step(0.01, &input).expect("a step");
        let mut members = [Member { body: &mut first, input }, Member { body: &mut second, input }];
        step_together(0.01, &mut members, &external_nodes, &mut state).expect("a step");
    }
    let end = |body: &Xpbd| *body.state().positions.last().expect("an end");
    let (one, two) = (end(&whole), end(&second));
    assert!((one - two).norm() < 2e-4, "{one} and {two}");
    // The tie bears everything that hangs below it.
    let below = gravity * (9.5 * 1e-4);
    let tied = state.moved().ties[0].force;
    assert!((tied - below).norm() < 0.01 * below.norm(), "{tied:?} for {below:?}");
    // Without a pin it flies as one: momentum is conserved.
    let mut first = body(&chain(0, 10), &[1e-4; 11], &[]);
    let mut second = body(&chain(10, 19), &[2e-4; 10], &[]);
    let mut moving = second.state().clone();
    moving.velocities.fill(Vector3::new(0.2, -0.1, 0.3));
    second.restore(moving).expect("its own nodes");
    let momentum = |first: &Xpbd, second: &Xpbd| -> Vector3<f64> {
        let of = |body: &Xpbd| -> Vector3<f64> {
            body.state().velocities.iter().zip(body.masses()).map(|(v, mass)| v * *mass).sum()
        };
        of(first) + of(second)
    };
    let state_of = |body: &Xpbd| body.state().clone();
    let damped = momentum(&first, &second);
    let still = XpbdInput::default();
    let mut members = [Member { body: &mut first, input: still }, Member { body: &mut second, input: still }];
    step_together(0.01, &mut members, &external_nodes, &mut state).expect("a step");
    // Damping removes the same fraction of everything: 40 substeps of a quarter millisecond at 2 1/s.
    let kept = (1.0 + 2.0 * 0.01 / 40.0_f64).powi(-40);
    let after = momentum(&first, &second);
    assert!((after - damped * kept).norm() < 1e-9 * damped.norm(), "{after:?} of {:?}", damped * kept);
    assert!(state_of(&first).velocities[10].norm() > 0.01, "the one draws the other along");
    // A tie to a missing node is rejected, and nothing has moved.
    let wrong = [Tie { ghost_nodes: [(OF_BODY + 99, 1.0); 4], ..ties[0] }];
    let external_nodes = ExternalNodes { ties: &wrong, ..ExternalNodes::default() };
    let before = (state_of(&first), state_of(&second));
    let mut members = [Member { body: &mut first, input: still }, Member { body: &mut second, input: still }];
    assert!(step_together(0.01, &mut members, &external_nodes, &mut state).is_err());
    assert_eq!((state_of(&first), state_of(&second)), before);
}
