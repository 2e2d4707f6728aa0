//! Heat source of an electrosurgical electrode. Current spreads from a small contact into a large body: its density
//! falls with the square of the distance, the heat with the fourth power (Wiley and Webster, *Analysis and control of
//! the current distribution under circular dispersive electrodes*, 1982, for the contact; a monopolar tip is the small
//! one). The heat is centred at the tissue nearest to the tip, where an arc strikes when contact is lost.
//!
//! The far field of the tip's distribution is deposited near it, too: the total power is exact, and the far field is
//! small compared with perfusion. The generator holds its power constant.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::error::{HeatStepError, input};

/// Radius of the heated region, in contact radii: there the density is 0.3 % of that at the centre.
pub(super) const REACH: f64 = 4.0;

/// Generator mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Cutting, continuous wave: cells burst, and tissue vaporises as its water boils.
    #[default]
    Cut,
    /// Coagulation, modulated wave at a high voltage: long sparks over a wide area; tissue dries, chars, and vaporises
    /// at the ablation temperature.
    Coagulate,
}

impl Mode {
    /// Spark length \[m\]: breakdown of air, 3 kV/mm, at the open-circuit voltages of generators (about 1.5 kV peak
    /// cutting, 9 kV in spray).
    #[must_use]
    pub fn spark(self) -> f64 {
        match self {
            Self::Cut => 0.5e-3,
            Self::Coagulate => 3e-3,
        }
    }

    /// Width of the heated region relative to the contact.
    #[must_use]
    pub fn spread(self) -> f64 {
        match self {
            Self::Cut => 1.0,
            Self::Coagulate => 1.5,
        }
    }
}

/// An active electrode during a step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Electrode {
    /// Centre of its spherical tip, in the tissue's rest frame \[m\].
    pub tip_in_rest: Point3<f64>,
    /// Generator power \[W\]; 0 while the pedal is up.
    pub power: f64,
    /// Generator mode.
    pub mode: Mode,
    /// Area of its bare metal \[m²\]: the largest contact area.
    pub contact_area: f64,
}

impl Electrode {
    /// Radius of a disc with the area of the bare metal \[m\], also that of the spherical tip.
    #[must_use]
    pub fn contact_radius(&self) -> f64 {
        (self.contact_area / std::f64::consts::PI).sqrt()
    }

    /// Radius of the heated region for this contact area \[m\]: that of a disc, widened by the mode.
    #[must_use]
    pub fn radius(&self, area: f64) -> f64 {
        (area / std::f64::consts::PI).sqrt() * self.mode.spread()
    }

    /// Fraction of the power that crosses a gap \[m\]: 1 in contact, 0 beyond the spark length.
    #[must_use]
    pub fn efficiency(&self, gap: f64) -> f64 {
        (1.0 - gap.max(0.0) / self.mode.spark()).clamp(0.0, 1.0)
    }

    pub(super) fn check(&self) -> Result<(), HeatStepError> {
        for coordinate in self.tip_in_rest.iter() {
            input("a coordinate of the tip", *coordinate, -1e3..=1e3, "within 1000 m")?;
        }
        input("power", self.power, 0.0..=500.0, "0 to 500 W")?;
        input("contact_area", self.contact_area, 1e-8..=1e-4, "1e-8 to 1e-4 m²")
    }
}

/// Relative heat density at a distance from the centre, for a radius \[m\].
#[inline]
#[must_use]
pub(super) fn profile(distance: f64, radius: f64) -> f64 {
    let ratio = distance / radius;
    let bell = 1.0 / (1.0 + ratio * ratio);
    bell * bell
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heat_falls_with_the_fourth_power_and_a_spark_has_its_reach() {
        let area = std::f64::consts::PI * 1e-6;
        let cut =
            Electrode { tip_in_rest: Point3::origin(), power: 30.0, mode: Mode::Cut, contact_area: area };
        assert!((cut.radius(area) - 1e-3).abs() < 1e-15);
        assert!((profile(20e-3, 1e-3) / profile(40e-3, 1e-3) - 16.0).abs() < 0.1);
        assert_eq!((cut.efficiency(-1.0), cut.efficiency(1.0)), (1.0, 0.0));
        let spray = Electrode { mode: Mode::Coagulate, ..cut };
        assert!(spray.efficiency(1e-3) > 0.5 && cut.efficiency(1e-3) == 0.0);
        assert!(Electrode { power: f64::INFINITY, ..cut }.check().is_err());
    }
}
