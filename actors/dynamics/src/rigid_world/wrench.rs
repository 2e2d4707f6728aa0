//! What pushes a body from outside, and how a body gives way across a direction.

use nalgebra::{Matrix3, Vector3};

/// What pushes a body from outside during a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force at the centre of mass, in world \[N\].
    pub force: Vector3<f64>,
    /// Torque about the centre of mass, in world axes \[N·m\].
    pub torque: Vector3<f64>,
}

/// What an impulse across `normal` makes of the speed across at most, over all directions \[1/kg\].
#[must_use]
pub fn most_across(feels: &Matrix3<f64>, normal: &Vector3<f64>) -> f64 {
    let across = Matrix3::identity() - normal * normal.transpose();
    let feels = across * feels * across;
    // Of the two numbers that are not zero: their sum, and the sum of their squares.
    let (sum, squares) = (feels.trace(), feels.norm_squared());
    0.5 * (sum + (2.0 * squares - sum * sum).max(0.0).sqrt())
}
