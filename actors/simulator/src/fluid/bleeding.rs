//! A vessel that bleeds. Through a hole blood goes as through an orifice, Q = C A √(2 Δp / ρ), and to the hole as through
//! the vessel before it, Δp = Q · 8 μ L / (π r⁴) (Poiseuille); both are in series. A clamp closes the vessel by its share, a
//! clot of coagulated tissue the hole; released, the vessel bleeds on.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::error::{FluidError, FluidStepError, parameter};
use super::sph::Fluid;

/// Viscosity of blood \[Pa·s\], at the shear rates of arteries, 37 °C.
pub const BLOOD_VISCOSITY: f64 = 3.5e-3;
/// Density of blood \[kg/m³\].
pub const BLOOD_DENSITY: f64 = 1060.0;
/// Discharge coefficient of a sharp-edged orifice.
const DISCHARGE: f64 = 0.61;

/// A vessel and the hole in it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Vessel {
    /// Inner radius \[m\].
    pub radius: f64,
    /// From where the pressure is known to the hole \[m\].
    pub length: f64,
    /// Share of the way from the mean venous (0) to the arterial pressure (1) at which it is.
    pub arterial: f64,
}

/// What has been done to a vessel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BleedingState {
    /// Area of the hole, as a share of the vessel's section; 1 is cut through.
    pub damage: f64,
    /// Share of the section that a clamp or a ligature closes.
    pub clamped: f64,
    /// Share of the hole that coagulated tissue closes; it stays closed.
    pub coagulated: f64,
    /// Blood that has come out \[m³\].
    pub lost: f64,
    /// Blood that came out, but makes no particle yet \[m³\].
    pub waiting: f64,
    /// Particles emitted.
    pub emitted: u64,
    /// Blood for which there was no place, since the hole lies outside of the liquid's box \[m³\].
    pub unseen: f64,
}

/// A source of blood.
#[derive(Clone, Debug)]
pub struct Bleeding {
    vessel: Vessel,
    state: BleedingState,
}

impl Bleeding {
    /// A vessel that is whole.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn new(vessel: Vessel) -> Result<Self, FluidError> {
        Self::restore(vessel, BleedingState::default())
    }

    /// Goes on from a state.
    ///
    /// # Errors
    /// A parameter or a number of the state out of its range.
    pub fn restore(vessel: Vessel, state: BleedingState) -> Result<Self, FluidError> {
        parameter("radius", vessel.radius, 1e-5..=0.05, "1e-5 to 0.05 m")?;
        parameter("length", vessel.length, 0.0..=1.0, "0 to 1 m")?;
        parameter("arterial", vessel.arterial, 0.0..=1.0, "0 to 1")?;
        for (what, share) in
            [("damage", state.damage), ("clamped", state.clamped), ("coagulated", state.coagulated)]
        {
            parameter(what, share, 0.0..=1.0, "0 to 1")?;
        }
        for (what, volume) in [("lost", state.lost), ("waiting", state.waiting), ("unseen", state.unseen)] {
            parameter(what, volume, 0.0..=1.0, "0 to 1 m³")?;
        }
        Ok(Self { vessel, state })
    }

    /// What has been done to it, and what came out.
    #[must_use]
    pub fn state(&self) -> &BleedingState {
        &self.state
    }

    /// Opens the hole to a share of the section; a hole grows, it does not heal.
    pub fn injure(&mut self, damage: f64) {
        if damage.is_finite() {
            self.state.damage = self.state.damage.max(damage).min(1.0);
        }
    }

    /// Closes a share of the section, or opens it again.
    pub fn clamp(&mut self, share: f64) {
        if share.is_finite() {
            self.state.clamped = share.clamp(0.0, 1.0);
        }
    }

    /// Closes a share of the hole for good.
    pub fn coagulate(&mut self, share: f64) {
        if share.is_finite() {
            self.state.coagulated = self.state.coagulated.max(share).min(1.0);
        }
    }

    /// What comes out at a mean arterial and a venous pressure above that in the cavity \[Pa\]: \[m³/s\].
    #[must_use]
    pub fn rate(&self, arterial: f64, venous: f64) -> f64 {
        let pressure = venous + (arterial - venous) * self.vessel.arterial;
        let section = PI * self.vessel.radius.powi(2);
        let hole = section * self.state.damage * (1.0 - self.state.coagulated);
        // A clamp narrows the vessel: what is left is a narrow place before the hole.
        let open = (1.0 - self.state.clamped) * section;
        if pressure <= 0.0 || hole <= 0.0 || open <= 0.0 || !pressure.is_finite() {
            return 0.0;
        }
        // a Q² + b Q = p: the hole and the narrow place, and the way there.
        let loss = |area: f64| BLOOD_DENSITY / (2.0 * (DISCHARGE * area).powi(2));
        let narrow = if self.state.clamped > 0.0 { loss(open) } else { 0.0 };
        let a = loss(hole) + narrow;
        let b = 8.0 * BLOOD_VISCOSITY * self.vessel.length / (PI * self.vessel.radius.powi(4));
        2.0 * pressure / (b + (b * b + 4.0 * a * pressure).sqrt())
    }

    /// Bleeds for `dt` \[s\] at these pressures \[Pa\] out of a hole at `place` \[m\] towards `outwards` (any length); blood that
    /// makes a particle goes into the liquid. The volume that came out \[m³\].
    ///
    /// # Errors
    /// A step that is no time.
    pub fn step(
        &mut self,
        dt: f64,
        (arterial, venous): (f64, f64),
        (place, outwards): (&Point3<f64>, &Vector3<f64>),
        fluid: &mut Fluid,
    ) -> Result<f64, FluidStepError> {
        if !(1e-9..=1.0).contains(&dt) {
            return Err(FluidStepError::Time(dt));
        }
        let rate = self.rate(arterial, venous);
        let volume = rate * dt;
        self.state.lost += volume;
        self.state.waiting += volume;
        let particle = fluid.particle_volume();
        let spacing = fluid.config().spacing;
        let hole =
            PI * self.vessel.radius.powi(2) * (self.state.damage * (1.0 - self.state.coagulated)).max(1e-6);
        // Particles are wider than the jet of a small vessel: not faster than one spacing in the step.
        let speed = (rate / hole).min(spacing / dt.max(1e-3));
        let direction = outwards.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let [across, beside] = crate::fluid::across(&direction);
        let ready = (self.state.waiting / particle).floor();
        for index in 0..ready as u64 {
            // One beside the other, in rings, and one above the other: never in one place.
            let (layer, corner) = (index / 4, index % 4);
            let side = spacing * 0.5;
            let aside = across * if corner % 2 == 0 { side } else { -side }
                + beside * if corner / 2 == 0 { side } else { -side };
            let at = place + aside + direction * (spacing * (0.5 + layer as f64));
            self.state.waiting -= particle;
            if fluid.add(at, direction * speed).is_some() {
                self.state.emitted += 1;
            } else {
                self.state.unseen += particle;
            }
        }
        Ok(volume)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fluid::FluidConfig;

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
        // About what surgeons know of a cut cystic artery: 1 to 10 ml/s.
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
    fn what_is_lost_is_what_was_emitted() {
        let mut fluid = Fluid::new(FluidConfig::default()).expect("a liquid");
        let mut artery = artery();
        artery.injure(1.0);
        let mut lost = 0.0;
        for step in 0..200 {
            artery.clamp(if step / 50 % 2 == 1 { 1.0 } else { 0.0 });
            let before = artery.state().lost;
            lost += artery
                .step(0.005, PRESSURES, (&Point3::origin(), &Vector3::x()), &mut fluid)
                .expect("a step");
            assert_eq!(artery.state().lost > before, step / 50 % 2 == 0, "step {step}");
            fluid.step(0.005).expect("a step");
        }
        let emitted = artery.state().emitted as f64 * fluid.particle_volume();
        assert!((emitted / lost - 1.0).abs() < 0.02, "{emitted} {lost}");
        let there = fluid.state().numbers.len() as u64 + fluid.state().absorbed;
        assert_eq!(there, artery.state().emitted);
        // Out of the box nothing is seen, but it is lost.
        let before = artery.state().lost;
        artery.clamp(0.0);
        for _ in 0..20 {
            let far = Point3::new(9.0, 0.0, 0.0);
            artery.step(0.1, PRESSURES, (&far, &Vector3::x()), &mut fluid).expect("a step");
        }
        assert!(artery.state().unseen > 0.9 * (artery.state().lost - before));
        let restored =
            Bleeding::restore(Vessel { radius: 0.8e-3, length: 0.03, arterial: 1.0 }, *artery.state());
        assert_eq!(restored.expect("its state").state(), artery.state());
    }
}
