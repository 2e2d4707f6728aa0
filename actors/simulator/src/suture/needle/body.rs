//! Rigid-body state of a needle: momenta are stored and velocities derived, so that momentum exchanged with other
//! bodies is conserved to rounding.

use nalgebra::{Isometry3, Matrix3, Point3, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::Solid;

/// State of a needle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeedleState {
    /// Centre of mass, in the world \[m\].
    pub center: Point3<f64>,
    /// `world_from_needle`.
    pub rotation: UnitQuaternion<f64>,
    /// Linear momentum \[kg·m/s\].
    pub momentum: Vector3<f64>,
    /// Angular momentum about the centre of mass, in the world \[kg·m²/s\].
    pub angular_momentum: Vector3<f64>,
}

impl NeedleState {
    /// At rest.
    #[must_use]
    pub fn at_rest(world_from_needle: &Isometry3<f64>) -> Self {
        Self {
            center: Point3::from(world_from_needle.translation.vector),
            rotation: world_from_needle.rotation,
            momentum: Vector3::zeros(),
            angular_momentum: Vector3::zeros(),
        }
    }

    /// `world_from_needle`.
    #[must_use]
    pub fn pose(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(self.center.coords), self.rotation)
    }

    /// Inertia about the centre of mass, in the world \[kg·m²\].
    #[must_use]
    pub fn inertia(&self, solid: &Solid) -> Matrix3<f64> {
        let turn = self.rotation.to_rotation_matrix();
        turn * solid.inertia() * turn.transpose()
    }

    /// Velocity of the centre of mass \[m/s\].
    #[must_use]
    pub fn velocity(&self, solid: &Solid) -> Vector3<f64> {
        self.momentum / solid.mass()
    }

    /// Angular velocity, in the world \[rad/s\].
    #[must_use]
    pub fn spin(&self, solid: &Solid) -> Vector3<f64> {
        let turn = self.rotation.to_rotation_matrix();
        let inverse = solid.inertia().try_inverse().unwrap_or_else(Matrix3::zeros);
        turn * (inverse * (turn.transpose() * self.angular_momentum))
    }

    /// Kinetic energy \[J\].
    #[must_use]
    pub fn kinetic_energy(&self, solid: &Solid) -> f64 {
        0.5 * (self.momentum.norm_squared() / solid.mass() + self.angular_momentum.dot(&self.spin(solid)))
    }

    /// Whether every value is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let numbers = self.center.iter().chain(&self.momentum).chain(&self.angular_momentum);
        numbers.chain(self.rotation.coords.iter()).all(|x| x.is_finite())
            && (self.rotation.norm() - 1.0).abs() < 1e-6
    }
}
