//! What one station tells another of a hand.

use nalgebra::{Isometry3, Vector3};
use trocar_devices::{DeviceState, Wrench};
use trocar_scene::Entity;

/// A hand at one instant: what its device measured, the force that goes with it, and what its instrument holds.
///
/// From the station that holds the device to the others, the wrench is what the motors rendered. From the station that
/// owns the scene back to the device, it is what the scene asks for, and the pose is the instrument's answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandSample {
    /// Number of the hand in the session's manifest.
    pub hand: u8,
    /// Pose, velocities, gripper and buttons in the device's frame; whether the device is connected.
    pub state: DeviceState,
    /// Force \[N\] and torque [N·m] in the device's frame.
    pub wrench: Wrench,
    /// What the instrument holds, and the node of it, if it holds something.
    pub grabbed: Option<(Entity, u32)>,
    /// How old the measurement was when it was sent \[µs\].
    pub age_us: u32,
    /// From the station that owns the scene: how often it has taken up the hand's motion anew from where the instrument
    /// was, modulo [`CLUTCHES`]. The device's station then brings its own hand there, and tells in the same way how often it
    /// has offered it from there.
    pub clutch: u8,
}

/// Where the count of clutches begins again.
pub const CLUTCHES: u8 = 16;

impl HandSample {
    /// At rest at the device's origin, disconnected, without force.
    pub fn unknown(hand: u8) -> Self {
        Self {
            hand,
            state: DeviceState::unknown(),
            wrench: Wrench::ZERO,
            grabbed: None,
            age_us: 0,
            clutch: 0,
        }
    }

    /// Whether no number is NaN or infinite and the rotation is of unit length.
    pub fn is_valid(&self) -> bool {
        self.state.is_valid() && self.wrench.is_finite()
    }

    /// Pose of the handle in the device's frame.
    pub fn pose_in_device(&self) -> &Isometry3<f64> {
        &self.state.pose_in_device
    }

    /// Position of the handle in the device's frame \[m\].
    pub fn position_in_device(&self) -> &Vector3<f64> {
        &self.state.pose_in_device.translation.vector
    }
}
