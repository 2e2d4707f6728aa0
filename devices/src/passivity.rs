//! Energy observer and passivity controller of a device's port: the last word on every force.
//!
//! The observer sums the energy that the hand put into the port, `W(n) = W(n−1) − f(n−1)·Δx(n)`, with the force
//! that the motors held over the interval and the displacement that it saw (Hannaford and Ryu, "Time-domain
//! passivity control of haptic interfaces", 2002). For a force that is held, that is exact (Ryu, Preusche,
//! Hannaford and Hirzinger, "Time domain passivity control with reference energy following", 2005), but only
//! where the force is finally decided: above the driver, limits and delays stand between the force that was asked
//! for and the one that is felt.
//!
//! The controller renders no force that would give the hand more than it has paid (the energy tank of Franken,
//! Stramigioli, Misra, Secchi and Macchelli, "Bilateral telemanipulation with time delays: a two-layer approach
//! combining passivity and transparency", 2011). Whatever the force `F` of the next interval is, its displacement is
//! known but for what the hand does within one step: with a constant force of the hand and mass `m`,
//!
//! ```text
//! Δx(n+1) = 2 Δx(n) − Δx(n−1) + T²/2m · (F(n) − F(n−2)),
//! ```
//!
//! exactly. A heavier hand only makes the last term smaller. So the force is shortened until `F·Δx(n+1)`, with a
//! reserve for what the hand may do meanwhile, is covered. It is never turned and never grows: no damper
//! behind a delay, which would shake the hand itself.
//!
//! Two things are lent. A hand at rest takes no energy from any force, but to know that takes a step: a small
//! *capital* covers the reserve, and shrinks to nothing while the hand moves along with the force. And a scene may be
//! active by intention (tissue that moves, a ring taken over from the other hand and lowered): a force that stays
//! uncovered for a while without a break is lent a limited power. A bounce or an oscillation is over before. The
//! observer forgives nothing of that: what it reports is what happened.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};

use crate::device::{Capabilities, Wrench};

/// How a [`PassivityController`] decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivityConfig {
    /// By how much the force of the hand and the friction of the device may change within a step \[N\]: the
    /// reserve. The default covers friction of a quarter of a newton that turns round.
    pub jolt: f64,
    /// Energy \[J\] that covers the reserve of a hand at rest which has not paid yet.
    pub capital: f64,
    /// Speed along the force [m/s] from which no capital is left.
    pub capital_speed: f64,
    /// Energy that is remembered for good \[J\]. Energy long lost to friction must not license an oscillation
    /// later; a wall's spring holds 11 mJ at 3.3 N and 500 N/m.
    pub storage: f64,
    /// Time constant with which energy above `storage` is forgotten \[s\]. A wall that was met with more than the
    /// device's greatest force takes up to 0.2 J, and gives it back within a few tenths of a second.
    pub storage_secs: f64,
    /// For how long a force must be uncovered, without a break and without turning round, until energy is lent \[s\]; longer than a
    /// bounce, and than half a period of anything that a hand would call an oscillation.
    pub lend_after_secs: f64,
    /// Most power that is lent \[W\], reached after twice that time.
    pub lend_power: f64,
    /// Greatest force that lent energy carries \[N\]: what pushes harder is a wall, and has to be paid.
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

/// What went through a device's port, and what passivity cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PortEnergy {
    /// Energy \[J\] that the hand put in and did not get back, as far as it is remembered; a passive scene never makes
    /// it negative.
    pub energy: f64,
    /// Smallest value so far \[J\].
    pub energy_min: f64,
    /// Energy that a force may give to the hand \[J\]: what the hand paid, and what was lent.
    pub available: f64,
    /// Energy \[J\] that passivity kept from the hand so far.
    pub dissipated: f64,
    /// Damping [N·s/m] to which the force amounts that is kept back now.
    pub damping: f64,
    /// Power \[W\] that is kept back now.
    pub power: f64,
}

/// Longest interval \[s\] for which motion is extrapolated.
const INTERVAL_MAX: f64 = 5e-3;
/// Damping that a device bears, as a share of its mass per step: most of what the delay and the measured velocity
/// leave.
const DAMPING_SHARE: f64 = 0.15;
/// Speed below which a damping would be meaningless [m/s].
const SPEED_MIN: f64 = 1e-3;

/// How the handle moved in one interval between two readings.
#[derive(Clone, Copy, Debug, Default)]
struct Motion {
    secs: f64,
    linear_velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    /// Mean of the force over it \[N\].
    force: Vector3<f64>,
}

/// A wrench that is held, and its integral since the last reading.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    wrench: Wrench,
    /// What was wanted and not rendered.
    withheld: Wrench,
    /// [N·s] and [N·m·s].
    impulse: Wrench,
    withheld_impulse: Wrench,
    secs: f64,
    counted_to_ns: u64,
}

impl Held {
    fn count_to(&mut self, now_ns: u64) {
        let secs = now_ns.saturating_sub(self.counted_to_ns) as f64 * 1e-9;
        add(&mut self.impulse, &self.wrench, secs);
        add(&mut self.withheld_impulse, &self.withheld, secs);
        self.secs += secs;
        self.counted_to_ns = now_ns;
    }
}

fn add(sum: &mut Wrench, wrench: &Wrench, factor: f64) {
    sum.force += wrench.force * factor;
    sum.torque += wrench.torque * factor;
}

fn work(wrench: &Wrench, translation: &Vector3<f64>, rotation: &Vector3<f64>) -> f64 {
    wrench.force.dot(translation) + wrench.torque.dot(rotation)
}

/// Energy observer and passivity controller of one port; stepped with time, reads no clock. Everything in the
/// device's frame.
#[derive(Clone, Debug)]
pub struct PassivityController {
    config: PassivityConfig,
    mass: f64,
    /// Stiffness of the spring that a short force is taken to come from [N/m].
    spring: f64,
    port: PortEnergy,
    lent: f64,
    uncovered_secs: f64,
    /// What was wanted when that began.
    uncovered: Wrench,
    /// Since a force was not covered: no more than a spring would push that had stored what is available.
    short: bool,
    last_reading: Option<(u64, Isometry3<f64>)>,
    /// The last interval, and the one before.
    motion: [Motion; 2],
    held: Held,
    held_at_ns: u64,
    step_secs: f64,
}

impl PassivityController {
    /// Without stored energy, for a device with these capabilities.
    pub fn new(config: PassivityConfig, capabilities: &Capabilities) -> Self {
        let mass = capabilities.apparent_mass;
        Self {
            config,
            // Too light is on the safe side; a NaN is taken as very light.
            mass: if mass > 1e-3 { mass } else { 1e-3 },
            spring: finite(capabilities.max_stiffness).max(1.0),
            port: PortEnergy::default(),
            lent: 0.0,
            uncovered_secs: 0.0,
            uncovered: Wrench::ZERO,
            short: false,
            last_reading: None,
            motion: [Motion::default(); 2],
            held: Held::default(),
            held_at_ns: 0,
            step_secs: 0.0,
        }
    }

    /// What went through the port so far.
    pub fn port(&self) -> &PortEnergy {
        &self.port
    }

    /// Takes a reading: books what the wrenches since the last one gave to the hand or took from it.
    pub fn observe(&mut self, now_ns: u64, pose_in_device: &Isometry3<f64>) {
        self.held.count_to(now_ns);
        let secs = self.held.secs;
        if let Some((_, before)) = &self.last_reading
            && secs > 0.0
        {
            let translation = pose_in_device.translation.vector - before.translation.vector;
            let rotation = rotation_vector(pose_in_device, before);
            let mean =
                |impulse: &Wrench| Wrench { force: impulse.force / secs, torque: impulse.torque / secs };
            let (wrench, withheld) = (mean(&self.held.impulse), mean(&self.held.withheld_impulse));
            self.book(work(&wrench, &translation, &rotation), secs);
            self.port.dissipated += finite(work(&withheld, &translation, &rotation)).max(0.0);
            let motion = Motion {
                secs,
                linear_velocity: translation / secs,
                angular_velocity: rotation / secs,
                force: wrench.force,
            };
            self.motion = [motion, self.motion[0]];
        }
        if secs > 0.0 || self.last_reading.is_none() {
            let Held { wrench, withheld, counted_to_ns, .. } = self.held;
            self.held = Held { wrench, withheld, counted_to_ns, ..Held::default() };
            self.last_reading = Some((now_ns, *pose_in_device));
        }
    }

    /// Forgets how the handle moved: there was no reading for so long that the next one continues nothing.
    pub fn interrupt(&mut self) {
        self.last_reading = None;
        self.motion = [Motion::default(); 2];
        self.uncovered_secs = 0.0;
    }

    fn book(&mut self, given_to_hand: f64, secs: f64) {
        let energy = self.port.energy - finite(given_to_hand);
        let above = (energy - self.config.storage).max(0.0);
        self.port.energy = energy - above * (secs / self.config.storage_secs.max(1e-6)).min(1.0);
        self.port.energy_min = self.port.energy_min.min(self.port.energy);
        self.lend(0.0);
    }

    /// Raises what is available by `joules`. What the hand pays beyond `storage` pays the loan back.
    fn lend(&mut self, joules: f64) {
        self.lent = (self.lent + joules).min(self.config.storage - self.port.energy).max(0.0);
        self.port.available = self.port.energy + self.lent;
    }

    /// The share of `wanted`, 0 to 1, that may be rendered over the next interval.
    pub fn share(&mut self, now_ns: u64, wanted: &Wrench) -> f64 {
        let secs = self.step_secs;
        let cost = self.cost(wanted, now_ns);
        let force = wanted.force.norm();
        // What a spring holds that pushes as much.
        let stored = force * force / (2.0 * self.spring);
        self.short = cost.of(1.0) > self.budget(&cost) || (self.short && stored > self.port.available);
        if !self.short {
            self.uncovered = Wrench::ZERO;
            self.uncovered_secs = 0.0;
            return 1.0;
        }
        // Lent energy carries a small force only.
        let part = if force > self.config.lend_force { self.config.lend_force / force } else { 1.0 };
        let missing = (cost.of(part) - self.budget(&cost)).max(stored * part * part - self.port.available);
        // What turns round swings, and swinging is lent nothing.
        let turned = work(&self.uncovered, &wanted.force, &wanted.torque) < 0.0;
        if missing > 0.0 && !turned {
            if self.uncovered_secs == 0.0 {
                self.uncovered = *wanted;
            }
            self.uncovered_secs += secs;
            let haste = (self.uncovered_secs / self.config.lend_after_secs.max(1e-6) - 1.0).clamp(0.0, 1.0);
            self.lend(missing.min(haste * self.config.lend_power * secs));
        } else {
            self.uncovered = Wrench::ZERO;
            self.uncovered_secs = 0.0;
        }
        let spring = (2.0 * self.spring * self.port.available.max(0.0)).sqrt();
        let damper = DAMPING_SHARE * self.mass / secs.max(1e-3) * (-cost.speed_along).max(0.0);
        cost.share(self.budget(&cost)).min((spring + damper) / force.max(1e-9))
    }

    fn budget(&self, cost: &Cost) -> f64 {
        if self.short {
            return self.port.available;
        }
        let still = (1.0 - cost.speed_along / self.config.capital_speed.max(1e-9)).clamp(0.0, 1.0);
        self.port.available + self.config.capital * still
    }

    fn cost(&self, wanted: &Wrench, now_ns: u64) -> Cost {
        let [last, before] = &self.motion;
        let secs = self.step_secs;
        // What was held since the last reading is not booked yet.
        let read_at_ns = self.last_reading.map_or(now_ns, |(at_ns, _)| at_ns);
        let unread_secs = (now_ns.saturating_sub(read_at_ns) as f64 * 1e-9).min(INTERVAL_MAX);
        // From the middle of an interval to that of the next; 1 when all are equally long.
        let (known, coming) = (last.secs + before.secs, secs + last.secs + unread_secs);
        let step = if known > 0.0 { (coming / known).min(2.0) } else { 0.0 };
        let ahead = |last: &Vector3<f64>, before: &Vector3<f64>| last + (last - before) * step;
        let linear = ahead(&last.linear_velocity, &before.linear_velocity);
        let angular = ahead(&last.angular_velocity, &before.angular_velocity);
        let force = wanted.force.norm();
        let yielding = secs * secs / self.mass;
        let power = work(wanted, &linear, &angular);
        Cost {
            motion: power * (secs + unread_secs) + force * self.config.jolt * yielding,
            push: 0.5 * yielding * force * force,
            pushed: 0.5 * yielding * wanted.force.dot(&before.force),
            speed_along: if force > 0.0 { wanted.force.dot(&linear) / force } else { 0.0 },
        }
    }

    /// What the motors hold from now on, and what of it was kept back.
    pub fn hold(&mut self, now_ns: u64, applied: &Wrench, withheld: &Wrench) {
        let elapsed_ns = now_ns.saturating_sub(self.held_at_ns);
        self.held_at_ns = now_ns;
        // The next step is taken to be as long as this one.
        self.step_secs = (elapsed_ns as f64 * 1e-9).min(INTERVAL_MAX);
        self.held.count_to(now_ns);
        self.held.wrench = *applied;
        self.held.withheld = *withheld;
        let [Motion { linear_velocity, .. }, _] = &self.motion;
        let power = withheld.force.dot(linear_velocity).max(0.0);
        let speed_squared = linear_velocity.norm_squared();
        self.port.power = power;
        self.port.damping = if speed_squared > SPEED_MIN * SPEED_MIN { power / speed_squared } else { 0.0 };
    }
}

/// Energy that a share `s` of the wanted wrench will give to the hand at most:
/// `s·motion + max(0, s²·push − s·pushed)`, convex in `s` and zero for none. \[J\]
#[derive(Clone, Copy, Debug)]
struct Cost {
    /// By the motion that the hand has anyway, with the reserve.
    motion: f64,
    /// By the motion that the force itself makes.
    push: f64,
    /// How much of that an equal force made already, and `motion` holds.
    pushed: f64,
    /// Speed of the hand along the force [m/s].
    speed_along: f64,
}

impl Cost {
    fn of(&self, share: f64) -> f64 {
        share * self.motion + (share * (share * self.push - self.pushed)).max(0.0)
    }

    /// The largest share that costs no more than `budget`; with a debt, the one that takes most from the hand.
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
        share.max(0.0).min(1.0)
    }
}

/// Vector of the rotation between two poses \[rad\], for angles as small as one step's.
fn rotation_vector(to: &Isometry3<f64>, from: &Isometry3<f64>) -> Vector3<f64> {
    let turn = to.rotation.into_inner() * from.rotation.into_inner().conjugate();
    turn.imag() * if turn.w < 0.0 { -2.0 } else { 2.0 }
}

fn finite(value: f64) -> f64 {
    if value.is_finite() { value } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::device::{Dofs, Workspace};
    use nalgebra::UnitQuaternion;

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

    /// A port at a hand that is led along `x(ms)` whatever it feels.
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
    fn the_observer_books_the_work_of_what_was_held() {
        let mut port = Led::new().port;
        port.observe(0, &at(0.0));
        let torque = Vector3::new(0.0, 0.0, 0.1);
        port.hold(0, &Wrench { force: Vector3::new(2.0, 0.0, 0.0), torque }, &Wrench::ZERO);
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, -0.002));
        port.observe(MS, &Isometry3::from_parts(Vector3::new(-0.001, 0.0, 0.0).into(), turned));
        assert!((port.port().energy - 2.2e-3).abs() < 1e-9, "{:?}", port.port());
        // Two wrenches between two readings count by their times.
        port.hold(MS, &push(1.0), &Wrench::ZERO);
        port.hold(2 * MS, &push(-1.0), &Wrench::ZERO);
        port.observe(5 * MS, &Isometry3::from_parts(Vector3::new(0.003, 0.0, 0.0).into(), turned));
        assert!((port.port().energy - 4.2e-3).abs() < 1e-9, "{:?}", port.port());
        assert_eq!(port.port().energy_min, 0.0);
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
        // The observer forgives nothing of what was lent.
        assert!(port.energy < -3e-3 && port.energy > -0.3 * 0.04 && port.dissipated > 2e-3, "{port:?}");
        // At most half a newton and 50 mW are lent.
        let mut strong = Led::new();
        // Two steps pass until a motion is known.
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
