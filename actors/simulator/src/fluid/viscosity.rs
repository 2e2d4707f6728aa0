//! Viscosity of a liquid, and its drag at rough walls.
//!
//! Between particles the viscous forces are those of Monaghan, *Smoothed particle hydrodynamics*, 2005, along the line
//! that connects two particles: they keep momentum and angular momentum. Where the step is long for the viscosity, the
//! velocities at its end determine the forces (Weiler et al., *A physically consistent implicit viscosity solver for
//! SPH fluids*, 2018), by conjugate gradients: any viscosity is stable in any step. A rough wall holds the liquid that
//! touches it (Adami et al., *A generalized wall boundary condition for smoothed particle hydrodynamics*, 2012); a
//! smooth one slips.

use nalgebra::Vector3;

use super::neighbour_clusters::{ForcesAndNoise, ViscousForces};
use super::neighbour_lists::Rows;

/// Factor of the forces between particles: 2 (d + 2) = 10 in d = 3 dimensions for many neighbours. Thirty, as they lie in a
/// liquid that has moved, carry 0.78 of that.
const FACTOR: f64 = 12.8;
/// Fraction of the pair forces by which noise is damped, over the square of a spacing: the largest eigenvalue is then
/// less than 1.
const NOISE: f64 = 0.3;
/// Viscosity times step over the square of a spacing up to which the velocities before the step determine the forces.
/// The largest eigenvalue of the forces is about 25 in these units: the forces are stable up to 0.08.
const EXPLICIT: f64 = 0.01;
/// Largest remaining error of the velocities, as a fraction of the change by viscosity in the step.
const TOLERANCE: f64 = 3e-5;
const ITERATIONS_MAX: u32 = 200;

/// Buffers of the solver, reused.
#[derive(Clone, Debug, Default)]
pub(super) struct ViscositySolver {
    /// Velocity change of each row.
    change: Vec<Vector3<f64>>,
    residual: Vec<Vector3<f64>>,
    direction: Vec<Vector3<f64>>,
    image: Vec<Vector3<f64>>,
    /// Velocity change of each row, and the noise of its neighbours.
    both: Vec<(Vector3<f64>, [f32; 4])>,
    /// Velocities of all rows that determined the forces.
    pub velocities: Vec<[f32; 4]>,
}

/// The viscous forces of a substep.
#[derive(Clone, Copy)]
pub(super) struct ViscousStep {
    /// Support radius \[m\].
    pub support: f32,
    /// Viscosity times the substep \[m²\].
    pub spread: f64,
    /// Particle spacing \[m\].
    pub spacing: f64,
}

impl ViscousStep {
    /// Factor of the forces.
    pub(super) fn scale(&self) -> f64 {
        FACTOR * self.spread
    }

    /// Factor of the forces that damp noise.
    fn noise(&self) -> f64 {
        NOISE * self.spacing * self.spacing
    }
}

impl ViscositySolver {
    /// Velocity change of each particle row by viscosity. `velocities` holds those of particles and walls before, and
    /// is a buffer.
    pub(super) fn solve(
        &mut self,
        rows: &Rows,
        step: ViscousStep,
        velocities: &mut [[f32; 4]],
    ) -> &[Vector3<f64>] {
        let (support, scale) = (step.support, step.scale());
        let Self { change, residual, direction, image, both, velocities: before } = self;
        change.resize(rows.particles, Vector3::zeros());
        image.resize(rows.particles, Vector3::zeros());
        before.clear();
        before.extend_from_slice(velocities);
        if step.spread <= EXPLICIT * step.spacing * step.spacing {
            both.resize(rows.particles, (Vector3::zeros(), [0.0; 4]));
            let forces = ViscousForces { velocities, support, scale, walls: true };
            rows.each(both, &ForcesAndNoise { forces, noise: step.noise() });
            damp_noise(rows, step, before, velocities, both, image);
            for (change, (by, _)) in change.iter_mut().zip(&*both) {
                *change = *by;
            }
            return change;
        }
        change.fill(Vector3::zeros());
        direction.resize(rows.particles, Vector3::zeros());
        residual.resize(rows.particles, Vector3::zeros());
        rows.each(residual, &ViscousForces { velocities, support, scale, walls: true });
        // (1 - S) Δ = S v, where S are the forces over a substep, symmetric and negative.
        let square = |list: &[Vector3<f64>]| list.iter().map(Vector3::norm_squared).sum::<f64>();
        let mut left = square(residual);
        let least = left * TOLERANCE * TOLERANCE;
        direction.copy_from_slice(residual);
        velocities[rows.particles..].fill([0.0; 4]);
        for _ in 0..ITERATIONS_MAX {
            if left <= least {
                break;
            }
            for (to, from) in velocities.iter_mut().zip(&*direction) {
                *to = [from.x as f32, from.y as f32, from.z as f32, 0.0];
            }
            rows.copy_to_images(velocities);
            rows.each(image, &ViscousForces { velocities, support, scale, walls: true });
            for (image, direction) in image.iter_mut().zip(&*direction) {
                *image = direction - *image;
            }
            let curvature: f64 = direction.iter().zip(&*image).map(|(a, b)| a.dot(b)).sum();
            if curvature <= 0.0 {
                break;
            }
            let length = left / curvature;
            for row in 0..rows.particles {
                change[row] += direction[row] * length;
                residual[row] -= image[row] * length;
            }
            let now = square(residual);
            let share = now / left;
            left = now;
            for (direction, residual) in direction.iter_mut().zip(&*residual) {
                *direction = residual + *direction * share;
            }
        }
        for (velocity, change) in before.iter_mut().zip(&*change) {
            let own = *velocity;
            *velocity =
                std::array::from_fn(|axis| own[axis] + if axis < 3 { change[axis] as f32 } else { 0.0 });
        }
        change
    }
}

/// Damps what neighbours do not share, the noise of the pressures: in a pool at rest it would go on for ever, since
/// viscosity alone is too weak. The forces of the forces are nothing where velocities vary over many particles: a wave
/// of 12 spacings loses a thousandth in a substep, one of 24 a hundred-thousandth. They keep momentum and angular
/// momentum. Where liquid is crowded, as in a wound that it comes from, they would be too strong: they go at most as far
/// as kinetic energy falls. `before` are the velocities, `velocities` is a buffer, `both` holds the velocity changes and the
/// first forces, and takes the change.
fn damp_noise(
    rows: &Rows,
    step: ViscousStep,
    before: &[[f32; 4]],
    velocities: &mut [[f32; 4]],
    both: &mut [(Vector3<f64>, [f32; 4])],
    image: &mut [Vector3<f64>],
) {
    for (to, (_, noise)) in velocities.iter_mut().zip(&*both) {
        *to = *noise;
    }
    rows.copy_to_images(velocities);
    rows.each(image, &ViscousForces { velocities, support: step.support, scale: step.noise(), walls: false });
    let (mut along, mut square) = (0.0, 0.0);
    for (velocity, image) in before.iter().zip(&*image) {
        along += (0..3).map(|axis| f64::from(velocity[axis]) * image[axis]).sum::<f64>();
        square += image.norm_squared();
    }
    let share = if square > along { along / square } else { 1.0 };
    for ((change, _), image) in both.iter_mut().zip(&*image) {
        *change -= image * share;
    }
}
