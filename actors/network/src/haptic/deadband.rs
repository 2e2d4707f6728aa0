//! Perceptual deadband: how far what is shown may be from what is, before a hand would feel or see it.
//!
//! After Weber's law the least change that is felt is a share of what is there (Hinterseer, Hirche,
//! Chaudhuri, Steinbach and Buss, "Perception-based data reduction and transmission of haptic data in
//! telepresence and teleaction systems", 2008), down to an absolute threshold near zero. Velocities, force,
//! torque and gripper have a share of themselves. A position has no zero to be a share of: its band is a
//! share of the way that the hand goes in [`Deadband::reach`]. Buttons, what is held, and whether a device is
//! connected have no band.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::hand_sample::HandSample;

/// The bands of all quantities of a hand. Each threshold is the band near zero.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Deadband {
    /// Weber fraction: the share of a quantity that goes unnoticed.
    pub weber: f64,
    /// The band of a pose is `weber` times the way that the hand goes in this time \[s\].
    pub reach: f64,
    /// Of the position \[m\].
    pub position: f64,
    /// Of the rotation \[rad\].
    pub rotation: f64,
    /// Of the linear velocity [m/s].
    pub linear_velocity: f64,
    /// Of the angular velocity [rad/s].
    pub angular_velocity: f64,
    /// Of the force \[N\]: beneath the friction of most devices.
    pub force: f64,
    /// Of the torque [N·m].
    pub torque: f64,
    /// Of the gripper's opening \[rad\].
    pub gripper: f64,
}

impl Default for Deadband {
    fn default() -> Self {
        Self {
            weber: 0.1,
            reach: 0.05,
            position: 2e-4,
            rotation: 5e-3,
            linear_velocity: 0.01,
            angular_velocity: 0.1,
            force: 0.02,
            torque: 1e-3,
            gripper: 0.01,
        }
    }
}

/// How far two samples of a hand are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Deviation {
    /// The quantity that is worst, in bands: up to 1 goes unnoticed.
    Bands(f64),
    /// Something differs that has no band: buttons, what is held, or whether the device is connected.
    Discrete,
}

impl Deviation {
    /// Whether a hand could notice it.
    pub fn is_noticed(self) -> bool {
        match self {
            Self::Bands(bands) => bands > 1.0,
            Self::Discrete => true,
        }
    }
}

impl Deadband {
    /// Whether every number is finite and positive.
    pub fn is_valid(&self) -> bool {
        let Self {
            weber,
            reach,
            position,
            rotation,
            linear_velocity,
            angular_velocity,
            force,
            torque,
            gripper,
        } = *self;
        let bands = [position, rotation, linear_velocity, angular_velocity, force, torque, gripper];
        bands.iter().chain(&[weber, reach]).all(|number| number.is_finite() && *number > 0.0)
    }

    /// How far `held` is from `sample`. A share is that of the smaller of both, so that an error is within
    /// the Weber fraction of what is true as well as of what is held.
    pub fn deviation(&self, sample: &HandSample, held: &HandSample) -> Deviation {
        let (a, b) = (&sample.state, &held.state);
        if a.buttons != b.buttons || a.connected != b.connected || sample.grabbed != held.grabbed {
            return Deviation::Discrete;
        }
        let speed = smaller(&a.linear_velocity, &b.linear_velocity);
        let spin = smaller(&a.angular_velocity, &b.angular_velocity);
        let moved = (sample.position_in_device() - held.position_in_device()).norm();
        // Twice the sine of half the angle: the angle itself as long as that is small.
        let turned = 2.0 * a.pose_in_device.rotation.rotation_to(&b.pose_in_device.rotation).imag().norm();
        let gripper =
            (a.gripper - b.gripper).abs() / self.band(self.gripper, a.gripper.abs().min(b.gripper.abs()));
        let bands = [
            moved / self.band(self.position, speed * self.reach),
            turned / self.band(self.rotation, spin * self.reach),
            self.apart(self.linear_velocity, &a.linear_velocity, &b.linear_velocity),
            self.apart(self.angular_velocity, &a.angular_velocity, &b.angular_velocity),
            self.apart(self.force, &sample.wrench.force, &held.wrench.force),
            self.apart(self.torque, &sample.wrench.torque, &held.wrench.torque),
            gripper,
        ];
        // A number that is not finite counts as noticed.
        let bands = bands.map(|bands| if bands.is_nan() { f64::INFINITY } else { bands });
        Deviation::Bands(bands.into_iter().fold(0.0, f64::max))
    }

    fn apart(&self, threshold: f64, a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
        (a - b).norm() / self.band(threshold, smaller(a, b))
    }

    fn band(&self, threshold: f64, magnitude: f64) -> f64 {
        threshold.max(self.weber * magnitude)
    }
}

fn smaller(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.norm().min(b.norm())
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;
    use trocar_scene::Entity;

    use super::*;

    fn sample() -> HandSample {
        let mut sample = HandSample::unknown(3);
        sample.state.connected = true;
        sample.state.linear_velocity = Vector3::new(0.2, 0.0, 0.0);
        sample.wrench.force = Vector3::new(0.0, 2.0, 0.0);
        sample.state.gripper = 0.5;
        sample
    }

    fn bands(change: impl Fn(&mut HandSample)) -> f64 {
        let mut changed = sample();
        change(&mut changed);
        match Deadband::default().deviation(&sample(), &changed) {
            Deviation::Bands(bands) => bands,
            Deviation::Discrete => panic!("{changed:?}"),
        }
    }

    #[test]
    fn each_quantity_has_its_band() {
        assert_eq!(bands(|_| {}), 0.0);
        // A tenth of a centimetre, which is the way of 50 ms.
        let moved = bands(|sample| sample.state.pose_in_device.translation.vector.z = 1e-3);
        assert!((moved - 1.0).abs() < 1e-12, "{moved}");
        let turned = bands(|sample| {
            sample.state.pose_in_device.rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * 0.01);
        });
        assert!((turned - 2.0).abs() < 1e-3, "{turned}");
        assert!((bands(|sample| sample.state.linear_velocity.x = 0.22) - 1.0).abs() < 1e-9);
        assert!((bands(|sample| sample.state.angular_velocity.x = 0.05) - 0.5).abs() < 1e-9);
        assert!((bands(|sample| sample.wrench.force.y = 2.5) - 2.5).abs() < 1e-9);
        assert!((bands(|sample| sample.wrench.torque.y = 2e-3) - 2.0).abs() < 1e-9);
        assert!((bands(|sample| sample.state.gripper = 0.55) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn what_has_no_band_is_always_noticed() {
        let changes: [fn(&mut HandSample); 3] = [
            |sample| sample.state.buttons = 1,
            |sample| sample.state.connected = false,
            |sample| sample.grabbed = Some((Entity::from_bits(4), 2)),
        ];
        for change in changes {
            let mut changed = sample();
            change(&mut changed);
            let deviation = Deadband::default().deviation(&sample(), &changed);
            assert_eq!(deviation, Deviation::Discrete);
            assert!(deviation.is_noticed());
        }
    }

    #[test]
    fn a_number_that_is_none_is_noticed() {
        assert_eq!(bands(|sample| sample.wrench.force.x = f64::NAN), f64::INFINITY);
    }

    proptest! {
        #[test]
        fn an_unnoticed_force_is_within_a_tenth_of_what_is_true(
            a in prop::array::uniform3(-5.0..5.0_f64), noise in prop::array::uniform3(-0.5..0.5_f64),
        ) {
            let (a, b) = (Vector3::from(a), Vector3::from(a) + Vector3::from(noise));
            let [mut sample, mut held] = [sample(), sample()];
            (sample.wrench.force, held.wrench.force) = (a, b);
            let band = Deadband::default();
            let noticed = band.deviation(&sample, &held).is_noticed();
            prop_assert_eq!(noticed, band.deviation(&held, &sample).is_noticed(), "both see the same");
            prop_assert_eq!(noticed, (a - b).norm() > band.force.max(0.1 * a.norm().min(b.norm())));
        }
    }
}
