//! ITP, the interoperability telesurgery protocol, of both ends: the console of the surgeon and the robot.
//!
//! After King et al., "Preliminary protocol for interoperable telesurgery" (2009), as the Raven II speaks it. Of 30 trials
//! between fourteen systems 93 % worked by it (King et al., "Plugfest 2009", 2010). Both ends are sans-IO: datagrams and a
//! time go in, datagrams come out.
//!
//! # Datagrams
//! Packed, little-endian. [`ConsolePacket`] goes from the console to the robot, to its UDP port [`ROBOT_PORT`]:
//!
//! | byte | field | type | meaning |
//! |---|---|---|---|
//! | 0 | sequence | u32 | from 1; 0 asks only whether somebody is there |
//! | 4 | pactyp | u32 | type, not looked at |
//! | 8 | version | u32 | version, not looked at |
//! | 12, 20, 28 | delx, dely, delz | 2 × i32 each | increments of both arms' positions \[µm\] |
//! | 36, 52, 68, 84 | Qx, Qy, Qz, Qw | 2 × f64 each | increments of both arms' rotations, multiplied from the left |
//! | 100 | buttonstate | 2 × i32 | buttons of both hands |
//! | 108 | grasp | 2 × i32 | see [`GraspMeaning`] |
//! | 116 | surgeon_mode | i32 | 1: the pedal is down |
//! | 120 | checksum | i32 | see [`ConsolePacket::checksum`] |
//!
//! In [`RotationLayout::Matrices`] two 3 × 3 matrices of f64, row by row, take the place of the quaternions: bytes 36 to
//! 179; then buttonstate is at 180, grasp at 188, surgeon_mode at 196, checksum at 200.
//!
//! [`RobotPacket`] goes from the robot to the console's port [`CONSOLE_PORT`]:
//!
//! | byte | field | type | meaning |
//! |---|---|---|---|
//! | 0 | sequence | u32 | of the robot's own datagrams |
//! | 4 | last_sequence | u32 | of the console's last datagram that the robot applied |
//! | 8, 12 | pactyp, version | u32 each | not looked at |
//! | 16, 24, 32 | fx, fy, fz | 2 × i32 each | forces at both arms \[mN\] |
//! | 40 | runlevel | i32 | see [`Runlevel`] |
//! | 44 | jointflags | u32 | bit `n`: joint `n` is at a limit |
//! | 48 | checksum | i32 | see [`RobotPacket::checksum`] |
//!
//! # Faults of the protocol
//! - A lost datagram's increments are lost for good, and the robot drops the first datagram after a gap as well: every loss
//!   leaves a permanent offset. [`RobotConfig::lenient`] halves it; dialects with absolute poses have none.
//! - Nothing is authenticated. Whoever reaches the port moves the robot, and a forged sequence number stops the console
//!   (Bonaci et al., "To make a robot secure", 2015). So sockets for it bind the loopback address unless both ends are named.
//! - The checksum covers neither rotation nor grasp, and the Raven does not check it.
//!
//! # Frames
//! Increments are along the axes of the console's frame; the robot rotates them into frames of its arms. Here both ends
//! count in that one frame, named `robot`, and whoever owns the arms rotates.

pub mod console;
mod console_link;
mod cycle;
pub mod packet;
pub mod robot;
mod robot_link;

pub use console::{Console, ConsoleConfig, ConsoleHand, RobotReport};
pub use console_link::{ConsoleArm, ConsoleLink, ConsoleReport, LedHand};
pub use packet::{ConsolePacket, PacketError, RobotPacket, Rotations};
pub use robot::{Condition, Refusal, Robot, RobotConfig, RobotCounts, Verdict};
pub use robot_link::{ArmEnd, ArmPost, CONSOLE_LEAVES_AFTER, RobotLink};

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Arms of a robot, and hands at a console: 0 left, 1 right.
pub const ARMS: usize = 2;
/// Name of a device that a console of ITP moves: it says what `DeviceInfo::is_unprotected` looks for.
pub const UNPROTECTED_MODEL: &str = "console of ITP (unprotected)";
/// UDP port at which a robot listens.
pub const ROBOT_PORT: u16 = 36_000;
/// UDP port to which a robot replies.
pub const CONSOLE_PORT: u16 = 36_001;
/// Smallest opening of the jaws that [`GraspMeaning::AngleIncrement`] can reach \[mrad\]: −10°.
pub const GRASP_MIN_MRAD: i32 = -174;
/// Largest opening of the jaws \[mrad\]: 90°.
pub const GRASP_MAX_MRAD: i32 = 1_570;
/// Number in [`ConsolePacket::grasp`] for the whole closing torque.
pub const GRASP_TORQUE_MAX: i32 = 32_767;
/// Micrometres in a metre.
const UM_PER_M: f64 = 1e6;
/// How far the length of a rotation's quaternion, or of a matrix's columns, may be from one.
const UNIT_TOLERANCE: f64 = 1e-3;

/// How rotations are written in a [`ConsolePacket`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RotationLayout {
    /// Two quaternions: 124 bytes, the Raven II.
    #[default]
    Quaternions,
    /// Two 3 × 3 matrices: 204 bytes, raven2_sim.
    Matrices,
}

/// What a position or a rotation in a [`ConsolePacket`] means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Meaning {
    /// The change since the datagram before; a rotation is multiplied from the left.
    #[default]
    Increment,
    /// The pose itself. A lost datagram leaves no offset.
    Absolute,
}

/// What `grasp` means.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GraspMeaning {
    /// Torque of the jaws, as the Raven's header says: 32,767 closes with all of it, −32,767 opens.
    Torque,
    /// Change of the jaws' opening \[mrad\], as the Raven's program reads it: positive numbers close. The opening stays
    /// within [`GRASP_MIN_MRAD`] to [`GRASP_MAX_MRAD`].
    #[default]
    AngleIncrement,
    /// The opening itself \[mrad\], within the same limits: raven2_sim.
    Angle,
}

/// The variant of the protocol, which the packets do not tell: both ends are told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dialect {
    /// How rotations are written.
    pub layout: RotationLayout,
    /// What positions mean.
    pub position: Meaning,
    /// What rotations mean.
    pub rotation: Meaning,
    /// What `grasp` means.
    pub grasp: GraspMeaning,
}

impl Dialect {
    /// The Raven II's own: increments of everything.
    pub const RAVEN: Self = Self {
        layout: RotationLayout::Quaternions,
        position: Meaning::Increment,
        rotation: Meaning::Increment,
        grasp: GraspMeaning::AngleIncrement,
    };
    /// That of raven2_sim: absolute poses with matrices.
    pub const RAVEN_SIM: Self = Self {
        layout: RotationLayout::Matrices,
        position: Meaning::Absolute,
        rotation: Meaning::Absolute,
        grasp: GraspMeaning::Angle,
    };
}

/// Operating state of a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Runlevel {
    /// 0: emergency stop.
    EmergencyStop,
    /// 1: it finds its zero positions.
    Initialising,
    /// 2: ready, and the pedal is up: it holds still.
    PedalUp,
    /// 3: it follows the console.
    PedalDown,
}

impl Runlevel {
    /// The number on the wire.
    pub fn number(self) -> i32 {
        match self {
            Self::EmergencyStop => 0,
            Self::Initialising => 1,
            Self::PedalUp => 2,
            Self::PedalDown => 3,
        }
    }

    /// The state of a number; `None` for others than 0 to 3.
    pub fn from_number(number: i32) -> Option<Self> {
        match number {
            0 => Some(Self::EmergencyStop),
            1 => Some(Self::Initialising),
            2 => Some(Self::PedalUp),
            3 => Some(Self::PedalDown),
            _ => None,
        }
    }
}

/// A parameter of a console or a robot that makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// The scale of motions.
    #[error("the console's scale is {0}; it has to be more than 0 and at most {max}", max = console::SCALE_MAX)]
    Scale(f64),
    /// The largest increment.
    #[error("the largest increment is {0} µm; it has to be 1 to {max} µm", max = INCREMENT_UM_MAX)]
    Increment(u32),
    /// The largest increment of rotations.
    #[error("the largest rotation increment is {0} rad; it has to be more than 0 and at most {max} rad", max = ROTATION_MAX)]
    Rotation(f64),
    /// How far a robot's arm may go.
    #[error("the reach is {0} µm; it has to be 1 to {max} µm", max = REACH_UM_MAX)]
    Reach(u32),
    /// The pose or the opening at which an arm starts.
    #[error(
        "arm {0} starts where no arm can be: its pose has to be finite and within reach, its rotation of unit length"
    )]
    Start(usize),
}

/// Largest increment of a position that can be allowed for a datagram, along each axis \[µm\].
pub const INCREMENT_UM_MAX: u32 = 100_000;
/// Largest increment of a rotation that can be allowed for a datagram \[rad\].
pub const ROTATION_MAX: f64 = 1.0;
/// Farthest that an arm can be allowed to go from the origin, along each axis \[µm\].
pub const REACH_UM_MAX: u32 = 100_000_000;

/// Where an arm is, or has to go: in the protocol's own resolution, so that sums of increments are exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmPose {
    /// Position in the robot's frame \[µm\].
    pub position_um_in_robot: [i64; 3],
    /// Rotation in the robot's frame.
    pub rotation_in_robot: UnitQuaternion<f64>,
    /// Opening of the jaws \[mrad\].
    pub jaw_mrad: i32,
}

impl ArmPose {
    /// An arm at this pose with its jaws open by this angle \[rad\]; `None` when no arm can be there.
    pub fn new(pose_in_robot: &Isometry3<f64>, jaw: f64) -> Option<Self> {
        let position = pose_in_robot.translation.vector;
        let rotation_in_robot = unit_rotation(pose_in_robot.rotation.coords.into())?;
        let within = |um: &f64| um.abs() <= f64::from(REACH_UM_MAX);
        let um = position * UM_PER_M;
        (um.iter().all(within) && jaw.is_finite()).then(|| Self {
            position_um_in_robot: um.map(|um| um.round() as i64).into(),
            rotation_in_robot,
            jaw_mrad: jaw_mrad(jaw),
        })
    }

    /// The pose in metres.
    pub fn pose_in_robot(&self) -> Isometry3<f64> {
        let position = Vector3::from(self.position_um_in_robot).map(|um| um as f64 / UM_PER_M);
        Isometry3::from_parts(position.into(), self.rotation_in_robot)
    }

    /// Opening of the jaws \[rad\].
    pub fn jaw(&self) -> f64 {
        f64::from(self.jaw_mrad) / 1e3
    }
}

/// An opening of the jaws \[rad\] in milliradians, within the limits of the protocol.
fn jaw_mrad(jaw: f64) -> i32 {
    ((jaw * 1e3).round() as i32).clamp(GRASP_MIN_MRAD, GRASP_MAX_MRAD)
}

/// The rotation of a quaternion x, y, z, w; `None` when a number of it is not finite, or its length is not one.
fn unit_rotation(quaternion: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let quaternion = Quaternion::from(quaternion);
    ((quaternion.norm() - 1.0).abs() <= UNIT_TOLERANCE).then(|| UnitQuaternion::new_normalize(quaternion))
}

/// One rotation after another, with its length kept at one.
fn after(increment: &UnitQuaternion<f64>, rotation: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(increment.into_inner() * rotation.into_inner())
}

#[cfg(test)]
#[path = "lossy_link_tests.rs"]
mod lossy_link_tests;
#[cfg(test)]
#[path = "peer_tests.rs"]
mod peer_tests;
