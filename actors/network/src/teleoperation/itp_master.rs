//! A hand at a console of ITP: its device is the master, and the slave is an arm of a robot somewhere else.
//!
//! The hand moves its own instrument as ever, and the arm by what it sends. What the robot replies is shown: its runlevel and
//! its forces. They are not rendered: a force that comes so late would be active ([`compensation`](crate::compensation)).
//! The pedals of the current are bits of the packet's buttons ([`Pedals`]).
//!
//! A person's device has a button for the surgeon's pedal. A virtual hand has none, and its pedal goes down by itself: once the
//! robot has been ready for half a second. It goes up when the robot stops, when nothing is heard of it for 100 ms, and while
//! this end is stopped.

use nalgebra::{Isometry3, Vector3};
use trocar_devices::{Capabilities, DeviceError, DeviceState, HandIntent, HapticDevice, Pedals, Wrench};
use trocar_scene::{SimTime, SlaveState, TeleoperationEnd};

use super::delay_histogram::DelayHistogram;
use super::exchange::{LinkReport, SlaveReport, ToldHand, WatchedHand, watched};
use crate::itp::{ConsoleArm, ConsoleHand, ConsoleReport, LedHand, Runlevel};

/// Silence of the robot after which it counts as gone.
const SILENCE: SimTime = SimTime::from_millis(100);
/// For how long the robot has to be ready before the pedal of a virtual hand goes down.
const READY_FOR: SimTime = SimTime::from_millis(500);
/// Bins of round trips: up to two seconds.
const ROUND_TRIPS: (SimTime, usize) = (SimTime::from_micros(500), 4_000);
/// Time between two quantiles of round trips.
const QUANTILES_EVERY: SimTime = SimTime::from_millis(20);

/// A device that leads an arm of a robot elsewhere.
pub struct ItpMaster {
    master: Box<dyn HapticDevice>,
    arm: ConsoleArm,
    arm_number: usize,
    /// Number of the button that is the surgeon's pedal; none: it goes down by itself.
    pedal: Option<u8>,
    /// The newest report of the link, and when it was first seen.
    heard: Option<(ConsoleReport, SimTime)>,
    /// Since when the robot is ready.
    ready_since: Option<SimTime>,
    /// Since when the robot does not follow a pedal that is down.
    refused_since: Option<SimTime>,
    pedal_down: bool,
    round_trips: DelayHistogram,
    link: LinkReport,
    quantiles_due: SimTime,
    stops: u64,
    silences: u64,
    energised_secs: f64,
    state: SlaveState,
    read_at: Option<SimTime>,
    told: ToldHand,
}

impl ItpMaster {
    /// The master of this arm (0 left, 1 right), and the end of the actor that shows it.
    pub fn new(
        master: Box<dyn HapticDevice>,
        arm: ConsoleArm,
        arm_number: usize,
        pedal: Option<u8>,
    ) -> (Self, WatchedHand) {
        let (told, watched) = watched();
        let master = Self {
            master,
            arm,
            arm_number,
            pedal,
            heard: None,
            ready_since: None,
            refused_since: None,
            pedal_down: false,
            round_trips: DelayHistogram::new(ROUND_TRIPS.0, ROUND_TRIPS.1),
            link: LinkReport::default(),
            quantiles_due: SimTime::ZERO,
            stops: 0,
            silences: 0,
            energised_secs: 0.0,
            state: SlaveState::Waiting,
            read_at: None,
            told,
        };
        (master, watched)
    }

    /// Takes the newest reply.
    fn hear(&mut self, now: SimTime) {
        let Some(report) = self.arm.report() else { return };
        let is_new = self.heard.is_none_or(|(before, _)| before.received != report.received);
        if is_new {
            self.heard = Some((report, now));
            if let Some(trip) = report.round_trip {
                self.round_trips.record(trip);
                self.link.newest = trip;
            }
        }
        self.link.sent = report.sent;
        self.link.received = report.received;
        self.link.refused = report.refused;
        if now >= self.quantiles_due {
            self.quantiles_due = now + QUANTILES_EVERY;
            let trips = &self.round_trips;
            let known = trips.mean().zip(trips.range()).zip(trips.quantile(0.99));
            self.link.round_trips = known.map(|((mean, (min, max)), p99)| [mean, min, p99, max]);
        }
    }

    /// The runlevel that the robot told last, unless it is silent.
    fn runlevel(&self, now: SimTime) -> Option<Runlevel> {
        let (report, heard_at) = self.heard.as_ref()?;
        report.robot.runlevel.filter(|_| now.since(*heard_at) < SILENCE)
    }

    /// Whether the surgeon's pedal is down.
    fn press(&mut self, now: SimTime, buttons: u32) -> bool {
        let runlevel = self.runlevel(now);
        let is_ready = matches!(runlevel, Some(Runlevel::PedalUp | Runlevel::PedalDown));
        let is_refused = self.pedal_down && runlevel == Some(Runlevel::PedalUp);
        self.refused_since = if is_refused { self.refused_since.or(Some(now)) } else { None };
        // Longer than the press needs to get there and back: the robot wants to see the pedal released.
        let patience = READY_FOR + self.link.newest;
        let in_vain = self.refused_since.is_some_and(|since| now.since(since) >= patience);
        self.ready_since = if is_ready && !in_vain { self.ready_since.or(Some(now)) } else { None };
        let by_foot = match self.pedal {
            Some(button) => buttons & (1 << button) != 0,
            // Down stays down, as long as the robot can follow.
            None => self.ready_since.is_some_and(|since| now.since(since) >= READY_FOR),
        };
        by_foot && !self.told.control.is_stopped()
    }

    /// What the robot does.
    fn slave_state(&self, now: SimTime) -> SlaveState {
        match self.runlevel(now) {
            None if self.heard.is_none() => SlaveState::Waiting,
            None => SlaveState::Silent,
            Some(Runlevel::EmergencyStop) => SlaveState::Stopped,
            Some(Runlevel::Initialising) => SlaveState::Waiting,
            Some(Runlevel::PedalDown) => SlaveState::Following,
            // The pedal of before has to be seen up there, and that takes a round trip.
            Some(Runlevel::PedalUp) if self.pedal_down => SlaveState::ReleasePedal,
            Some(Runlevel::PedalUp) => SlaveState::PedalUp,
        }
    }

    fn lead(&mut self, now: SimTime, state: &DeviceState) {
        self.pedal_down = self.press(now, state.buttons);
        let hand = ConsoleHand {
            pose_in_console: state.pose_in_device,
            jaw: state.gripper,
            squeeze: 0.0,
            buttons: state.buttons,
        };
        self.arm.lead(Some(LedHand { hand, pedal_down: self.pedal_down }));
    }

    fn tell(&mut self, now: SimTime, master_in_device: Isometry3<f64>, buttons: u32) {
        let before = self.state;
        self.state = self.slave_state(now);
        let becomes = |state| before != state && self.state == state;
        self.stops += u64::from(becomes(SlaveState::Stopped));
        self.silences += u64::from(becomes(SlaveState::Silent));
        let follows = self.state == SlaveState::Following;
        let pedals = match Pedals::of(buttons) {
            Pedals::Energy | Pedals::Coagulate if !follows => Pedals::Released,
            pedals => pedals,
        };
        if matches!(pedals, Pedals::Energy | Pedals::Coagulate) {
            let secs = self.read_at.map_or(0.0, |before| now.since(before).as_secs_f64());
            self.energised_secs += secs;
        }
        let force = |(report, _): &(ConsoleReport, SimTime)| report.robot.forces_in_robot[self.arm_number];
        let force = self.heard.as_ref().filter(|_| self.runlevel(now).is_some()).map(force);
        self.told.reports.write(Some(SlaveReport {
            at: now,
            end: TeleoperationEnd::Console,
            master_in_device,
            state: self.state,
            pedals,
            force_in_device: force.unwrap_or_else(Vector3::zeros),
            stops: self.stops,
            silences: self.silences,
            energised_secs: self.energised_secs,
            link: Some(self.link),
            ..SlaveReport::default()
        }));
    }
}

impl HapticDevice for ItpMaster {
    fn capabilities(&self) -> &Capabilities {
        self.master.capabilities()
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.master.open(now_ns)
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        let now = SimTime(now_ns);
        let master = self.master.read(now_ns);
        self.hear(now);
        match &master {
            Ok(state) if state.is_valid() && state.connected => {
                self.lead(now, state);
                self.tell(now, state.pose_in_device, state.buttons);
            }
            // Nobody holds the handle: the pedal goes up, and the robot stands.
            _ => {
                self.pedal_down = false;
                self.ready_since = None;
                self.arm.lead(None);
            }
        }
        self.read_at = Some(now);
        master
    }

    fn write(&mut self, now_ns: u64, _: &Wrench) -> Result<(), DeviceError> {
        self.master.write(now_ns, &Wrench::ZERO)
    }

    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        self.master.set_intent(now_ns, intent);
    }

    fn close(&mut self) {
        self.arm.lead(None);
        self.master.close();
    }
}

#[cfg(test)]
#[path = "itp_master_tests.rs"]
mod tests;
