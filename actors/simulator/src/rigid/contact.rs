//! What bodies touch, and the impulses that answer: sequential impulses, which is Gauss and Seidel's method projected onto
//! what contacts can do (Catto, *Iterative dynamics with temporal coherence*, 2005). Penetration is undone by velocities of
//! its own that are forgotten (split impulses), so that it makes no energy.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

/// A contact between a body and another, or something that stands or is moved from outside.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigidContact {
    /// The body that is pushed along the normal.
    pub body: u32,
    /// The other one; none is the world.
    pub other: Option<u32>,
    /// Where, in world \[m\].
    pub point_in_world: Point3<f64>,
    /// Unit direction in which the body is pushed, in world.
    pub normal_in_world: Vector3<f64>,
    /// How deep they are in each other \[m\]; below 0 a gap that may close within the step.
    pub depth: f64,
    /// Coulomb friction.
    pub friction: f64,
    /// Coefficient of restitution, 0 to 1.
    pub restitution: f64,
    /// Velocity of the world at the point, when there is no other \[m/s\].
    pub surface_velocity: Vector3<f64>,
}

/// Parameters of the response.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ContactConfig {
    /// Rounds over the contacts that have to do with each other at most. A step begins with the impulses of the last one where the
    /// list has the same length: keep contacts that last in their order, and stacks stand still.
    pub iterations: u32,
    /// A round that changes no speed by more than this is the last one \[m/s\].
    pub tolerance: f64,
    /// Share of the penetration beyond the slop that a step undoes.
    pub correction: f64,
    /// Penetration that stays, so that contacts stay \[m\].
    pub slop: f64,
    /// Approach below which nothing bounces \[m/s\]: else what rests would tremble.
    pub rest_speed: f64,
}

impl Default for ContactConfig {
    fn default() -> Self {
        Self { iterations: 50, tolerance: 0.0, correction: 0.2, slop: 1e-5, rest_speed: 1e-3 }
    }
}

/// What a contact came to in the last step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactImpulse {
    /// On the body, in world \[N·s\].
    pub impulse: Vector3<f64>,
}
