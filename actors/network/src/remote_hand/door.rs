//! Door: admits the samples of an authenticated but possibly nonsensical hand at another station.
//!
//! Guarantees, whatever arrives (each with a test of its name):
//!
//! - what comes out is finite, and within the device's workspace, or where the hand was when the door took over from it;
//! - it moves, turns, opens and closes no faster than [`DoorLimits`] allow: a jump becomes an approach;
//! - it moves evenly, although samples come unevenly, as a [`ConstantAge`];
//! - its velocity is that of the motion let through, whatever the sample claims;
//! - forces are within the limits, and fade with the time since the newest datagram *arrived*, never with the path's
//!   delay: 1 up to 50 ms, 0 from 100 ms;
//! - silence of 100 ms releases every button and pedal, holds the jaws, and stops the motion, short of the goal at the latest;
//! - who returns from silence, takes the hand over, or offers his own anew, moves nothing by it (a [`Clutch`] takes up the
//!   difference), and must release a button or pedal before a press of it counts.
//!
//! A sample that is refused counts as not having arrived: a station that sends only nonsense falls silent.
//! A door reads no clock, allocates nothing and never blocks; same inputs, same bits.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use thiserror::Error;
use trocar_devices::{Capabilities, DeviceState, Dofs, HAS_PEDALS, Pedals, Workspace, Wrench};
use trocar_scene::SimTime;

use super::clutch::Clutch;
use super::constant_age::ConstantAge;
use super::grip::{GripMatch, PedalGate};
use super::limits::{DoorLimits, LimitError};
use super::motion::{Caps, MotionLimiter, STEP_MAX_SECS, shortened};
use crate::hand_sample::HandSample;

/// How far from unit length a rotation may be that is renormalised: single precision is 1e-7 off.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Buttons that a sample carries.
const BUTTONS: u32 = 0xffff | Pedals::MASK;
/// Share of an interval between datagrams that the newest interval has in the estimate.
const INTERVAL_BLEND: f64 = 0.125;
/// A stream whose interval is at most this many steps is followed at once; one that is slower is spread.
const SPREAD_FROM_STEPS: f64 = 1.5;

/// Why a sample is refused. Carries no heap data, since it occurs at the datagrams' rate.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// The sample is of another hand.
    #[error("the sample is of hand {found}, and this door admits hand {expected}")]
    UnknownHand {
        /// The sample's hand.
        found: u8,
        /// The door's hand.
        expected: u8,
    },
    /// A NaN, an infinity, or a rotation that is none.
    #[error(
        "the sample of hand {hand} has a number that is not finite, or a rotation that is not of unit length"
    )]
    Invalid {
        /// The hand.
        hand: u8,
    },
    /// A newer one arrived before, or it has waited for so long that its station counts as silent.
    #[error("the sample of hand {hand} arrived before the newest one, or too long ago")]
    Older {
        /// The hand.
        hand: u8,
    },
}

/// How the station stands to the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// The door is open, and nothing has arrived yet.
    Waiting,
    /// Samples arrive, and move the hand.
    Live,
    /// No sample has arrived for [`DoorLimits::silence_secs`]; the hand is still connected as far as is known.
    Silent,
    /// The station says that its device is unplugged.
    Unplugged,
}

/// Counters of a door.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DoorStatistics {
    /// Samples that were admitted.
    pub admitted: u64,
    /// Samples refused because they are of another hand.
    pub refused_hand: u64,
    /// Samples refused because of a NaN, an infinity or a rotation that is none.
    pub refused_invalid: u64,
    /// Samples refused because a newer one arrived before, or because they waited for too long.
    pub refused_older: u64,
    /// Samples with a position outside the workspace.
    pub clamped_workspace: u64,
    /// Samples with too great a force or torque.
    pub clamped_wrench: u64,
    /// Samples with a gripper out of range.
    pub clamped_gripper: u64,
    /// Steps in which a limit of speed acted on the motion or the turn.
    pub speed_limited: u64,
    /// Steps in which the limit of speed acted on the gripper.
    pub gripper_limited: u64,
    /// Times at which the station fell silent.
    pub silences: u64,
    /// Times at which it returned.
    pub returns: u64,
    /// Times at which the station's motion was taken up from where the hand was.
    pub clutches: u64,
}

/// The door of one hand.
#[derive(Clone, Debug)]
pub struct Door {
    number: u8,
    limits: DoorLimits,
    // The device's workspace, and the same with the point at which the door took over.
    workspace: Workspace,
    bounds: Workspace,
    force_max: f64,
    torque_max: f64,

    standing: Standing,
    since: SimTime,
    arrived_at: Option<SimTime>,
    stepped_at: Option<SimTime>,
    // None before the hand has a place.
    motion: Option<MotionLimiter>,
    // None while the clutch is open.
    clutch: Option<Clutch>,
    // How often the station has offered its hand anew, as it said last.
    offers: Option<u8>,
    hand: ConstantAge,
    goal_in_device: Isometry3<f64>,
    // What is left of the way to the goal when the newest sample came, as a slow stream's steps are spread.
    way: Way,
    // Caps of speed while the motion stops.
    stopping: Caps,
    interval_secs: f64,
    left_secs: f64,
    holding: bool,
    mirroring: bool,
    grip: GripMatch,
    fingers: f64,
    gate: PedalGate,
    buttons: u32,
    wrench: Wrench,
    statistics: DoorStatistics,
}

impl Door {
    /// A door for samples of `hand`, which stands for a device with these capabilities. The hand has no place yet: the
    /// first sample gives it one.
    ///
    /// # Errors
    /// [`LimitError`] when a limit is out of range or the workspace is no box.
    pub fn new(hand: u8, limits: DoorLimits, capabilities: &Capabilities) -> Result<Self, LimitError> {
        limits.check()?;
        let workspace = capabilities.workspace;
        let size = workspace.size();
        if !size.iter().all(|edge| edge.is_finite() && *edge >= 0.0) {
            return Err(LimitError::Workspace { device: capabilities.name.clone() });
        }
        let torque_max = if capabilities.output_dofs == Dofs::Six { capabilities.max_torque } else { 0.0 };
        Ok(Self {
            number: hand,
            limits,
            workspace,
            bounds: workspace,
            // `max` and `min` drop a NaN.
            force_max: capabilities.max_force_newtons.max(0.0).min(limits.force_max),
            torque_max: torque_max.max(0.0).min(limits.torque_max),
            standing: Standing::Waiting,
            since: SimTime::ZERO,
            arrived_at: None,
            stepped_at: None,
            motion: None,
            clutch: None,
            offers: None,
            hand: ConstantAge::default(),
            goal_in_device: Isometry3::identity(),
            way: Way::NONE,
            stopping: Caps { linear_speed: 0.0, angular_speed: 0.0 },
            interval_secs: 0.0,
            left_secs: 0.0,
            holding: false,
            mirroring: false,
            grip: GripMatch::following(0.0),
            fingers: 0.0,
            gate: PedalGate::default(),
            buttons: 0,
            wrench: Wrench::ZERO,
            statistics: DoorStatistics::default(),
        })
    }

    /// The limits.
    pub fn limits(&self) -> &DoorLimits {
        &self.limits
    }

    /// Counters since the door was made.
    pub fn statistics(&self) -> &DoorStatistics {
        &self.statistics
    }

    /// How the station stands to the hand, as of the latest step.
    pub fn standing(&self) -> Standing {
        self.standing
    }

    /// Where the hand should be for a sample of this pose, before the limits; `None` while the clutch is open.
    pub fn goal_of(&self, hand_in_device: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        self.clutch.map(|clutch| clutch.shown(hand_in_device))
    }

    /// Time since the newest sample arrived, or since the door was opened if none has.
    pub fn age(&self, now: SimTime) -> SimTime {
        now.since(self.arrived_at.unwrap_or(self.since))
    }

    /// Says whether the instrument holds something, so that its jaws wait for the fingers of whoever comes.
    pub fn set_holding(&mut self, holding: bool) {
        self.holding = holding;
    }

    /// Says whether the hand goes to the place that the station names, at the speed that the limits allow, rather than
    /// follow its motion from where it is.
    pub fn set_mirroring(&mut self, mirroring: bool) {
        self.mirroring = mirroring;
    }

    /// Opens the door to a station at time `now`: the hand stays where it is shown at present, until the station's first
    /// sample closes the clutch. A hand that has never had a place (`None`) gets it from the first sample.
    pub fn open(&mut self, now: SimTime, shown: Option<&DeviceState>) {
        self.standing = Standing::Waiting;
        self.since = now;
        self.arrived_at = None;
        self.stepped_at = Some(now);
        self.offers = None;
        self.bounds = self.workspace;
        self.release();
        self.buttons = 0;
        self.motion = shown.filter(|shown| shown.is_valid()).map(|shown| {
            let position = shown.pose_in_device.translation.vector;
            // Where the hand is, a hand can be: its own device has a wall there, or none.
            self.bounds.min_in_device = self.bounds.min_in_device.inf(&position);
            self.bounds.max_in_device = self.bounds.max_in_device.sup(&position);
            self.goal_in_device = shown.pose_in_device;
            self.grip = GripMatch::following(shown.gripper.max(0.0).min(self.limits.gripper_max));
            self.fingers = self.grip.angle();
            let (linear, angular) = (shown.linear_velocity, shown.angular_velocity);
            MotionLimiter::from_motion(shown.pose_in_device, linear, angular, self.caps())
        });
        // The hand is held at once; only what is told of its velocity decays.
        self.stopping = Caps { linear_speed: 0.0, angular_speed: 0.0 };
    }

    /// Takes a sample that has arrived, at time `now`.
    ///
    /// # Errors
    /// [`Refusal`] when it is of another hand, has a number that is none, or is not the newest.
    pub fn admit(
        &mut self,
        now: SimTime,
        arrival: impl Into<Arrival>,
        sample: &HandSample,
    ) -> Result<(), Refusal> {
        let Arrival { at: arrived_at, measured_at } = arrival.into();
        let hand = self.number;
        if sample.hand != hand {
            self.statistics.refused_hand += 1;
            return Err(Refusal::UnknownHand { found: sample.hand, expected: hand });
        }
        let Some(hand_in_device) = checked_pose(sample) else {
            self.statistics.refused_invalid += 1;
            return Err(Refusal::Invalid { hand });
        };
        // An arrival ahead of this clock would keep a dead station alive.
        let arrived_at = arrived_at.min(now);
        let waited_secs = now.since(arrived_at).as_secs_f64();
        if self.arrived_at.is_some_and(|newest| arrived_at < newest)
            || waited_secs >= self.limits.silence_secs
        {
            self.statistics.refused_older += 1;
            return Err(Refusal::Older { hand });
        }
        self.watch(arrived_at);
        let gap_secs = self.arrived_at.map_or(0.0, |before| arrived_at.since(before).as_secs_f64());
        self.arrived_at = Some(arrived_at);
        self.statistics.admitted += 1;
        if !sample.state.connected {
            self.standing = Standing::Unplugged;
            self.stop();
            return Ok(());
        }
        self.statistics.returns += u64::from(self.standing == Standing::Silent);
        self.standing = Standing::Live;
        let offers = self.offers.replace(sample.clutch);
        if !self.mirroring && offers.is_some_and(|before| before != sample.clutch) {
            // The station has brought its hand to where the instrument is; it may have taken less time than a silence.
            self.release();
        }
        let (linear, angular) = (sample.state.linear_velocity, sample.state.angular_velocity);
        let Caps { linear_speed, angular_speed } = self.caps();
        let (linear, angular) = (shortened(linear, linear_speed), shortened(angular, angular_speed));
        self.hand.take(measured_at, hand_in_device, linear, angular);
        self.aim(now, gap_secs);
        self.press(&sample.state);
        self.wrench = self.limited(&sample.wrench);
        Ok(())
    }

    /// One step to time `now`, which must not decrease: the state that the hand has here.
    pub fn step(&mut self, now: SimTime) -> DeviceState {
        self.watch(now);
        let step_secs = self.stepped_at.map_or(0.0, |before| now.since(before).as_secs_f64());
        self.stepped_at = Some(self.stepped_at.map_or(now, |before| before.max(now)));
        let step_secs = step_secs.min(STEP_MAX_SECS);
        let live = self.clutch.is_some();
        let caps = if live {
            let left = self.left(step_secs);
            let goal = self.goal(now, step_secs).unwrap_or(self.goal_in_device);
            self.goal_in_device = self.way.short_of(&goal, left);
            self.caps()
        } else {
            let slower = |speed: f64, deceleration: f64| (speed - deceleration * step_secs).max(0.0);
            self.stopping = Caps {
                linear_speed: slower(self.stopping.linear_speed, self.limits.linear_deceleration),
                angular_speed: slower(self.stopping.angular_speed, self.limits.angular_deceleration),
            };
            self.stopping
        };
        if let Some(motion) = &mut self.motion {
            let limited = motion.step(&self.goal_in_device, caps, step_secs);
            self.statistics.speed_limited += u64::from(live && limited);
            let change_max = self.limits.gripper_speed * step_secs;
            let limited = live && self.grip.step(self.fingers, change_max, self.limits.grip_match);
            self.statistics.gripper_limited += u64::from(limited);
        }
        self.state()
    }

    /// The state of the latest step.
    pub fn state(&self) -> DeviceState {
        let Some(motion) = &self.motion else { return DeviceState::unknown() };
        DeviceState {
            pose_in_device: *motion.pose_in_device(),
            linear_velocity: *motion.linear_velocity(),
            angular_velocity: *motion.angular_velocity(),
            gripper: self.grip.angle(),
            buttons: self.buttons,
            connected: self.standing != Standing::Unplugged,
        }
    }

    /// The wrench of the newest sample, within the limits, faded by the time since it arrived.
    pub fn wrench(&self, now: SimTime) -> Wrench {
        let Some(arrived_at) = self.arrived_at else { return Wrench::ZERO };
        let DoorLimits { fade_start_secs, fade_end_secs, .. } = self.limits;
        let age_secs = now.since(arrived_at).as_secs_f64();
        if age_secs <= fade_start_secs {
            return self.wrench;
        }
        if age_secs >= fade_end_secs {
            return Wrench::ZERO;
        }
        self.wrench * ((fade_end_secs - age_secs) / (fade_end_secs - fade_start_secs))
    }

    /// Notes that the station is silent, if it is.
    fn watch(&mut self, now: SimTime) {
        let silent = self.age(now).as_secs_f64() >= self.limits.silence_secs;
        if silent && self.standing == Standing::Live {
            self.standing = Standing::Silent;
            self.statistics.silences += 1;
            self.stop();
        }
    }

    /// Opens the clutch and releases what acts; what moves comes to rest by itself.
    fn stop(&mut self) {
        if self.clutch.is_some()
            && let Some(motion) = &self.motion
        {
            self.stopping = motion.speed();
        }
        self.release();
    }

    fn release(&mut self) {
        self.clutch = None;
        self.gate.close();
        // Pedals that are released still are the only ones that count.
        self.buttons &= HAS_PEDALS;
        self.wrench = Wrench::ZERO;
    }

    fn caps(&self) -> Caps {
        Caps { linear_speed: self.limits.linear_speed, angular_speed: self.limits.angular_speed }
    }

    /// Where the hand of the newest sample is to be now, by way of the clutch and within bounds; `None` while that is open.
    fn goal(&mut self, now: SimTime, step_secs: f64) -> Option<Isometry3<f64>> {
        let mut goal = self.clutch?.shown(&self.hand.step(now, step_secs));
        let wanted = goal.translation.vector;
        goal.translation.vector = wanted.sup(&self.bounds.min_in_device).inf(&self.bounds.max_in_device);
        Some(goal)
    }

    /// Sets out for the place of the newest sample; closes the clutch first if it is open.
    fn aim(&mut self, now: SimTime, gap_secs: f64) {
        let hand_in_device = self.hand.step(now, 0.0);
        let clutch = match (self.clutch, &self.motion) {
            (Some(clutch), _) => {
                let gap_secs = gap_secs.min(self.limits.spread_max_secs);
                let blend = if self.interval_secs > 0.0 { INTERVAL_BLEND } else { 1.0 };
                self.interval_secs += blend * (gap_secs - self.interval_secs);
                clutch
            }
            (None, Some(motion)) => {
                self.interval_secs = 0.0;
                self.statistics.clutches += 1;
                if self.holding {
                    self.grip.unmatch();
                }
                if self.mirroring {
                    Clutch::identity()
                } else {
                    Clutch::between(&hand_in_device, motion.pose_in_device())
                }
            }
            (None, None) => {
                self.interval_secs = 0.0;
                self.statistics.clutches += 1;
                Clutch::identity()
            }
        };
        self.clutch = Some(clutch);
        self.left_secs = self.interval_secs;
        let wanted = clutch.shown(&hand_in_device).translation.vector;
        let Some(goal) = self.goal(now, 0.0) else { return };
        // Without the rounding of the clutch, which would count a hand that waits at the wall.
        self.statistics.clamped_workspace += u64::from((goal.translation.vector - wanted).amax() > 1e-12);
        self.way = self.motion.map_or(Way::NONE, |motion| Way::between(&goal, motion.pose_in_device()));
        self.goal_in_device = goal;
    }

    fn press(&mut self, state: &DeviceState) {
        let buttons = state.buttons & BUTTONS;
        self.buttons = self.gate.pass(buttons & !HAS_PEDALS) | (buttons & HAS_PEDALS);
        self.fingers = state.gripper.max(0.0).min(self.limits.gripper_max);
        self.statistics.clamped_gripper += u64::from(self.fingers != state.gripper);
        if self.motion.is_none() {
            self.motion = Some(MotionLimiter::at_rest(self.goal_in_device));
            self.grip = GripMatch::following(self.fingers);
        }
    }

    fn limited(&mut self, wrench: &Wrench) -> Wrench {
        let limited = Wrench {
            force: shortened(wrench.force, self.force_max),
            torque: shortened(wrench.torque, self.torque_max),
        };
        // A torque that the device cannot drive is dropped, and is no nonsense.
        let torque_counts = self.torque_max > 0.0;
        self.statistics.clamped_wrench +=
            u64::from(limited.force != wrench.force || (torque_counts && limited.torque != wrench.torque));
        limited
    }

    /// Share of the way that is left after a step. A slow stream's steps are spread over the time until the next datagram
    /// is due, so that a hand at 60 Hz does not hammer on what it touches; at 1 kHz nothing is delayed.
    fn left(&mut self, step_secs: f64) -> f64 {
        if self.interval_secs <= SPREAD_FROM_STEPS * step_secs || self.left_secs <= step_secs {
            self.left_secs = 0.0;
            return 0.0;
        }
        self.left_secs -= step_secs;
        self.left_secs / self.interval_secs
    }
}

/// When a sample arrived, and when it was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// When it arrived, by this session's clock.
    pub at: SimTime,
    /// When it was measured, by this session's clock; `None` if the sample is to be shown as it comes.
    pub measured_at: Option<SimTime>,
}

impl From<SimTime> for Arrival {
    fn from(at: SimTime) -> Self {
        Self { at, measured_at: None }
    }
}

/// How far and how turned the shown pose is from its goal.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Way {
    shift: Vector3<f64>,
    turn: Quaternion<f64>,
}

impl Way {
    const NONE: Self = Self { shift: Vector3::new(0.0, 0.0, 0.0), turn: Quaternion::new(1.0, 0.0, 0.0, 0.0) };

    fn between(goal: &Isometry3<f64>, shown: &Isometry3<f64>) -> Self {
        let turn = shown.rotation.into_inner() * goal.rotation.into_inner().conjugate();
        let turn = if turn.w < 0.0 { -turn } else { turn };
        Self { shift: shown.translation.vector - goal.translation.vector, turn }
    }

    /// A pose that is short of the goal by this share of the way.
    fn short_of(&self, goal: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
        if share <= 0.0 {
            return *goal;
        }
        let turn = Quaternion::new(1.0, 0.0, 0.0, 0.0) * (1.0 - share) + self.turn * share;
        Isometry3::from_parts(
            (goal.translation.vector + self.shift * share).into(),
            UnitQuaternion::new_normalize(turn * goal.rotation.into_inner()),
        )
    }
}

/// The sample's pose, with its rotation brought to unit length; `None` if anything of the sample is no number.
fn checked_pose(sample: &HandSample) -> Option<Isometry3<f64>> {
    let state = &sample.state;
    let finite = |vector: &Vector3<f64>| vector.iter().all(|x| x.is_finite());
    let mut pose = state.pose_in_device;
    let length = pose.rotation.coords.norm();
    // A NaN length fails the comparison as well.
    let sound = (length - 1.0).abs() <= ROTATION_TOLERANCE
        && finite(&pose.translation.vector)
        && finite(&state.linear_velocity)
        && finite(&state.angular_velocity)
        && state.gripper.is_finite()
        && sample.wrench.is_finite();
    pose.rotation.renormalize();
    sound.then_some(pose)
}
