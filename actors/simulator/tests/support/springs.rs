//! Meshes, materials and methods shared by mass-spring tests.
#![allow(dead_code)] // every test uses another part

use nalgebra::{Point3, Vector3};
use trocar_simulator::mass_spring::{
    Config, Input, Integrator, LinearSolver, Network, Spring, SurfaceMaterial, TooLarge,
};

pub const G: f64 = 9.81;
pub const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -G);

pub fn explicit(too_large: TooLarge) -> Config {
    Config { integrator: Integrator::Explicit { too_large }, ..Config::default() }
}
pub fn implicit(solver: LinearSolver, newton: u32) -> Config {
    Config { integrator: Integrator::Implicit { solver, newton }, ..Config::default() }
}
pub const GRADIENTS: LinearSolver =
    LinearSolver::ConjugateGradients { tolerance: 1e-10, iterations_max: 2000 };
pub const WARPED: LinearSolver = LinearSolver::Warped { tolerance: 1e-10, iterations_max: 2000 };
pub fn under_gravity<'a>() -> Input<'a> {
    Input { gravity: DOWN, ..Input::default() }
}

/// A chain along `step` from the origin with equal masses and springs.
pub fn chain(
    count: usize,
    mass: f64,
    stiffness: f64,
    rest: f64,
    step: Vector3<f64>,
) -> (Network, Vec<Point3<f64>>) {
    let springs = (1..count as u32).map(|node| Spring { nodes: [node - 1, node], rest, stiffness }).collect();
    let positions = (0..count).map(|node| Point3::from(step * node as f64)).collect();
    (Network { masses: vec![mass; count], springs, ..Network::default() }, positions)
}

/// A grid of `n` × `n` squares of side `size / n`, each of two triangles.
pub fn grid(n: u32, size: f64) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let at = |i: u32| size * f64::from(i) / f64::from(n);
    let points = (0..=n).flat_map(|j| (0..=n).map(move |i| Point3::new(at(i), at(j), 0.0))).collect();
    let triangles = (0..n).flat_map(|j| {
        (0..n).flat_map(move |i| {
            let [a, b, c, d] = [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
            [[a, b, d], [a, d, c]]
        })
    });
    (points, triangles.collect())
}

/// A cylinder of radius 1 cm along z, its ends open.
pub fn tube(around: u32, along: u32) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let point = move |i: u32, j: u32| {
        let angle = std::f64::consts::TAU * f64::from(i) / f64::from(around);
        Point3::new(0.01 * angle.cos(), 0.01 * angle.sin(), 0.003 * f64::from(j))
    };
    let points = (0..=along).flat_map(|j| (0..around).map(move |i| point(i, j))).collect();
    let triangles = (0..along).flat_map(|j| {
        (0..around).flat_map(move |i| {
            let next = (i + 1) % around;
            let [a, b, c, d] = [[i, j], [next, j], [i, j + 1], [next, j + 1]].map(|[i, j]| j * around + i);
            [[a, b, d], [a, d, c]]
        })
    });
    (points, triangles.collect())
}

pub const CLOTH: SurfaceMaterial =
    SurfaceMaterial { membrane_stiffness: 500.0, bending_stiffness: 1e-5, density: 0.15 };
