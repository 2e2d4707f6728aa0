//! Console of ITP, the master: poses of two hands in, increments for two arms out.
//!
//! Every increment is the difference between where the arm has to be and the sum of what was sent. So what is rounded off,
//! or cut off from a motion that is too fast, goes out with the next packets, and nothing drifts. A motion begins where the
//! pedal is pressed and ends where it is released: between, the hands move freely (clutch). Rotations are not scaled.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::SimTime;

use super::packet::{SURGEON_DISENGAGED, SURGEON_ENGAGED};
use super::{
    ARMS, ArmPose, ConfigError, ConsolePacket, Dialect, GRASP_MAX_MRAD, GRASP_MIN_MRAD, GRASP_TORQUE_MAX,
    GraspMeaning, INCREMENT_UM_MAX, Meaning, PacketError, ROTATION_MAX, RobotPacket, Rotations, Runlevel,
    UM_PER_M, after, cycle, jaw_mrad, unit_rotation,
};

/// Largest scale of motions.
pub const SCALE_MAX: f64 = 10.0;
/// Largest change of the jaws' opening in a packet \[mrad\]; what is more goes out with the next packets.
pub const JAW_MRAD_MAX: i32 = 20;
/// How old a robot's forces are when they begin to fade.
pub const FORCE_FADES: SimTime = SimTime::from_millis(50);
/// How old a robot's forces are when nothing is left of them.
pub const FORCE_GONE: SimTime = SimTime::from_millis(100);
/// A reply so many numbers behind the newest is from a robot that was started again.
pub const REPLY_RESET_BEHIND: i64 = 1_000;

/// Parameters of a [`Console`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsoleConfig {
    /// The variant that the robot understands.
    pub dialect: Dialect,
    /// Motion of the arm over motion of the hand, more than 0 and at most [`SCALE_MAX`].
    pub scale: f64,
    /// Largest increment of a position in a packet, along each axis \[µm\], 1 to [`INCREMENT_UM_MAX`]: 1,000 is 1 m/s at
    /// 1 kHz. A faster hand is followed later.
    pub increment_um_max: u32,
    /// Largest increment of a rotation in a packet \[rad\], at most [`ROTATION_MAX`]: 0.02 is 20 rad/s at 1 kHz.
    pub rotation_max: f64,
    /// Where the robot's arms are at the start. Dialects with absolute poses need it.
    pub start_in_robot: [Isometry3<f64>; ARMS],
    /// Opening of the robot's jaws at the start \[rad\].
    pub start_jaw: [f64; ARMS],
    /// Whether replies with a wrong checksum are refused: only where the robot is ours.
    pub check_checksum: bool,
}

impl Default for ConsoleConfig {
    fn default() -> Self {
        Self {
            dialect: Dialect::RAVEN,
            scale: 1.0,
            increment_um_max: 1_000,
            rotation_max: 0.02,
            start_in_robot: [Isometry3::identity(); ARMS],
            start_jaw: [0.0; ARMS],
            check_checksum: false,
        }
    }
}

/// A hand at the console.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConsoleHand {
    /// Pose of the handle, along the axes of the robot's frame \[m\]; its origin does not matter.
    pub pose_in_console: Isometry3<f64>,
    /// Opening that the jaws should have \[rad\].
    pub jaw: f64,
    /// How hard the jaws should close: 1 with all torque, −1 opens; for [`GraspMeaning::Torque`].
    pub squeeze: f64,
    /// Buttons of the handle.
    pub buttons: u32,
}

impl ConsoleHand {
    /// The hand's pose, if it is one.
    fn valid_pose(&self) -> Option<Isometry3<f64>> {
        let position = self.pose_in_console.translation.vector;
        let rotation = unit_rotation(self.pose_in_console.rotation.coords.into())?;
        position.iter().all(|x| x.is_finite()).then(|| Isometry3::from_parts(position.into(), rotation))
    }
}

/// What a robot replied last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotReport {
    /// Force at each arm in the robot's frame \[N\].
    pub forces_in_robot: [Vector3<f64>; ARMS],
    /// State of the robot; `None` when it sent a number that is none.
    pub runlevel: Option<Runlevel>,
    /// Bit `n` is set while joint `n` is at a limit.
    pub joint_flags: u32,
    /// Number of our last packet that the robot applied; 0 before the first.
    pub last_sequence: u32,
    /// When the reply came.
    pub received_at: SimTime,
}

/// Where hand and arm were when a motion began.
#[derive(Clone, Copy, Debug)]
struct Anchor {
    hand_in_console: Isometry3<f64>,
    arm: ArmPose,
}

/// One hand's arm, as the console knows it.
#[derive(Clone, Copy, Debug)]
struct Follower {
    /// Sum of everything that was sent.
    sent: ArmPose,
    /// The motion that goes on; `None` while the pedal is up or the hand's pose is none.
    anchor: Option<Anchor>,
}

/// What a packet says of one arm.
#[derive(Clone, Copy, Debug)]
struct Command {
    position_um: [i32; 3],
    rotation: UnitQuaternion<f64>,
    grasp: i32,
    buttons: i32,
}

/// The surgeon's end of ITP.
#[derive(Clone, Debug)]
pub struct Console {
    config: ConsoleConfig,
    sequence: u32,
    followers: [Follower; ARMS],
    /// Number of the newest reply.
    newest_reply: Option<u32>,
    report: Option<RobotReport>,
}

impl Console {
    /// A console whose first packet has number 1.
    pub fn new(config: ConsoleConfig) -> Result<Self, ConfigError> {
        let ConsoleConfig { scale, increment_um_max, rotation_max, .. } = config;
        if !(scale > 0.0 && scale <= SCALE_MAX) {
            return Err(ConfigError::Scale(scale));
        }
        check_limits(increment_um_max, rotation_max)?;
        let arms = start(&config.start_in_robot, &config.start_jaw)?;
        let followers = arms.map(|sent| Follower { sent, anchor: None });
        Ok(Self { config, sequence: 0, followers, newest_reply: None, report: None })
    }

    /// The next packet, for these hands and this pedal; once a period, with the pedal up too.
    ///
    /// The arm of a hand whose pose is no pose stands still until it is one again, and its motion then begins anew.
    pub fn command(&mut self, hands: &[ConsoleHand; ARMS], pedal_down: bool) -> ConsolePacket {
        self.sequence = cycle::next(self.sequence);
        let commands = [0, 1].map(|arm| self.followers[arm].follow(&self.config, &hands[arm], pedal_down));
        let Dialect { layout, .. } = self.config.dialect;
        ConsolePacket {
            sequence: self.sequence,
            packet_type: 0,
            version: 0,
            position_um: commands.map(|command| command.position_um),
            rotations: Rotations::new(layout, &commands.map(|command| command.rotation)),
            buttons: commands.map(|command| command.buttons),
            grasp: commands.map(|command| command.grasp),
            surgeon_mode: if pedal_down { SURGEON_ENGAGED } else { SURGEON_DISENGAGED },
        }
    }

    /// Takes a robot's reply. `Ok(true)`: it is the newest, and reported; `Ok(false)`: a newer one came before it.
    pub fn receive(&mut self, datagram: &[u8], now: SimTime) -> Result<bool, PacketError> {
        let reply = RobotPacket::decode(datagram, self.config.check_checksum)?;
        if let Some(newest) = self.newest_reply {
            let ahead = cycle::ahead(reply.sequence, newest);
            if (-REPLY_RESET_BEHIND..=0).contains(&ahead) {
                return Ok(false);
            }
        }
        self.newest_reply = Some(reply.sequence);
        self.report = Some(RobotReport {
            forces_in_robot: reply.force_mn.map(|mn| Vector3::from(mn).map(|mn| f64::from(mn) / 1e3)),
            runlevel: Runlevel::from_number(reply.runlevel),
            joint_flags: reply.joint_flags,
            last_sequence: reply.last_sequence,
            received_at: now,
        });
        Ok(true)
    }

    /// What the robot replied last.
    pub fn report(&self) -> Option<&RobotReport> {
        self.report.as_ref()
    }

    /// Forces at the arms in the robot's frame \[N\]: those of the newest reply, which fade from [`FORCE_FADES`] on and are
    /// zero at [`FORCE_GONE`].
    pub fn forces_in_robot(&self, now: SimTime) -> [Vector3<f64>; ARMS] {
        let Some(report) = &self.report else { return [Vector3::zeros(); ARMS] };
        let left = FORCE_GONE.since(now.since(report.received_at)).as_secs_f64();
        let share = left / FORCE_GONE.since(FORCE_FADES).as_secs_f64();
        report.forces_in_robot.map(|force| force * share.min(1.0))
    }

    /// Where an arm (0 or 1) is, if every packet was applied.
    pub fn sent(&self, arm: usize) -> &ArmPose {
        &self.followers[arm].sent
    }

    /// Number of the last packet; 0 before the first.
    pub fn sequence(&self) -> u32 {
        self.sequence
    }

    /// Goes on after this number, as a console that was started again would if it remembered.
    pub fn resume_after(&mut self, sequence: u32) {
        self.sequence = sequence;
    }
}

/// What the robot, too, demands of limits.
pub(super) fn check_limits(increment_um_max: u32, rotation_max: f64) -> Result<(), ConfigError> {
    if !(1..=INCREMENT_UM_MAX).contains(&increment_um_max) {
        return Err(ConfigError::Increment(increment_um_max));
    }
    if !(rotation_max > 0.0 && rotation_max <= ROTATION_MAX) {
        return Err(ConfigError::Rotation(rotation_max));
    }
    Ok(())
}

/// Arms where they start.
pub(super) fn start(
    poses_in_robot: &[Isometry3<f64>; ARMS],
    jaws: &[f64; ARMS],
) -> Result<[ArmPose; ARMS], ConfigError> {
    let arm = |arm: usize| ArmPose::new(&poses_in_robot[arm], jaws[arm]).ok_or(ConfigError::Start(arm));
    Ok([arm(0)?, arm(1)?])
}

impl Follower {
    /// Takes the arm a packet's step towards the hand; returns what the packet says of it.
    fn follow(&mut self, config: &ConsoleConfig, hand: &ConsoleHand, pedal_down: bool) -> Command {
        let before = self.sent;
        let pose = if pedal_down { hand.valid_pose() } else { None };
        let mut turned = UnitQuaternion::identity();
        match pose {
            None => self.anchor = None,
            Some(hand_in_console) => {
                let anchor = *self.anchor.get_or_insert(Anchor { hand_in_console, arm: before });
                self.sent.position_um_in_robot =
                    step_position(config, &anchor, &hand_in_console, &before.position_um_in_robot);
                turned = step_rotation(config, &anchor, &hand_in_console, &before.rotation_in_robot);
                self.sent.rotation_in_robot = after(&turned, &before.rotation_in_robot);
                if hand.jaw.is_finite() {
                    let change = jaw_mrad(hand.jaw) - before.jaw_mrad;
                    let jaw = before.jaw_mrad + change.clamp(-JAW_MRAD_MAX, JAW_MRAD_MAX);
                    self.sent.jaw_mrad = jaw.clamp(GRASP_MIN_MRAD, GRASP_MAX_MRAD);
                }
            }
        }
        let um = [0, 1, 2].map(|axis| match config.dialect.position {
            Meaning::Increment => self.sent.position_um_in_robot[axis] - before.position_um_in_robot[axis],
            Meaning::Absolute => self.sent.position_um_in_robot[axis],
        });
        Command {
            position_um: um.map(|um| um.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32),
            rotation: match config.dialect.rotation {
                Meaning::Increment => turned,
                Meaning::Absolute => self.sent.rotation_in_robot,
            },
            grasp: match config.dialect.grasp {
                GraspMeaning::Torque if pose.is_some() && hand.squeeze.is_finite() => {
                    (hand.squeeze.clamp(-1.0, 1.0) * f64::from(GRASP_TORQUE_MAX)).round() as i32
                }
                GraspMeaning::Torque => 0,
                GraspMeaning::AngleIncrement => before.jaw_mrad - self.sent.jaw_mrad,
                GraspMeaning::Angle => self.sent.jaw_mrad,
            },
            buttons: hand.buttons as i32,
        }
    }
}

/// The arm's next position \[µm\].
fn step_position(
    config: &ConsoleConfig,
    anchor: &Anchor,
    hand_in_console: &Isometry3<f64>,
    sent_um: &[i64; 3],
) -> [i64; 3] {
    let moved = hand_in_console.translation.vector - anchor.hand_in_console.translation.vector;
    let max = i64::from(config.increment_um_max);
    [0, 1, 2].map(|axis| {
        // The conversion saturates, and so do the sums: a hand may be anywhere.
        let moved_um = (moved[axis] * config.scale * UM_PER_M).round() as i64;
        let wanted_um = anchor.arm.position_um_in_robot[axis].saturating_add(moved_um);
        sent_um[axis].saturating_add(wanted_um.saturating_sub(sent_um[axis]).clamp(-max, max))
    })
}

/// The increment that takes the arm's rotation towards the hand's.
fn step_rotation(
    config: &ConsoleConfig,
    anchor: &Anchor,
    hand_in_console: &Isometry3<f64>,
    sent: &UnitQuaternion<f64>,
) -> UnitQuaternion<f64> {
    let turned = after(&hand_in_console.rotation, &anchor.hand_in_console.rotation.inverse());
    let wanted = after(&turned, &anchor.arm.rotation_in_robot);
    let increment = after(&wanted, &sent.inverse());
    match increment.axis_angle() {
        Some((axis, angle)) if angle > config.rotation_max => {
            UnitQuaternion::from_axis_angle(&axis, config.rotation_max)
        }
        // Of the two quaternions of a rotation, the one that peers expect.
        _ if increment.w < 0.0 => UnitQuaternion::new_unchecked(-increment.into_inner()),
        _ => increment,
    }
}

#[cfg(test)]
#[path = "console_tests.rs"]
mod tests;
