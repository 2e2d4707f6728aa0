//! Isotropic elasticity: Young's modulus and Poisson's ratio, stress, and changes of an element's stiffness.
//!
//! Coarse linear tetrahedra are too stiff: a clamped beam five times as long as thick bends half as far as it should
//! with two layers of elements, and four fifths as far with four (`tests/linear_fem_reference.rs`). A body that is to
//! deform according to its modulus needs several layers, or a modulus fitted on the mesh.

use nalgebra::Matrix3;
use thiserror::Error;

/// The largest Poisson's ratio for linear tetrahedra. Closer to 0.5 they lock: they bend far too little, because each
/// element preserves its volume separately (Hughes 2000, ch. 4).
pub const POISSON_MAX: f64 = 0.45;

/// Young's modulus and Poisson's ratio.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elastic {
    young_modulus: f64,
    poisson_ratio: f64,
}

/// Constants that are no valid material.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ElasticError {
    /// Young's modulus is not positive.
    #[error("Young's modulus is {0} Pa: above 0 is valid")]
    YoungModulus(f64),
    /// Poisson's ratio is unstable, or linear tetrahedra lock.
    #[error(
        "Poisson's ratio is {0}: above -1 and up to {POISSON_MAX} is valid; beyond it linear tetrahedra lock"
    )]
    PoissonRatio(f64),
}

impl Elastic {
    /// Young's modulus \[Pa\], above 0, and Poisson's ratio, above −1 and up to [`POISSON_MAX`].
    ///
    /// # Errors
    /// The constant that is out of range.
    pub fn new(young_modulus: f64, poisson_ratio: f64) -> Result<Self, ElasticError> {
        if !(young_modulus > 0.0 && young_modulus.is_finite()) {
            return Err(ElasticError::YoungModulus(young_modulus));
        }
        if !(poisson_ratio > -1.0 && poisson_ratio <= POISSON_MAX) {
            return Err(ElasticError::PoissonRatio(poisson_ratio));
        }
        Ok(Self { young_modulus, poisson_ratio })
    }

    /// Young's modulus \[Pa\].
    #[must_use]
    pub fn young_modulus(&self) -> f64 {
        self.young_modulus
    }

    /// Poisson's ratio.
    #[must_use]
    pub fn poisson_ratio(&self) -> f64 {
        self.poisson_ratio
    }

    /// Lamé's first constant λ \[Pa\].
    #[must_use]
    pub fn lambda(&self) -> f64 {
        let nu = self.poisson_ratio;
        self.young_modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    }

    /// The shear modulus μ \[Pa\].
    #[must_use]
    pub fn mu(&self) -> f64 {
        self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))
    }
}

/// Change of an element of tissue, a tetrahedron or a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alteration {
    /// Factor of its stiffness; 0 when it is removed.
    pub stiffness: f64,
    /// Factor of its rest length.
    pub length: f64,
}

impl Alteration {
    /// Unchanged.
    pub const NONE: Self = Self { stiffness: 1.0, length: 1.0 };
    /// Removed.
    pub const GONE: Self = Self { stiffness: 0.0, length: 1.0 };
}

/// Cauchy stress \[Pa\] of a neo-Hookean material with Lamé's constants λ and μ \[Pa\] under a deformation gradient
/// (Bonet, Wood 1997). For small strains it is that of linear elasticity, for any rotation. For an inverted element it
/// is that of a flattened one.
#[must_use]
pub fn cauchy_stress([lambda, mu]: [f64; 2], gradient: &Matrix3<f64>) -> Matrix3<f64> {
    let jacobian = gradient.determinant().max(1e-3);
    let left = gradient * gradient.transpose() - Matrix3::identity();
    (left * mu + Matrix3::from_diagonal_element(lambda * jacobian.ln())) / jacobian
}

/// The stress of linear elasticity \[Pa\], with Lamé's constants λ and μ \[Pa\], under a deformation gradient close to
/// the identity: the antisymmetric part, an infinitesimal rotation, is ignored.
#[must_use]
pub fn small_stress([lambda, mu]: [f64; 2], gradient: &Matrix3<f64>) -> Matrix3<f64> {
    let strain = (gradient + gradient.transpose()) * 0.5 - Matrix3::identity();
    strain * (2.0 * mu) + Matrix3::from_diagonal_element(lambda * strain.trace())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constants_are_checked_and_turned_into_lames() {
        let material = Elastic::new(1e5, 0.3).expect("in range");
        assert!((material.lambda() - 57_692.307_692_307_69).abs() < 1e-9);
        assert!((material.mu() - 38_461.538_461_538_46).abs() < 1e-9);
        for (young, poisson) in
            [(0.0, 0.3), (f64::NAN, 0.3), (f64::INFINITY, 0.3), (1e5, 0.46), (1e5, -1.0), (1e5, f64::NAN)]
        {
            assert!(Elastic::new(young, poisson).is_err(), "{young} {poisson}");
        }
        let error = Elastic::new(1e5, 0.49).expect_err("locks");
        assert!(error.to_string().contains("up to 0.45"), "{error}");
    }
}
