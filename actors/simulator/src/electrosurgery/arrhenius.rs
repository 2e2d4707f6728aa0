//! Arrhenius model of thermal damage, a first-order reaction (Henriques and Moritz, *Studies of thermal injury*, 1947):
//! dΩ/dt = A exp(−Eₐ / (R T)). At Ω = 1, 63 % of the tissue is coagulated: it turns pale, its vessels close.

use serde::{Deserialize, Serialize};

use super::error::{ElectrosurgeryError, parameter};

/// Gas constant \[J/(mol·K)\].
pub const GAS_CONSTANT: f64 = 8.314;
/// 0 °C \[K\].
pub const ZERO_CELSIUS: f64 = 273.15;
/// Ω above which tissue counts as coagulated.
pub const COAGULATED: f64 = 1.0;

/// Parameters of the reaction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arrhenius {
    /// Frequency factor A \[1/s\].
    pub frequency: f64,
    /// Activation energy Eₐ \[J/mol\].
    pub activation_energy: f64,
    /// Temperature \[°C\] below which living tissue repairs damage as fast as it arises, and Ω stays constant: by the
    /// law alone, a liver would coagulate at its own 37 °C within the hour.
    pub threshold: f64,
}

impl Default for Arrhenius {
    /// Liver: A = 7.39e39 1/s, Eₐ = 257.7 kJ/mol (Kim, Jacques, Rastegar, Thomsen and Motamedi, *Nonlinear finite-element
    /// analysis of the role of dynamic changes in blood perfusion and optical properties in laser coagulation of tissue*, 1996);
    /// 43 °C is where hyperthermia begins (Sapareto and Dewey, *Thermal dose determination in cancer therapy*, 1984).
    fn default() -> Self {
        Self { frequency: 7.39e39, activation_energy: 2.577e5, threshold: 43.0 }
    }
}

impl Arrhenius {
    pub(super) fn check(&self) -> Result<(), ElectrosurgeryError> {
        parameter("damage.frequency", self.frequency, 0.0..=1e200, "0 to 1e200 1/s")?;
        parameter("damage.activation_energy", self.activation_energy, 0.0..=1e7, "0 to 1e7 J/mol")?;
        parameter("damage.threshold", self.threshold, -273.15..=1e3, "-273.15 to 1000 °C")
    }

    /// Rate of Ω \[1/s\] at a temperature \[°C\].
    #[inline]
    #[must_use]
    pub fn rate(&self, celsius: f64) -> f64 {
        if celsius < self.threshold {
            return 0.0;
        }
        let kelvin = celsius + ZERO_CELSIUS;
        // In one exponential: A alone may overflow, though the exponential makes the product small.
        (self.frequency.ln() - self.activation_energy / (GAS_CONSTANT * kelvin)).exp()
    }

    /// Fraction of dead cells at Ω.
    #[must_use]
    pub fn dead(damage: f64) -> f64 {
        -(-damage).exp_m1()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn liver_coagulates_in_a_minute_at_50_and_in_seconds_at_60_degrees() {
        let liver = Arrhenius::default();
        for (celsius, seconds) in [(50.0, 61.38), (60.0, 3.4486)] {
            let time = COAGULATED / liver.rate(celsius);
            assert!((time / seconds - 1.0).abs() < 0.01, "{celsius} °C: {time} s, not {seconds}");
        }
        assert_eq!(liver.rate(37.0), 0.0);
        assert!((Arrhenius::dead(COAGULATED) - 0.632).abs() < 1e-3);
        assert!(liver.rate(5000.0).is_finite());
    }

    #[test]
    fn without_a_threshold_the_body_would_cook_itself() {
        let bare = Arrhenius { threshold: -273.15, ..Arrhenius::default() };
        assert!(COAGULATED / bare.rate(37.0) < 2.0 * 3600.0);
    }
}
