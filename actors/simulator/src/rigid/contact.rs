//! Contacts by sequential impulses: projected Gauss–Seidel (Catto, *Iterative dynamics with temporal coherence*, 2005).
//! Penetration is corrected by separate velocities that are discarded (split impulses), so that the correction adds no
//! energy.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A contact of a body with another one, or with the fixed or moving world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidContact {
    /// The body pushed along the normal.
    pub body: u32,
    /// The other one; `None` is the world.
    pub other: Option<u32>,
    /// Contact point, in world \[m\].
    pub point_in_world: Point3<f64>,
    /// Unit normal towards the body, in world.
    pub normal_in_world: Vector3<f64>,
    /// Penetration depth \[m\]; negative for a gap that may close within the step.
    pub depth: f64,
    /// Coulomb's friction coefficient.
    pub friction: f64,
    /// Coefficient of restitution, 0 to 1.
    pub restitution: f64,
    /// Velocity of the world at the point, without another body \[m/s\].
    pub surface_velocity: Vector3<f64>,
}

/// Settings of the contact solver.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactConfig {
    /// Maximum iterations over each island. A step is warm-started with the impulses of the last one where the list has
    /// the same length: keep lasting contacts in their order, and stacks stay at rest.
    pub iterations: u32,
    /// Convergence: the iteration ends when no velocity changes by more than this \[m/s\].
    pub tolerance: f64,
    /// Fraction of the penetration beyond the slop that a step corrects.
    pub correction: f64,
    /// Penetration that is not corrected, so that contacts persist \[m\].
    pub slop: f64,
    /// Approach velocity below which there is no restitution \[m/s\]: resting bodies would jitter otherwise.
    pub rest_speed: f64,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self { iterations: 50, tolerance: 0.0, correction: 0.2, slop: 1e-5, rest_speed: 1e-3 }
    }
}

/// Result of a contact in the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactImpulse {
    /// Impulse on the body, in world \[N·s\].
    pub impulse: Vector3<f64>,
}
