//! Bleeding vessel. Outflow through the hole follows the orifice equation, Q = C A √(2 Δp / ρ), in series with the
//! vessel upstream, Δp = Q · 8 μ L / (π r⁴) (Poiseuille). A clamp closes a fraction of the vessel, a coagulated clot a
//! fraction of the hole; once unclamped, the vessel bleeds again.
//!
//! Flowing blood cools the rim of its hole, so that heat cannot coagulate it: a vessel has to be clamped first. Heat
//! reaches the rim as it does a disc on a half-space, 4 k a (Carslaw and Jaeger, *Conduction of heat in solids*, 1959),
//! and blood removes it at ρ c Q.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use super::error::{FluidError, FluidStepError, parameter};
use crate::electrosurgery::{Arrhenius, BODY, ThermalMaterial};

/// Viscosity of blood \[Pa·s\], at the shear rates of arteries, 37 °C.
pub const BLOOD_VISCOSITY: f64 = 3.5e-3;
/// Density of blood \[kg/m³\].
pub const BLOOD_DENSITY: f64 = 1060.0;
/// Discharge coefficient of a sharp-edged orifice.
const DISCHARGE: f64 = 0.61;
/// A hole of which less than this fraction is open is sealed.
const TIGHT: f64 = 1e-3;
/// Ω beyond which damage is no longer tracked.
const BURN_MAX: f64 = 100.0;

/// A vessel with a hole.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vessel {
    /// Inner radius \[m\].
    pub radius: f64,
    /// Length from the point of known pressure to the hole \[m\].
    pub length: f64,
    /// Source pressure as a fraction from the mean venous (0) to the arterial pressure (1).
    pub arterial: f64,
}

/// State of a vessel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BleedingState {
    /// Area of the hole, as a fraction of the vessel's cross-section; 1 is cut through.
    pub damage: f64,
    /// Fraction of the cross-section closed by a clamp or a ligature.
    pub clamped: f64,
    /// Fraction of the hole closed by coagulation, permanently.
    pub coagulated: f64,
    /// Thermal damage Ω of the rim of the hole.
    pub burn: f64,
    /// Volume of blood lost \[m³\].
    pub lost: f64,
}

/// A bleeding source.
#[derive(Clone, Debug)]
pub struct Bleeding {
    vessel: Vessel,
    state: BleedingState,
}

impl Bleeding {
    /// An intact vessel.
    ///
    /// # Errors
    /// A parameter out of range.
    pub fn new(vessel: Vessel) -> Result<Self, FluidError> {
        Self::restore(vessel, BleedingState::default())
    }

    /// Restores from a state.
    ///
    /// # Errors
    /// A parameter or a number of the state out of range.
    pub fn restore(vessel: Vessel, state: BleedingState) -> Result<Self, FluidError> {
        parameter("radius", vessel.radius, 1e-5..=0.05, "1e-5 to 0.05 m")?;
        parameter("length", vessel.length, 0.0..=1.0, "0 to 1 m")?;
        parameter("arterial", vessel.arterial, 0.0..=1.0, "0 to 1")?;
        for (what, share) in
            [("damage", state.damage), ("clamped", state.clamped), ("coagulated", state.coagulated)]
        {
            parameter(what, share, 0.0..=1.0, "0 to 1")?;
        }
        parameter("burn", state.burn, 0.0..=BURN_MAX, "0 to 100")?;
        parameter("lost", state.lost, 0.0..=1.0, "0 to 1 m³")?;
        Ok(Self { vessel, state })
    }

    /// Its state.
    #[must_use]
    pub fn state(&self) -> &BleedingState {
        &self.state
    }

    /// Sets the length from the point of known pressure to the hole \[m\].
    pub fn set_length(&mut self, length: f64) {
        if (0.0..=1.0).contains(&length) {
            self.vessel.length = length;
        }
    }

    /// Enlarges the hole to a fraction of the cross-section; it never shrinks.
    pub fn injure(&mut self, damage: f64) {
        if damage.is_finite() {
            self.state.damage = self.state.damage.max(damage).min(1.0);
        }
    }

    /// Sets the clamped fraction of the cross-section.
    pub fn clamp(&mut self, share: f64) {
        if share.is_finite() {
            self.state.clamped = share.clamp(0.0, 1.0);
        }
    }

    /// Cuts it through, upstream of any hole: earlier closures have no effect any more.
    pub fn sever(&mut self) {
        (self.state.damage, self.state.coagulated, self.state.burn) = (1.0, 0.0, 0.0);
    }

    /// Closes a fraction of the hole permanently.
    pub fn coagulate(&mut self, share: f64) {
        if share.is_finite() {
            self.state.coagulated = self.state.coagulated.max(share).min(1.0);
        }
    }

    /// Temperature of the hole's rim \[°C\] in tissue of `celsius`, at an outflow of `rate` \[m³/s\].
    #[must_use]
    pub fn rim_celsius(&self, celsius: f64, rate: f64) -> f64 {
        let tissue = ThermalMaterial::default();
        let conductance = 4.0 * tissue.conductivity * self.vessel.radius * self.state.damage.sqrt();
        let cooling = tissue.blood_capacity * rate.max(0.0);
        if conductance <= 0.0 {
            celsius
        } else {
            BODY + (celsius - BODY) * conductance / (conductance + cooling)
        }
    }

    /// Heats the rim for `dt` \[s\] in tissue of `celsius` \[°C\], at an outflow of `rate` \[m³/s\]: its denatured
    /// fraction closes the hole.
    pub fn heat(&mut self, dt: f64, celsius: f64, rate: f64) {
        let rim = self.rim_celsius(celsius, rate);
        let more = dt * Arrhenius::default().rate(rim);
        if self.state.damage > 0.0 && more.is_finite() && more > 0.0 {
            self.state.burn = (self.state.burn + more).min(BURN_MAX);
            self.coagulate(1.0 - (-self.state.burn).exp());
        }
    }

    /// Outflow \[m³/s\] at mean arterial and venous pressures relative to the cavity \[Pa\].
    #[must_use]
    pub fn rate(&self, arterial: f64, venous: f64) -> f64 {
        let pressure = venous + (arterial - venous) * self.vessel.arterial;
        let section = PI * self.vessel.radius.powi(2);
        let gap = 1.0 - self.state.coagulated;
        let hole = section * self.state.damage * if gap < TIGHT { 0.0 } else { gap };
        // A clamp narrows the vessel: a stenosis in series with the hole.
        let open = (1.0 - self.state.clamped) * section;
        if pressure <= 0.0 || hole <= 0.0 || open <= 0.0 || !pressure.is_finite() {
            return 0.0;
        }
        // a Q² + b Q = p: orifice losses of the hole and the stenosis, and the vessel's resistance.
        let loss = |area: f64| BLOOD_DENSITY / (2.0 * (DISCHARGE * area).powi(2));
        let narrow = if self.state.clamped > 0.0 { loss(open) } else { 0.0 };
        let a = loss(hole) + narrow;
        let b = 8.0 * BLOOD_VISCOSITY * self.vessel.length / (PI * self.vessel.radius.powi(4));
        2.0 * pressure / (b + (b * b + 4.0 * a * pressure).sqrt())
    }

    /// Open area of the hole \[m²\], without the clot.
    #[must_use]
    pub fn hole(&self) -> f64 {
        PI * self.vessel.radius.powi(2) * self.state.damage * (1.0 - self.state.coagulated)
    }

    /// Bleeds for `dt` \[s\] at these pressures \[Pa\]; returns the volume \[m³\].
    ///
    /// # Errors
    /// An invalid time step.
    pub fn step(&mut self, dt: f64, arterial: f64, venous: f64) -> Result<f64, FluidStepError> {
        if !(1e-9..=1.0).contains(&dt) {
            return Err(FluidStepError::Time(dt));
        }
        let volume = self.rate(arterial, venous) * dt;
        self.state.lost += volume;
        Ok(volume)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 95 mmHg and 5 mmHg.
    const PRESSURES: (f64, f64) = (12_665.0, 667.0);

    fn artery() -> Bleeding {
        // A cystic artery.
        Bleeding::new(Vessel { radius: 0.8e-3, length: 0.03, arterial: 1.0 }).expect("a vessel")
    }

    #[test]
    fn through_a_long_vessel_poiseuille_and_through_a_hole_the_orifice_decides() {
        let (radius, length) = (0.2e-3, 1.0);
        let mut long = Bleeding::new(Vessel { radius, length, arterial: 1.0 }).expect("a vessel");
        long.injure(1.0);
        let poiseuille = PI * radius.powi(4) * PRESSURES.0 / (8.0 * BLOOD_VISCOSITY * length);
        assert!((long.rate(PRESSURES.0, 0.0) / poiseuille - 1.0).abs() < 0.01);
        let mut short = Bleeding::new(Vessel { radius: 5e-3, length: 0.0, arterial: 1.0 }).expect("a vessel");
        short.injure(0.1);
        let orifice = DISCHARGE * 0.1 * PI * 25e-6 * (2.0 * PRESSURES.0 / BLOOD_DENSITY).sqrt();
        assert!((short.rate(PRESSURES.0, 0.0) / orifice - 1.0).abs() < 1e-9);
        // Clinical range for a cut cystic artery: 1 to 10 ml/s.
        let mut artery = artery();
        artery.injure(1.0);
        assert!((1e-6..10e-6).contains(&artery.rate(PRESSURES.0, PRESSURES.1)));
    }

    #[test]
    fn it_ends_when_clamped_resumes_when_released_and_ends_for_good_when_coagulated() {
        let mut artery = artery();
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), 0.0, "whole");
        artery.injure(0.5);
        let free = artery.rate(PRESSURES.0, PRESSURES.1);
        artery.clamp(0.5);
        let half = artery.rate(PRESSURES.0, PRESSURES.1);
        artery.clamp(1.0);
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), 0.0);
        artery.clamp(0.0);
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), free);
        assert!(free > half && half > 0.0);
        assert!(artery.rate(PRESSURES.0 / 2.0, 0.0) < free, "a lower pressure bleeds less");
        artery.coagulate(0.9);
        assert!(artery.rate(PRESSURES.0, PRESSURES.1) < 0.2 * free);
        artery.coagulate(1.0);
        artery.coagulate(0.0);
        artery.injure(1.0);
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), 0.0, "a clot stays");
        artery.injure(f64::NAN);
        artery.clamp(f64::NAN);
        assert!(artery.state().damage == 1.0 && artery.state().clamped == 0.0);
    }

    #[test]
    fn blood_that_flows_keeps_its_hole_from_coagulating_and_a_closed_vessel_is_sealed() {
        let mut artery = artery();
        artery.injure(1.0);
        let rate = artery.rate(PRESSURES.0, PRESSURES.1);
        // At 95 °C for 2 s with flowing blood, which removes all of the heat.
        assert!(artery.rim_celsius(95.0, rate) < 38.0, "{} °C", artery.rim_celsius(95.0, rate));
        (0..200).for_each(|_| artery.heat(0.01, 95.0, rate));
        assert_eq!(artery.state().coagulated, 0.0);
        // Clamped, it coagulates at 60 °C within seconds: Ω = 1 after 3.4486 s.
        (0..345).for_each(|_| artery.heat(0.01, 60.0, 0.0));
        let denatured = 1.0 - (-1.0_f64).exp();
        assert!((artery.state().coagulated - denatured).abs() < 0.01, "{}", artery.state().coagulated);
        (0..200).for_each(|_| artery.heat(0.01, 80.0, 0.0));
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), 0.0);
        artery.sever();
        assert_eq!(artery.rate(PRESSURES.0, PRESSURES.1), rate, "before the clot");
        artery.heat(f64::NAN, 80.0, 0.0);
        assert_eq!(artery.state().burn, 0.0);
    }

    #[test]
    fn a_state_goes_on() {
        let mut artery = artery();
        artery.injure(0.3);
        artery.step(0.5, PRESSURES.0, PRESSURES.1).expect("a step");
        let vessel = Vessel { radius: 0.8e-3, length: 0.03, arterial: 1.0 };
        let mut other = Bleeding::restore(vessel, *artery.state()).expect("its state");
        for artery in [&mut artery, &mut other] {
            artery.step(0.5, PRESSURES.0, PRESSURES.1).expect("a step");
        }
        assert_eq!(artery.state(), other.state());
        assert!(artery.step(f64::NAN, 1e4, 0.0).is_err());
        let broken = BleedingState { burn: f64::NAN, ..*artery.state() };
        assert!(Bleeding::restore(vessel, broken).is_err());
    }
}
