//! Energy observer of a device's port (time-domain passivity).
//!
//! Sums the energy that the hand put into the port, `W(n) = W(n−1) − f(n−1)·Δx(n)`, with the force held by the motors
//! over the interval and the displacement in it (Hannaford and Ryu, "Time-domain passivity control of haptic
//! interfaces", 2002). For a held force (zero-order hold) the sum is exact (Ryu, Preusche, Hannaford and Hirzinger,
//! "Time domain passivity control with reference energy following", 2005), but only at the driver: above it, limits and
//! delays separate the commanded force from the rendered one.

use nalgebra::{Isometry3, Vector3};

use crate::device::Wrench;

/// Longest step \[s\] used for prediction.
const STEP_MAX: f64 = 5e-3;

/// Motion of the handle between two readings.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Motion {
    pub secs: f64,
    pub linear_velocity: Vector3<f64>,
    pub angular_velocity: Vector3<f64>,
    /// Mean of the force over it \[N\].
    pub force: Vector3<f64>,
}

/// A held wrench, and its integral since the last reading.
#[derive(Clone, Copy, Debug, Default)]
struct Held {
    wrench: Wrench,
    /// [N·s] and [N·m·s].
    impulse: Wrench,
}

impl Held {
    fn count(&mut self, secs: f64) {
        self.impulse.force += self.wrench.force * secs;
        self.impulse.torque += self.wrench.torque * secs;
    }

    /// Takes the mean since the last reading, `secs` ago.
    fn take_mean(&mut self, secs: f64) -> Wrench {
        let impulse = std::mem::take(&mut self.impulse);
        Wrench { force: impulse.force / secs, torque: impulse.torque / secs }
    }
}

/// The energy observer; time is passed in, it reads no clock. All vectors are in the device's frame.
#[derive(Clone, Debug)]
pub(crate) struct EnergyObserver {
    storage: f64,
    storage_secs: f64,
    energy: f64,
    energy_min: f64,
    withheld_energy: f64,
    applied: Held,
    withheld: Held,
    /// Time since the last reading.
    unread_secs: f64,
    counted_to_ns: u64,
    held_at_ns: u64,
    step_secs: f64,
    last_pose: Option<Isometry3<f64>>,
    motion: [Motion; 2],
}

impl EnergyObserver {
    /// Stores up to `storage` \[J\] without loss; energy above it decays with the time constant `storage_secs` \[s\].
    pub fn new(storage: f64, storage_secs: f64) -> Self {
        Self {
            storage,
            storage_secs,
            energy: 0.0,
            energy_min: 0.0,
            withheld_energy: 0.0,
            applied: Held::default(),
            withheld: Held::default(),
            unread_secs: 0.0,
            counted_to_ns: 0,
            held_at_ns: 0,
            step_secs: 0.0,
            last_pose: None,
            motion: [Motion::default(); 2],
        }
    }

    /// Continues at `now_ns` with another observer's energy, and with the wrench held by the motors.
    pub fn resume(&mut self, now_ns: u64, energy: f64, energy_min: f64, withheld: f64, applied: &Wrench) {
        self.energy = finite(energy);
        self.energy_min = finite(energy_min);
        self.withheld_energy = finite(withheld);
        self.applied.wrench = *applied;
        self.counted_to_ns = now_ns;
        self.held_at_ns = now_ns;
    }

    /// Net energy put in by the hand \[J\], after decay, and its minimum so far.
    pub fn energy(&self) -> (f64, f64) {
        (self.energy, self.energy_min)
    }

    /// Energy that the withheld wrenches would have given to the hand \[J\].
    pub fn withheld_energy(&self) -> f64 {
        self.withheld_energy
    }

    /// The last interval between readings, and the one before.
    pub fn motion(&self) -> &[Motion; 2] {
        &self.motion
    }

    /// Length of the last step \[s\], used as the prediction of the next one.
    pub fn step_secs(&self) -> f64 {
        self.step_secs
    }

    /// Time since the last reading \[s\], whose work is not yet summed.
    pub fn unread_secs(&self, now_ns: u64) -> f64 {
        (self.unread_secs + self.uncounted_secs(now_ns)).min(STEP_MAX)
    }

    fn uncounted_secs(&self, now_ns: u64) -> f64 {
        now_ns.saturating_sub(self.counted_to_ns) as f64 * 1e-9
    }

    fn count_to(&mut self, now_ns: u64) {
        let secs = self.uncounted_secs(now_ns);
        self.applied.count(secs);
        self.withheld.count(secs);
        self.unread_secs += secs;
        self.counted_to_ns = now_ns;
    }

    /// Takes a reading: adds the work that the wrenches since the last one exchanged with the hand.
    pub fn observe(&mut self, now_ns: u64, pose_in_device: &Isometry3<f64>) {
        self.count_to(now_ns);
        let secs = self.unread_secs;
        if secs <= 0.0 && self.last_pose.is_some() {
            return;
        }
        let before = self.last_pose.replace(*pose_in_device);
        self.unread_secs = 0.0;
        let secs = if secs > 0.0 { secs } else { 1.0 };
        let (applied, withheld) = (self.applied.take_mean(secs), self.withheld.take_mean(secs));
        let Some(before) = before else { return };
        let translation = pose_in_device.translation.vector - before.translation.vector;
        let rotation = rotation_vector(pose_in_device, &before);
        let energy = self.energy - finite(work(&applied, &translation, &rotation));
        let above = (energy - self.storage).max(0.0);
        self.energy = energy - above * (secs / self.storage_secs.max(1e-6)).min(1.0);
        self.energy_min = self.energy_min.min(self.energy);
        self.withheld_energy += finite(work(&withheld, &translation, &rotation)).max(0.0);
        let motion = Motion {
            secs,
            linear_velocity: translation / secs,
            angular_velocity: rotation / secs,
            force: applied.force,
        };
        self.motion = [motion, self.motion[0]];
    }

    /// Sets the wrench that the motors hold from now on, and the withheld part.
    pub fn hold(&mut self, now_ns: u64, applied: &Wrench, withheld: &Wrench) {
        self.step_secs = (now_ns.saturating_sub(self.held_at_ns) as f64 * 1e-9).min(STEP_MAX);
        self.held_at_ns = now_ns;
        self.count_to(now_ns);
        self.applied.wrench = *applied;
        self.withheld.wrench = *withheld;
    }

    /// Discards the motion: the next reading starts a new interval.
    pub fn interrupt(&mut self) {
        self.last_pose = None;
        self.motion = [Motion::default(); 2];
    }
}

/// Work \[J\] of a wrench over a displacement, or power \[W\] at a velocity.
pub(crate) fn work(wrench: &Wrench, translation: &Vector3<f64>, rotation: &Vector3<f64>) -> f64 {
    wrench.force.dot(translation) + wrench.torque.dot(rotation)
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
    use nalgebra::UnitQuaternion;

    const MS: u64 = 1_000_000;

    fn push(newtons: f64) -> Wrench {
        Wrench::from_force(Vector3::new(newtons, 0.0, 0.0))
    }

    #[test]
    fn the_work_of_what_was_held_is_booked() {
        let mut observer = EnergyObserver::new(0.02, 1.0);
        observer.observe(0, &Isometry3::identity());
        let torque = Vector3::new(0.0, 0.0, 0.1);
        observer.hold(0, &Wrench { force: Vector3::new(2.0, 0.0, 0.0), torque }, &Wrench::ZERO);
        let turned = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, -0.002));
        let at = |x: f64| Isometry3::from_parts(Vector3::new(x, 0.0, 0.0).into(), turned);
        observer.observe(MS, &at(-0.001));
        assert!((observer.energy().0 - 2.2e-3).abs() < 1e-9, "{observer:?}");
        // Several wrenches between two readings are weighted by their durations.
        observer.hold(MS, &push(1.0), &push(0.5));
        observer.hold(2 * MS, &push(-1.0), &push(0.5));
        assert!((observer.unread_secs(4 * MS) - 3e-3).abs() < 1e-12);
        observer.observe(5 * MS, &at(0.003));
        assert!((observer.energy().0 - 4.2e-3).abs() < 1e-9, "{observer:?}");
        assert!((observer.withheld_energy() - 2e-3).abs() < 1e-9, "{observer:?}");
        assert_eq!(observer.energy().1, 0.0);
    }

    #[test]
    fn what_was_given_is_never_forgiven() {
        let mut observer = EnergyObserver::new(0.02, 1.0);
        observer.observe(0, &Isometry3::identity());
        observer.hold(0, &push(1.0), &Wrench::ZERO);
        observer.observe(MS, &Isometry3::translation(0.001, 0.0, 0.0));
        observer.hold(MS, &Wrench::ZERO, &Wrench::ZERO);
        for ms in 2..5_000 {
            observer.observe(ms * MS, &Isometry3::translation(0.001 * (ms % 7) as f64, 0.0, 0.0));
        }
        assert!((observer.energy().0 + 1e-3).abs() < 1e-12 && observer.energy().1 == observer.energy().0);
    }

    #[test]
    fn an_interruption_books_nothing() {
        let mut observer = EnergyObserver::new(0.02, 1.0);
        observer.observe(0, &Isometry3::identity());
        observer.hold(0, &push(1.0), &Wrench::ZERO);
        observer.interrupt();
        observer.observe(MS, &Isometry3::translation(1.0, 0.0, 0.0));
        assert_eq!(observer.energy(), (0.0, 0.0));
        observer.observe(2 * MS, &Isometry3::translation(0.999, 0.0, 0.0));
        assert!((observer.energy().0 - 1e-3).abs() < 1e-12, "{observer:?}");
    }
}
