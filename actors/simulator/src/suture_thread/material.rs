//! Material of a thread.

use serde::{Deserialize, Serialize};

use super::ThreadError;

/// A round thread. Axial, bending and twisting stiffness are independent: a braid is nearly inextensible and yet a
/// thousand times more flexible in bending than a solid rod of the same axial stiffness.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThreadMaterial {
    /// Radius of the cross-section \[m\].
    pub radius: f64,
    /// Mass per length \[kg/m\].
    pub mass_per_length: f64,
    /// `EA`, force per unit strain \[N\].
    pub axial_stiffness: f64,
    /// `EI`, moment per unit curvature \[N·m²\].
    pub bending_stiffness: f64,
    /// `GJ`, moment per unit twist \[N·m²\].
    pub twisting_stiffness: f64,
    /// Damping: moment per rate of curvature or twist, as a multiple of the stiffness \[s\].
    pub damping: f64,
    /// Drag of the surrounding medium per mass \[1/s\].
    pub drag: f64,
    /// Coulomb's friction coefficient of the thread on itself.
    pub friction: f64,
    /// Contact compliance of one strand \[m/N\].
    pub contact_compliance: f64,
}

impl ThreadMaterial {
    /// Braided silk, USP size 2-0: 0.3 mm thick, 1.3 g/cm³; strain 0.06 % at 2 N. Bending stiffness: a hundredth of
    /// that of a solid silk rod (3.5e-6 N·m², from the modulus of Naleway et al. 2015), since a braid is far more
    /// flexible; twisting stiffness near that of the solid rod; friction in the middle of the values reported for
    /// sutures. These three are chosen, not measured.
    #[must_use]
    pub fn silk_2_0() -> Self {
        Self {
            radius: 1.5e-4,
            mass_per_length: 9.2e-5,
            axial_stiffness: 3.5e3,
            bending_stiffness: 3.5e-8,
            twisting_stiffness: 2.5e-6,
            damping: 2e-3,
            drag: 1.0,
            friction: 0.2,
            contact_compliance: 2e-6,
        }
    }

    /// Diameter \[m\].
    #[must_use]
    pub fn diameter(&self) -> f64 {
        2.0 * self.radius
    }

    /// Rejects invalid values.
    pub(crate) fn check(&self) -> Result<(), ThreadError> {
        let positive = [
            ("radius", self.radius),
            ("mass_per_length", self.mass_per_length),
            ("axial_stiffness", self.axial_stiffness),
            ("bending_stiffness", self.bending_stiffness),
            ("twisting_stiffness", self.twisting_stiffness),
            ("contact_compliance", self.contact_compliance),
        ];
        let at_least_zero = [("damping", self.damping), ("drag", self.drag), ("friction", self.friction)];
        for (name, value) in positive {
            if !value.is_finite() || value <= 0.0 {
                return Err(ThreadError::Material { name, value, valid: "above 0" });
            }
        }
        for (name, value) in at_least_zero {
            if !value.is_finite() || value < 0.0 {
                return Err(ThreadError::Material { name, value, valid: "0 or more" });
            }
        }
        Ok(())
    }
}
