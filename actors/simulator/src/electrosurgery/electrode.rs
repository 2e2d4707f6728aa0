//! What an electrosurgical electrode puts where. Current leaves a small contact into a large body: its density falls with
//! the square of the distance, the heat with the fourth power (Wiley and Webster, *Analysis and control of the current
//! distribution under circular dispersive electrodes*, 1982, for the contact; a monopolar tip is the small one). The
//! heat is deposited about the tissue that is nearest to the tip: there an arc strikes when the contact is lost.
//!
//! What the tip's own distribution leaves to the far field is put near, too: power is exact, and the far field's share is
//! small against perfusion. The generator is one that holds its power.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::error::{HeatStepError, input};

/// Radii of the contact beyond which no heat is deposited: there it is 0.3 % of the middle's.
pub(super) const REACH: f64 = 4.0;

/// How the generator drives the electrode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Continuous wave: cells burst, and tissue goes as its water boils.
    #[default]
    Cut,
    /// Modulated wave at a high voltage: long sparks over a wide area; tissue dries, chars, and goes at the temperature of
    /// ablation.
    Coagulate,
}

impl Mode {
    /// How far a spark reaches \[m\]: breakdown of air, 3 kV/mm, at the open-circuit voltages of generators (about
    /// 1.5 kV peak cutting, 9 kV in spray).
    #[must_use]
    pub fn spark(self) -> f64 {
        match self {
            Self::Cut => 0.5e-3,
            Self::Coagulate => 3e-3,
        }
    }

    /// How much wider than the contact the heat is spread.
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
    /// Middle of the ball that is its tip, in the tissue's rest frame \[m\].
    pub tip_in_rest: Point3<f64>,
    /// Power that the generator gives \[W\]; 0 while the pedal is up.
    pub power: f64,
    /// How it gives it.
    pub mode: Mode,
    /// Area of its bare metal \[m²\]: so much is in contact with tissue at most.
    pub contact_area: f64,
}

impl Electrode {
    /// Radius of a disc with the area of the bare metal \[m\]; the metal is a ball of that radius about the tip.
    #[must_use]
    pub fn contact_radius(&self) -> f64 {
        (self.contact_area / std::f64::consts::PI).sqrt()
    }

    /// Radius about which heat is deposited by so much area in contact \[m\]: that of a disc, spread as the mode spreads it.
    #[must_use]
    pub fn radius(&self, area: f64) -> f64 {
        (area / std::f64::consts::PI).sqrt() * self.mode.spread()
    }

    /// Share of the power that arrives over a gap \[m\]: all of it in contact, none where no spark reaches.
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

/// How much heat is deposited, relative to where it is most, at a distance from there, about a radius \[m\].
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
