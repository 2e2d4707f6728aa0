//! Component of a linear organ.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::{Elastic, POISSON_MAX};
use trocar_scene::{Component, ComponentError, SoftAbilities};

use crate::controller::cutting::volume::FailureCriteria;

/// An organ with immediate response to contact, for small displacements. It needs a tetrahedral mesh, and `anchors`
/// where it is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(
    name = "linear_fem", check = Self::ranges, schema,
    soft_body = SoftAbilities { bears: true, is_pinnable: true, loses_elements: true, ..SoftAbilities::NONE },
)]
#[serde(default, deny_unknown_fields)]
pub struct LinearFemBody {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to 0.45.
    pub poisson_ratio: f64,
    /// Radius of the contact patch \[m\]. From about one and a half surface edges on, forces are independent of the
    /// mesh; 0: contact with single vertices, which feel stiffer the coarser the mesh is.
    pub contact_radius: f64,
    /// Whether blades cut it, along the faces between its elements; then they do not push it.
    pub cut: bool,
    /// Tensile strength \[Pa\]; absent: it never tears.
    pub strength: Option<f64>,
}

impl Default for LinearFemBody {
    /// Liver, in round numbers; for measured values of each organ see [`trocar_scene::tissue`].
    fn default() -> Self {
        Self { young_modulus: 6e3, poisson_ratio: 0.45, contact_radius: 0.006, cut: false, strength: None }
    }
}

impl LinearFemBody {
    pub(super) fn failure_criteria(&self) -> Result<FailureCriteria, String> {
        let elastic = Elastic::new(self.young_modulus, self.poisson_ratio).map_err(|e| e.to_string())?;
        let lame = [elastic.lambda(), elastic.mu()];
        let tears = self.strength.map(|strength| (strength, lame));
        let young_modulus = self.young_modulus;
        Ok(FailureCriteria {
            cut: self.cut,
            halves: false,
            hangs_on: true,
            tears,
            is_linear: true,
            young_modulus,
        })
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=POISSON_MAX, "0 to 0.45")?;
        ComponentError::range("contact_radius", self.contact_radius, 0.0..=0.1, "0 to 0.1 m")?;
        ComponentError::range("strength", self.strength.unwrap_or(1.0), 1.0..=1e9, "1 to 1e9 Pa")
    }
}
