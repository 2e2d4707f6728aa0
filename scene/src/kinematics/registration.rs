//! Registration of a device's frame in the world: a pose and one scale.
//!
//! Motion is scaled by `scale`; the wrench is mapped back by the transpose, so that the power at the hand equals the
//! power at the instrument. (A separate force gain, as in some simulators, makes a passive scene active at the hand
//! whenever the gain exceeds the scale.)

use nalgebra::{Isometry3, Translation3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::spatial::{Twist, Wrench, valid_pose};

/// Why a registration was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RegistrationError {
    /// The scale is out of range.
    #[error("registration scale {0} is out of range (valid: 0.01 to 100)")]
    Scale(f64),
    /// The pose holds NaN, infinity or a rotation that is not normalised.
    #[error("registration pose world_from_device is not a finite, normalised pose")]
    Pose,
}

/// `point_in_world = world_from_device * (scale · point_in_device)`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Registration {
    world_from_device: Isometry3<f64>,
    scale: f64,
}

impl Default for Registration {
    fn default() -> Self {
        Self { world_from_device: Isometry3::identity(), scale: 1.0 }
    }
}

impl Registration {
    /// From the pose of the device's frame in the world and the world's metres per device metre.
    ///
    /// # Errors
    /// [`RegistrationError`] for a scale outside 0.01–100 or an invalid pose.
    pub fn new(world_from_device: Isometry3<f64>, scale: f64) -> Result<Self, RegistrationError> {
        if !(0.01..=100.0).contains(&scale) {
            return Err(RegistrationError::Scale(scale));
        }
        if !valid_pose(&world_from_device) {
            return Err(RegistrationError::Pose);
        }
        Ok(Self { world_from_device, scale })
    }

    /// Pose of the device's frame in the world.
    pub fn world_from_device(&self) -> &Isometry3<f64> {
        &self.world_from_device
    }
    /// Metres in the world per metre of the device.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// A pose of the device's handle, in the world.
    pub fn pose_to_world(&self, pose_in_device: &Isometry3<f64>) -> Isometry3<f64> {
        let scaled = Isometry3::from_parts(
            Translation3::from(pose_in_device.translation.vector * self.scale),
            pose_in_device.rotation,
        );
        self.world_from_device * scaled
    }

    /// A pose in the world, as the device's own handle pose.
    pub fn pose_to_device(&self, pose_in_world: &Isometry3<f64>) -> Isometry3<f64> {
        let scaled = self.world_from_device.inv_mul(pose_in_world);
        Isometry3::from_parts(Translation3::from(scaled.translation.vector / self.scale), scaled.rotation)
    }

    /// A velocity of the device's handle, in the world.
    pub fn twist_to_world(&self, twist_in_device: &Twist) -> Twist {
        let rotation = &self.world_from_device.rotation;
        Twist::new(rotation * twist_in_device.linear * self.scale, rotation * twist_in_device.angular)
    }

    /// A velocity in the world, as the device's own.
    pub fn twist_to_device(&self, twist_in_world: &Twist) -> Twist {
        let rotation = &self.world_from_device.rotation;
        Twist::new(
            rotation.inverse_transform_vector(&twist_in_world.linear) / self.scale,
            rotation.inverse_transform_vector(&twist_in_world.angular),
        )
    }

    /// A wrench on the handle in the world, in the device's frame: same power.
    pub fn wrench_to_device(&self, wrench_in_world: &Wrench) -> Wrench {
        let rotation = &self.world_from_device.rotation;
        Wrench::new(
            rotation.inverse_transform_vector(&wrench_in_world.force) * self.scale,
            rotation.inverse_transform_vector(&wrench_in_world.torque),
        )
    }

    /// A wrench of the device on the hand, in the world: same power.
    pub fn wrench_to_world(&self, wrench_in_device: &Wrench) -> Wrench {
        let rotation = &self.world_from_device.rotation;
        Wrench::new(rotation * wrench_in_device.force / self.scale, rotation * wrench_in_device.torque)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-bound..bound).prop_map(Vector3::from)
    }
    fn pose() -> impl Strategy<Value = Isometry3<f64>> {
        (vector(1.0), vector(3.0))
            .prop_map(|(t, r)| Isometry3::from_parts(t.into(), UnitQuaternion::from_scaled_axis(r)))
    }

    proptest! {
        #[test]
        fn power_is_the_same_on_both_sides(
            place in pose(), scale in 0.1..5.0f64,
            linear in vector(2.0), angular in vector(10.0), force in vector(5.0), torque in vector(0.5),
        ) {
            let registration = Registration::new(place, scale).unwrap();
            let (twist, wrench) = (Twist::new(linear, angular), Wrench::new(force, torque));
            let in_world = wrench.power(&registration.twist_to_world(&twist));
            let in_device = registration.wrench_to_device(&wrench).power(&twist);
            prop_assert!((in_world - in_device).abs() < 1e-10 * (1.0 + in_world.abs()));
            let back = registration.wrench_to_world(&registration.wrench_to_device(&wrench));
            prop_assert!((back.force - force).norm() < 1e-12 && (back.torque - torque).norm() < 1e-12);
            let back = registration.twist_to_device(&registration.twist_to_world(&twist));
            prop_assert!((back.linear - linear).norm() < 1e-12 && (back.angular - angular).norm() < 1e-12);
        }

        #[test]
        fn poses_go_to_the_world_and_back(place in pose(), scale in 0.1..5.0f64, handle in pose()) {
            let registration = Registration::new(place, scale).unwrap();
            let back = registration.pose_to_device(&registration.pose_to_world(&handle));
            prop_assert!((back.translation.vector - handle.translation.vector).norm() < 1e-12);
            prop_assert!(back.rotation.angle_to(&handle.rotation) < 1e-7);
        }

        #[test]
        fn the_velocity_is_the_derivative_of_the_pose(
            place in pose(), scale in 0.1..5.0f64, handle in pose(), linear in vector(1.0), angular in vector(1.0),
        ) {
            let registration = Registration::new(place, scale).unwrap();
            let dt = 1e-6;
            let step = |sign: f64| Isometry3::from_parts(
                (handle.translation.vector + linear * dt * sign).into(),
                UnitQuaternion::from_scaled_axis(angular * dt * sign) * handle.rotation,
            );
            let (before, after) = (registration.pose_to_world(&step(-1.0)), registration.pose_to_world(&step(1.0)));
            let twist = registration.twist_to_world(&Twist::new(linear, angular));
            let numeric = (after.translation.vector - before.translation.vector) / (2.0 * dt);
            prop_assert!((numeric - twist.linear).norm() < 1e-6);
            let turned = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * dt);
            prop_assert!((turned - twist.angular).norm() < 1e-6);
        }
    }

    #[test]
    fn a_bad_registration_is_refused() {
        assert_eq!(Registration::new(Isometry3::identity(), 0.0), Err(RegistrationError::Scale(0.0)));
        assert!(Registration::new(Isometry3::identity(), f64::NAN).is_err());
        let bad = Isometry3::translation(f64::INFINITY, 0.0, 0.0);
        assert_eq!(Registration::new(bad, 1.0), Err(RegistrationError::Pose));
    }
}
