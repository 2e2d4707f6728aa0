//! Budgets of a free thread: momentum, angular momentum, energy; and the step that an explicit spring thread would
//! need.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::particles::StepError;
use trocar_simulator::mass_spring::{Config, Input, Integrator, LineMaterial, MassSpring, Network, TooLarge};
use trocar_simulator::suture_thread::{Hold, Load, Surroundings, Thread, ThreadMaterial, ThreadState};

/// Silk without drag.
fn free_silk() -> ThreadMaterial {
    ThreadMaterial { drag: 0.0, damping: 0.0, ..ThreadMaterial::silk_2_0() }
}

/// Conserved quantities of a thread.
#[derive(Clone, Copy, Debug)]
struct Budget {
    /// Momentum \[kg·m/s\]
    linear: Vector3<f64>,
    /// Angular momentum about the origin, including the spin of edges \[kg·m²/s\].
    angular: Vector3<f64>,
    /// Kinetic, stretch, bending and twist energy \[J\].
    energy: f64,
}

fn budget(material: &ThreadMaterial, state: &ThreadState) -> Budget {
    let ThreadState { positions, velocities, rest_lengths, twists, spins, .. } = state;
    let mut sum = Budget { linear: Vector3::zeros(), angular: Vector3::zeros(), energy: 0.0 };
    let length = |edge: usize| rest_lengths.get(edge).copied().unwrap_or(0.0);
    for (node, (position, velocity)) in positions.iter().zip(velocities).enumerate() {
        let before = if node > 0 { length(node - 1) } else { 0.0 };
        let mass = 0.5 * material.mass_per_length * (before + length(node));
        sum.linear += velocity * mass;
        sum.angular += position.coords.cross(velocity) * mass;
        sum.energy += 0.5 * mass * velocity.norm_squared();
    }
    let edge_of = |edge: usize| positions[edge + 1] - positions[edge];
    for (edge, rest) in rest_lengths.iter().enumerate() {
        let inertia = 0.5 * material.mass_per_length * rest * material.radius.powi(2);
        sum.angular += edge_of(edge).normalize() * (inertia * spins[edge]);
        sum.energy += 0.5 * inertia * spins[edge].powi(2);
        sum.energy += 0.5 * material.axial_stiffness / rest * (edge_of(edge).norm() - rest).powi(2);
    }
    for node in 1..rest_lengths.len() {
        let span = 0.5 * (rest_lengths[node - 1] + rest_lengths[node]);
        let (t, u) = (edge_of(node - 1).normalize(), edge_of(node).normalize());
        let binormal = t.cross(&u) * (2.0 / (1.0 + t.dot(&u)));
        sum.energy += 0.5 * material.bending_stiffness / span * binormal.norm_squared();
        sum.energy += 0.5 * material.twisting_stiffness / span * twists[node].powi(2);
    }
    sum
}

/// A straight thread that flies, rotates and begins to bend, for a twentieth of a second: relative losses of momentum,
/// angular momentum and energy, and the largest energy relative to the initial one.
fn flown(dt: f64) -> [f64; 4] {
    let material = free_silk();
    let points: Vec<_> = (0..=40).map(|i| Point3::new(1e-3 * f64::from(i) - 0.02, 0.0, 0.0)).collect();
    let mut state = Thread::new(material, &points).expect("a thread").state().clone();
    let spin = Vector3::new(0.0, -3.0, 12.0);
    for (velocity, point) in state.velocities.iter_mut().zip(&points) {
        let bends = Vector3::new(0.0, 0.02, 0.03) * (3.0 * PI * point.x / 0.04).cos();
        *velocity = Vector3::new(0.1, -0.05, 0.02) + spin.cross(&point.coords) + bends;
    }
    let first = budget(&material, &state);
    let mut thread = Thread::restore(material, state).expect("a thread");
    let mut most = 0.0_f64;
    for _ in 0..(0.05 / dt).round() as u32 {
        thread.step(dt, &Surroundings::default()).expect("a step");
        most = most.max(budget(&material, thread.state()).energy / first.energy);
    }
    let last = budget(&material, thread.state());
    [
        (last.linear - first.linear).norm() / first.linear.norm(),
        (last.angular - first.angular).norm() / first.angular.norm(),
        1.0 - last.energy / first.energy,
        most,
    ]
}

#[test]
fn a_free_thread_keeps_its_momentum_and_gains_no_energy() {
    let [coarse, middle, fine] = [1e-3, 5e-4, 2.5e-4].map(flown);
    for [linear, _, gone, most] in [coarse, middle, fine] {
        // Rounding errors are amplified by the ratio of axial stiffness to inertia, 1e8.
        assert!(linear < 1e-6, "{linear} of its momentum");
        assert!(
            most < 1.0 + 1e-6 && (0.0..0.03).contains(&gone),
            "{gone} of its energy, at most {most} times it"
        );
    }
    // Backward Euler slows rotation in proportion to the step, and damps vibration faster than the step.
    for pair in [[coarse, middle], [middle, fine]] {
        let order = (pair[0][1] / pair[1][1]).log2();
        assert!((0.9..1.1).contains(&order), "{pair:?}: order {order} of angular momentum");
        assert!(pair[1][2] < pair[0][2], "{pair:?}");
    }
    assert!(coarse[1] < 0.01, "{} of its turning", coarse[1]);
}

#[test]
fn an_explicit_thread_of_springs_would_need_steps_of_less_than_a_microsecond() {
    // 3-0 silk: initial modulus 8701 MPa (Naleway et al. 2015), 0.25 mm thick, 1.3 g/cm³; segments of 1.5 diameters.
    let (modulus, density, thickness) = (8701e6, 1300.0, 0.25e-3_f64);
    let section = PI * thickness * thickness / 4.0;
    let rest: Vec<_> =
        (0..=100).map(|node| Point3::new(1.5 * thickness * f64::from(node), 0.0, 0.0)).collect();
    let edges: Vec<_> = (0..100).map(|node| [node, node + 1]).collect();
    let (axial_stiffness, mass) = (modulus * section, density * section);
    let material = LineMaterial { axial_stiffness, bending_stiffness: 0.0, density: mass };
    let network = Network::from_line(&rest, &edges, &material).expect("a line");
    let integrator = Integrator::Explicit { too_large: TooLarge::Refuse };
    let config = Config { integrator, ..Config::default() };
    let mut springs = MassSpring::new(network, rest.clone(), &[0], config).expect("a thread");
    assert!(springs.safe_step() < 0.6e-6, "{} s", springs.safe_step());
    let refused = springs.step(1e-3, &Input::default());
    assert!(matches!(refused, Err(StepError::TooLarge { .. })), "{refused:?}");
    // The rod of the same stiffness takes a millisecond, and hardly stretches.
    let silk = ThreadMaterial {
        radius: thickness / 2.0,
        mass_per_length: mass,
        axial_stiffness,
        ..ThreadMaterial::silk_2_0()
    };
    let mut thread = Thread::new(silk, &rest).expect("a thread");
    let holds = [Hold::fixed(0, rest[0])];
    let loads = [Load { node: 100, force: Vector3::new(1.0, 0.0, 0.0) }];
    let around = Surroundings { holds: &holds, loads: &loads, ..Surroundings::default() };
    for _ in 0..100 {
        thread.step(1e-3, &around).expect("a step");
    }
    // The hold itself has a compliance of a micrometre.
    let strain = (thread.positions()[100].x - thread.positions()[0].x) / rest[100].x - 1.0;
    assert!((strain * axial_stiffness - 1.0).abs() < 1e-3, "{strain}");
}
