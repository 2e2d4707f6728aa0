//! Thermal material of a tissue.

use serde::{Deserialize, Serialize};

use super::arrhenius::Arrhenius;
use super::error::{ElectrosurgeryError, parameter};

/// Reference temperature of stored heat \[°C\]: that of the body.
pub const BODY: f64 = 37.0;

/// Thermal properties of a tissue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermalMaterial {
    /// Density \[kg/m³\].
    pub density: f64,
    /// Specific heat capacity \[J/(kg·K)\].
    pub heat_capacity: f64,
    /// Thermal conductivity \[W/(m·K)\].
    pub conductivity: f64,
    /// Perfusion by volume \[1/s\]; none in coagulated tissue.
    pub perfusion: f64,
    /// Volumetric heat capacity of blood \[J/(m³·K)\].
    pub blood_capacity: f64,
    /// Arterial temperature \[°C\].
    pub arterial: f64,
    /// Water mass fraction.
    pub water: f64,
    /// Boiling temperature \[°C\].
    pub boiling: f64,
    /// Latent heat per mass of water \[J/kg\].
    pub latent_heat: f64,
    /// Whether boiling takes latent heat. Without it tissue vaporises at 100 °C, about eight times too easily.
    pub has_latent_heat: bool,
    /// Specific heat capacity of dried tissue \[J/(kg·K)\].
    pub dry_heat_capacity: f64,
    /// Conductivity of dried tissue \[W/(m·K)\].
    pub dry_conductivity: f64,
    /// Share of a coagulating current through dry tissue, relative to as much wet tissue: it hardly conducts.
    pub dry_current: f64,
    /// Charring temperature of dry tissue \[°C\].
    pub charring: f64,
    /// Ablation temperature of dry tissue \[°C\].
    pub ablation: f64,
    /// Fraction of the removed dry mass that becomes airborne smoke; the rest is ash and gas.
    pub smoke: f64,
    /// Stiffness factor of coagulated tissue.
    pub coagulated_stiffness: f64,
    /// Shrinkage of coagulated tissue, as a fraction of length.
    pub coagulated_shrinkage: f64,
    /// Thermal damage.
    pub damage: Arrhenius,
}

impl Default for ThermalMaterial {
    /// Liver. Density, capacity and conductivity: IT'IS tissue database; perfusion as in models of ablation
    /// (Tungjitkusolmun et al. 2002): the database has 0.0155 1/s; 70 % water by mass. Dry tissue: as protein. Charring
    /// from 200 °C and ablation from 400 °C: the range in which proteins and fats pyrolyse. Stiffness: 6.6 → 46 kPa in
    /// porcine liver under radio frequency (ultrasonic elastometry, ex vivo). Shrinkage: 21.7 % of length after 15 min
    /// at 95 °C (Rossmann et al., *Dynamics of tissue shrinkage during ablative temperature exposures*, 2014).
    fn default() -> Self {
        Self {
            density: 1079.0,
            heat_capacity: 3540.0,
            conductivity: 0.52,
            perfusion: 0.0064,
            blood_capacity: 4.18e6,
            arterial: BODY,
            water: 0.7,
            boiling: 100.0,
            latent_heat: 2.257e6,
            has_latent_heat: true,
            dry_heat_capacity: 1500.0,
            dry_conductivity: 0.2,
            dry_current: 0.05,
            charring: 200.0,
            ablation: 400.0,
            smoke: 0.1,
            coagulated_stiffness: 7.0,
            coagulated_shrinkage: 0.217,
            damage: Arrhenius::default(),
        }
    }
}

impl ThermalMaterial {
    /// Volumetric heat capacity of wet tissue \[J/(m³·K)\].
    #[must_use]
    pub fn wet_capacity(&self) -> f64 {
        self.density * self.heat_capacity
    }

    /// Volumetric heat capacity of dried tissue \[J/(m³·K)\]; at most that of wet tissue.
    #[must_use]
    pub fn dry_capacity(&self) -> f64 {
        (self.density * (1.0 - self.water) * self.dry_heat_capacity).min(self.wet_capacity())
    }

    /// Latent heat of all its water by volume \[J/m³\]; 0 where the latent heat is switched off.
    #[must_use]
    pub fn latent(&self) -> f64 {
        if self.has_latent_heat { self.density * self.water * self.latent_heat } else { 0.0 }
    }

    /// Perfusion heat loss by volume and temperature \[W/(m³·K)\].
    #[must_use]
    pub fn perfusion_loss(&self) -> f64 {
        self.perfusion * self.blood_capacity
    }

    pub(super) fn check(&self) -> Result<(), ElectrosurgeryError> {
        parameter("density", self.density, 1.0..=1e5, "1 to 1e5 kg/m³")?;
        parameter("heat_capacity", self.heat_capacity, 1.0..=1e5, "1 to 1e5 J/(kg·K)")?;
        parameter("conductivity", self.conductivity, 0.0..=1e3, "0 to 1000 W/(m·K)")?;
        parameter("perfusion", self.perfusion, 0.0..=10.0, "0 to 10 1/s")?;
        parameter("blood_capacity", self.blood_capacity, 0.0..=1e8, "0 to 1e8 J/(m³·K)")?;
        parameter("arterial", self.arterial, 0.0..=99.0, "0 to 99 °C")?;
        parameter("water", self.water, 0.0..=0.99, "0 to 0.99")?;
        parameter("boiling", self.boiling, 50.0..=1e4, "50 to 10000 °C")?;
        parameter("latent_heat", self.latent_heat, 0.0..=1e8, "0 to 1e8 J/kg")?;
        parameter("dry_heat_capacity", self.dry_heat_capacity, 1.0..=1e5, "1 to 1e5 J/(kg·K)")?;
        parameter("dry_conductivity", self.dry_conductivity, 0.0..=1e3, "0 to 1000 W/(m·K)")?;
        parameter("dry_current", self.dry_current, 0.0..=1.0, "0 to 1")?;
        parameter("charring", self.charring, self.boiling..=1e4, "from boiling to 10000 °C")?;
        parameter("ablation", self.ablation, self.boiling..=1e4, "from boiling to 10000 °C")?;
        parameter("smoke", self.smoke, 0.0..=1.0, "0 to 1")?;
        parameter("coagulated_stiffness", self.coagulated_stiffness, 1.0..=1e3, "1 to 1000")?;
        parameter("coagulated_shrinkage", self.coagulated_shrinkage, 0.0..=0.9, "0 to 0.9")?;
        self.damage.check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn liver_takes_the_energy_of_the_reference_to_boil_and_seven_times_that_to_dry() {
        let liver = ThermalMaterial::default();
        let heat = liver.wet_capacity() * (100.0 - BODY) * 1e-9;
        assert!((heat - 0.24064).abs() < 1e-5, "{heat} J/mm³");
        let latent = liver.latent() * 1e-9;
        assert!((latent - 1.70471).abs() < 1e-5, "{latent} J/mm³");
        let easier = (heat + latent) / heat;
        assert!((7.5..8.5).contains(&easier), "without latent heat {easier} times too easy");
        assert_eq!(ThermalMaterial { has_latent_heat: false, ..liver }.latent(), 0.0);
    }

    #[test]
    fn a_parameter_out_of_range_is_named() {
        let wrong = ThermalMaterial { water: f64::NAN, ..ThermalMaterial::default() };
        let error = wrong.check().expect_err("no such water").to_string();
        assert_eq!(error, "water of NaN: 0 to 0.99 is valid");
    }
}
