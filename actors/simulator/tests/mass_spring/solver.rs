//! Mass-spring networks against closed forms, and their energy and momentum budgets.

use nalgebra::{DMatrix, DVector, Point3, SymmetricEigen, Vector3};
use proptest::prelude::*;
use trocar_dynamics::particles::StepError;
use trocar_simulator::mass_spring::{
    Config, Contact, Hinge, Input, LinearSolver, MassSpring, Network, NetworkError, NodeForce, Prescribed,
    Spring, SurfaceMaterial, Tet, TooLarge, VolumeMaterial,
};

use crate::support::springs::*;

/// Force that stretches a strip by 2 %: the modulus times its width, whatever the triangles.
#[test]
fn refining_a_mesh_keeps_the_material() {
    let stretched = |n: u32| {
        let (points, triangles) = grid(n, 0.1);
        let network =
            Network::from_surface(&points, &triangles, &SurfaceMaterial { bending_stiffness: 0.0, ..CLOTH })
                .expect("valid");
        let end = |x: f64| {
            let points = &points;
            (0..points.len() as u32).filter(move |&node| (points[node as usize].x - x).abs() < 1e-9)
        };
        let fixed: Vec<u32> = end(0.0).chain(end(0.1)).collect();
        let pulled = points.iter().map(|point| {
            if (point.x - 0.1).abs() < 1e-9 { Point3::new(0.102, point.y, point.z) } else { *point }
        });
        let config = Config { damping: 5.0, ..implicit(LinearSolver::Cholesky, 2) };
        let mut solver = MassSpring::new(network, pulled.collect(), &fixed, config).expect("valid");
        for _ in 0..100 {
            solver.step(0.05, &Input::default()).expect("a step");
        }
        let ends: Vec<u32> = end(0.1).collect();
        -solver.pull_on(&ends).x
    };
    let (coarse, fine) = (stretched(8), stretched(32));
    assert!((fine / coarse - 1.0).abs() < 0.01, "{coarse} N and {fine} N");
    // Clamped ends cannot narrow: above the free strip's E t × width × strain, below a quarter more, which these
    // triangles exert where nothing narrows.
    let free = 500.0 * 0.1 * 0.02;
    assert!((1.0..1.25).contains(&(fine / free)), "{fine} N against {free} N");

    // A volume likewise, in proportion to its modulus; a thread in proportion to its length.
    let weigh = |n: u32| {
        let at = |i: u32| 0.02 * f64::from(i) / f64::from(n);
        let side = n + 1;
        let points: Vec<_> = (0..side.pow(3))
            .map(|index| Point3::new(at(index / side / side), at(index / side % side), at(index % side)))
            .collect();
        let corner = |cell: [u32; 3], local: u32| {
            let [i, j, k] = [cell[0] + local / 4, cell[1] + local / 2 % 2, cell[2] + local % 2];
            (i * side + j) * side + k
        };
        let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
        let tets: Vec<[u32; 4]> = (0..n.pow(3))
            .flat_map(|cell| {
                let cell = [cell / n / n, cell / n % n, cell % n];
                six.map(|tet| tet.map(|local| corner(cell, local)))
            })
            .collect();
        let material = VolumeMaterial { young_modulus: 1e4, density: 1000.0 };
        let network = Network::from_volume(&points, &tets, &material).expect("valid");
        assert!((network.masses.iter().sum::<f64>() / 0.008 - 1.0).abs() < 1e-9);
        let squeezed: Vec<_> =
            points.iter().map(|point| Point3::new(point.x, point.y, 0.98 * point.z)).collect();
        MassSpring::new(network, squeezed, &[], Config::default()).expect("valid").elastic_energy()
    };
    // Uniform strain along one axis at Poisson's ratio 1/4: (λ + 2μ)/2 ε² V, with λ = μ = 0.4 E for edges in all
    // directions alike; six-tet cells prefer their diagonal.
    let (coarse, fine) = (weigh(2), weigh(4));
    assert!((fine / coarse - 1.0).abs() < 1e-9, "{coarse} J and {fine} J");
    let isotropic = 0.5 * 1.2e4 * 0.02_f64.powi(2) * 8e-6;
    assert!((0.7..1.3).contains(&(fine / isotropic)), "{fine} J against {isotropic} J");
}

fn thrown_tube(config: Config) -> MassSpring {
    let (points, triangles) = tube(12, 8);
    let network = Network::from_surface(&points, &triangles, &CLOTH).expect("valid");
    let mut state = MassSpring::new(network.clone(), points, &[], config).expect("valid").state().clone();
    for (index, velocity) in state.velocities.iter_mut().enumerate() {
        let turn = index as f64;
        *velocity = Vector3::new((1.3 * turn).sin(), (2.1 * turn).cos(), (0.7 * turn).sin()) * 0.3;
    }
    MassSpring::restore(network, state, &[], config).expect("valid")
}

#[test]
fn free_motion_keeps_momentum_and_energy() {
    let mut solver = thrown_tube(explicit(TooLarge::Refuse));
    let dt = 0.1 * solver.safe_step();
    let energy = |solver: &MassSpring| solver.elastic_energy() + solver.kinetic_energy();
    let (began, all) = (solver.momentum(), energy(&solver));
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for _ in 0..20_000 {
        solver.step(dt, &Input::default()).expect("a step");
        least = least.min(energy(&solver));
        most = most.max(energy(&solver));
    }
    let ended = solver.momentum();
    // Symplectic: the energy oscillates around its value and does not drift.
    assert!(least > 0.98 * all && most < 1.02 * all, "{least} to {most} J of {all} J");
    let scale = 0.3 * solver.network().masses.iter().sum::<f64>();
    assert!((ended[0] - began[0]).norm() < 1e-12 * scale, "{:?}", ended[0] - began[0]);
    assert!((ended[1] - began[1]).norm() < 1e-9 * scale * 0.01, "{:?}", ended[1] - began[1]);

    // Damping along springs removes energy and no momentum; backward Euler likewise conserves linear momentum.
    let damped = Config { lag: 1e-4, ..explicit(TooLarge::Divide { most: 1000 }) };
    for config in [damped, implicit(GRADIENTS, 1), implicit(WARPED, 2), implicit(LinearSolver::Cholesky, 3)] {
        let mut solver = thrown_tube(config);
        let began = solver.momentum();
        for _ in 0..100 {
            solver.step(1e-3, &Input::default()).expect("a step");
        }
        let ended = solver.momentum();
        assert!(energy(&solver) < 0.9 * all);
        assert!((ended[0] - began[0]).norm() < 1e-8 * scale, "{config:?}: {:?}", ended[0] - began[0]);
    }
}

#[test]
fn what_a_step_too_large_does_is_found_and_undone() {
    let (network, mut positions) = chain(40, 1e-3, 50.0, 0.05, Vector3::new(0.05, 0.0, 0.0));
    for (node, position) in positions.iter_mut().enumerate() {
        position.x += 1e-6 * (3.1 * node as f64).sin();
    }
    let make = |too_large| {
        MassSpring::new(network.clone(), positions.clone(), &[0], explicit(too_large)).expect("valid")
    };
    let safe = make(TooLarge::Refuse).safe_step();
    // For a long chain the bound is sharp: ω² = 4 k/m.
    assert!((safe - (1e-3_f64 / 50.0).sqrt()).abs() < 1e-12);
    let mut sound = make(TooLarge::Refuse);
    for _ in 0..20_000 {
        sound.step(0.95 * safe, &Input::default()).expect("a safe step");
    }
    assert!(sound.elastic_energy() + sound.kinetic_energy() < 1e-7);
    assert_eq!(
        sound.step(1.02 * safe, &Input::default()),
        Err(StepError::TooLarge { step: 1.02 * safe, safe }),
    );
    assert_eq!(
        make(TooLarge::Divide { most: 3 }).step(2.5 * safe, &Input::default()).expect("parts").parts,
        3
    );
    assert!(matches!(
        make(TooLarge::Divide { most: 3 }).step(3.5 * safe, &Input::default()),
        Err(StepError::TooManyParts { most: 3, .. })
    ));

    // The failing control: accepted as it is, the step diverges.
    let mut blown = make(TooLarge::Accept);
    let mut before = blown.state().clone();
    let error = loop {
        match blown.step(1.02 * safe, &Input::default()) {
            Ok(_) => before = blown.state().clone(),
            Err(error) => break error,
        }
    };
    assert!(matches!(error, StepError::Runaway { limit: 100.0, .. }), "{error}");
    assert_eq!(*blown.state(), before, "the last good state");
    // The same step is stable with the implicit method.
    let mut calm = MassSpring::new(network, positions, &[0], implicit(GRADIENTS, 1)).expect("valid");
    for _ in 0..200 {
        calm.step(100.0 * safe, &Input::default()).expect("a step");
    }
    assert!(calm.elastic_energy() + calm.kinetic_energy() < 1e-12);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]
    /// The stiffness matrix by finite differences, for networks with flat and curved hinges and tetrahedra in any shape.
    #[test]
    fn no_eigenvalue_is_above_the_bound(
        points in prop::collection::vec([-1.0..1.0, -1.0..1.0, -1.0..1.0], 7),
        springs in prop::collection::vec((0..7_u32, 0..7_u32, 0.0..1.5, 1.0..100.0), 1..14),
        hinges in prop::collection::vec((0..7_u32, 0..7_u32, 0..7_u32, 0.0..1.0, 1.0..50.0, -1.0..1.0), 0..5),
        tets in prop::collection::vec((0..4_u32, 0.1_f64..2.0, prop::bool::ANY, 1.0..20.0), 0..4),
        masses in prop::collection::vec(0.1..3.0, 7),
    ) {
        let positions: Vec<_> = points.into_iter().map(Point3::from).collect();
        let springs: Vec<_> = springs.into_iter().filter(|(a, b, ..)| a != b)
            .map(|(a, b, rest, stiffness)| Spring { nodes: [a, b], rest, stiffness }).collect();
        let hinges: Vec<_> = hinges.into_iter().map(|(a, b, c, rest, stiffness, skew): (u32, u32, u32, f64, f64, f64)| {
            let rest = if rest < 0.5 { 0.0 } else { rest };
            let weights = [1.0 + skew, 1.0 - skew, -1.2, -0.8];
            Hinge { nodes: [a, b, c, (a + 3) % 7], weights, rest, side: skew.signum(), stiffness }
        }).collect();
        let tets = tets.into_iter().map(|(first, rest, other, stiffness)| {
            let rest = if other { -rest } else { rest };
            Tet { nodes: [first, first + 1, first + 2, first + 3], rest, stiffness }
        }).collect();
        let network = Network { masses: masses.clone(), springs, hinges, tets, ..Network::default() };
        let at = |positions: Vec<Point3<f64>>| {
            let mut solver = MassSpring::new(network.clone(), positions, &[], Config::default()).expect("valid");
            (0..7).map(|node| solver.pull_on(&[node])).collect::<Vec<_>>()
        };
        let mut matrix = DMatrix::zeros(21, 21);
        let step = 1e-6;
        for column in 0..21 {
            let moved = |by: f64| {
                let mut moved = positions.clone();
                moved[column / 3][column % 3] += by;
                at(moved)
            };
            let (ahead, behind) = (moved(step), moved(-step));
            for row in 0..21 {
                let slope = (ahead[row / 3][row % 3] - behind[row / 3][row % 3]) / (2.0 * step);
                matrix[(row, column)] = -slope / (masses[row / 3] * masses[column / 3]).sqrt();
            }
        }
        // A hinge at its fold has no derivative there: such cases are skipped.
        let symmetric = (&matrix - matrix.transpose()).amax() < 1e-3 * (1.0 + matrix.amax());
        prop_assume!(symmetric);
        let largest = SymmetricEigen::new((&matrix + matrix.transpose()) * 0.5).eigenvalues.max();
        let solver = MassSpring::new(network, positions, &[], Config::default()).expect("valid");
        let bound = 4.0 / solver.safe_step().powi(2);
        prop_assert!(largest <= bound * (1.0 + 1e-5) + 1e-3, "{largest} above {bound}");
    }

    /// Forces are minus the gradient of the energy, also for hinges turned inside out.
    #[test]
    fn forces_are_the_slope_of_the_energy(
        points in prop::collection::vec([-1.0..1.0, -1.0..1.0, -1.0..1.0], 4),
        rest in 0.1..2.0,
        side in prop::bool::ANY,
        direction in prop::collection::vec(-1.0..1.0, 12),
    ) {
        let positions: Vec<_> = points.into_iter().map(Point3::from).collect();
        let side = if side { 1.0 } else { -1.0 };
        let hinge = Hinge { nodes: [0, 1, 2, 3], weights: [1.3, 0.7, -1.2, -0.8], rest, side, stiffness: 3.0 };
        let springs = vec![Spring { nodes: [0, 3], rest: 0.4, stiffness: 2.0 }];
        let network = Network { masses: vec![1.0; 4], springs, hinges: vec![hinge], ..Network::default() };
        let at = |by: f64| {
            let moved = positions.iter().enumerate().map(|(node, point)| {
                point + Vector3::from_column_slice(&direction[3 * node..3 * node + 3]) * by
            });
            MassSpring::new(network.clone(), moved.collect(), &[], Config::default()).expect("valid")
        };
        let step = 1e-6;
        let slope = (at(step).elastic_energy() - at(-step).elastic_energy()) / (2.0 * step);
        let mut here = at(0.0);
        let forces: Vec<f64> = (0..4).flat_map(|node| here.pull_on(&[node]).iter().copied().collect::<Vec<_>>()).collect();
        let along = DVector::from_vec(forces).dot(&DVector::from_column_slice(&direction));
        let six = {
            let [a, b, c, d] = [0, 1, 2, 3].map(|node| positions[node]);
            (b - a).cross(&(c - a)).dot(&(d - a))
        };
        prop_assume!(six.abs() > 1e-4);
        prop_assert!((slope + along).abs() < 1e-4 * (1.0 + slope.abs()), "{slope} against {along}");
    }
}

#[test]
fn both_linear_solvers_and_the_explicit_method_agree() {
    let (points, triangles) = grid(8, 0.1);
    let network = Network::from_surface(&points, &triangles, &CLOTH).expect("valid");
    let end = |config: Config, dt: f64| {
        let mut solver = MassSpring::new(network.clone(), points.clone(), &[0, 8], config).expect("valid");
        for _ in 0..(0.1_f64 / dt).round() as usize {
            solver.step(dt, &under_gravity()).expect("a step");
        }
        solver.state().positions.clone()
    };
    let far = |first: &[Point3<f64>], second: &[Point3<f64>]| {
        first.iter().zip(second).map(|(first, second)| (first - second).norm()).fold(0.0, f64::max)
    };
    let lagging = |config| Config { lag: 2e-4, damping: 1.0, ..config };
    let by_gradients = end(lagging(implicit(GRADIENTS, 2)), 1e-3);
    let by_cholesky = end(lagging(implicit(LinearSolver::Cholesky, 2)), 1e-3);
    assert!(far(&by_gradients, &by_cholesky) < 1e-8);
    let warped = end(lagging(implicit(WARPED, 2)), 1e-3);
    assert!(far(&warped, &by_cholesky) < 1e-8, "{}", far(&warped, &by_cholesky));
    let explicit = end(lagging(explicit(TooLarge::Refuse)), 2e-5);
    let implicit = end(lagging(implicit(LinearSolver::Cholesky, 3)), 5e-5);
    let moved = far(&explicit, &points);
    assert!(
        moved > 0.02 && far(&explicit, &implicit) < 0.01 * moved,
        "{} of {moved}",
        far(&explicit, &implicit)
    );
}

/// Iterations for a falling cloth of 64 × 64, hanging by two corners, with a third one prescribed.
#[test]
fn the_factor_of_the_cloth_at_rest_does_most_of_the_work_of_the_iteration() {
    let (points, triangles) = grid(64, 0.1);
    let material = SurfaceMaterial { bending_stiffness: 1e-6, ..CLOTH };
    let network = Network::from_surface(&points, &triangles, &material).expect("valid");
    let iterations = |solver: LinearSolver| {
        let config = Config { damping: 1.0, ..implicit(solver, 1) };
        let mut solver = MassSpring::new(network.clone(), points.clone(), &[0, 64], config).expect("valid");
        let mut most = 0;
        for step in 1..=40 {
            let position = points[65 * 64] + Vector3::new(0.0, 0.0, 2e-4 * f64::from(step));
            let driven = [Prescribed { node: 65 * 64, position }];
            let input = Input { gravity: DOWN, prescribed: &driven, ..Input::default() };
            most = most.max(solver.step(1e-3, &input).expect("a step").iterations);
        }
        (most, solver.state().clone())
    };
    let (many, slowly) =
        iterations(LinearSolver::ConjugateGradients { tolerance: 1e-3, iterations_max: 1000 });
    let (few, quickly) = iterations(LinearSolver::Warped { tolerance: 1e-3, iterations_max: 1000 });
    assert!(few <= 30 && many >= 6 * few, "{few} and {many} iterations");
    let apart = slowly.positions.iter().zip(&quickly.positions).map(|(a, b)| (a - b).norm());
    assert!(apart.fold(0.0, f64::max) < 5e-6, "they do not end at the same place");
}

#[test]
fn contacts_give_the_momentum_that_they_tell() {
    let (points, triangles) = grid(6, 0.05);
    let network = Network::from_surface(&points, &triangles, &CLOTH).expect("valid");
    let mass: f64 = network.masses.iter().sum();
    let divided = explicit(TooLarge::Divide { most: 200 });
    for config in [divided, implicit(GRADIENTS, 1), implicit(WARPED, 1), implicit(LinearSolver::Cholesky, 3)]
    {
        let config = Config { lag: 1e-4, ..config };
        let mut solver = MassSpring::new(network.clone(), points.clone(), &[], config).expect("valid");
        let dt = 1e-3;
        let mut given = Vector3::zeros();
        for _ in 0..500 {
            // A floor at z = −1 mm that moves along x, in contact with nodes and triangle centres.
            let floor = |nodes: [u32; 3], weights: [f64; 3]| {
                let at = |node: u32| solver.state().positions[node as usize].z;
                let height: f64 = nodes.iter().zip(weights).map(|(&node, weight)| weight * at(node)).sum();
                let contact = Contact::at_node(0, Vector3::z(), -1e-3 - height, 200.0);
                let velocity = Vector3::new(0.02, 0.0, 0.0);
                Contact { nodes, weights, velocity, damping: 0.02, friction: 0.4, ..contact }
            };
            let mut contacts: Vec<Contact> =
                (0..points.len() as u32).map(|node| floor([node; 3], [1.0, 0.0, 0.0])).collect();
            contacts.extend(triangles.iter().map(|&corners| floor(corners, [0.25, 0.25, 0.5])));
            let before = solver.momentum()[0];
            solver
                .step(dt, &Input { gravity: DOWN, contacts: &contacts, ..Input::default() })
                .expect("a step");
            let force: Vector3<f64> = solver.contact_forces().iter().sum();
            let budget = before + (DOWN * mass + force) * dt;
            let off = (solver.momentum()[0] - budget).norm();
            assert!(off < 1e-8 * mass, "{config:?}: {off} of {}", mass * G * dt);
            given += force * dt;
        }
        // It is at rest relative to the floor, which carries it and drags it along.
        let state = solver.state();
        let lowest = state.positions.iter().map(|point| point.z).fold(0.0, f64::min);
        assert!(lowest > -1.3e-3, "{lowest}");
        assert!((given.z / (mass * G * 0.5) - 1.0).abs() < 0.05, "{given}");
        let along = solver.momentum()[0].x / mass;
        assert!((along - 0.02).abs() < 2e-3, "{along} m/s");
    }
}

#[test]
fn friction_holds_below_its_angle_and_slides_above() {
    let network = Network { masses: vec![0.01], ..Network::default() };
    let slide = |degrees: f64| {
        let normal = Vector3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos());
        let mut solver =
            MassSpring::new(network.clone(), vec![Point3::origin()], &[], explicit(TooLarge::Refuse))
                .expect("valid");
        // At rest in the slope from the beginning.
        let sunk = 0.01 * G * normal.z / 1000.0;
        for _ in 0..1000 {
            let depth = sunk - solver.state().positions[0].coords.dot(&normal);
            let contact =
                Contact { friction: 0.5, damping: 1.0, ..Contact::at_node(0, normal, depth, 1000.0) };
            solver
                .step(1e-3, &Input { gravity: DOWN, contacts: &[contact], ..Input::default() })
                .expect("a step");
        }
        solver.state().positions[0].coords.norm()
    };
    // tan 26.57° = 0.5.
    assert!(slide(26.0) < 1e-6, "{}", slide(26.0));
    let (sin, cos) = 35.0_f64.to_radians().sin_cos();
    let wanted = 0.5 * G * (sin - 0.5 * cos);
    assert!((slide(35.0) / wanted - 1.0).abs() < 0.01, "{} m, not {wanted} m", slide(35.0));
}

#[test]
fn led_nodes_are_where_they_have_to_be_and_pull_the_rest_along() {
    for config in [
        explicit(TooLarge::Divide { most: 100 }),
        implicit(GRADIENTS, 1),
        implicit(WARPED, 1),
        implicit(LinearSolver::Cholesky, 1),
    ] {
        let (points, triangles) = grid(5, 0.05);
        let network = Network::from_surface(&points, &triangles, &CLOTH).expect("valid");
        let config = Config { damping: 5.0, ..config };
        let mut solver = MassSpring::new(network, points.clone(), &[], config).expect("valid");
        for step in 1..=500 {
            let position = points[0] + Vector3::new(0.0, 0.0, 1e-4 * f64::from(step));
            let driven = [Prescribed { node: 0, position }, Prescribed { node: 5, position: points[5] }];
            solver.step(1e-3, &Input { prescribed: &driven, ..Input::default() }).expect("a step");
            assert_eq!(solver.state().positions[0], position);
            assert_eq!(solver.state().positions[5], points[5]);
        }
        assert!(solver.state().positions[7].z > 0.01);
        // Once released, it is free.
        for _ in 0..10 {
            solver.step(1e-3, &under_gravity()).expect("a step");
        }
        assert!(solver.state().positions[0].z < 0.05);
    }
}

#[test]
fn a_solver_restored_mid_run_goes_on_with_the_same_bits() {
    for config in [
        explicit(TooLarge::Divide { most: 1000 }),
        implicit(GRADIENTS, 2),
        implicit(WARPED, 2),
        implicit(LinearSolver::Cholesky, 1),
    ] {
        let mut first = thrown_tube(Config { lag: 1e-4, ..config });
        for _ in 0..20 {
            first.step(1e-3, &under_gravity()).expect("a step");
        }
        let text = serde_json::to_string(first.state()).expect("a state");
        let state = serde_json::from_str(&text).expect("a state");
        let config = Config { lag: 1e-4, ..config };
        let mut second = MassSpring::restore(first.network().clone(), state, &[], config).expect("valid");
        for _ in 0..20 {
            let reports = [&mut first, &mut second].map(|solver| solver.step(1e-3, &under_gravity()));
            assert_eq!(reports[0], reports[1]);
        }
        assert_eq!(first.state(), second.state());
    }
}

#[test]
fn what_cannot_be_simulated_is_named() {
    let (points, mut triangles) = grid(2, 1.0);
    triangles[3] = [0, 1, 2];
    triangles[5] = [0, 1, 2];
    let refused = Network::from_surface(&points, &triangles, &CLOTH).expect_err("no area");
    assert_eq!(refused.to_string(), "triangles without extent: 3, 5");
    triangles[4] = [0, 1, 99];
    triangles[6] = [1, 1, 2];
    let refused = Network::from_surface(&points, &triangles, &CLOTH).expect_err("no such node");
    assert_eq!(
        refused.to_string(),
        "triangles that name a node twice, or one that does not exist (there are 9): 4, 6"
    );
    let mut nowhere = points.clone();
    nowhere[4].x = f64::NAN;
    assert!(matches!(
        Network::from_surface(&nowhere, &grid(2, 1.0).1, &CLOTH),
        Err(NetworkError::NotFinite(faulty)) if faulty.first == [4]
    ));
    let stray: Vec<_> = points.iter().copied().chain([Point3::origin()]).collect();
    assert!(matches!(
        Network::from_surface(&stray, &grid(2, 1.0).1, &CLOTH),
        Err(NetworkError::Masses(faulty)) if faulty.first == [9]
    ));
    let soft = SurfaceMaterial { membrane_stiffness: -1.0, ..CLOTH };
    assert!(Network::from_surface(&points, &grid(2, 1.0).1, &soft).is_err());

    let network = Network::from_surface(&points, &grid(2, 1.0).1, &CLOTH).expect("valid");
    let mut solver = MassSpring::new(network, points, &[], Config::default()).expect("valid");
    assert_eq!(
        solver.step(f64::NAN, &Input::default()).map(|_| ()).expect_err("no time").to_string(),
        "a step of NaN s: above 0 and finite is valid"
    );
    let contact = Contact::at_node(0, Vector3::zeros(), 0.0, 1.0);
    let refused = solver.step(1e-3, &Input { contacts: &[contact], ..Input::default() });
    assert_eq!(
        refused.expect_err("no direction").to_string(),
        "contact 0: has a normal that is not a unit vector"
    );
    let force = [NodeForce { node: 99, force: Vector3::zeros() }];
    assert!(solver.step(1e-3, &Input { forces: &force, ..Input::default() }).is_err());
    let force = [NodeForce { node: 1, force: Vector3::new(1e308, 1e308, 0.0) }];
    let before = solver.state().clone();
    assert!(matches!(
        solver.step(1.0, &Input { forces: &force, ..Input::default() }),
        Err(StepError::NotFinite { .. } | StepError::Runaway { .. } | StepError::TooManyParts { .. })
    ));
    assert_eq!(*solver.state(), before);
}
