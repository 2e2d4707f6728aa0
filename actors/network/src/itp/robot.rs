//! Robot of ITP, the slave: packets in, poses of two arms out.
//!
//! Packets are judged by their number, as the Raven does: the next one is applied; a number twice is a duplicate; a number
//! beyond the next one shows a gap, and that packet is not applied either; a number more than [`RESET_BEHIND`] behind is
//! from a console that was started again, and numbers go on from there. Only while the robot is ready and the pedal down do
//! increments count. Poses are where the arms have to go: limits on speed, force and workspace belong to what moves them.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::SimTime;

use super::{
    ARMS, ArmPose, ConfigError, ConsolePacket, Dialect, GRASP_MAX_MRAD, GRASP_MIN_MRAD, GRASP_TORQUE_MAX,
    GraspMeaning, Meaning, PacketError, REACH_UM_MAX, RobotPacket, Runlevel, console, cycle,
};

/// A packet so many numbers behind is no late one.
pub const RESET_BEHIND: i64 = 1_000;
/// Period of the Raven's control loop.
pub const TICK: SimTime = SimTime::from_millis(1);
/// Ticks of silence after which the Raven takes the pedal as released.
pub const SILENCE_TICKS: u64 = 5_000;
/// Silence after which a robot in a session takes the pedal as released.
pub const SILENCE: SimTime = SimTime::from_millis(100);

/// Parameters of a [`Robot`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotConfig {
    /// The variant that the console speaks.
    pub dialect: Dialect,
    /// Whether packets with a wrong checksum are refused. Some consoles send none.
    pub check_checksum: bool,
    /// Whether the packet that shows a gap is applied. The Raven does not.
    pub lenient: bool,
    /// Largest increment of a position in a packet, along each axis \[µm\], 1 to [`INCREMENT_UM_MAX`]: a packet with more is
    /// refused.
    ///
    /// [`INCREMENT_UM_MAX`]: super::INCREMENT_UM_MAX
    pub increment_um_max: u32,
    /// Largest increment of a rotation in a packet \[rad\], at most [`ROTATION_MAX`](super::ROTATION_MAX).
    pub rotation_max: f64,
    /// How far an arm can go from the origin, along each axis \[µm\], 1 to [`REACH_UM_MAX`]. It holds still there.
    pub reach_um: u32,
    /// The pedal counts as released after more than this time without an applied packet.
    pub silence: SimTime,
    /// Whether the pedal has to be released and pressed again at the start, after silence, after a stop, and when the
    /// console was started again. The Raven follows at once.
    pub press_again: bool,
    /// Where the arms start.
    pub start_in_robot: [Isometry3<f64>; ARMS],
    /// Opening of the jaws at the start \[rad\].
    pub start_jaw: [f64; ARMS],
}

impl Default for RobotConfig {
    fn default() -> Self {
        Self {
            dialect: Dialect::RAVEN,
            check_checksum: true,
            lenient: false,
            increment_um_max: 2_000,
            rotation_max: 0.05,
            reach_um: 1_000_000,
            silence: SILENCE,
            press_again: true,
            start_in_robot: [Isometry3::identity(); ARMS],
            start_jaw: [0.0; ARMS],
        }
    }
}

impl RobotConfig {
    /// As the Raven II behaves: checksums are not looked at, five seconds of silence, and a pedal that is still down after
    /// them moves the arms.
    pub fn raven() -> Self {
        Self {
            check_checksum: false,
            silence: SimTime(SILENCE_TICKS * TICK.as_nanos()),
            press_again: false,
            ..Self::default()
        }
    }
}

/// What the robot itself is able to do, whatever the console says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Emergency stop.
    Stopped,
    /// It finds its zero positions.
    Initialising,
    /// It can follow.
    Ready,
}

/// What became of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The next one: applied.
    Applied,
    /// It shows that packets are missing.
    Gap {
        /// How many.
        missed: u32,
        /// Whether this one was applied: [`RobotConfig::lenient`].
        applied: bool,
    },
    /// Its number was the last one's.
    Duplicate,
    /// It came too late.
    OutOfOrder,
    /// From a console that was started again: not applied, but the next one will be.
    Reset,
    /// Number 0, which only asks whether somebody is there.
    Question,
}

/// Why a packet was refused. Nothing of it was applied, and the robot hears silence. A pedal that is up always counts: the
/// rest of its packet is not looked at.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// It is no packet.
    #[error(transparent)]
    Packet(#[from] PacketError),
    /// An increment of a position is too large.
    #[error("ITP packet {sequence} moves arm {arm} by {um} µm; at most {max} µm are followed")]
    Increment {
        /// Number of the packet.
        sequence: u32,
        /// 0 or 1.
        arm: usize,
        /// The largest increment along an axis.
        um: i32,
        /// The limit.
        max: u32,
    },
    /// An increment of a rotation is too large.
    #[error("ITP packet {sequence} turns arm {arm} by {angle:.3} rad; at most {max} rad are followed")]
    Turn {
        /// Number of the packet.
        sequence: u32,
        /// 0 or 1.
        arm: usize,
        /// The angle.
        angle: f64,
        /// The limit.
        max: f64,
    },
    /// A rotation is none.
    #[error(
        "the rotation of arm {arm} in ITP packet {sequence} is none; it has to be finite and of unit length"
    )]
    Rotation {
        /// Number of the packet.
        sequence: u32,
        /// 0 or 1.
        arm: usize,
    },
}

/// How many packets had which fate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotCounts {
    /// Applied, also with the pedal up.
    pub applied: u64,
    /// Not applied because they showed a gap.
    pub after_gap: u64,
    /// Missing according to the numbers; late ones are not subtracted.
    pub missed: u64,
    /// Came twice.
    pub duplicates: u64,
    /// Came too late.
    pub out_of_order: u64,
    /// Consoles that were started again.
    pub resets: u64,
    /// Number 0.
    pub questions: u64,
    /// No packets: wrong size or checksum.
    pub malformed: u64,
    /// Moved or turned an arm too far at once.
    pub too_far: u64,
    /// Had a rotation that is none.
    pub no_rotation: u64,
    /// Applied, but an arm had to stop at its reach.
    pub beyond_reach: u64,
    /// Silences that released the pedal.
    pub silences: u64,
}

/// The patient's end of ITP.
#[derive(Clone, Debug)]
pub struct Robot {
    config: RobotConfig,
    condition: Condition,
    arms: [ArmPose; ARMS],
    torques: [f64; ARMS],
    buttons: [u32; ARMS],
    /// Number of the last packet that came in order; `None` before the first.
    last: Option<u32>,
    last_applied: u32,
    heard_at: SimTime,
    pedal_down: bool,
    /// Whether the pedal has to be seen up before it counts as down.
    release_first: bool,
    replies: u32,
    counts: RobotCounts,
}

impl Robot {
    /// A robot that initialises, and has heard nobody.
    pub fn new(config: RobotConfig) -> Result<Self, ConfigError> {
        console::check_limits(config.increment_um_max, config.rotation_max)?;
        if !(1..=REACH_UM_MAX).contains(&config.reach_um) {
            return Err(ConfigError::Reach(config.reach_um));
        }
        let arms = console::start(&config.start_in_robot, &config.start_jaw)?;
        let within = |pose: &ArmPose| {
            pose.position_um_in_robot.iter().all(|um| um.unsigned_abs() <= u64::from(config.reach_um))
        };
        if let Some(arm) = arms.iter().position(|pose| !within(pose)) {
            return Err(ConfigError::Start(arm));
        }
        Ok(Self {
            condition: Condition::Initialising,
            arms,
            torques: [0.0; ARMS],
            buttons: [0; ARMS],
            last: None,
            last_applied: 0,
            heard_at: SimTime::ZERO,
            pedal_down: false,
            release_first: config.press_again,
            replies: 0,
            counts: RobotCounts::default(),
            config,
        })
    }

    /// What the robot is able to do from now on. Leaving [`Condition::Ready`] releases the pedal.
    pub fn set_condition(&mut self, condition: Condition) {
        self.condition = condition;
        if condition != Condition::Ready {
            self.release();
        }
    }

    /// Takes a datagram that came at `now`, which must not decrease.
    pub fn receive(&mut self, datagram: &[u8], now: SimTime) -> Result<Verdict, Refusal> {
        self.poll(now);
        let Dialect { layout, .. } = self.config.dialect;
        let packet = ConsolePacket::decode(datagram, layout, self.config.check_checksum)
            .inspect_err(|_| self.counts.malformed += 1)?;
        let verdict = self.judge(packet.sequence);
        if matches!(verdict, Verdict::Applied | Verdict::Gap { applied: true, .. }) {
            let down = packet.pedal_is_down();
            if !down {
                self.release_first = false;
                self.pedal_down = false;
            } else if self.condition == Condition::Ready && !self.release_first {
                self.apply(&packet)?;
                self.pedal_down = true;
            }
            self.heard_at = now;
            self.last_applied = packet.sequence;
            self.counts.applied += 1;
        }
        Ok(verdict)
    }

    /// Time passes: silence releases the pedal. Call it every tick.
    pub fn poll(&mut self, now: SimTime) {
        if self.pedal_down && now.since(self.heard_at) > self.config.silence {
            self.counts.silences += 1;
            self.release();
        }
    }

    /// The robot's operating state.
    pub fn runlevel(&self) -> Runlevel {
        match self.condition {
            Condition::Stopped => Runlevel::EmergencyStop,
            Condition::Initialising => Runlevel::Initialising,
            Condition::Ready if self.pedal_down => Runlevel::PedalDown,
            Condition::Ready => Runlevel::PedalUp,
        }
    }

    /// Where an arm (0 or 1) has to go.
    pub fn arm(&self, arm: usize) -> &ArmPose {
        &self.arms[arm]
    }

    /// How hard the jaws of an arm should close with [`GraspMeaning::Torque`]: 1 with all torque, −1 opens; 0 while the
    /// pedal is up.
    pub fn torque(&self, arm: usize) -> f64 {
        if self.runlevel() == Runlevel::PedalDown { self.torques[arm] } else { 0.0 }
    }

    /// Buttons of a hand (0 or 1); none while the pedal is up, so that no energy flows.
    pub fn buttons(&self, arm: usize) -> u32 {
        if self.runlevel() == Runlevel::PedalDown { self.buttons[arm] } else { 0 }
    }

    /// The next reply, with forces at the arms in the robot's frame \[N\].
    pub fn reply(&mut self, forces_in_robot: &[Vector3<f64>; ARMS], joint_flags: u32) -> RobotPacket {
        self.replies = cycle::next(self.replies);
        RobotPacket {
            sequence: self.replies,
            last_sequence: self.last_applied,
            packet_type: 0,
            version: 0,
            // The conversion saturates, and makes zero of NaN.
            force_mn: forces_in_robot.map(|force| force.map(|newton| (newton * 1e3).round() as i32).into()),
            runlevel: self.runlevel().number(),
            joint_flags,
        }
    }

    /// What became of the packets so far.
    pub fn counts(&self) -> &RobotCounts {
        &self.counts
    }

    /// Judges a packet by its number, and counts it.
    fn judge(&mut self, sequence: u32) -> Verdict {
        if sequence == 0 {
            self.counts.questions += 1;
            return Verdict::Question;
        }
        // The first packet has number 1. Another one shows that the console has been sending before.
        let ahead = self.last.map_or(i64::from(sequence), |last| cycle::ahead(sequence, last));
        let counts = &mut self.counts;
        let verdict = match ahead {
            0 => {
                counts.duplicates += 1;
                return Verdict::Duplicate;
            }
            1 => Verdict::Applied,
            2.. => {
                let (missed, applied) = ((ahead - 1) as u32, self.config.lenient);
                counts.missed += u64::from(missed);
                counts.after_gap += u64::from(!applied);
                Verdict::Gap { missed, applied }
            }
            _ if ahead < -RESET_BEHIND => {
                counts.resets += 1;
                if self.config.press_again {
                    self.release();
                }
                Verdict::Reset
            }
            _ => {
                counts.out_of_order += 1;
                return Verdict::OutOfOrder;
            }
        };
        self.last = Some(sequence);
        verdict
    }

    fn release(&mut self) {
        self.pedal_down = false;
        self.release_first = self.config.press_again;
    }

    /// Applies a packet to both arms, or to none.
    fn apply(&mut self, packet: &ConsolePacket) -> Result<(), Refusal> {
        let rotations = [self.rotation(packet, 0)?, self.rotation(packet, 1)?];
        for arm in 0..ARMS {
            self.check_increment(packet, arm)?;
        }
        let mut beyond = false;
        for (arm, rotation) in rotations.into_iter().enumerate() {
            let pose = &mut self.arms[arm];
            let reach = i64::from(self.config.reach_um);
            for (um, given) in pose.position_um_in_robot.iter_mut().zip(packet.position_um[arm]) {
                let wanted = match self.config.dialect.position {
                    Meaning::Increment => *um + i64::from(given),
                    Meaning::Absolute => i64::from(given),
                };
                *um = wanted.clamp(-reach, reach);
                beyond |= *um != wanted;
            }
            pose.rotation_in_robot = match self.config.dialect.rotation {
                Meaning::Increment => super::after(&rotation, &pose.rotation_in_robot),
                Meaning::Absolute => rotation,
            };
            let grasp = packet.grasp[arm];
            match self.config.dialect.grasp {
                GraspMeaning::Torque => {
                    self.torques[arm] = (f64::from(grasp) / f64::from(GRASP_TORQUE_MAX)).clamp(-1.0, 1.0);
                }
                GraspMeaning::AngleIncrement => {
                    let wanted = pose.jaw_mrad.saturating_sub(grasp);
                    pose.jaw_mrad = wanted.clamp(GRASP_MIN_MRAD, GRASP_MAX_MRAD);
                }
                GraspMeaning::Angle => pose.jaw_mrad = grasp.clamp(GRASP_MIN_MRAD, GRASP_MAX_MRAD),
            }
            self.buttons[arm] = packet.buttons[arm] as u32;
        }
        self.counts.beyond_reach += u64::from(beyond);
        Ok(())
    }

    fn rotation(&mut self, packet: &ConsolePacket, arm: usize) -> Result<UnitQuaternion<f64>, Refusal> {
        let sequence = packet.sequence;
        let Some(rotation) = packet.rotations.rotation(arm) else {
            self.counts.no_rotation += 1;
            return Err(Refusal::Rotation { sequence, arm });
        };
        let (angle, max) = (rotation.angle(), self.config.rotation_max);
        if self.config.dialect.rotation == Meaning::Increment && angle > max {
            self.counts.too_far += 1;
            return Err(Refusal::Turn { sequence, arm, angle, max });
        }
        Ok(rotation)
    }

    fn check_increment(&mut self, packet: &ConsolePacket, arm: usize) -> Result<(), Refusal> {
        let max = self.config.increment_um_max;
        let largest = packet.position_um[arm].into_iter().max_by_key(|um| um.unsigned_abs()).unwrap_or(0);
        if self.config.dialect.position == Meaning::Increment && largest.unsigned_abs() > max {
            self.counts.too_far += 1;
            return Err(Refusal::Increment { sequence: packet.sequence, arm, um: largest, max });
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "robot_tests.rs"]
mod tests;
