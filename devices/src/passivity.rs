//! Passivity controller of a device's port: the last limit on every force.
//!
//! It limits the energy given to the hand to the energy that the hand has put in (energy tank of Franken, Stramigioli,
//! Misra, Secchi and Macchelli, "Bilateral telemanipulation with time delays: a two-layer approach combining passivity
//! and transparency", 2011), as measured by the energy observer. The displacement under the next step's force `F` is
//! predictable, except for changes of the hand's force: with mass `m`,
//!
//! ```text
//! Δx(n+1) = 2 Δx(n) − Δx(n−1) + T²/2m · (F(n) − F(n−2)),
//! ```
//!
//! exactly, if the hand's own force stays constant. A heavier hand only reduces the last term. The force is therefore
//! scaled down until the available energy covers `F·Δx(n+1)` plus a reserve for a change of the hand's force. Its
//! direction stays, and it is never increased.
//!
//! A force scaled down once stays *limited* until the hand's energy covers all of it, or it ends: it is no greater than
//! that of a spring, of the device's greatest stiffness, that stores what is available, and of a damper against the
//! hand's motion. A hand that leans on a wall without having put in its energy thus sinks in until it has, and rests
//! there on a wall of full stiffness. Without this limit the force would depend on a reserve of microjoules, and
//! chatter.
//!
//! Energy is lent in two cases. A hand at rest takes no energy from any force, but this is known only a step later: a
//! small *capital* covers the reserve, and shrinks to zero while the hand moves along with the force. And a scene may
//! be active by design (moving tissue, a ring taken over from the other hand and lowered): a force that stays uncovered
//! for a while is lent a limited power, up to a limited force. Bounces and oscillations are too short for that. The
//! observer does not count loans: it reports the true energy.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::device::{Capabilities, Wrench};
use crate::energy_observer::{EnergyObserver, work};

/// Parameters of a [`PassivityController`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivityConfig {
    /// Assumed change of the hand's force and the device's friction within a step \[N\]: the reserve. The default
    /// covers a reversal of a friction of a quarter of a newton.
    pub jolt: f64,
    /// Energy \[J\] that covers the reserve for a hand at rest that has put in no energy yet.
    pub capital: f64,
    /// Speed along the force [m/s] at which the capital is zero.
    pub capital_speed: f64,
    /// Energy stored without decay \[J\]. Energy long lost to friction must not license an oscillation later; a wall's
    /// spring holds 11 mJ at 3.3 N and 500 N/m.
    pub storage: f64,
    /// Time constant with which energy above `storage` decays \[s\]. A wall hit with more than the device's greatest
    /// force takes up to 0.2 J, and returns it within a few tenths of a second.
    pub storage_secs: f64,
    /// How long a force must be uncovered before energy is lent \[s\], without a break or a reversal: longer than a
    /// bounce, and than half a period of a perceptible oscillation.
    pub lend_after_secs: f64,
    /// Largest lent power \[W\], reached after twice that time.
    pub lend_power: f64,
    /// Greatest force that lent energy supports \[N\]: a stronger force is a wall, and is not lent.
    pub lend_force: f64,
}

impl Default for PassivityConfig {
    fn default() -> Self {
        Self {
            jolt: 0.5,
            capital: 5e-5,
            capital_speed: 0.01,
            storage: 0.02,
            storage_secs: 1.0,
            lend_after_secs: 0.1,
            lend_power: 0.05,
            lend_force: 0.5,
        }
    }
}

/// Energy through a device's port, and the cost of passivity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PortEnergy {
    /// Net energy \[J\] put in by the hand, after decay; a passive scene never makes it negative.
    pub energy: f64,
    /// Smallest value so far \[J\].
    pub energy_min: f64,
    /// Energy that a force may give to the hand \[J\]: its own net energy plus loans.
    pub available: f64,
    /// Energy \[J\] withheld from the hand so far.
    pub dissipated: f64,
    /// Damping [N·s/m] equivalent to the force withheld now.
    pub damping: f64,
    /// Power \[W\] withheld now.
    pub power: f64,
}

/// Largest stable damping of a device, as a share of its mass per step: the delays of the loop and of the measured
/// velocity, together about three steps, reduce the apparent mass by damping times delay, and half of it must remain.
const DAMPING_SHARE: f64 = 0.15;
/// Shortest step \[s\] for this limit; a faster driver does not measure velocities faster.
const DAMPING_STEP_MIN: f64 = 1e-3;
/// Speed below which a damping is not computed [m/s].
const SPEED_MIN: f64 = 1e-3;

/// Energy observer and passivity controller of one port; time is passed in, it reads no clock. All vectors are in the
/// device's frame.
#[derive(Clone, Debug)]
pub struct PassivityController {
    config: PassivityConfig,
    mass: f64,
    stiffness: f64,
    observer: EnergyObserver,
    port: PortEnergy,
    lent: f64,
    short: bool,
    /// How long the force has been uncovered, and the commanded wrench when that began.
    uncovered_secs: f64,
    uncovered: Wrench,
}

impl PassivityController {
    /// A controller without stored energy, for a device with these capabilities.
    pub fn new(config: PassivityConfig, capabilities: &Capabilities) -> Self {
        let Capabilities { apparent_mass, max_stiffness, .. } = *capabilities;
        Self {
            config,
            // Underestimates of mass and stiffness are safe; NaN counts as the minimum.
            mass: if apparent_mass > 1e-3 { apparent_mass } else { 1e-3 },
            stiffness: if max_stiffness > 1.0 { max_stiffness.min(1e6) } else { 1.0 },
            observer: EnergyObserver::new(config.storage, config.storage_secs),
            port: PortEnergy::default(),
            lent: 0.0,
            short: false,
            uncovered_secs: 0.0,
            uncovered: Wrench::ZERO,
        }
    }

    /// Energy through the port so far.
    pub fn port(&self) -> &PortEnergy {
        &self.port
    }

    /// Continues at `now_ns` with another controller's energy, and with the wrench held by the motors.
    pub(crate) fn resume(&mut self, now_ns: u64, account: &PortEnergy, applied: &Wrench) {
        self.observer.resume(now_ns, account.energy, account.energy_min, account.dissipated, applied);
        self.port = *account;
        self.lent = (account.available - account.energy).max(0.0);
        self.lend(0.0);
    }

    /// Takes a reading: adds the work that the wrenches since the last one exchanged with the hand.
    pub fn observe(&mut self, now_ns: u64, pose_in_device: &Isometry3<f64>) {
        self.observer.observe(now_ns, pose_in_device);
        (self.port.energy, self.port.energy_min) = self.observer.energy();
        self.port.dissipated = self.observer.withheld_energy();
        self.lend(0.0);
    }

    /// Discards the motion after a long time without readings: the next reading starts a new interval.
    pub fn interrupt(&mut self) {
        self.observer.interrupt();
        self.covered();
    }

    /// Sets the wrench that the motors hold from now on, and the withheld part.
    pub fn hold(&mut self, now_ns: u64, applied: &Wrench, withheld: &Wrench) {
        self.observer.hold(now_ns, applied, withheld);
        let velocity = self.observer.motion()[0].linear_velocity;
        let speed_squared = velocity.norm_squared();
        self.port.power = withheld.force.dot(&velocity).max(0.0);
        self.port.damping =
            if speed_squared > SPEED_MIN * SPEED_MIN { self.port.power / speed_squared } else { 0.0 };
    }

    /// The share of `wanted`, 0 to 1, that may be rendered over the next step.
    pub fn share(&mut self, now_ns: u64, wanted: &Wrench) -> f64 {
        let cost = self.cost(wanted, now_ns);
        let force = wanted.force.norm();
        let stored = force * force / (2.0 * self.stiffness);
        self.short = cost.of(1.0) > self.budget(&cost) || (self.short && stored > self.port.available);
        if !self.short {
            self.covered();
            return 1.0;
        }
        let part = if force > self.config.lend_force { self.config.lend_force / force } else { 1.0 };
        let missing = (cost.of(part) - self.budget(&cost)).max(stored * part * part - self.port.available);
        self.consider_lending(wanted, missing);
        let spring = (2.0 * self.stiffness * self.port.available.max(0.0)).sqrt();
        let bearable = DAMPING_SHARE * self.mass / self.observer.step_secs().max(DAMPING_STEP_MIN);
        let damper = bearable * (-cost.speed_along).max(0.0);
        let by_spring = if force > 0.0 { (spring + damper) / force } else { 1.0 };
        cost.share(self.budget(&cost)).min(by_spring)
    }

    /// Energy that a force may give to the hand \[J\].
    fn budget(&self, cost: &Cost) -> f64 {
        let still = (1.0 - cost.speed_along / self.config.capital_speed.max(1e-9)).clamp(0.0, 1.0);
        self.port.available + if self.short { 0.0 } else { self.config.capital * still }
    }

    fn cost(&self, wanted: &Wrench, now_ns: u64) -> Cost {
        let [last, before] = self.observer.motion();
        let secs = self.observer.step_secs();
        let unread_secs = self.observer.unread_secs(now_ns);
        // Time from the middle of an interval to that of the next, in steps; 1 when all are equally long.
        let (known, coming) = (last.secs + before.secs, secs + last.secs + unread_secs);
        let step = if known > 0.0 { (coming / known).min(2.0) } else { 0.0 };
        let ahead = |last: &Vector3<f64>, before: &Vector3<f64>| last + (last - before) * step;
        let linear = ahead(&last.linear_velocity, &before.linear_velocity);
        let angular = ahead(&last.angular_velocity, &before.angular_velocity);
        let force = wanted.force.norm();
        let yielding = secs * secs / self.mass;
        Cost {
            motion: work(wanted, &linear, &angular) * (secs + unread_secs)
                + force * self.config.jolt * yielding,
            push: 0.5 * yielding * force * force,
            pushed: 0.5 * yielding * wanted.force.dot(&before.force),
            speed_along: if force > 0.0 { wanted.force.dot(&linear) / force } else { 0.0 },
        }
    }

    /// Raises the available energy by `joules`. Energy of the hand beyond `storage` repays the loan.
    fn lend(&mut self, joules: f64) {
        self.lent = (self.lent + joules).min(self.config.storage - self.port.energy).max(0.0);
        self.port.available = self.port.energy + self.lent;
    }

    /// Lends part of the `missing` energy \[J\], if it has been missing for long enough.
    fn consider_lending(&mut self, wanted: &Wrench, missing: f64) {
        // A reversing force is an oscillation, which gets no loan.
        if missing <= 0.0 || work(&self.uncovered, &wanted.force, &wanted.torque) < 0.0 {
            return self.covered();
        }
        if self.uncovered_secs == 0.0 {
            self.uncovered = *wanted;
        }
        let secs = self.observer.step_secs();
        self.uncovered_secs += secs;
        let haste = (self.uncovered_secs / self.config.lend_after_secs.max(1e-6) - 1.0).clamp(0.0, 1.0);
        self.lend(missing.min(haste * self.config.lend_power * secs));
    }

    fn covered(&mut self) {
        self.uncovered = Wrench::ZERO;
        self.uncovered_secs = 0.0;
    }
}

/// Energy that a share `s` of the wanted wrench will give to the hand at most:
/// `s·motion + max(0, s²·push − s·pushed)`, convex in `s` and zero for none. \[J\]
#[derive(Clone, Copy, Debug)]
struct Cost {
    /// Energy by the motion that the hand already has, with the reserve.
    motion: f64,
    /// Energy by the motion that the force itself causes.
    push: f64,
    /// Part of that already caused by an equal force, and contained in `motion`.
    pushed: f64,
    /// Speed of the hand along the force [m/s].
    speed_along: f64,
}

impl Cost {
    fn of(&self, share: f64) -> f64 {
        share * self.motion + (share * (share * self.push - self.pushed)).max(0.0)
    }

    /// The largest share that costs no more than `budget`; with a negative budget, the one that takes most energy from
    /// the hand.
    fn share(&self, budget: f64) -> f64 {
        let Self { motion, push, pushed, .. } = *self;
        let share = if budget < 0.0 {
            if motion >= 0.0 || push <= 0.0 {
                0.0
            } else {
                (pushed / push).max((pushed - motion) / (2.0 * push))
            }
        } else {
            let by_motion = if motion > 0.0 { budget / motion } else { 1.0 };
            let slope = motion - pushed;
            let by_push = if push > 0.0 {
                ((slope * slope + 4.0 * push * budget).sqrt() - slope) / (2.0 * push)
            } else {
                1.0
            };
            by_motion.min(by_push)
        };
        // `clamp` would keep a NaN.
        if share > 0.0 { share.min(1.0) } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Dofs, Workspace};

    const MS: u64 = 1_000_000;

    fn capabilities() -> Capabilities {
        Capabilities {
            name: "bench".into(),
            workspace: Workspace::centred(Vector3::repeat(0.1)),
            max_force_newtons: 3.3,
            max_torque: 0.2,
            max_stiffness: 1000.0,
            input_dofs: Dofs::Six,
            output_dofs: Dofs::Six,
            apparent_mass: 0.045,
        }
    }

    fn at(x: f64) -> Isometry3<f64> {
        Isometry3::translation(x, 0.0, 0.0)
    }

    fn push(newtons: f64) -> Wrench {
        Wrench::from_force(Vector3::new(newtons, 0.0, 0.0))
    }

    /// A port at a hand that follows `x(ms)` regardless of force.
    struct Led {
        port: PassivityController,
        now_ns: u64,
    }

    impl Led {
        fn new() -> Self {
            Self { port: PassivityController::new(PassivityConfig::default(), &capabilities()), now_ns: 0 }
        }
        fn step(&mut self, x: f64, newtons: f64) -> f64 {
            self.port.observe(self.now_ns, &at(x));
            let wanted = push(newtons);
            let share = self.port.share(self.now_ns, &wanted);
            self.port.hold(self.now_ns, &(wanted * share), &(wanted * (1.0 - share)));
            self.now_ns += MS;
            newtons * share
        }
    }

    #[test]
    fn a_force_on_a_hand_at_rest_is_left_alone() {
        let mut led = Led::new();
        for ms in 0..100 {
            let wanted = 3.3 * f64::from(ms.min(50)) / 50.0;
            assert_eq!(led.step(0.0, wanted), wanted, "{ms} ms");
        }
        assert_eq!(led.port.port().energy_min, 0.0);
    }

    #[test]
    fn a_passive_wall_is_left_alone_however_it_is_pressed() {
        let mut led = Led::new();
        for ms in 0..4000 {
            let phase = f64::from(ms) * 1e-3 * 8.0;
            let (depth, speed) = (0.003 * (1.0 - phase.cos()), 0.003 * 8.0 * phase.sin());
            let wanted = 800.0 * depth + 4.0 * speed;
            assert!((led.step(-depth, wanted) - wanted).abs() < 1e-12, "{ms} ms: {:?}", led.port);
        }
        assert_eq!((led.port.port().energy_min, led.port.port().dissipated), (0.0, 0.0));
    }

    #[test]
    fn a_force_that_follows_the_hand_is_kept_back_and_then_lent() {
        let mut led = Led::new();
        // A weight of 0.3 N that the hand did not lift, lowered at 0.1 m/s.
        let felt: Vec<f64> = (0..400).map(|ms| led.step(f64::from(ms) * 1e-4, 0.3)).collect();
        assert!(felt[10..90].iter().all(|force| *force < 1e-9), "{:?}", &felt[..20]);
        assert!(felt[300..].iter().all(|force| (force - 0.3).abs() < 1e-9), "{:?}", &felt[90..]);
        let port = *led.port.port();
        // The observer does not count what was lent.
        assert!(port.energy < -3e-3 && port.energy > -0.3 * 0.04 && port.dissipated > 2e-3, "{port:?}");
        // At most half a newton and 50 mW are lent.
        let mut strong = Led::new();
        // A motion is known only after two steps.
        let most = (0..2000).map(|ms| strong.step(f64::from(ms) * 1e-4, 3.0)).skip(2).fold(0.0, f64::max);
        assert!(most <= 0.5 + 1e-9, "{most}");
    }

    #[test]
    fn an_oscillation_is_lent_nothing() {
        let mut led = Led::new();
        for ms in 0..5000 {
            // Negative damping at 10 Hz.
            let phase = f64::from(ms) * 1e-3 * 62.8;
            led.step(0.001 * phase.sin(), 2.0 * 0.0628 * phase.cos());
        }
        let port = led.port.port();
        assert!(port.energy_min >= -PassivityConfig::default().capital, "{port:?}");
        assert!(port.dissipated > 0.0, "{port:?}");
    }

    #[test]
    fn old_surplus_is_forgotten_above_what_is_remembered_for_good() {
        let mut led = Led::new();
        for ms in 0..200 {
            led.step(f64::from(ms) * 1e-3, -1.0);
        }
        assert!(led.port.port().energy > 0.1, "a deep wall gives back what it took");
        for _ in 0..10_000 {
            led.step(0.2, -1.0);
        }
        let storage = PassivityConfig::default().storage;
        assert!((led.port.port().energy - storage).abs() < 1e-4, "{:?}", led.port.port());
    }

    #[test]
    fn the_share_solves_what_it_costs() {
        for (motion, push, pushed) in
            [(1e-4, 1e-5, 0.0), (-1e-5, 4e-5, 1e-5), (2e-5, 0.0, 0.0), (-1e-4, 1e-4, 3e-4)]
        {
            let cost = Cost { motion, push, pushed, speed_along: 0.0 };
            for budget in [0.0, 1e-7, 1e-5, 1e-3] {
                let share = cost.share(budget);
                assert!(
                    (0.0..=1.0).contains(&share) && cost.of(share) <= budget + 1e-15,
                    "{cost:?} {budget}"
                );
                assert!(
                    share == 1.0 || cost.of(share + 1e-6) > budget,
                    "{cost:?} {budget}: more was possible"
                );
            }
            let best = cost.share(-1.0);
            for other in 0..=100 {
                assert!(
                    cost.of(best) <= cost.of(f64::from(other) / 100.0) + 1e-15,
                    "{cost:?}: {best} {other}"
                );
            }
        }
    }

    #[test]
    fn numbers_that_are_none_do_not_poison_the_account() {
        let mut led = Led::new();
        led.step(0.0, 1.0);
        led.step(f64::NAN, 1.0);
        led.step(f64::INFINITY, f64::NAN);
        led.step(0.0, 1.0);
        let port = *led.port.port();
        assert!(
            port.energy.is_finite() && port.energy_min.is_finite() && port.available.is_finite(),
            "{port:?}"
        );
    }
}
