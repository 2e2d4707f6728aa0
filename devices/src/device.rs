//! The interface of a device driver.
//!
//! How to write one (the virtual hand is the shortest complete example):
//!
//! 1. Put the manufacturer's data into [`Capabilities`]: the driver core clamps to these limits, so state forces that
//!    are safe for the motors and for a hand.
//! 2. [`HapticDevice::open`] finds and initialises the device. It is called again after the device was
//!    unplugged, at most every 100 ms, so it must be repeatable and bounded in time.
//! 3. [`HapticDevice::read`] returns the newest state in SI units and in one frame that never changes. Return
//!    [`DeviceError::Disconnected`] when the device is unplugged; any other error means "no reading this time".
//! 4. [`HapticDevice::write`] hands a wrench to the motors. It has been clamped, limited and checked already.
//! 5. [`HapticDevice::close`] leaves the motors without force; dropping the device must do so too.
//!
//! `read` and `write` run up to 10,000 times a second at the highest priority: no allocation, no lock, no log, no
//! blocking. A device never reads a clock: time is passed to it.

use std::any::Any;
use std::ops::Mul;

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A force and a torque that act on the hand, along the axes of the device's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Wrench {
    /// Force at the handle's origin \[N\].
    pub force: Vector3<f64>,
    /// Torque about the handle's origin [N·m].
    pub torque: Vector3<f64>,
}

impl Wrench {
    /// No force and no torque.
    pub const ZERO: Self = Self { force: Vector3::new(0.0, 0.0, 0.0), torque: Vector3::new(0.0, 0.0, 0.0) };

    /// A force \[N\] without torque.
    pub const fn from_force(force: Vector3<f64>) -> Self {
        Self { force, torque: Vector3::new(0.0, 0.0, 0.0) }
    }

    /// Whether no number is NaN or infinite.
    pub fn is_finite(&self) -> bool {
        is_finite(&self.force) && is_finite(&self.torque)
    }
}

/// Bits behind the binary point of a device's numbers.
const POSITION_BITS: u8 = 40;
const ROTATION_BITS: u8 = 30;
const VELOCITY_BITS: u8 = 26;
const ANGULAR_BITS: u8 = 22;
const GRIPPER_BITS: u8 = 30;
const FORCE_BITS: u8 = 24;
const TORQUE_BITS: u8 = 30;

/// The nearest number with that many bits behind the binary point; never −0.
fn round(x: f64, bits: u8) -> f64 {
    let scale = (1_u64 << bits) as f64;
    (x * scale).round() / scale + 0.0
}

impl Wrench {
    /// The same rounded towards zero to 60 nN and 1 nN·m, as [`DeviceState::rounded`]: never above a limit.
    pub fn rounded(&self) -> Self {
        let shorten = |x: f64, bits: u8| {
            let scale = (1_u64 << bits) as f64;
            (x * scale).trunc() / scale + 0.0
        };
        Self {
            force: self.force.map(|x| shorten(x, FORCE_BITS)),
            torque: self.torque.map(|x| shorten(x, TORQUE_BITS)),
        }
    }
}

impl Mul<f64> for Wrench {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self { force: self.force * factor, torque: self.torque * factor }
    }
}

impl Default for Wrench {
    fn default() -> Self {
        Self::ZERO
    }
}

/// State of a device at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceState {
    /// Pose of the handle in the device's frame \[m\].
    pub pose_in_device: Isometry3<f64>,
    /// Velocity of the handle's origin along the device's axes [m/s].
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity of the handle along the device's axes [rad/s].
    pub angular_velocity: Vector3<f64>,
    /// Opening angle of the gripper \[rad\]; 0 is closed.
    pub gripper: f64,
    /// Bit `n` is set while button `n` of the handle is pressed, up to 15; above are the [`Pedals`](crate::Pedals).
    pub buttons: u32,
    /// False while the device is unplugged; pose and gripper are then the last that were measured.
    pub connected: bool,
}

impl DeviceState {
    /// At the device's origin, at rest, closed, unplugged: the state before the first reading.
    pub fn unknown() -> Self {
        Self {
            pose_in_device: Isometry3::identity(),
            linear_velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            gripper: 0.0,
            buttons: 0,
            connected: false,
        }
    }

    /// Whether no number is NaN or infinite and the rotation is of unit length within 1e-6.
    pub fn is_valid(&self) -> bool {
        pose_is_valid(&self.pose_in_device)
            && is_finite(&self.linear_velocity)
            && is_finite(&self.angular_velocity)
            && self.gripper.is_finite()
    }

    /// The same with its numbers rounded, far below what any device resolves: to 1 pm, 1 nrad, 15 nm/s, 240 nrad/s, and
    /// 1 nrad of the gripper. Rounded numbers take few bits in recordings and on networks, without loss. The steps are so
    /// small that a force of newtons at the port does no work by them that an observer of energy would see (1e-12 J).
    pub fn rounded(&self) -> Self {
        let Isometry3 { translation, rotation } = self.pose_in_device;
        let rotation = rotation.into_inner().coords.map(|x| round(x, ROTATION_BITS));
        Self {
            pose_in_device: Isometry3::from_parts(
                translation.vector.map(|x| round(x, POSITION_BITS)).into(),
                UnitQuaternion::new_unchecked(Quaternion::from(rotation)),
            ),
            linear_velocity: self.linear_velocity.map(|x| round(x, VELOCITY_BITS)),
            angular_velocity: self.angular_velocity.map(|x| round(x, ANGULAR_BITS)),
            gripper: round(self.gripper, GRIPPER_BITS),
            ..*self
        }
    }

    /// The same pose at rest, marked as unplugged.
    pub fn unplugged(&self) -> Self {
        Self {
            linear_velocity: Vector3::zeros(),
            angular_velocity: Vector3::zeros(),
            connected: false,
            ..*self
        }
    }
}

/// Target of the human who holds the handle. Virtual hands move towards it; real devices ignore it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandIntent {
    /// Desired pose of the handle in the device's frame \[m\].
    pub pose_in_device: Isometry3<f64>,
    /// Desired opening angle of the gripper \[rad\].
    pub gripper: f64,
    /// Buttons and pedals that are pressed, as bits of [`DeviceState::buttons`].
    pub buttons: u32,
}

impl HandIntent {
    /// To be at this pose with the gripper this far open \[rad\], and to press nothing.
    pub fn at(pose_in_device: Isometry3<f64>, gripper: f64) -> Self {
        Self { pose_in_device, gripper, buttons: 0 }
    }

    /// Whether no number is NaN or infinite and the rotation is of unit length within 1e-6.
    pub fn is_valid(&self) -> bool {
        pose_is_valid(&self.pose_in_device) && self.gripper.is_finite()
    }
}

/// How many degrees of freedom a device measures or drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Dofs {
    /// None.
    Zero,
    /// Three translations.
    Three,
    /// Three translations and three rotations.
    Six,
}

impl Dofs {
    /// As a number: 0, 3 or 6.
    pub const fn count(self) -> u8 {
        match self {
            Self::Zero => 0,
            Self::Three => 3,
            Self::Six => 6,
        }
    }
}

/// Box in which the handle can move, in the device's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Workspace {
    /// Lowest corner \[m\].
    pub min_in_device: Vector3<f64>,
    /// Highest corner \[m\].
    pub max_in_device: Vector3<f64>,
}

impl Workspace {
    /// A box around the origin with these edge lengths \[m\].
    pub fn centred(size: Vector3<f64>) -> Self {
        Self { min_in_device: -0.5 * size, max_in_device: 0.5 * size }
    }

    /// Edge lengths \[m\].
    pub fn size(&self) -> Vector3<f64> {
        self.max_in_device - self.min_in_device
    }

    /// How far the point \[m\] lies outside, per axis and signed; zero inside.
    pub fn excess(&self, point_in_device: &Vector3<f64>) -> Vector3<f64> {
        point_in_device - point_in_device.sup(&self.min_in_device).inf(&self.max_in_device)
    }
}

/// Capabilities of a device, from its manufacturer's data. The driver core keeps every force within these limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Capabilities {
    /// Make and model, for display.
    pub name: String,
    /// Where the handle can move.
    pub workspace: Workspace,
    /// Greatest force \[N\] (Euclidean norm) that may be rendered.
    pub max_force_newtons: f64,
    /// Greatest torque [N·m] (Euclidean norm) that may be rendered.
    pub max_torque: f64,
    /// Greatest stiffness [N/m] that can be rendered, along the weakest axis.
    pub max_stiffness: f64,
    /// Measured degrees of freedom.
    pub input_dofs: Dofs,
    /// Driven degrees of freedom; torques are dropped when only translations are driven.
    pub output_dofs: Dofs,
    /// Mass that the hand feels when no force is rendered \[kg\].
    pub apparent_mass: f64,
}

/// Why a device call failed. Carries no heap data, since it occurs at the device's rate.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum DeviceError {
    /// The device is absent or unplugged; the driver renders zero and tries to open it again.
    #[error("the device is disconnected")]
    Disconnected,
    /// The device answered with a fault of its own, such as warm motors.
    #[error("the device reports a fault: {0}")]
    Fault(&'static str),
    /// A transfer failed; the next may succeed.
    #[error("a transfer to or from the device failed (error number {0})")]
    Transfer(i32),
    /// A method was called before [`HapticDevice::open`] succeeded.
    #[error("the device is not open")]
    NotOpen,
}

/// A haptic device: up to six measured degrees of freedom, and motors that render force.
///
/// Stepped by a driver ([`crate::DriverThread`] live, the lock-step scheduler in virtual time), never by a
/// controller. `now_ns` is the time since the start of the session \[ns\] and does not decrease.
pub trait HapticDevice: Send {
    /// Its capabilities; constant, and known before `open`.
    fn capabilities(&self) -> &Capabilities;

    /// Finds and initialises the device; also after it was unplugged. Motors stay without force.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`] when there is none (yet).
    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError>;

    /// The newest state.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`] when the device is gone; others mean that there is no reading this time.
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError>;

    /// How long before the latest reading the handle was there \[ns\]: of a hand that is elsewhere, its way here.
    fn lag_ns(&self) -> u64 {
        0
    }

    /// Renders a wrench until the next call.
    ///
    /// # Errors
    /// [`DeviceError::Disconnected`] when the device is gone.
    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError>;

    /// Sets the human's target for the handle. Only virtual hands use it.
    fn set_intent(&mut self, _now_ns: u64, _intent: &HandIntent) {}

    /// Sets the motors' force to zero and releases the device.
    fn close(&mut self);

    /// A copy in the same state, for a branch of a session in virtual time. `None` for physical devices.
    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        None
    }

    /// The device itself, for whoever has made it and has to reach it behind this interface; `None` for devices that need
    /// none of that.
    fn as_any(&mut self) -> Option<&mut dyn Any> {
        None
    }

    /// Continues from the state measured at `now_ns`, with the human's target `intent`. Only needed for devices with
    /// state that support [`HapticDevice::fork`].
    fn resume(&mut self, _now_ns: u64, _state: &DeviceState, _intent: &HandIntent) {}
}

impl<T: HapticDevice + ?Sized> HapticDevice for Box<T> {
    fn capabilities(&self) -> &Capabilities {
        (**self).capabilities()
    }
    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        (**self).open(now_ns)
    }
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        (**self).read(now_ns)
    }
    fn lag_ns(&self) -> u64 {
        (**self).lag_ns()
    }
    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        (**self).write(now_ns, wrench)
    }
    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        (**self).set_intent(now_ns, intent);
    }
    fn close(&mut self) {
        (**self).close();
    }
    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        (**self).fork()
    }
    fn as_any(&mut self) -> Option<&mut dyn Any> {
        (**self).as_any()
    }
    fn resume(&mut self, now_ns: u64, state: &DeviceState, intent: &HandIntent) {
        (**self).resume(now_ns, state, intent);
    }
}

pub(crate) fn is_finite(vector: &Vector3<f64>) -> bool {
    vector.iter().all(|x| x.is_finite())
}

fn pose_is_valid(pose: &Isometry3<f64>) -> bool {
    // A NaN length fails the comparison as well.
    is_finite(&pose.translation.vector) && (pose.rotation.coords.norm() - 1.0).abs() <= 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn workspace_excess_is_zero_inside_and_signed_outside() {
        let workspace = Workspace::centred(Vector3::new(0.16, 0.12, 0.07));
        assert_eq!(workspace.excess(&Vector3::new(0.079, -0.06, 0.0)), Vector3::zeros());
        let excess = workspace.excess(&Vector3::new(0.1, -0.07, 0.0));
        assert!((excess - Vector3::new(0.02, -0.01, 0.0)).norm() < 1e-15);
        assert_eq!(workspace.size(), Vector3::new(0.16, 0.12, 0.07));
    }

    #[test]
    fn states_with_nan_or_unnormalised_rotation_are_invalid() {
        let good = DeviceState::unknown();
        assert!(good.is_valid());
        let mut nan = good;
        nan.pose_in_device.translation.vector.y = f64::NAN;
        assert!(!nan.is_valid());
        let mut long = good;
        long.pose_in_device.rotation =
            nalgebra::UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.01, 0.0, 0.0, 0.0));
        assert!(!long.is_valid());
        assert!(!DeviceState { gripper: f64::INFINITY, ..good }.is_valid());
    }
}
