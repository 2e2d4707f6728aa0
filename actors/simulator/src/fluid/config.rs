//! What a liquid is, its particles, and what a step of it came to.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::clone_in_place::clones_in_place;

/// What a liquid is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FluidConfig {
    /// Distance of particles at rest \[m\]; each stands for the cube of it.
    pub spacing: f64,
    /// Density at rest \[kg/m³\].
    pub density: f64,
    /// Kinematic viscosity \[m²/s\].
    pub viscosity: f64,
    /// Acceleration of gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Box in which it is \[m\]; what leaves it is absorbed.
    pub min: Point3<f64>,
    /// The other end of the box \[m\].
    pub max: Point3<f64>,
    /// Most particles; when there are more, the oldest are absorbed.
    pub particles_max: usize,
    /// Part of a spacing that all but the fastest hundredth of the particles may go in a part of a step; those a whole one.
    pub cfl: f64,
    /// Most parts of a step.
    pub parts_max: u32,
    /// Mean compression that is left, as a share.
    pub compression: f64,
    /// Most iterations of the solver in a part of a step.
    pub iterations_max: u32,
}

impl Default for FluidConfig {
    /// Blood at 37 °C: 1060 kg/m³, 3.3e-6 m²/s.
    fn default() -> Self {
        Self {
            spacing: 2e-3,
            density: 1060.0,
            viscosity: 3.3e-6,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            min: Point3::new(-0.1, -0.1, -0.1),
            max: Point3::new(0.1, 0.1, 0.1),
            particles_max: 20_000,
            cfl: 0.4,
            parts_max: 128,
            compression: 1e-3,
            iterations_max: 100,
        }
    }
}

/// Particles of a liquid; lists are in no particular order, but always the same.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FluidState {
    /// Numbers, in the order in which particles came: never used twice.
    pub numbers: Vec<u64>,
    /// Where they are \[m\].
    pub positions: Vec<Point3<f64>>,
    /// How they move \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
    /// Pressure over density that held them, for the solver to begin with \[m²/s²\].
    pub pushes: Vec<f32>,
    /// The same of the samples of walls, in the order in which these were given.
    pub wall_pushes: Vec<f32>,
    /// Number of the next one.
    pub next: u64,
    /// How many were absorbed since the beginning.
    pub absorbed: u64,
}

clones_in_place!(FluidState { numbers, positions, velocities, pushes, wall_pushes, next, absorbed });

/// What a step came to.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FluidReport {
    /// Parts that the step was taken in.
    pub parts: u32,
    /// Iterations of the solver, over all parts.
    pub iterations: u32,
    /// Mean compression that was left, as a share.
    pub compression: f64,
    /// Particles absorbed in the step.
    pub absorbed: u64,
}
