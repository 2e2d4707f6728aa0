//! Energy observer and time-domain passivity controller.
//!
//! Hannaford & Ryu 2002, "Time-domain passivity control of haptic interfaces" (IEEE Trans. Robotics and
//! Automation 18(1)). The observer sums the energy that the hand put into the scene,
//! `W(n) = W(n−1) − f(n−1)·Δx(n)`, with the force that was held over the interval and the displacement that
//! it saw, which is exact for a zero-order hold (Ryu, Preusche, Hannaford & Hirzinger 2005). When the force
//! about to be rendered would let `W` fall below zero, the controller adds the damping
//! `α = −W/(ΔT v²)` that takes the deficit out again.
//!
//! The loop from sample to force has a delay, and a strong damper behind a delay shakes the hand by itself, so
//! `α` is bounded. What damping cannot balance any more, the force pays: it fades with the deficit and is gone at
//! `deficit_max`. Unlike damping that needs no velocity, so it works at rest and at any delay. The observer itself
//! forgives nothing: what it reports is what happened.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::spatial::{Twist, Wrench};

/// Parameters of the passivity controller.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PassivityConfig {
    /// Whether damping is injected; the observer runs either way.
    pub enabled: bool,
    /// Most damping \[N·s/m\]; well below `m/ΔT` of the device, or the damper itself oscillates.
    pub damping_max: f64,
    /// Deficit at which no force is left \[J\].
    pub deficit_max: f64,
    /// Time constant with which a deficit is forgiven \[s\]: a force that has faded must come back, or the
    /// hand sinks through the wall for good. The scene's mean power into the hand stays below
    /// `deficit_max / forgiving_secs`.
    pub forgiving_secs: f64,
    /// Apparent mass of the device \[kg\]: how fast an unopposed force changes the velocity.
    pub apparent_mass: f64,
    /// Most energy that the observer remembers \[J\]. Energy long lost to friction must not license an
    /// oscillation later; a wall's spring holds 11 mJ at 3.3 N and 500 N/m.
    pub storage_max: f64,
}

impl Default for PassivityConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            damping_max: 11.0,
            deficit_max: 0.005,
            forgiving_secs: 0.1,
            apparent_mass: 0.045,
            storage_max: 0.02,
        }
    }
}

/// Energy that went through the port between hand and scene.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EnergyObserver {
    /// Energy that the scene took from the hand and has not returned \[J\]; a passive scene never makes it
    /// negative.
    pub energy: f64,
    /// Smallest value so far \[J\].
    pub energy_min: f64,
}

impl EnergyObserver {
    /// The hand moved by `displacement` (translation \[m\] and rotation vector \[rad\]) under `on_hand`.
    pub fn exchange(&mut self, on_hand: &Wrench, displacement: &Twist) {
        let given_to_hand = on_hand.power(displacement);
        if given_to_hand.is_finite() {
            self.energy -= given_to_hand;
            self.energy_min = self.energy_min.min(self.energy);
        }
    }
}

/// What the controller did in one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Passivated {
    /// The force to render \[N\].
    pub force: Vector3<f64>,
    /// Damping injected \[N·s/m\].
    pub damping: f64,
    /// Power that it takes out \[W\].
    pub power: f64,
}

/// Time-domain passivity controller with its observer. All quantities in the device's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PassivityController {
    config: PassivityConfig,
    observer: EnergyObserver,
    /// Energy taken out so far \[J\].
    dissipated: f64,
    /// The balance that decides \[J\]: the observer's, with deficits slowly forgiven.
    account: f64,
    /// The force of the tick before: on its way to the hand, and not yet observed \[N\].
    pending: Vector3<f64>,
}

impl PassivityController {
    /// Starts without stored energy.
    pub fn new(config: PassivityConfig) -> Self {
        Self { config, ..Self::default() }
    }
    /// Continues with what an earlier one had observed; numbers that are not finite count as zero.
    #[must_use]
    pub fn resumed(config: PassivityConfig, energy: f64, energy_min: f64, dissipated: f64) -> Self {
        let sane = |x: f64| if x.is_finite() { x } else { 0.0 };
        let observer =
            EnergyObserver { energy: sane(energy), energy_min: sane(energy_min).min(sane(energy)) };
        Self {
            config,
            observer,
            dissipated: sane(dissipated),
            account: observer.energy,
            pending: Vector3::zeros(),
        }
    }
    /// The observer.
    pub fn observer(&self) -> &EnergyObserver {
        &self.observer
    }
    /// Energy taken out so far \[J\].
    pub fn dissipated(&self) -> f64 {
        self.dissipated
    }

    /// Energy that the scene may still give back \[J\]; negative in deficit.
    pub fn available(&self) -> f64 {
        self.account
    }

    /// Accounts for the interval that just ended: `applied` acted on the hand while it moved by
    /// `displacement`.
    pub fn observe(&mut self, applied: &Wrench, displacement: &Twist) {
        let before = self.observer.energy;
        self.observer.exchange(applied, displacement);
        self.account = (self.account + self.observer.energy - before).min(self.config.storage_max);
        self.observer.energy = self.observer.energy.min(self.config.storage_max);
    }

    /// Makes `wanted` \[N\] passive for an interval of `dt` \[s\] that begins at `velocity` \[m/s\].
    pub fn passivate(&mut self, wanted: &Vector3<f64>, velocity: &Vector3<f64>, dt: f64) -> Passivated {
        if self.account < 0.0 {
            self.account /= 1.0 + dt / self.config.forgiving_secs;
        }
        let passivated = self.damp(wanted, velocity, dt);
        self.dissipated += passivated.power * dt;
        self.pending = passivated.force;
        passivated
    }

    fn damp(&self, wanted: &Vector3<f64>, velocity: &Vector3<f64>, dt: f64) -> Passivated {
        if !self.config.enabled {
            return Passivated { force: *wanted, ..Passivated::default() };
        }
        let share = (1.0 + self.account / self.config.deficit_max).clamp(0.0, 1.0);
        let force = wanted * share;
        let unchanged = Passivated { force, ..Passivated::default() };
        let speed_squared = velocity.norm_squared();
        if speed_squared < 1e-12 {
            return unchanged;
        }
        let delivered = force.dot(velocity);
        // A driver renders this force one step later; until then the one before acts.
        let on_its_way = self.pending.dot(velocity).max(0.0);
        // The velocity changes meanwhile by about f ΔT/m, and with it what a push delivers. A force that
        // opposes the motion needs no such reserve.
        let reserve =
            if delivered > 0.0 { force.norm_squared() * dt * dt / self.config.apparent_mass } else { 0.0 };
        let left = self.account - (delivered + on_its_way) * dt - reserve;
        if left >= 0.0 {
            return unchanged;
        }
        let damping = (-left / (dt * speed_squared)).min(self.config.damping_max);
        Passivated { force: force - velocity * damping, damping, power: damping * speed_squared }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 1e-3;

    /// A mass in the hand of a 1-DOF environment `force(x, v)`, stepped finely under a held force.
    fn run(enabled: bool, environment: impl Fn(f64, f64) -> f64, seconds: f64) -> (PassivityController, f64) {
        let config = PassivityConfig { enabled, ..PassivityConfig::default() };
        let mut controller = PassivityController::new(config);
        let (mass, viscous) = (config.apparent_mass, 0.05);
        // From the relaxed spring: what is stored at the start would come out unpaid.
        let (mut x, mut v, mut force) = (0.0f64, 0.08f64, 0.0f64);
        let mut peak = 0.0f64;
        for _ in 0..(seconds / DT) as usize {
            let before = x;
            for _ in 0..20 {
                v += (force - viscous * v) / mass * DT / 20.0;
                x += v * DT / 20.0;
            }
            let applied = Wrench::new(Vector3::new(force, 0.0, 0.0), Vector3::zeros());
            controller.observe(&applied, &Twist::new(Vector3::new(x - before, 0.0, 0.0), Vector3::zeros()));
            let wanted = Vector3::new(environment(x, v).clamp(-3.3, 3.3), 0.0, 0.0);
            force = controller.passivate(&wanted, &Vector3::new(v, 0.0, 0.0), DT).force.x;
            peak = peak.max(x.abs());
        }
        (controller, peak)
    }

    #[test]
    fn an_active_environment_becomes_passive() {
        // Negative damping pumps the spring; on its own it diverges against the force limit.
        let active = |x: f64, v: f64| -300.0 * x + 1.5 * v;
        let (free, peak_free) = run(false, active, 3.0);
        assert!(free.observer().energy < -0.01, "must be active without control: {}", free.observer().energy);
        let (tamed, peak) = run(true, active, 3.0);
        assert!(tamed.observer().energy_min >= -1e-6, "energy {}", tamed.observer().energy_min);
        assert!(peak < 0.0025 && peak_free > 2.0 * peak, "{peak} {peak_free}");
        assert!(tamed.dissipated() > 0.0);
    }

    #[test]
    fn a_passive_environment_is_left_alone() {
        let (controller, _) = run(true, |x, v| -200.0 * x - 1.0 * v, 3.0);
        assert_eq!(controller.dissipated(), 0.0);
        assert!(controller.observer().energy_min >= 0.0);
    }

    #[test]
    fn the_observer_books_the_work_of_a_held_force() {
        let mut observer = EnergyObserver::default();
        let push = Wrench::new(Vector3::new(0.0, 2.0, 0.0), Vector3::new(0.0, 0.0, 0.1));
        observer.exchange(&push, &Twist::new(Vector3::new(0.0, -0.01, 0.0), Vector3::new(0.0, 0.0, -0.2)));
        assert!((observer.energy - 0.04).abs() < 1e-15);
        observer.exchange(&push, &Twist::new(Vector3::new(f64::NAN, 0.0, 0.0), Vector3::zeros()));
        assert!((observer.energy - 0.04).abs() < 1e-15, "a NaN must not poison the sum");
    }

    #[test]
    fn old_surplus_is_forgotten_above_the_limit() {
        let mut controller = PassivityController::new(PassivityConfig::default());
        let drag = Wrench::new(Vector3::new(-1.0, 0.0, 0.0), Vector3::zeros());
        for _ in 0..1000 {
            controller.observe(&drag, &Twist::new(Vector3::new(1e-3, 0.0, 0.0), Vector3::zeros()));
        }
        assert_eq!(controller.observer().energy, PassivityConfig::default().storage_max);
        assert_eq!(controller.observer().energy_min, 0.0);
    }

    #[test]
    fn injected_damping_is_the_published_formula() {
        let config = PassivityConfig { forgiving_secs: f64::INFINITY, ..PassivityConfig::default() };
        let mut controller = PassivityController::new(config);
        let displaced = Twist::new(Vector3::new(1e-4, 0.0, 0.0), Vector3::zeros());
        controller.observe(&Wrench::new(Vector3::new(0.1, 0.0, 0.0), Vector3::zeros()), &displaced);
        let deficit = 1e-5;
        let velocity = Vector3::new(0.1, 0.0, 0.0);
        let out = controller.passivate(&Vector3::zeros(), &velocity, DT);
        let expected = deficit / (DT * 0.01);
        assert!((out.damping - expected).abs() < 1e-9, "{} {expected}", out.damping);
        assert!((out.force.x + expected * 0.1).abs() < 1e-12);
        assert!((controller.dissipated() - deficit).abs() < 1e-15);
    }

    #[test]
    fn a_deficit_fades_the_force_and_is_forgiven() {
        let mut controller = PassivityController::new(PassivityConfig::default());
        let displaced = Twist::new(Vector3::new(1e-3, 0.0, 0.0), Vector3::zeros());
        controller.observe(&Wrench::new(Vector3::new(2.5, 0.0, 0.0), Vector3::zeros()), &displaced);
        let mut felt = || controller.passivate(&Vector3::x(), &Vector3::zeros(), DT).force.x;
        let first = felt();
        assert!((first - 0.5).abs() < 0.01, "half of the allowed deficit leaves half of the force: {first}");
        let later = (0..1000).map(|_| felt()).last().unwrap();
        assert!(later > 0.99, "{later}");
        assert!((controller.observer().energy + 2.5e-3).abs() < 1e-15, "the observer forgets nothing");
    }

    #[test]
    fn resuming_keeps_the_balance_and_survives_garbage() {
        let resumed = PassivityController::resumed(PassivityConfig::default(), 0.003, -1e-5, 0.5);
        assert_eq!((resumed.observer().energy, resumed.dissipated()), (0.003, 0.5));
        let garbage = PassivityController::resumed(PassivityConfig::default(), f64::NAN, f64::INFINITY, 0.0);
        assert_eq!((garbage.observer().energy, garbage.observer().energy_min), (0.0, 0.0));
    }
}
