//! What keeps the tetrahedra of a volume from collapsing.

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_simulator::mass_spring::{
    Config, Input, LinearSolver, MassSpring, Network, Tet, TooLarge, VolumeMaterial,
};

use crate::support::springs::*;

const MATERIAL: VolumeMaterial = VolumeMaterial { young_modulus: 2e4, density: 1000.0 };
/// Share of the volume below which a tetrahedron resists.
const BEGIN: f64 = 0.95;

/// A cube of 2 cm, of `n`³ cells of six tetrahedra each.
fn cube(n: u32) -> (Network, Vec<Point3<f64>>) {
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
    (Network::from_volume(&points, &tets, &MATERIAL).expect("valid"), points)
}

/// The same cube with its height times `by`.
fn squeezed(points: &[Point3<f64>], by: f64) -> Vec<Point3<f64>> {
    points.iter().map(|point| Point3::new(point.x, point.y, by * point.z)).collect()
}

fn bare(network: &Network) -> Network {
    Network { tets: Vec::new(), ..network.clone() }
}

fn energy(network: &Network, positions: Vec<Point3<f64>>) -> f64 {
    MassSpring::new(network.clone(), positions, &[], Config::default()).expect("valid").elastic_energy()
}

/// The closed form of the energy, and none at small strain.
#[test]
fn a_squeezed_volume_has_the_energy_of_its_law_and_at_small_strain_none() {
    let (network, points) = cube(2);
    assert_eq!(network.tets.len(), 48);
    for by in [1.3, 1.0, 0.951] {
        let at = squeezed(&points, by);
        assert_eq!(energy(&network, at.clone()), energy(&bare(&network), at), "{by}");
    }
    for by in [0.9, 0.6, 0.25] {
        let at = squeezed(&points, by);
        let found = energy(&network, at.clone()) - energy(&bare(&network), at);
        let law =
            BEGIN * BEGIN * (BEGIN / by).ln() - 2.0 * BEGIN * (BEGIN - by) + 0.5 * (BEGIN * BEGIN - by * by);
        let known = MATERIAL.young_modulus * 8e-6 * law;
        assert!((found / known - 1.0).abs() < 1e-9, "{by}: {found} J, {known} J");
    }
}

/// Springs alone have no energy in a mirror; with the tetrahedra the more, the further the volume is inside out.
#[test]
fn squeezing_a_volume_costs_ever_more_through_flat_to_inside_out() {
    let (network, points) = cube(2);
    let along: Vec<f64> = (0..40).map(|k| 1.0 - 0.05 * f64::from(k)).collect();
    let energies: Vec<f64> = along.iter().map(|by| energy(&network, squeezed(&points, *by))).collect();
    assert!(energies.windows(2).all(|pair| pair[1] > pair[0]), "{energies:?}");
    assert!(energy(&bare(&network), squeezed(&points, -1.0)) < 1e-12 * energies[10]);
    // Down to a tenth of its height a stress that grows.
    let stresses: Vec<f64> = energies[..18].windows(2).map(|pair| pair[1] - pair[0]).collect();
    assert!(stresses.windows(2).all(|pair| pair[1] > pair[0]), "{stresses:?}");
}

/// A cube that is its own mirror image, which is a state of rest of springs alone.
#[test]
fn what_is_inside_out_turns_back_by_both_methods() {
    let (network, points) = cube(1);
    let mirrored = squeezed(&points, -1.0);
    let held: Vec<u32> = (0..8).filter(|node| node % 2 == 0).collect();
    let volume = |solver: &MassSpring| {
        let at = &solver.state().positions;
        let of = |tet: &Tet| {
            let [a, b, c, d] = tet.nodes.map(|node| at[node as usize]);
            (b - a).cross(&(c - a)).dot(&(d - a)) / tet.rest
        };
        network.tets.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    let by_parts = explicit(TooLarge::Divide { most: 100 });
    for config in [by_parts, implicit(GRADIENTS, 1), implicit(LinearSolver::Cholesky, 1)] {
        let config = Config { lag: 1e-3, damping: 5.0, ..config };
        let end = |network: &Network| {
            let mut solver =
                MassSpring::new(network.clone(), mirrored.clone(), &held, config).expect("valid");
            for _ in 0..1000 {
                solver.step(1e-3, &Input::default()).expect("a step");
            }
            volume(&solver)
        };
        let (with, without) = (end(&network), end(&bare(&network)));
        assert!(with > 0.3, "{config:?}: {with}");
        assert!(without < -0.9, "{config:?}: {without}");
    }
}

/// A block that its weight squeezes to far below its height.
#[test]
fn a_squeezed_volume_moves_alike_by_all_methods() {
    let (network, points) = cube(2);
    let held: Vec<u32> = (0..27).filter(|node| node % 3 == 0).collect();
    let heavy = Input { gravity: 40.0 * DOWN, ..Input::default() };
    let end = |config: Config, dt: f64| {
        let mut solver = MassSpring::new(network.clone(), points.clone(), &held, config).expect("valid");
        for _ in 0..(0.02_f64 / dt).round() as usize {
            solver.step(dt, &heavy).expect("a step");
        }
        solver.state().positions.clone()
    };
    let far = |first: &[Point3<f64>], second: &[Point3<f64>]| {
        first.iter().zip(second).map(|(first, second)| (first - second).norm()).fold(0.0, f64::max)
    };
    let lagging = |config| Config { lag: 2e-4, damping: 1.0, ..config };
    let by_cholesky = end(lagging(implicit(LinearSolver::Cholesky, 2)), 1e-3);
    let by_gradients = end(lagging(implicit(GRADIENTS, 2)), 1e-3);
    assert!(far(&by_gradients, &by_cholesky) < 1e-7, "{}", far(&by_gradients, &by_cholesky));
    let explicit = end(lagging(explicit(TooLarge::Refuse)), 1e-5);
    let implicit = end(lagging(implicit(LinearSolver::Cholesky, 3)), 2e-5);
    let moved = far(&explicit, &points);
    let lowest = explicit.iter().zip(&points).map(|(at, from)| at.z - from.z).fold(0.0, f64::min);
    assert!(lowest < -4e-3, "{lowest}");
    assert!(far(&explicit, &implicit) < 0.01 * moved, "{} of {moved}", far(&explicit, &implicit));
}

/// A strongly squeezed cube springs apart: its energy stays, and so do its momenta.
#[test]
fn a_squeezed_volume_keeps_its_energy_and_momentum() {
    let (network, points) = cube(2);
    let mut solver =
        MassSpring::new(network, squeezed(&points, 0.3), &[], explicit(TooLarge::Refuse)).expect("valid");
    let dt = 0.05 * solver.safe_step();
    let energy = |solver: &MassSpring| solver.elastic_energy() + solver.kinetic_energy();
    let begun = energy(&solver);
    let (mut least, mut most) = (begun, begun);
    for _ in 0..20_000 {
        solver.step(dt, &Input::default()).expect("a step");
        least = least.min(energy(&solver));
        most = most.max(energy(&solver));
    }
    assert!(least > 0.98 * begun && most < 1.02 * begun, "{least} to {most} of {begun} J");
    let [linear, angular] = solver.momentum();
    let scale = (2.0 * 0.008 * begun).sqrt();
    assert!(linear.norm() < 1e-11 * scale && angular.norm() < 1e-12 * scale, "{linear} {angular}");
}

/// Where a step may not be divided often enough, the tetrahedra give way: the step is neither refused nor unstable.
#[test]
fn too_few_parts_soften_a_squeezed_volume_and_create_no_energy() {
    let (network, points) = cube(2);
    for most in [6, 12, 200] {
        // Springs that are damped as much as those of a scene by default.
        let config = Config { lag: 2e-4, ..explicit(TooLarge::Divide { most }) };
        let at_rest =
            |at: Vec<Point3<f64>>| MassSpring::new(network.clone(), at, &[], config).expect("valid");
        // Enough parts for the springs, with the least ones too few for the tetrahedra.
        let step = 5.0 * at_rest(points.clone()).safe_step();
        assert!(step / at_rest(squeezed(&points, 0.3)).safe_step() > 8.0);
        for by in [0.7, 0.5, 0.3, 0.15] {
            let mut solver = at_rest(squeezed(&points, by));
            let energy = |solver: &MassSpring| solver.elastic_energy() + solver.kinetic_energy();
            let begun = energy(&solver);
            for _ in 0..1000 {
                let parts = solver.step(step, &Input::default()).expect("a step").parts;
                let now = energy(&solver);
                assert!(parts <= most && now < begun, "{most}, {by}: {parts} parts, {now} J, {begun} J");
            }
            assert!(energy(&solver) < 1e-9 * begun, "{most}, {by}: {} J", energy(&solver));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    /// In any shape, inside out too; and they neither push nor turn the whole.
    #[test]
    fn forces_of_a_tetrahedron_are_the_slope_of_its_energy(
        points in prop::collection::vec([-1.0..1.0, -1.0..1.0, -1.0..1.0], 4),
        rest in 0.1_f64..3.0,
        other in prop::bool::ANY,
        direction in prop::collection::vec(-1.0..1.0, 12),
    ) {
        let rest = if other { -rest } else { rest };
        let positions: Vec<_> = points.into_iter().map(Point3::from).collect();
        let tets = vec![Tet { nodes: [0, 1, 2, 3], rest, stiffness: 3.0 }];
        let network = Network { masses: vec![1.0; 4], tets, ..Network::default() };
        let at = |by: f64| {
            let moved = positions.iter().enumerate().map(|(node, point)| {
                point + Vector3::from_column_slice(&direction[3 * node..3 * node + 3]) * by
            });
            MassSpring::new(network.clone(), moved.collect(), &[], Config::default()).expect("valid")
        };
        let step = 1e-6;
        let slope = (at(step).elastic_energy() - at(-step).elastic_energy()) / (2.0 * step);
        let mut here = at(0.0);
        let forces: Vec<Vector3<f64>> = (0..4).map(|node| here.pull_on(&[node])).collect();
        let along: f64 = forces.iter().enumerate().map(|(node, force)| {
            force.dot(&Vector3::from_column_slice(&direction[3 * node..3 * node + 3]))
        }).sum();
        let scale: f64 = 1.0 + forces.iter().map(|force| force.norm()).sum::<f64>();
        prop_assert!((slope + along).abs() < 1e-5 * scale, "{slope} against {along}");
        let sum: Vector3<f64> = forces.iter().sum();
        let moment: Vector3<f64> = positions.iter().zip(&forces).map(|(at, force)| at.coords.cross(force)).sum();
        prop_assert!(sum.norm() < 1e-12 * scale && moment.norm() < 1e-12 * scale, "{sum} {moment}");
    }
}
