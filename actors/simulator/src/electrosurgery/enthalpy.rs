//! Enthalpy method of phase change: a cell accumulates heat, and its temperature follows from that. Heat above the
//! boiling point vaporises water, however much arrives at once; so boiling is never missed, whatever the step (Voller
//! and Cross, *Accurate solutions of moving boundary problems using the enthalpy method*, 1981). An apparent heat
//! capacity near 100 °C would be stepped over instead.
//!
//! Steam leaves with the heat of its water: a dried cell does not regain water by cooling.

use super::material::{BODY, ThermalMaterial};

/// Largest conductance factor between a dry cell and a boiling neighbour ([`boiling_nearer`]).
const BOILING_NEARER: f64 = 2.0;

/// Conductance factor between a dry cell and a boiling neighbour, the front in which has left this part ahead of it. Heat
/// crosses half of the dry cell, and then the part of the boiling one behind its front: 2 where the front arrives, 2/3 where
/// it leaves. In the mean of the resistance over that time this is 1: a front advances by Stefan's law, and not by jumps of a
/// cell. A cell that dries by a current of its own boils all over, and has no such part.
#[inline]
pub(super) fn boiling_nearer(ahead: f64) -> f64 {
    1.0 / (1.0 / BOILING_NEARER + (1.0 - ahead))
}

/// Derived material constants used by every cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Enthalpy {
    pub wet: f64,
    pub dry: f64,
    pub latent: f64,
    pub boiling: f64,
    conductivity: f64,
    dry_conductivity: f64,
}

/// Heat given off by a cell, per volume \[J/m³\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ReleasedHeat {
    /// Vaporised fraction of the cell's water.
    pub water: f64,
    /// Latent heat.
    pub latent: f64,
    /// Heat capacity lost with the water \[J/(m³·K)\].
    pub capacity: f64,
}

impl Enthalpy {
    pub(super) fn new(material: &ThermalMaterial) -> Self {
        Self {
            wet: material.wet_capacity(),
            dry: material.dry_capacity(),
            latent: material.latent(),
            boiling: material.boiling,
            conductivity: material.conductivity,
            dry_conductivity: material.dry_conductivity,
        }
    }

    /// Heat capacity of a cell with this water fraction \[J/(m³·K)\].
    #[inline]
    pub(super) fn capacity(&self, water: f64) -> f64 {
        self.dry + (self.wet - self.dry) * water
    }

    /// Conductivity of a cell with this water fraction \[W/(m·K)\].
    #[inline]
    pub(super) fn conductivity(&self, water: f64) -> f64 {
        self.dry_conductivity + (self.conductivity - self.dry_conductivity) * water
    }

    /// Largest diffusivity of a cell \[m²/s\]: that of a dry one among boiling ones, which are effectively nearer
    /// ([`BOILING_NEARER`]).
    pub(super) fn diffusivity_max(&self) -> f64 {
        // Both are linear in the water: their quotient is largest at an end.
        (self.conductivity / self.wet).max(BOILING_NEARER * self.dry_conductivity / self.dry)
    }

    /// Heat that vaporises a fresh cell's water \[J/m³\].
    pub(super) fn vaporisation(&self) -> f64 {
        self.wet * (self.boiling - BODY) + self.latent
    }

    /// Boils a cell at `celsius` above the boiling point as far as its heat allows; the second result is its new
    /// temperature. With H the heat above boiling, H = C(w) (T − Tb) before; vaporisation removes the latent heat L and
    /// the water's capacity, at Tb. Only a dry cell can be hotter.
    #[inline]
    pub(super) fn boil(&self, celsius: f64, water: f64) -> (ReleasedHeat, f64) {
        let above = self.capacity(water) * (celsius - self.boiling);
        let need = self.latent * water;
        if above < need {
            let gone = above / self.latent;
            let capacity = (self.wet - self.dry) * gone;
            (ReleasedHeat { water: gone, latent: above, capacity }, self.boiling)
        } else {
            let capacity = (self.wet - self.dry) * water;
            (ReleasedHeat { water, latent: need, capacity }, self.boiling + (above - need) / self.dry)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Heats a cell uniformly; returns the heat at which it was dry, and the error of the balance.
    fn dried_after(parts: u32, total: f64) -> (f64, f64) {
        let cell = Enthalpy::new(&ThermalMaterial::default());
        let (mut celsius, mut water, mut gone) = (BODY, 1.0, 0.0);
        let mut dried = f64::NAN;
        for part in 1..=parts {
            celsius += total / f64::from(parts) / cell.capacity(water);
            if celsius > cell.boiling && water > 0.0 {
                let (boiled, after) = cell.boil(celsius, water);
                water -= boiled.water;
                gone += boiled.latent + boiled.capacity * (cell.boiling - BODY);
                celsius = after;
                if water == 0.0 {
                    dried = total * f64::from(part) / f64::from(parts);
                }
            }
        }
        (dried, total - gone - cell.capacity(water) * (celsius - BODY))
    }

    #[test]
    fn a_cell_dries_after_the_same_heat_however_it_comes_and_no_heat_is_lost() {
        let needed = Enthalpy::new(&ThermalMaterial::default()).vaporisation();
        for parts in [1, 3, 10, 100, 10_000] {
            let total = 1.2 * needed;
            let (dried, missing) = dried_after(parts, total);
            let part = total / f64::from(parts);
            assert!(dried >= needed * (1.0 - 1e-12) && dried < needed + part * 1.001, "{parts}: {dried}");
            assert!(missing.abs() < 1e-12 * total, "{parts} parts: {missing} J/m³ missing");
        }
    }

    /// For comparison, an apparent heat capacity: a peak of 1 K at the boiling point, evaluated at the temperature
    /// before the step.
    fn apparent_capacity_temperature(parts: u32, total: f64) -> f64 {
        let material = ThermalMaterial::default();
        let mut celsius = BODY;
        for _ in 0..parts {
            let peak = if (celsius - material.boiling).abs() < 0.5 { material.latent() } else { 0.0 };
            celsius += total / f64::from(parts) / (material.wet_capacity() + peak);
        }
        celsius
    }

    #[test]
    fn an_apparent_heat_capacity_steps_over_the_boiling_where_the_enthalpy_does_not() {
        let cell = Enthalpy::new(&ThermalMaterial::default());
        // Half of the water's latent heat: the tissue must be at 100 °C.
        let total = cell.wet * (cell.boiling - BODY) + 0.5 * cell.latent;
        assert!((apparent_capacity_temperature(100_000, total) - 100.0).abs() < 0.6, "fine steps see it");
        assert!(apparent_capacity_temperature(40, total) > 250.0, "long steps do not");
        for parts in [1, 40, 100_000] {
            let (mut celsius, mut water) = (BODY, 1.0);
            for _ in 0..parts {
                celsius += total / f64::from(parts) / cell.capacity(water);
                if celsius > cell.boiling {
                    let (boiled, after) = cell.boil(celsius, water);
                    (water, celsius) = (water - boiled.water, after);
                }
            }
            assert!(
                (celsius - 100.0).abs() < 1e-9 && (water - 0.5).abs() < 1e-9,
                "{parts}: {celsius} {water}"
            );
        }
    }

    #[test]
    fn without_latent_heat_water_is_gone_at_the_boiling_point() {
        let cell = Enthalpy::new(&ThermalMaterial { has_latent_heat: false, ..ThermalMaterial::default() });
        let (boiled, after) = cell.boil(100.5, 1.0);
        assert_eq!((boiled.water, boiled.latent), (1.0, 0.0));
        assert!(after > 100.0 && after.is_finite());
    }
}
