//! Constant age: a hand as it was a steady time ago, however unevenly its samples come.
//!
//! On a path with jitter the newest sample is now 71 ms old and now 76 ms, and a deadband sends one every few milliseconds
//! only. A hand that is shown as its samples come stands and jumps, by a millimetre at 0.2 m/s, and shakes a ring out of
//! its jaws. So the newest sample is moved along its own velocity to the age that samples have on average (dead reckoning,
//! as distributed simulators do it: IEEE 1278.1), for [`REACH_SECS`] at most, so that a hand that stops in a loss is not
//! carried far. No sample waits for this.
//!
//! Uses only additions, multiplications, divisions and square roots: bit-identical on every machine.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use trocar_scene::SimTime;

/// Longest time that a sample is moved along its velocity, forwards and backwards \[s\].
pub const REACH_SECS: f64 = 0.01;
/// Time constant of the mean age \[s\].
const MEAN_SECS: f64 = 1.0;

/// The newest sample of a hand, and the age at which it is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantAge {
    hand_in_device: Isometry3<f64>,
    linear_velocity: Vector3<f64>,
    angular_velocity: Vector3<f64>,
    /// By the clock of this session; `None` if the sample is shown as it came.
    measured_at: Option<SimTime>,
    mean_secs: Option<f64>,
}

impl Default for ConstantAge {
    fn default() -> Self {
        Self {
            hand_in_device: Isometry3::identity(),
            linear_velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            measured_at: None,
            mean_secs: None,
        }
    }
}

impl ConstantAge {
    /// Takes the newest sample: a pose, and its velocity [m/s, rad/s] along the device's axes.
    pub fn take(
        &mut self,
        measured_at: Option<SimTime>,
        hand_in_device: Isometry3<f64>,
        linear_velocity: Vector3<f64>,
        angular_velocity: Vector3<f64>,
    ) {
        (self.hand_in_device, self.measured_at) = (hand_in_device, measured_at);
        (self.linear_velocity, self.angular_velocity) = (linear_velocity, angular_velocity);
        if measured_at.is_none() {
            self.mean_secs = None;
        }
    }

    /// The hand at the mean age, which follows the age over this step.
    pub fn step(&mut self, now: SimTime, step_secs: f64) -> Isometry3<f64> {
        let Some(measured_at) = self.measured_at else { return self.hand_in_device };
        let age_secs = now.since(measured_at).as_secs_f64();
        let mean_secs = self.mean_secs.unwrap_or(age_secs);
        let mean_secs = mean_secs + (step_secs / MEAN_SECS).min(1.0) * (age_secs - mean_secs);
        self.mean_secs = Some(mean_secs);
        self.moved((age_secs - mean_secs).clamp(-REACH_SECS, REACH_SECS))
    }

    fn moved(&self, secs: f64) -> Isometry3<f64> {
        let pose = &self.hand_in_device;
        // Of so small a turn its half tangent is half the angle.
        let turn = Quaternion::from_parts(1.0, self.angular_velocity * (0.5 * secs));
        Isometry3::from_parts(
            (pose.translation.vector + self.linear_velocity * secs).into(),
            UnitQuaternion::new_normalize(turn * pose.rotation.into_inner()),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::random::SplitMix64;

    const MS: f64 = 1e-3;

    /// A hand that swings at 1 Hz, 40 mm to both sides, and turns with it.
    fn swing(at_secs: f64) -> (Isometry3<f64>, Vector3<f64>, Vector3<f64>) {
        let (phase, rate) = (std::f64::consts::TAU * at_secs, std::f64::consts::TAU);
        let pose = Isometry3::new(Vector3::x() * (0.04 * phase.sin()), Vector3::z() * (0.5 * phase.sin()));
        let swing = rate * phase.cos();
        (pose, Vector3::x() * (0.04 * swing), Vector3::z() * (0.5 * swing))
    }

    #[test]
    fn uneven_samples_are_shown_evenly() {
        let mut random = SplitMix64::new(7);
        // A sample every 5 ms, which is under way for 70 to 80 ms.
        let sent: Vec<(f64, f64)> = (0..600)
            .map(|k| (0.005 * f64::from(k), 0.005 * f64::from(k) + 0.07 + 0.01 * random.unit()))
            .collect();
        let (mut hand, mut plain, mut newest) = (ConstantAge::default(), 0.0, -1.0);
        let mut shown = [Vec::new(), Vec::new()];
        for tick in 0..3_000 {
            let now = f64::from(tick) * MS;
            let arrived = sent.iter().filter(|(_, arrives)| *arrives <= now).map(|(measured, _)| *measured);
            let measured = arrived.fold(newest, f64::max);
            if measured > newest {
                newest = measured;
                let (pose, linear, angular) = swing(measured);
                hand.take(Some(SimTime::from_secs_f64(measured)), pose, linear, angular);
                plain = pose.translation.vector.x;
            }
            let pose = hand.step(SimTime::from_secs_f64(now), MS);
            if tick > 1_500 {
                shown[0].push(pose.translation.vector.x);
                shown[1].push(plain);
            }
        }
        // Speed from one tick to the next, against the greatest that the hand has.
        let jerkiness = |xs: &[f64]| {
            xs.windows(2).map(|pair| (pair[1] - pair[0]).abs() / MS).fold(0.0, f64::max)
                / (0.04 * std::f64::consts::TAU)
        };
        let [even, uneven] = shown.map(|xs| jerkiness(&xs));
        assert!(even < 2.5 && uneven > 8.0, "{even} and {uneven} times the hand's own speed");
    }

    #[test]
    fn a_hand_that_stops_in_a_loss_is_carried_no_further_than_the_reach() {
        let mut hand = ConstantAge::default();
        let mut now = SimTime::from_millis(100);
        for _ in 0..2_000 {
            now += SimTime::from_millis(1);
            hand.take(Some(now), Isometry3::identity(), Vector3::x() * 0.2, Vector3::z());
            let shown = hand.step(now, MS);
            assert!(shown.translation.vector.norm() < 1e-12 && shown.rotation.angle() < 1e-12);
        }
        for _ in 0..200 {
            now += SimTime::from_millis(1);
            let shown = hand.step(now, MS);
            assert!(shown.translation.vector.x <= 0.2 * REACH_SECS + 1e-12);
            assert!(shown.rotation.angle() <= REACH_SECS + 1e-6);
        }
    }

    #[test]
    fn a_sample_of_unknown_age_is_shown_as_it_came() {
        let mut hand = ConstantAge::default();
        let pose = Isometry3::new(Vector3::new(0.1, 0.2, 0.3), Vector3::x());
        hand.take(None, pose, Vector3::x(), Vector3::x());
        assert_eq!(hand.step(SimTime::from_millis(500), MS), pose);
    }
}
