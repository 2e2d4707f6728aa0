//! Smoke as puffs that rise by buoyancy, spread and expire. A puff's excess temperature and velocity relax to those of
//! the surrounding gas, as a thermal mixes with air (Morton, Taylor and Turner, *Turbulent gravitational convection*,
//! 1956, in its simplest form: one mixing time); its spread follows from the diffusivity and is drawn by the viewer.
//! Puffs perform a random walk of that diffusivity, seeded by their number: independent of order and restarts.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::random::{GOLDEN_GAMMA, SplitMix64};

use super::error::{FluidError, FluidStepError, parameter};

/// Smoke settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SmokeConfig {
    /// Mass of smoke in a puff \[kg\].
    pub puff: f64,
    /// Lifetime of a puff \[s\].
    pub lifetime: f64,
    /// Mixing time in which a puff takes on temperature and velocity of the gas \[s\].
    pub mixing: f64,
    /// Initial temperature excess over the gas \[K\].
    pub warmth: f64,
    /// Turbulent diffusivity in the cavity \[m²/s\].
    pub diffusivity: f64,
    /// Upward vector of the magnitude of gravity \[m/s²\].
    pub up: Vector3<f64>,
    /// Maximum number of puffs; the oldest are dropped.
    pub puffs_max: usize,
}

impl Default for SmokeConfig {
    fn default() -> Self {
        Self {
            puff: 1e-9,
            lifetime: 8.0,
            mixing: 0.4,
            warmth: 60.0,
            diffusivity: 2e-4,
            up: Vector3::new(0.0, 0.0, 9.81),
            puffs_max: 2_000,
        }
    }
}

/// State of smoke: puffs in order of emission.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SmokeState {
    /// Number of the first in the lists; the others follow consecutively.
    pub first: u64,
    /// Positions \[m\].
    pub positions: Vec<Point3<f64>>,
    /// Velocities \[m/s\].
    pub velocities: Vec<Vector3<f64>>,
    /// Ages \[s\].
    pub ages: Vec<f64>,
    /// Temperature excess over the gas \[K\].
    pub warmths: Vec<f64>,
    /// Emitted smoke too little for a puff \[kg\].
    pub waiting: f64,
    /// Smoke emitted since the beginning \[kg\].
    pub emitted: f64,
    /// Number of puffs dropped by the limit.
    pub dropped: u64,
}

/// Smoke in a cavity.
#[derive(Clone, Debug)]
pub struct Smoke {
    config: SmokeConfig,
    state: SmokeState,
}

/// Temperature of the gas \[K\], for its thermal expansion.
const GAS_KELVIN: f64 = 310.0;

impl Smoke {
    /// Clear air.
    ///
    /// # Errors
    /// A parameter out of range.
    pub fn new(config: SmokeConfig) -> Result<Self, FluidError> {
        parameter("puff", config.puff, 1e-15..=1.0, "1e-15 to 1 kg")?;
        parameter("lifetime", config.lifetime, 1e-3..=1e4, "0.001 to 10000 s")?;
        parameter("mixing", config.mixing, 1e-3..=1e4, "0.001 to 10000 s")?;
        parameter("warmth", config.warmth, 0.0..=1e3, "0 to 1000 K")?;
        parameter("diffusivity", config.diffusivity, 0.0..=1.0, "0 to 1 m²/s")?;
        config.up.iter().try_for_each(|up| parameter("up", *up, -1e3..=1e3, "-1000 to 1000 m/s²"))?;
        parameter("puffs_max", config.puffs_max as f64, 1.0..=65_536.0, "1 to 65536")?;
        Ok(Self { config, state: SmokeState::default() })
    }

    /// The puffs.
    #[must_use]
    pub fn state(&self) -> &SmokeState {
        &self.state
    }

    /// Restores from a state.
    ///
    /// # Errors
    /// Lists of different lengths, too many puffs, non-finite numbers.
    pub fn restore(&mut self, state: &SmokeState) -> Result<(), FluidError> {
        let count = state.positions.len();
        let lengths = [state.velocities.len(), state.ages.len(), state.warmths.len()];
        if lengths.iter().any(|length| *length != count) || count > self.config.puffs_max {
            return Err(FluidError::State { count, most: self.config.puffs_max });
        }
        let is_finite = |at: &usize| {
            let place =
                state.positions[*at].iter().chain(state.velocities[*at].iter()).all(|x| x.is_finite());
            place && state.ages[*at].is_finite() && state.warmths[*at].is_finite()
        };
        if let Some(particle) = (0..count).find(|at| !is_finite(at)) {
            return Err(FluidError::NotFinite { particle });
        }
        self.state.clone_from(state);
        Ok(())
    }

    /// Emits smoke \[kg\] at points, and advances all puffs by `dt` \[s\] in gas that moves by `wind` \[m/s\].
    ///
    /// # Errors
    /// An invalid time step; a negative mass, a non-finite point or wind (reported with the number of the next puff).
    pub fn step(
        &mut self,
        dt: f64,
        sources: &[(Point3<f64>, f64)],
        wind: &Vector3<f64>,
    ) -> Result<(), FluidStepError> {
        if !(1e-9..=1.0).contains(&dt) {
            return Err(FluidStepError::Time(dt));
        }
        let next = self.state.first + self.state.positions.len() as u64;
        let is_source = |(place, mass): &(Point3<f64>, f64)| {
            place.iter().all(|x| x.is_finite()) && (0.0..=1.0).contains(mass)
        };
        if !sources.iter().all(is_source) || !wind.iter().all(|w| w.abs() <= 1e3) {
            return Err(FluidStepError::NotFinite { number: next });
        }
        // Exact for a velocity that relaxes to the wind under a buoyancy that decays at the same rate.
        let keep = (-dt / self.config.mixing).exp();
        let stray = (6.0 * self.config.diffusivity * dt).sqrt();
        let state = &mut self.state;
        for index in 0..state.positions.len() {
            let lift = self.config.up * (state.warmths[index] / GAS_KELVIN);
            let velocity = wind + (state.velocities[index] - wind + lift * dt) * keep;
            state.positions[index] +=
                velocity * dt + stray * direction(state.first + index as u64, state.ages[index]);
            state.velocities[index] = velocity;
            state.warmths[index] *= keep;
            state.ages[index] += dt;
        }
        let old = state.ages.iter().take_while(|age| **age > self.config.lifetime).count();
        self.forget(old);
        for (place, mass) in sources {
            self.state.waiting += mass;
            self.state.emitted += mass;
            let puffs = (self.state.waiting / self.config.puff).floor();
            self.state.waiting -= puffs * self.config.puff;
            for _ in 0..puffs.min(self.config.puffs_max as f64) as usize {
                self.emit(*place, wind);
            }
        }
        Ok(())
    }

    fn emit(&mut self, place: Point3<f64>, wind: &Vector3<f64>) {
        if self.state.positions.len() == self.config.puffs_max {
            self.forget(1);
            self.state.dropped += 1;
        }
        self.state.positions.push(place);
        self.state.velocities.push(*wind);
        self.state.ages.push(0.0);
        self.state.warmths.push(self.config.warmth);
    }

    fn forget(&mut self, count: usize) {
        self.state.positions.drain(..count);
        self.state.velocities.drain(..count);
        self.state.ages.drain(..count);
        self.state.warmths.drain(..count);
        self.state.first += count as u64;
    }
}

/// A unit direction from a puff's number and age: no generator state has to be stored.
fn direction(number: u64, age: f64) -> Vector3<f64> {
    let seed = number.wrapping_mul(GOLDEN_GAMMA) ^ age.to_bits().rotate_left(23);
    let mut random = SplitMix64::new(seed);
    let (z, angle) = (2.0 * random.unit() - 1.0, std::f64::consts::TAU * random.unit());
    let side = (1.0 - z * z).sqrt();
    Vector3::new(side * angle.cos(), side * angle.sin(), z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(config: SmokeConfig, rate: f64, seconds: f64, wind: Vector3<f64>) -> Smoke {
        let mut smoke = Smoke::new(config).expect("smoke");
        for _ in 0..(seconds / 0.02) as u32 {
            smoke.step(0.02, &[(Point3::origin(), rate * 0.02)], &wind).expect("a step");
        }
        smoke
    }

    #[test]
    fn smoke_rises_drifts_with_the_gas_and_goes() {
        let config = SmokeConfig::default();
        let wind = Vector3::new(0.05, 0.0, 0.0);
        let mut smoke = run(config, 1e-7, 2.0, wind);
        let count = smoke.state().positions.len();
        assert!((195..=200).contains(&count), "{count}");
        let mean = smoke.state().positions.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count as f64;
        assert!(mean.z > 0.02 && mean.x > 0.03, "{mean}");
        for _ in 0..500 {
            smoke.step(0.02, &[], &wind).expect("a step");
        }
        assert!(smoke.state().positions.is_empty());
        assert_eq!(smoke.state().first, count as u64);
    }

    #[test]
    fn puffs_stray_as_their_diffusivity_says() {
        let config = SmokeConfig { warmth: 0.0, lifetime: 100.0, ..SmokeConfig::default() };
        let mut smoke = Smoke::new(config).expect("smoke");
        smoke.step(0.01, &[(Point3::origin(), 1000.0 * config.puff)], &Vector3::zeros()).expect("a step");
        for _ in 0..200 {
            smoke.step(0.01, &[], &Vector3::zeros()).expect("a step");
        }
        let count = smoke.state().positions.len() as f64;
        let square = smoke.state().positions.iter().map(|p| p.coords.norm_squared()).sum::<f64>() / count;
        // ⟨r²⟩ = 6 D t.
        let should = 6.0 * config.diffusivity * 2.0;
        assert!(count > 990.0 && (square / should - 1.0).abs() < 0.1, "{count}: {square} {should}");
    }

    #[test]
    fn there_are_never_too_many_and_a_state_goes_on() {
        let config = SmokeConfig { puffs_max: 50, ..SmokeConfig::default() };
        let smoke = run(config, 1e-7, 2.0, Vector3::zeros());
        assert_eq!(smoke.state().positions.len(), 50);
        assert!(smoke.state().dropped >= 140, "{}", smoke.state().dropped);
        let (mut a, mut b) = (smoke.clone(), Smoke::new(config).expect("smoke"));
        b.restore(smoke.state()).expect("its state");
        for smoke in [&mut a, &mut b] {
            for _ in 0..100 {
                smoke.step(0.02, &[(Point3::origin(), 6e-10)], &Vector3::zeros()).expect("a step");
            }
        }
        assert_eq!(a.state(), b.state());
        assert!(a.step(f64::NAN, &[], &Vector3::zeros()).is_err());
        assert!(a.step(0.1, &[(Point3::new(f64::NAN, 0.0, 0.0), 1.0)], &Vector3::zeros()).is_err());
        assert_eq!(a.state(), b.state());
    }
}
