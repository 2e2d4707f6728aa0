//! Mobility of a body at a contact.

use nalgebra::{Matrix3, Vector3};

/// Maximum tangential mobility over all directions orthogonal to `normal`: change of velocity per impulse \[1/kg\].
#[must_use]
pub fn tangential_mobility_max(mobility: &Matrix3<f64>, normal: &Vector3<f64>) -> f64 {
    let across = Matrix3::identity() - normal * normal.transpose();
    let mobility = across * mobility * across;
    // The sum of the two non-zero eigenvalues, and the sum of their squares.
    let (sum, squares) = (mobility.trace(), mobility.norm_squared());
    0.5 * (sum + (2.0 * squares - sum * sum).max(0.0).sqrt())
}
