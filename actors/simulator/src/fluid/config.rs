//! Settings, state and step report of a liquid.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::clone_in_place::clones_in_place;

/// Settings of a liquid.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FluidConfig {
    /// Particle spacing at rest \[m\]; the volume of a particle is its cube.
    pub spacing: f64,
    /// Density at rest \[kg/m³\].
    pub density: f64,
    /// Kinematic viscosity \[m²/s\]; see [`Fluid::viscosity_min`](super::Fluid::viscosity_min).
    pub viscosity: f64,
    /// Acceleration of gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// Ends at which the liquid goes on, if any.
    #[serde(default)]
    pub ends: Option<Ends>,
    /// Lower corner of its box \[m\]; particles that leave it are removed.
    pub min: Point3<f64>,
    /// Upper corner of the box \[m\].
    pub max: Point3<f64>,
    /// Maximum number of particles; the oldest are removed.
    pub particles_max: usize,
    /// CFL number: fraction of a spacing that all but the fastest hundredth of the particles may move in a substep;
    /// those a whole one.
    pub cfl: f64,
    /// Maximum number of substeps.
    pub parts_max: u32,
    /// Tolerance: mean remaining compression, as a fraction.
    pub compression: f64,
    /// Maximum solver iterations in a substep.
    pub iterations_max: u32,
}

/// Two opposite sides of the box between which the liquid goes on: what leaves at one end enters at the other, as in a
/// piece of a long pipe. Walls have to reach beyond the ends by twice the spacing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ends {
    /// The axis along which it goes on: 0, 1 or 2.
    pub axis: usize,
    /// Pressure at the lower end above that at the upper end \[Pa\], which drives the liquid.
    pub pressure_drop: f64,
}

impl Default for FluidConfig {
    /// Blood at 37 °C: 1060 kg/m³, 3.3e-6 m²/s.
    fn default() -> Self {
        Self {
            spacing: 2e-3,
            density: 1060.0,
            viscosity: 3.3e-6,
            gravity: Vector3::new(0.0, 0.0, -9.81),
            ends: None,
            min: Point3::new(-0.1, -0.1, -0.1),
            max: Point3::new(0.1, 0.1, 0.1),
            particles_max: 20_000,
            cfl: 0.4,
            parts_max: 128,
            compression: 3e-4,
            iterations_max: 100,
        }
    }
}

/// State of a liquid; the order of its lists is arbitrary but deterministic.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FluidState {
    /// Particle numbers, in order of creation: never reused.
    pub numbers: Vec<u64>,
    /// Positions \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Velocities \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
    /// Pressure over density in the last substep, the solver's initial guess \[m²/s²\].
    pub pushes: Vec<f32>,
    /// The same for wall samples, in the order in which they were given.
    pub wall_pushes: Vec<f32>,
    /// The next particle number.
    pub next: u64,
    /// Number of particles removed since the beginning.
    pub absorbed: u64,
}

clones_in_place!(FluidState { numbers, positions, velocities, pushes, wall_pushes, next, absorbed });

/// Statistics of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FluidReport {
    /// Number of substeps.
    pub parts: u32,
    /// Solver iterations, over all substeps.
    pub iterations: u32,
    /// Mean remaining compression, as a fraction.
    pub compression: f64,
    /// Particles removed in the step.
    pub absorbed: u64,
}
