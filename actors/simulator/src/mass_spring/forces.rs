//! Forces and energy of springs and hinges, and of tetrahedra.

use nalgebra::{Point3, Vector3};

use super::collapse;
use super::network::Network;

/// Fraction of a curved hinge's rest length within which its force fades out: nearly flat, its vector has no direction.
pub(crate) const NEARLY_FLAT: f64 = 0.125;

/// Adds the forces of springs, hinges and tetrahedra to `forces` \[N\].
pub(super) fn add_all_forces(
    network: &Network,
    lag: f64,
    positions: &[Point3<f64>],
    velocities: &[Vector3<f64>],
    forces: &mut [Vector3<f64>],
) {
    add_forces(network, lag, positions, velocities, forces);
    collapse::add_forces(network, positions, forces);
}

/// Adds spring and hinge forces to `forces` \[N\]; `lag` is the ratio of damping to stiffness \[s\] (Kelvin–Voigt).
pub(crate) fn add_forces(
    network: &Network,
    lag: f64,
    positions: &[Point3<f64>],
    velocities: &[Vector3<f64>],
    forces: &mut [Vector3<f64>],
) {
    for spring in &network.springs {
        let [a, b] = spring.nodes.map(|node| node as usize);
        let along = positions[b] - positions[a];
        let squared = along.norm_squared();
        let length = squared.sqrt();
        let inverse = if length > 0.0 { 1.0 / length } else { 0.0 };
        let mut stretch = length - spring.rest;
        if lag > 0.0 {
            stretch += lag * (velocities[b] - velocities[a]).dot(&along) * inverse;
        }
        let pull = along * (spring.stiffness * stretch * inverse);
        forces[a] += pull;
        forces[b] -= pull;
    }
    for hinge in &network.hinges {
        let vector = hinge.vector(positions);
        let mut scale = hinge.stiffness;
        if hinge.rest > 0.0 {
            scale *= 1.0 - pull_of_rest(hinge.rest, vector.norm(), hinge.sense(positions));
        }
        let mut pull = vector * scale;
        if lag > 0.0 {
            let [a, b, c, d] = hinge.nodes.map(|node| velocities[node as usize]);
            let w = hinge.weights;
            let rate = a * w[0] + b * w[1] + c * w[2] + d * w[3];
            let squared = vector.norm_squared();
            if squared > 0.0 {
                pull += vector * (hinge.stiffness * lag * rate.dot(&vector) / squared);
            }
        }
        for (node, weight) in hinge.nodes.into_iter().zip(hinge.weights) {
            forces[node as usize] -= pull * weight;
        }
    }
}

/// Rest length over length, as in the force: negative where the hinge is inside out, limited where it is nearly flat.
#[inline]
pub(crate) fn pull_of_rest(rest: f64, length: f64, sense: f64) -> f64 {
    sense * rest / length.max(NEARLY_FLAT * rest)
}

/// Elastic energy of springs, hinges and tetrahedra \[J\].
pub(crate) fn elastic_energy(network: &Network, positions: &[Point3<f64>]) -> f64 {
    let mut energy = 0.0;
    for spring in &network.springs {
        let [a, b] = spring.nodes.map(|node| positions[node as usize]);
        energy += 0.5 * spring.stiffness * ((b - a).norm() - spring.rest).powi(2);
    }
    for hinge in &network.hinges {
        let (length, faded) = (hinge.vector(positions).norm(), NEARLY_FLAT * hinge.rest);
        let sense = hinge.sense(positions);
        // The integral of the force: linear in the length, quadratic where the force fades.
        let pushed = if length >= faded { length - 0.5 * faded } else { 0.5 * length * length / faded };
        let none = hinge.rest == 0.0;
        let of_rest = if none { 0.0 } else { hinge.rest * (0.5 * hinge.rest - sense * pushed) };
        energy += hinge.stiffness * (0.5 * length * length + of_rest);
    }
    energy + collapse::energy(network, positions)
}
