//! Mass-spring networks against closed forms: pendulum, chain, string, catenary, elastica, plate.

use nalgebra::{Point3, Vector3};
use trocar_simulator::mass_spring::{
    Config, Input, LineMaterial, LinearSolver, MassSpring, Network, NodeForce, Spring, SurfaceMaterial,
    TooLarge,
};

use crate::support::springs::*;

/// Period of a pendulum of 1 m released at an angle, relative to that of small oscillations.
fn pendulum(angle: f64) -> f64 {
    let bob = Point3::new(angle.sin(), 0.0, -angle.cos());
    let network = Network {
        masses: vec![1.0; 2],
        springs: vec![Spring { nodes: [0, 1], rest: 1.0, stiffness: 1e7 }],
        ..Network::default()
    };
    let mut solver = MassSpring::new(network, vec![Point3::origin(), bob], &[0], explicit(TooLarge::Refuse))
        .expect("valid");
    let dt = 1e-4;
    let (mut crossings, mut before) = (Vec::new(), bob.x);
    for step in 1..200_000 {
        solver.step(dt, &under_gravity()).expect("a step");
        let now = solver.state().positions[1].x;
        if before * now < 0.0 {
            crossings.push(dt * (f64::from(step) - now / (now - before)));
        }
        before = now;
        if crossings.len() == 5 {
            break;
        }
    }
    (crossings[4] - crossings[0]) / 2.0 / (std::f64::consts::TAU * (1.0 / G).sqrt())
}

#[test]
fn a_pendulum_swings_with_the_period_of_the_elliptic_integral() {
    for (degrees, wanted) in [(30.0_f64, 1.0174088), (90.0, 1.1803406)] {
        let found = pendulum(degrees.to_radians());
        assert!((found / wanted - 1.0).abs() < 1e-5, "{degrees}°: {found}, not {wanted}");
    }
}

#[test]
fn a_hanging_chain_stretches_by_the_sum_of_what_hangs_below() {
    let (network, positions) = chain(21, 1e-3, 50.0, 0.05, Vector3::new(0.0, 0.0, -0.05));
    let config = Config { damping: 20.0, ..explicit(TooLarge::Refuse) };
    let mut slowly = MassSpring::new(network.clone(), positions.clone(), &[0], config).expect("valid");
    for _ in 0..40_000 {
        slowly.step(5e-4, &under_gravity()).expect("a step");
    }
    let mut at_once =
        MassSpring::new(network, positions, &[0], implicit(LinearSolver::Cholesky, 5)).expect("valid");
    for _ in 0..60 {
        at_once.step(1.0, &under_gravity()).expect("a step");
    }
    for solver in [slowly, at_once] {
        let elongation = -solver.state().positions[20].z - 1.0;
        assert!((elongation / 0.041202 - 1.0).abs() < 1e-6, "{elongation}");
    }
}

#[test]
fn a_string_rings_with_its_first_frequency() {
    // Twenty masses of a gram between two ends, 0.05 m apart under 1 N.
    let (network, mut positions) = chain(22, 1e-3, 1000.0, 0.049, Vector3::new(0.05, 0.0, 0.0));
    for (node, position) in positions.iter_mut().enumerate() {
        position.z = 1e-6 * (std::f64::consts::PI * node as f64 / 21.0).sin();
    }
    let mut solver =
        MassSpring::new(network, positions, &[0, 21], explicit(TooLarge::Refuse)).expect("valid");
    let (dt, mut crossings, mut before) = (1e-4, Vec::new(), 1.0);
    for step in 1..40_000 {
        solver.step(dt, &Input::default()).expect("a step");
        let now = solver.state().positions[10].z;
        if before * now < 0.0 {
            crossings.push(dt * (f64::from(step) - now / (now - before)));
        }
        before = now;
    }
    let periods = (crossings.len() - 1) as f64 / 2.0;
    let frequency = periods / (crossings[crossings.len() - 1] - crossings[0]);
    assert!((frequency / 3.364_036_13 - 1.0).abs() < 1e-5, "{frequency} Hz");
}

/// The catenary through two points at the same height 0.6 m apart, 1 m long.
#[test]
fn an_inextensible_line_hangs_as_a_catenary() {
    let error_of = |segments: u32| {
        let count = segments + 1;
        let rest: Vec<_> =
            (0..count).map(|node| Point3::new(f64::from(node) / f64::from(segments), 0.0, 0.0)).collect();
        let edges: Vec<_> = (0..segments).map(|node| [node, node + 1]).collect();
        let material = LineMaterial { axial_stiffness: 1e5, bending_stiffness: 0.0, density: 0.01 };
        let network = Network::from_line(&rest, &edges, &material).expect("valid");
        // Laid as a triangle, so that it has a side to fall to.
        let start = (0..count).map(|node| {
            let along = f64::from(node) / f64::from(segments);
            Point3::new(0.6 * along, 0.0, -0.8 * along.min(1.0 - along))
        });
        let config = Config { damping: 2.0, ..implicit(LinearSolver::Cholesky, 3) };
        let mut solver = MassSpring::new(network, start.collect(), &[0, segments], config).expect("valid");
        for _ in 0..1500 {
            solver.step(0.02, &under_gravity()).expect("a step");
        }
        let sag = -solver.state().positions.iter().map(|point| point.z).fold(0.0, f64::min);
        // The catenary's parameter is the horizontal tension over the weight per length; it is the same at every link.
        let pull = solver.pull_on(&[0]).x.abs() / (material.density * G);
        [(sag / 0.362_782_19 - 1.0).abs(), (pull / 0.163_168_27 - 1.0).abs()]
    };
    let (coarse, fine) = (error_of(20), error_of(80));
    for (what, coarse, fine) in [("sag", coarse[0], fine[0]), ("parameter", coarse[1], fine[1])] {
        assert!(fine < 1e-3, "{what}: {fine}");
        let order = (coarse / fine).log2() / 2.0;
        assert!((1.8..2.2).contains(&order), "{what}: errors {coarse} and {fine}, order {order}");
    }
}

/// Tip of a cantilever of 1 m and EI 1 under a force of constant direction at its end.
#[test]
fn a_line_bends_as_the_elastica() {
    for (load, wanted) in [(0.5, 0.162_143_58), (2.0, 0.493_457_48), (10.0, 0.810_609_02)] {
        let segments = 64_u32;
        // Two nodes held clamp the line in the middle between them.
        let length = 1.0 / (f64::from(segments) - 0.5);
        let rest: Vec<_> =
            (0..=segments).map(|node| Point3::new((f64::from(node) - 0.5) * length, 0.0, 0.0)).collect();
        let edges: Vec<_> = (0..segments).map(|node| [node, node + 1]).collect();
        let material = LineMaterial { axial_stiffness: 1e6, bending_stiffness: 1.0, density: 0.1 };
        let network = Network::from_line(&rest, &edges, &material).expect("valid");
        let config = Config { damping: 5.0, ..implicit(LinearSolver::Cholesky, 4) };
        let mut solver = MassSpring::new(network, rest, &[0, 1], config).expect("valid");
        let force = [NodeForce { node: segments, force: Vector3::new(0.0, 0.0, -load) }];
        for _ in 0..800 {
            solver.step(0.05, &Input { forces: &force, ..Input::default() }).expect("a step");
        }
        let tip = -solver.state().positions[segments as usize].z;
        assert!((tip / wanted - 1.0).abs() < 2e-3, "load {load}: {tip}, not {wanted}");
    }
}

/// Equilateral triangles rolled to a cylinder in any direction have the energy of a plate.
#[test]
fn a_rolled_sheet_holds_the_energy_of_a_plate() {
    let (n, edge, radius) = (64_u32, 1e-3, 0.3);
    let height = edge * 0.75_f64.sqrt();
    let flat: Vec<_> = (0..=n)
        .flat_map(|j| {
            (0..=n).map(move |i| {
                Point3::new(edge * (f64::from(i) + 0.5 * f64::from(j)), height * f64::from(j), 0.0)
            })
        })
        .collect();
    let (_, triangles) = grid(n, 1.0);
    // The grid's diagonals run from corner a to d; of a sheared lattice the short ones run from b to c.
    let triangles: Vec<[u32; 3]> = triangles
        .chunks_exact(2)
        .flat_map(|pair| {
            let ([a, b, d], [_, _, c]) = (pair[0], pair[1]);
            [[a, b, c], [b, d, c]]
        })
        .collect();
    let material = SurfaceMaterial { membrane_stiffness: 1.0, bending_stiffness: 2e-6, density: 0.1 };
    let mut network = Network::from_surface(&flat, &triangles, &material).expect("valid");
    network.springs.clear();
    for degrees in [0.0_f64, 20.0, 45.0, 75.0, 90.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let rolled = flat.iter().map(|point| {
            let (across, along) = (cos * point.x + sin * point.y, cos * point.y - sin * point.x);
            let angle = across / radius;
            Point3::new(radius * angle.sin(), along, radius * (1.0 - angle.cos()))
        });
        let solver =
            MassSpring::new(network.clone(), rolled.collect(), &[], Config::default()).expect("valid");
        // Each hinge represents a third of the area of its two triangles; at the border one direction has more of them.
        let area = network.hinges.len() as f64 * 2.0 * (0.5 * edge * height) / 3.0;
        let wanted = 0.5 * material.bending_stiffness / (radius * radius) * area;
        let found = solver.elastic_energy();
        assert!((found / wanted - 1.0).abs() < 0.02, "{degrees}°: {found}, not {wanted}");
    }
}
