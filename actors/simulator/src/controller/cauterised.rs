//! Components of electrosurgery: tissue that burns, and electrodes.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError};

use crate::electrosurgery::{Arrhenius, LatticeConfig, ThermalMaterial};

/// Tissue under electrosurgery: a volume, or, with a thickness, a membrane. Omitted properties are those of the
/// entity's `tissue`, else of liver; for ranges and sources see [`trocar_scene::tissue`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "cauterised", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct CauterisedBody {
    /// Thickness of a membrane \[m\]; absent for a volume.
    pub thickness: Option<f64>,
    /// Cell size at the tip \[m\]; 0.5 mm or less resolves the field.
    pub spacing: f64,
    /// Whether vaporisation takes up latent heat.
    pub latent_heat: bool,
    /// Density \[kg/m³\].
    pub density: f64,
    /// Specific heat capacity \[J/(kg·K)\].
    pub heat_capacity: f64,
    /// Thermal conductivity \[W/(m·K)\].
    pub conductivity: f64,
    /// Volumetric blood perfusion rate \[1/s\].
    pub perfusion: f64,
    /// Mass fraction of water.
    pub water: f64,
    /// Frequency factor of thermal damage \[1/s\].
    pub damage_frequency: f64,
    /// Activation energy of thermal damage \[J/mol\].
    pub damage_energy: f64,
    /// Temperature at which dry tissue turns to char \[°C\].
    pub charring: f64,
    /// Temperature at which dry tissue is ablated as smoke \[°C\].
    pub ablation: f64,
}

impl Default for CauterisedBody {
    fn default() -> Self {
        let liver = ThermalMaterial::default();
        Self {
            thickness: None,
            spacing: LatticeConfig::default().spacing,
            latent_heat: true,
            density: liver.density,
            heat_capacity: liver.heat_capacity,
            conductivity: liver.conductivity,
            perfusion: liver.perfusion,
            water: liver.water,
            damage_frequency: liver.damage.frequency,
            damage_energy: liver.damage.activation_energy,
            charring: liver.charring,
            ablation: liver.ablation,
        }
    }
}

impl CauterisedBody {
    pub(crate) fn material(&self) -> ThermalMaterial {
        let liver = ThermalMaterial::default();
        ThermalMaterial {
            has_latent_heat: self.latent_heat,
            density: self.density,
            heat_capacity: self.heat_capacity,
            conductivity: self.conductivity,
            perfusion: self.perfusion,
            water: self.water,
            charring: self.charring,
            ablation: self.ablation,
            damage: Arrhenius {
                frequency: self.damage_frequency,
                activation_energy: self.damage_energy,
                ..liver.damage
            },
            ..liver
        }
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("spacing", self.spacing, 5e-5..=5e-3, "5e-5 to 5e-3 m")?;
        ComponentError::range("thickness", self.thickness.unwrap_or(1e-3), 1e-5..=0.05, "1e-5 to 0.05 m")?;
        ComponentError::range("density", self.density, 100.0..=1e4, "100 to 1e4 kg/m³")?;
        ComponentError::range("heat_capacity", self.heat_capacity, 100.0..=1e4, "100 to 1e4 J/(kg·K)")?;
        ComponentError::range("conductivity", self.conductivity, 0.0..=100.0, "0 to 100 W/(m·K)")?;
        ComponentError::range("perfusion", self.perfusion, 0.0..=1.0, "0 to 1 1/s")?;
        ComponentError::range("water", self.water, 0.0..=0.99, "0 to 0.99")?;
        ComponentError::range("damage_frequency", self.damage_frequency, 0.0..=1e200, "0 to 1e200 1/s")?;
        ComponentError::range("damage_energy", self.damage_energy, 0.0..=1e7, "0 to 1e7 J/mol")?;
        ComponentError::range("charring", self.charring, 100.0..=1e4, "100 to 1e4 °C")?;
        ComponentError::range("ablation", self.ablation, 100.0..=1e4, "100 to 1e4 °C")
    }
}

/// An electrode: an instrument that burns while it is switched on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "electrode", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct ElectrodeTip {
    /// Power at full activation \[W\].
    pub power: f64,
    /// Whether it coagulates if its `Activation` names no current; else it cuts.
    pub coagulates: bool,
    /// Bare metal area \[m²\], of a sphere: the contact area follows from its depth in tissue.
    pub contact_area: f64,
}

impl Default for ElectrodeTip {
    /// A hook: 30 W, about 1 mm².
    fn default() -> Self {
        Self { power: 30.0, coagulates: false, contact_area: 1e-6 }
    }
}

impl ElectrodeTip {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("power", self.power, 0.0..=400.0, "0 to 400 W")?;
        ComponentError::range("contact_area", self.contact_area, 1e-8..=1e-4, "1e-8 to 1e-4 m²")
    }
}
