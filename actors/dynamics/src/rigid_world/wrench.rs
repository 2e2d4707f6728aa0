//! External wrench on a body, and its tangential mobility at a contact.

use nalgebra::{Matrix3, Vector3};

/// External wrench on a body during a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force at the centre of mass, in world \[N\].
    pub force: Vector3<f64>,
    /// Torque about the centre of mass, in world axes \[N·m\].
    pub torque: Vector3<f64>,
}

/// Maximum tangential mobility over all directions orthogonal to `normal`: change of velocity per impulse \[1/kg\].
#[must_use]
pub fn most_across(feels: &Matrix3<f64>, normal: &Vector3<f64>) -> f64 {
    let across = Matrix3::identity() - normal * normal.transpose();
    let feels = across * feels * across;
    // The sum of the two non-zero eigenvalues, and the sum of their squares.
    let (sum, squares) = (feels.trace(), feels.norm_squared());
    0.5 * (sum + (2.0 * squares - sum * sum).max(0.0).sqrt())
}
