//! What a step of soft matter costs, on one thread: `cargo bench -p trocar-simulator --bench soft`.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use nalgebra::{Point3, Vector3};
use trocar_dynamics::soft_body::bearing::rigid_response::RigidPresses;
use trocar_dynamics::soft_body::jaw_friction::JawFriction;
use trocar_simulator::mass_spring::{
    Config, Input, Integrator, LinearSolver, MassSpring, Network, SurfaceMaterial, TooLarge,
};
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig, XpbdInput};

/// Gauze: 10 × 10 cm of `n` × `n` squares, held at two corners.
fn cloth(n: u32, config: Config) -> MassSpring {
    let at = |i: u32| 0.1 * f64::from(i) / f64::from(n);
    let points: Vec<_> = (0..=n).flat_map(|j| (0..=n).map(move |i| Point3::new(at(i), at(j), 0.0))).collect();
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|j| {
            (0..n).flat_map(move |i| {
                let [a, b, c, d] =
                    [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
                [[a, b, d], [a, d, c]]
            })
        })
        .collect();
    let material = SurfaceMaterial { membrane_stiffness: 500.0, bending_stiffness: 1e-6, density: 0.15 };
    let network = Network::from_surface(&points, &triangles, &material).expect("a surface");
    MassSpring::new(network, points, &[0, n], config).expect("a cloth")
}

const INPUT: Input<'static> = Input {
    gravity: Vector3::new(0.0, 0.0, -9.81),
    forces: &[],
    prescribed: &[],
    contacts: &[],
    rigid: RigidPresses { bodies: &[], contacts: &[] },
    jaws: JawFriction { grips: &[], limits: &[] },
};

fn mass_spring(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("mass_spring");
    group.sample_size(30);
    for n in [16, 32, 64] {
        let refuse = Integrator::Explicit { too_large: TooLarge::Refuse };
        let mut explicit = cloth(n, Config { integrator: refuse, damping: 1.0, ..Config::default() });
        let dt = 0.9 * explicit.safe_step();
        group.bench_function(BenchmarkId::new("explicit", n), |bench| {
            bench.iter(|| explicit.step(dt, &INPUT).expect("a step"));
        });
        let gradients = LinearSolver::ConjugateGradients { tolerance: 1e-4, iterations_max: 500 };
        let warped = LinearSolver::Warped { tolerance: 1e-4, iterations_max: 500 };
        let solvers = [("gradients", gradients), ("warped", warped), ("cholesky", LinearSolver::Cholesky)];
        for (name, solver) in solvers {
            for milliseconds in [1, 10] {
                let integrator = Integrator::Implicit { solver, newton: 1 };
                let mut implicit = cloth(n, Config { integrator, damping: 1.0, ..Config::default() });
                for _ in 0..50 {
                    implicit.step(1e-3, &INPUT).expect("a step");
                }
                let name = format!("implicit, {name}, {milliseconds} ms");
                group.bench_function(BenchmarkId::new(name, n), |bench| {
                    bench.iter(|| implicit.step(1e-3 * f64::from(milliseconds), &INPUT).expect("a step"));
                });
            }
        }
    }
    group.finish();
}

/// A beam of 2,520 tetrahedra under its weight, five rounds of its constraints in a step of 5 ms.
fn xpbd(criterion: &mut Criterion) {
    let (cells, edge) = ([30_u32, 7, 2], 0.01);
    let side = cells.map(|count| count + 1);
    let points: Vec<_> = (0..side[0] * side[1] * side[2])
        .map(|index| [index / side[2] / side[1], index / side[2] % side[1], index % side[2]])
        .map(|[i, j, k]| Point3::new(f64::from(i) * edge, f64::from(j) * edge, f64::from(k) * edge))
        .collect();
    let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
    let tets: Vec<[u32; 4]> = (0..cells[0] * cells[1] * cells[2])
        .map(|index| [index / cells[2] / cells[1], index / cells[2] % cells[1], index % cells[2]])
        .flat_map(|[i, j, k]| {
            let corner =
                |local: u32| ((i + local / 4) * side[1] + j + local / 2 % 2) * side[2] + k + local % 2;
            six.map(|tet| tet.map(corner))
        })
        .collect();
    let elasticity = Some(Elasticity { young_modulus: 1e5, poisson_ratio: 0.3, density: 1000.0 });
    let body = Body { rest: &points, tets: &tets, elasticity, ..Body::default() };
    let clamped: Vec<u32> = (0..side[1] * side[2]).collect();
    let mut group = criterion.benchmark_group("xpbd");
    for (parts, iterations) in [(1, 5), (5, 1)] {
        let config = XpbdConfig { parts, iterations, damping: 1.0, ..XpbdConfig::default() };
        let mut solver = Xpbd::new(&body, &clamped, config).expect("a body");
        let input = XpbdInput { gravity: Vector3::new(0.0, 0.0, -9.81), ..XpbdInput::default() };
        group.bench_function(
            BenchmarkId::new(format!("{parts} parts, {iterations} iterations"), tets.len()),
            |bench| {
                bench.iter(|| solver.step(5e-3, &input).expect("a step"));
            },
        );
    }
    group.finish();
}

criterion_group!(benches, mass_spring, xpbd);
criterion_main!(benches);
