//! Limits of the door for the samples of a hand at another station.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Limits of a [`Door`](super::Door). Workspace, and the device's own limits of force, come from its
/// [`Capabilities`](trocar_devices::Capabilities).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DoorLimits {
    /// Fastest motion of the handle [m/s]. Surgeons reach 0.5 m/s; the force guard's slew limit is a wall met at 1 m/s.
    pub linear_speed: f64,
    /// Fastest turn of the handle [rad/s].
    pub angular_speed: f64,
    /// How fast a motion stops when the station falls silent [m/s²]: 5 ms from 0.1 m/s, over 0.25 mm.
    pub linear_deceleration: f64,
    /// How fast a turn stops then [rad/s²].
    pub angular_deceleration: f64,
    /// Greatest force \[N\] that is believed of the station; the device's own limit holds if it is lower.
    pub force_max: f64,
    /// Greatest torque [N·m] that is believed of the station; the device's own limit holds if it is lower.
    pub torque_max: f64,
    /// Widest opening of the gripper \[rad\]; 0 is closed.
    pub gripper_max: f64,
    /// Fastest change of the gripper [rad/s].
    pub gripper_speed: f64,
    /// How near the fingers must come to jaws that hold something, before these follow \[rad\].
    pub grip_match: f64,
    /// Time without a datagram until which a force of the station is believed in full \[s\].
    pub fade_start_secs: f64,
    /// Time without a datagram from which a force of the station is zero \[s\].
    pub fade_end_secs: f64,
    /// Time without a datagram after which the station counts as silent \[s\].
    pub silence_secs: f64,
    /// Time of silence after which the station counts as lost, and a local device takes over \[s\].
    pub lost_secs: f64,
    /// Time over which forces fade out and in when the hand changes its owner \[s\].
    pub handover_secs: f64,
    /// Longest time over which a slow stream's steps are spread \[s\]; it covers 60 Hz.
    pub spread_max_secs: f64,
}

impl Default for DoorLimits {
    fn default() -> Self {
        Self {
            linear_speed: 1.0,
            angular_speed: 15.0,
            linear_deceleration: 20.0,
            angular_deceleration: 300.0,
            force_max: 20.0,
            torque_max: 1.0,
            gripper_max: 1.6,
            gripper_speed: 10.0,
            grip_match: 0.1,
            fade_start_secs: 0.05,
            fade_end_secs: 0.1,
            silence_secs: 0.1,
            lost_secs: 2.0,
            handover_secs: 0.05,
            spread_max_secs: 0.02,
        }
    }
}

/// A limit of a [`Door`](super::Door) that is out of range.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LimitError {
    /// A number is out of range, or none.
    #[error("remote hand: {field} = {value} is out of range ({min} to {max} {unit})")]
    Range {
        /// The limit.
        field: &'static str,
        /// What it was set to.
        value: f64,
        /// Smallest valid value.
        min: f64,
        /// Greatest valid value.
        max: f64,
        /// Unit of the limit.
        unit: &'static str,
    },
    /// The device's workspace is no box.
    #[error(
        "remote hand: the workspace of \"{device}\" is no box of finite size: its lowest corner must not be above its highest"
    )]
    Workspace {
        /// Name of the device.
        device: String,
    },
}

impl DoorLimits {
    /// Refuses limits that are out of range.
    ///
    /// # Errors
    /// [`LimitError::Range`] names the limit and its range.
    pub fn check(&self) -> Result<(), LimitError> {
        let range = |field, value: f64, min: f64, max: f64, unit| {
            // NaN fails every range check.
            if (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(LimitError::Range { field, value, min, max, unit })
            }
        };
        range("linear_speed", self.linear_speed, 0.01, 10.0, "m/s")?;
        range("angular_speed", self.angular_speed, 0.1, 100.0, "rad/s")?;
        range("linear_deceleration", self.linear_deceleration, 0.1, 1e4, "m/s²")?;
        range("angular_deceleration", self.angular_deceleration, 1.0, 1e5, "rad/s²")?;
        range("force_max", self.force_max, 0.0, 1e3, "N")?;
        range("torque_max", self.torque_max, 0.0, 100.0, "N·m")?;
        range("gripper_max", self.gripper_max, 0.0, 4.0, "rad")?;
        range("gripper_speed", self.gripper_speed, 0.1, 100.0, "rad/s")?;
        range("grip_match", self.grip_match, 0.0, 1.0, "rad")?;
        range("fade_start_secs", self.fade_start_secs, 0.0, 0.1, "s")?;
        range("fade_end_secs", self.fade_end_secs, self.fade_start_secs, 0.2, "s")?;
        range("silence_secs", self.silence_secs, 0.02, 1.0, "s")?;
        range("lost_secs", self.lost_secs, self.silence_secs, 600.0, "s")?;
        range("handover_secs", self.handover_secs, 0.0, 1.0, "s")?;
        range("spread_max_secs", self.spread_max_secs, 0.0, 0.1, "s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_pass_and_a_bad_limit_is_named_with_its_range() {
        DoorLimits::default().check().unwrap();
        let bad = DoorLimits { linear_speed: f64::NAN, ..DoorLimits::default() };
        let text = bad.check().unwrap_err().to_string();
        assert_eq!(text, "remote hand: linear_speed = NaN is out of range (0.01 to 10 m/s)");
        let bad = DoorLimits { fade_end_secs: 0.04, ..DoorLimits::default() };
        assert!(bad.check().unwrap_err().to_string().contains("fade_end_secs"));
    }
}
