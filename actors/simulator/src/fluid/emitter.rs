//! Emitter: outflow of a hole as liquid particles. It is given the cumulative volume, so that a late or restarted
//! receiver neither loses nor double-counts any.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::error::{FluidError, parameter};
use super::liquid::Fluid;

/// Largest jet velocity, in spacings per step: particles are wider than the jet of a small vessel.
const SPACINGS_PER_STEP: f64 = 1.0;

/// A hole from which liquid flows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hole {
    /// Its centre \[m\].
    pub place: Point3<f64>,
    /// Outward direction (any length).
    pub outwards: Vector3<f64>,
    /// Its area \[m²\].
    pub area: f64,
}

/// State of an emitter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Emitter {
    /// Cumulative volume received \[m³\].
    pub given: f64,
    /// Part of it too small for a particle \[m³\].
    pub waiting: f64,
    /// Particles emitted.
    pub emitted: u64,
    /// Volume not emitted because the hole lies outside of the liquid's box \[m³\].
    pub unseen: f64,
}

impl Emitter {
    /// Validates the state.
    ///
    /// # Errors
    /// A number out of range.
    pub fn check(&self) -> Result<(), FluidError> {
        for (what, volume) in [("given", self.given), ("waiting", self.waiting), ("unseen", self.unseen)] {
            parameter(what, volume, 0.0..=1e3, "0 to 1000 m³")?;
        }
        Ok(())
    }

    /// Emits the increase of the cumulative volume `given` \[m³\], over the last `dt` \[s\], into the liquid.
    pub fn emit(&mut self, given: f64, dt: f64, hole: &Hole, fluid: &mut Fluid) {
        if !given.is_finite() || dt.is_nan() || dt <= 0.0 {
            return;
        }
        let new = (given - self.given).max(0.0);
        self.given += new;
        self.waiting += new;
        let particle = fluid.particle_volume();
        let spacing = fluid.config().spacing;
        let speed = (new / dt / hole.area.max(1e-12)).min(SPACINGS_PER_STEP * spacing / dt.max(1e-3));
        let direction = hole.outwards.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        let [across, beside] = super::across(&direction);
        // At most the maximum number of particles.
        let ready = (self.waiting / particle).floor().min(fluid.config().particles_max as f64);
        for index in 0..ready as u64 {
            // Four side by side, in layers: never two at one position.
            let (layer, corner) = (index / 4, index % 4);
            let side = spacing * 0.5;
            let aside = across * if corner % 2 == 0 { side } else { -side }
                + beside * if corner / 2 == 0 { side } else { -side };
            let at = hole.place + aside + direction * (spacing * (0.5 + layer as f64));
            self.waiting -= particle;
            if fluid.add(at, direction * speed).is_some() {
                self.emitted += 1;
            } else {
                self.unseen += particle;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fluid::FluidConfig;

    #[test]
    fn what_is_given_is_what_is_emitted_however_often_one_listens() {
        let mut fluid = Fluid::new(FluidConfig::default()).expect("a liquid");
        let hole = Hole { place: Point3::origin(), outwards: Vector3::x(), area: 2e-6 };
        let mut emitter = Emitter::default();
        for step in 1..=200_u32 {
            // 5 ml/s; now and then an update is lost or repeated.
            let given = f64::from(step) * 5e-6 * 0.005;
            for _ in 0..step % 3 {
                emitter.emit(given, 0.005, &hole, &mut fluid);
            }
            fluid.step(0.005).expect("a step");
        }
        let volume = fluid.particle_volume();
        let all = emitter.emitted as f64 * volume + emitter.waiting;
        assert!((all - 5e-6).abs() < 1e-15 && emitter.waiting < volume, "{emitter:?}");
        assert!((emitter.emitted as f64 * volume / 5e-6 - 1.0).abs() < 0.02);
        assert_eq!(fluid.state().numbers.len() as u64 + fluid.state().absorbed, emitter.emitted);
        // Outside of the box nothing is emitted, but counted.
        let far = Hole { place: Point3::new(9.0, 0.0, 0.0), ..hole };
        emitter.emit(6e-6, 0.1, &far, &mut fluid);
        assert!((emitter.unseen + emitter.waiting - 1e-6).abs() < volume);
        emitter.emit(f64::NAN, 0.1, &hole, &mut fluid);
        emitter.emit(1e-6, 0.1, &hole, &mut fluid);
        assert_eq!(emitter.given, 6e-6, "less than before is nothing new");
        emitter.check().expect("a state");
        assert!(Emitter { waiting: -1.0, ..emitter }.check().is_err());
    }
}
