//! Slave: a robot that follows a master's poses within its own limits.
//!
//! ```text
//! arrival ─▶ pedal, emergency stop ─▶ scale ─▶ [ Door: clutch, workspace, speed, silence ] ─▶ force limit ─▶ pose
//! ```
//!
//! Guarantees, each with a test of its name:
//!
//! - it follows only while the pedal is down, and never from where the master is to where it is itself: a clutch takes up
//!   the difference in position and rotation, so that a surgeon can move his hands without the slave (indexing);
//! - an emergency stop holds it at once; it follows again only when the stop has ended, and the pedal was released and
//!   pressed;
//! - after 100 ms of silence it stops, and follows again only when the pedal was released and pressed;
//! - the pedals of its current travel with the poses, and count as they arrive; silence, a stop and the clutch switch the
//!   current off, and each pedal must then be released and pressed again;
//! - it moves no faster, no farther and pushes no harder than [`SlaveConfig`] says;
//! - motions are scaled, rotations and jaws are not.
//!
//! Without a pedal the slave follows whatever arrives, still by way of the clutch. It reads no clock and allocates nothing.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_devices::{Capabilities, DeviceState, HAS_PEDALS, Pedals, Workspace};
use trocar_scene::{SimTime, SlaveState};

use super::exchange::{Arrival, SlaveReport};
use super::force_limit::ForceLimit;
use super::tremor_filter::CUTOFF_HZ;
use crate::hand_sample::HandSample;
use crate::remote_hand::{Door, DoorLimits, LimitError, STEP_MAX_SECS, Standing};

/// Buttons that a sample carries.
const BUTTONS: u8 = 16;
/// Period of a driver. A step that follows a late one comes early after it, and has as much time as any other.
const PERIOD: SimTime = SimTime::from_millis(1);

/// A slave, and what is done to its master's motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlaveConfig {
    /// Motion of the slave over motion of the master.
    pub scale: f64,
    /// Edges of the box in which the slave can move, around the device's origin \[m\]; none: the device's own.
    pub workspace: Option<[f64; 3]>,
    /// Fastest motion [m/s].
    pub linear_speed: f64,
    /// Fastest turn [rad/s].
    pub angular_speed: f64,
    /// Greatest force with which the slave pushes \[N\]. It is measured at the master's device, which clamps it.
    pub force_max: f64,
    /// Number of the device's button that is the pedal; none: the slave follows always.
    pub pedal: Option<u8>,
    /// Cut-off of the tremor filter \[Hz\]; none: no filter.
    pub tremor_cutoff_hz: Option<f64>,
}

impl Default for SlaveConfig {
    fn default() -> Self {
        let door = DoorLimits::default();
        Self {
            scale: 1.0,
            workspace: None,
            linear_speed: door.linear_speed,
            angular_speed: door.angular_speed,
            force_max: 3.0,
            pedal: None,
            tremor_cutoff_hz: None,
        }
    }
}

/// A figure of a slave that is out of range.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SlaveError {
    /// A number.
    #[error("slave: {field} = {value} is out of range ({valid})")]
    Range {
        /// Which one.
        field: &'static str,
        /// What it is.
        value: f64,
        /// What is valid.
        valid: String,
    },
    /// A limit of the door.
    #[error(transparent)]
    Door(#[from] LimitError),
}

impl SlaveConfig {
    /// Refuses what is out of range for a master's device.
    ///
    /// # Errors
    /// [`SlaveError`] names it with its range.
    pub fn check(&self, device: &Capabilities) -> Result<(), SlaveError> {
        let range = |field, value: f64, min: f64, max: f64, unit: &str| {
            // NaN fails every range check.
            let wrong = || SlaveError::Range { field, value, valid: format!("{min} to {max}{unit}") };
            if (min..=max).contains(&value) { Ok(()) } else { Err(wrong()) }
        };
        range("scale", self.scale, 0.01, 10.0, "")?;
        for edge in self.workspace.into_iter().flatten() {
            range("workspace", edge, 0.0, 10.0, " m")?;
        }
        if device.max_force_newtons > 0.0 {
            let told = " N: a device tells no more than it can render";
            range("force_max", self.force_max, 0.05, device.max_force_newtons.max(0.05), told)?;
        }
        if let Some(pedal) = self.pedal {
            range("pedal", f64::from(pedal), 0.0, f64::from(BUTTONS - 1), ", the numbers of buttons")?;
        }
        if let Some(hz) = self.tremor_cutoff_hz {
            range("tremor_cutoff_hz", hz, CUTOFF_HZ.0, CUTOFF_HZ.1, " Hz")?;
        }
        Ok(())
    }

    /// What the slave is able to do, behind a master's device.
    pub fn capabilities(&self, device: &Capabilities) -> Capabilities {
        let workspace = self.workspace.map(|size| Workspace::centred(Vector3::from(size)));
        Capabilities { workspace: workspace.unwrap_or(device.workspace), ..device.clone() }
    }

    fn limits(&self) -> DoorLimits {
        DoorLimits {
            linear_speed: self.linear_speed,
            angular_speed: self.angular_speed,
            // Packets come at the slave's own rate: what is late is late, and not spread.
            spread_max_secs: 0.0,
            ..DoorLimits::default()
        }
    }

    /// A master's pose, scaled.
    fn scaled(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts((pose.translation.vector * self.scale).into(), pose.rotation)
    }
}

/// A slave.
#[derive(Clone, Debug)]
pub struct Slave {
    config: SlaveConfig,
    door: Door,
    force_limit: ForceLimit,
    /// Force on the slave, along the device's axes \[N\].
    force: Vector3<f64>,
    /// Whether it goes to the very places that it is told, because its master has a clutch of its own.
    mirrors: bool,
    stopped: bool,
    pedal_down: bool,
    /// Whether the pedal must be seen up before it counts as down.
    release_first: bool,
    heard: Option<SimTime>,
    /// Time stamp of the pose that is applied.
    applied: Option<SimTime>,
    /// When it stepped last, by a clock that goes on by no less than a period at each step.
    paced: Option<SimTime>,
    shown: Option<DeviceState>,
    /// Whether the master has pedals.
    has_pedals: bool,
    limited: u64,
    stops: u64,
    /// Time with the current on \[s\].
    energised_secs: f64,
}

impl Slave {
    /// A slave that has no place yet: the first sample gives it one.
    ///
    /// # Errors
    /// [`SlaveError`] when a figure is out of range.
    pub fn new(hand: u8, config: SlaveConfig, device: &Capabilities) -> Result<Self, SlaveError> {
        config.check(device)?;
        Ok(Self {
            door: Door::new(hand, config.limits(), &config.capabilities(device))?,
            force_limit: ForceLimit::default(),
            force: Vector3::zeros(),
            mirrors: false,
            stopped: false,
            pedal_down: false,
            release_first: false,
            heard: None,
            applied: None,
            paced: None,
            shown: None,
            has_pedals: false,
            limited: 0,
            stops: 0,
            energised_secs: 0.0,
            config,
        })
    }

    /// The same for a master whose poses stand still while its own pedal is up, so that they are where the slave has to be.
    pub fn mirroring(self) -> Self {
        let mut slave = Self { mirrors: true, ..self };
        slave.door.set_mirroring(true);
        slave
    }

    /// Takes the newest sample that has arrived.
    pub fn admit(&mut self, now: SimTime, arrival: &Arrival) {
        let Arrival { sampled_at, arrived_at, sample, .. } = arrival;
        self.heard = Some(*arrived_at);
        self.has_pedals |= sample.state.buttons & HAS_PEDALS != 0;
        let pedal_down = self.config.pedal.is_none_or(|pedal| sample.state.buttons & (1 << pedal) != 0);
        if !pedal_down {
            self.release_first = false;
            self.hold(now);
            return;
        }
        if self.stopped || (self.release_first && self.config.pedal.is_some()) {
            return;
        }
        let mut state = sample.state;
        state.pose_in_device = self.config.scaled(&state.pose_in_device);
        state.linear_velocity *= self.config.scale;
        // Jaws that hold something wait for the fingers.
        self.door.set_holding(true);
        // The door counts what it refuses.
        if self.door.admit(now, *arrived_at, &HandSample { state, ..*sample }).is_ok() {
            self.door.set_mirroring(self.mirrors);
            self.pedal_down = true;
            self.applied = Some(*sampled_at);
        }
    }

    /// Its master lets it stand, as of `now`. `heard`: because that was said, and not because nothing was.
    pub fn rest(&mut self, now: SimTime, heard: bool) {
        if heard {
            self.heard = Some(now);
            self.release_first = false;
        }
        self.hold(now);
    }

    /// Stops the slave at once, or ends a stop.
    pub fn set_stop(&mut self, now: SimTime, stop: bool) {
        if stop && !self.stopped {
            self.stops += 1;
            self.release_first = true;
            self.hold(now);
        }
        self.stopped = stop;
    }

    /// The force on the slave, along the device's axes \[N\].
    pub fn feel(&mut self, force: &Vector3<f64>) {
        self.force = *force;
    }

    /// One step to time `now`, which must not decrease: the state that the slave has.
    pub fn step(&mut self, now: SimTime) -> DeviceState {
        let before = self.door.statistics().speed_limited + self.door.statistics().clamped_workspace;
        let paced = self.paced.map_or(now, |before| now.max((before + PERIOD).min(now + PERIOD)));
        let mut state = self.door.step(paced);
        if self.has_pedals {
            // Pedals that are not heard of are up; a hand without any would be switched by others.
            state.buttons |= HAS_PEDALS;
        }
        let after = self.door.statistics().speed_limited + self.door.statistics().clamped_workspace;
        if self.door.standing() == Standing::Silent {
            self.release_first = true;
        }
        let secs = self.paced.map_or(0.0, |before| paced.since(before).as_secs_f64()).min(STEP_MAX_SECS);
        self.paced = Some(paced);
        if !state.is_valid() || self.applied.is_none() {
            // It has no place yet.
            return state;
        }
        let given_way = self.force_limit.step(&self.force, self.config.force_max, secs);
        state.pose_in_device.translation.vector += given_way;
        self.limited += u64::from(after > before || self.force_limit.is_acting());
        if !self.follows() {
            (state.linear_velocity, state.angular_velocity) = (Vector3::zeros(), Vector3::zeros());
        }
        if matches!(Pedals::of(state.buttons), Pedals::Energy | Pedals::Coagulate) {
            self.energised_secs += secs;
        }
        self.shown = Some(state);
        state
    }

    /// What is told of it, while it shows this state. What it does not know is as in an empty report.
    pub fn report(&self, now: SimTime, shown: &DeviceState) -> SlaveReport {
        SlaveReport {
            at: now,
            slave_in_device: self.applied.map(|_| shown.pose_in_device),
            state: self.state(now),
            applied: self.applied,
            pedals: Pedals::of(shown.buttons),
            limited: self.limited,
            stops: self.stops,
            silences: self.door.statistics().silences,
            energised_secs: self.energised_secs,
            ..SlaveReport::default()
        }
    }

    /// Goes on from this state, as after a break: it stands there, and goes to where its master is as soon as that is heard.
    pub fn resume(&mut self, now: SimTime, state: &DeviceState) {
        self.has_pedals |= state.buttons & HAS_PEDALS != 0;
        self.applied.get_or_insert(now);
        self.shown = Some(*state);
        self.door.open(now, Some(state));
        self.door.set_mirroring(true);
    }

    /// What it does.
    pub fn state(&self, now: SimTime) -> SlaveState {
        let silence = SimTime::from_secs_f64(self.door.limits().silence_secs);
        match (self.heard, self.door.standing()) {
            _ if self.stopped => SlaveState::Stopped,
            (None, _) => SlaveState::Waiting,
            (Some(heard), _) if now.since(heard) >= silence => SlaveState::Silent,
            (_, Standing::Live) => SlaveState::Following,
            (_, Standing::Unplugged) => SlaveState::Unplugged,
            _ if self.release_first && self.config.pedal.is_some() => SlaveState::ReleasePedal,
            _ => SlaveState::PedalUp,
        }
    }

    /// Whether it follows the master now.
    pub fn follows(&self) -> bool {
        self.door.standing() == Standing::Live && !self.stopped
    }

    /// Where it should be for this pose of the master, without its limits; none while it does not follow.
    pub fn wanted(&self, master_in_device: &Isometry3<f64>) -> Option<Isometry3<f64>> {
        self.door.goal_of(&self.config.scaled(master_in_device)).filter(|_| self.follows())
    }

    /// Time stamp of the pose that it applies.
    pub fn applied(&self) -> Option<SimTime> {
        self.applied
    }

    /// Steps in which a limit of speed, workspace or force held it back.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Stands where it is from now on, and moves from there when it follows again.
    fn hold(&mut self, now: SimTime) {
        if self.pedal_down {
            self.pedal_down = false;
            let mut shown = self.shown;
            if let Some(shown) = &mut shown {
                // What gave way to a force is not where the door has it.
                let given_way = self.force_limit.step(&self.force, self.config.force_max, 0.0);
                shown.pose_in_device.translation.vector -= given_way;
                (shown.linear_velocity, shown.angular_velocity) = (Vector3::zeros(), Vector3::zeros());
            }
            self.door.open(now, shown.as_ref());
        }
    }
}

#[cfg(test)]
#[path = "slave_tests.rs"]
mod tests;
