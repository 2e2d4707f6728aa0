//! Reflected hand: a device whose handle is a master, and whose shown pose is the slave's, which follows what has come back
//! from the packet reflector.
//!
//! Haptics and physics see the slave. The master's device is read, and moved by a virtual trainee, without any delay. What
//! the scene asks for is felt by the slave, whose force is limited. The master's device renders no force unless there is a
//! [`ForceFeedback`]: one that comes a round trip after the motion would be active by itself.
//!
//! `read` and `write` allocate nothing, lock nothing and do not block, if the master's device does not.

use std::any::Any;

use nalgebra::{Isometry3, Vector3};
use trocar_devices::{Capabilities, DeviceError, DeviceState, HandIntent, HapticDevice, Wrench};
use trocar_scene::SimTime;

use super::coupled_ends::CoupledEnds;
use super::exchange::{DeviceEnd, LinkedHand, MasterSample, SlaveReport, WatchedHand, exchange};
use super::force_feedback::ForceFeedback;
use super::pose_history::PoseHistory;
use super::slave::{Slave, SlaveConfig, SlaveError};
use super::tremor_filter::TremorFilter;
use crate::compensation::Compensation;

/// A device behind a path.
pub struct ReflectedHand {
    number: u8,
    capabilities: Capabilities,
    master: Box<dyn HapticDevice>,
    filter: Option<TremorFilter>,
    slave: Slave,
    end: DeviceEnd,
    /// What was sent.
    history: PoseHistory,
    /// When the newest arrival that was taken was sent.
    taken: Option<SimTime>,
    read_at: Option<SimTime>,
    /// What was written last.
    sampled: Option<MasterSample>,
    report: Option<SlaveReport>,
    /// Ends of a copy that nobody has yet.
    free: Option<(LinkedHand, WatchedHand)>,
    master_in_device: Isometry3<f64>,
    /// As in [`SlaveReport`].
    errors: (u64, f64, f64),
    force: Vector3<f64>,
    feedback: Option<ForceFeedback>,
}

impl ReflectedHand {
    /// Hand number `hand`: the device that is the master, and the ends of its link and its actor.
    ///
    /// # Errors
    /// [`SlaveError`] when a figure of the slave is out of range.
    pub fn new(
        hand: u8,
        config: SlaveConfig,
        master: Box<dyn HapticDevice>,
    ) -> Result<(Self, LinkedHand, WatchedHand), SlaveError> {
        let slave = Slave::new(hand, config, master.capabilities())?;
        let (end, linked, watched) = exchange(hand);
        let device = Self {
            number: hand,
            capabilities: config.capabilities(master.capabilities()),
            master,
            filter: config.tremor_cutoff_hz.map(TremorFilter::new),
            slave,
            end,
            history: PoseHistory::default(),
            taken: None,
            read_at: None,
            sampled: None,
            report: None,
            free: None,
            master_in_device: Isometry3::identity(),
            errors: (0, 0.0, 0.0),
            force: Vector3::zeros(),
            feedback: None,
        };
        Ok((device, linked, watched))
    }

    /// The same with forces at the master's device, compensated for the delay; the instrument's coupling has this stiffness
    /// [N/m].
    pub fn feeding_back(
        mut self,
        choice: Compensation,
        config: &SlaveConfig,
        coupling_stiffness: f64,
    ) -> Self {
        let device = self.master.capabilities();
        self.feedback = Some(ForceFeedback::new(choice, config, device, coupling_stiffness));
        self
    }

    /// The ends of the link and of the actor of a copy, once: it is of no use before they are where they belong.
    pub fn take_ends(&mut self) -> Option<(LinkedHand, WatchedHand)> {
        self.free.take()
    }

    /// Brings the master's pose on its way, and what the ends of its coupling tell each other.
    fn send(&mut self, now: SimTime, mut state: DeviceState, coupled: Option<CoupledEnds>) {
        let secs = self.read_at.map_or(0.0, |before| now.since(before).as_secs_f64());
        if let Some(filter) = &mut self.filter {
            state.pose_in_device = filter.step(&state.pose_in_device, secs);
        }
        if !state.is_valid() {
            return;
        }
        self.history.push(now, state.pose_in_device);
        self.master_in_device = state.pose_in_device;
        self.sampled = Some(MasterSample { sampled_at: now, state, coupled });
        self.end.masters.write(self.sampled);
    }

    /// A step of the coupling with what the master's device was read as; the slave is where that lets it be.
    fn couple(
        &mut self,
        now: SimTime,
        master: &Result<DeviceState, DeviceError>,
        shown: &mut DeviceState,
    ) -> Option<CoupledEnds> {
        let feedback = self.feedback.as_mut()?;
        let master = master.as_ref().ok().filter(|master| master.connected && master.is_valid());
        let is_new = self.read_at != Some(now);
        match master.filter(|_| is_new) {
            Some(master) => Some(feedback.step(now, master, &self.slave, &self.force, shown)),
            None => {
                if master.is_none() {
                    // What the hand felt was for where it was.
                    feedback.release();
                }
                feedback.place(shown);
                None
            }
        }
    }

    /// Compares the slave with the master's pose whose time stamp it applies.
    fn compare(&mut self, slave: &DeviceState) {
        let Some(applied) = self.slave.applied() else { return };
        let Some(wanted) = self.history.at(applied).and_then(|master| self.slave.wanted(master)) else {
            return;
        };
        let error = (slave.pose_in_device.translation.vector - wanted.translation.vector).norm();
        let (count, squares, largest) = &mut self.errors;
        *count += 1;
        *squares += error * error;
        *largest = largest.max(error);
    }
}

impl HapticDevice for ReflectedHand {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.master.open(now_ns)
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        let now = SimTime(now_ns);
        let master = self.master.read(now_ns);
        self.slave.set_stop(now, self.end.told.control.is_stopped());
        if let Some(arrival) = self.end.arrivals.read().filter(|arrival| self.taken != Some(arrival.sent_at))
        {
            self.taken = Some(arrival.sent_at);
            self.slave.admit(now, &arrival);
            if let Some(feedback) = &mut self.feedback {
                feedback.hear(&arrival);
            }
        }
        let mut state = self.slave.step(now);
        let coupled = self.couple(now, &master, &mut state);
        if let Ok(master) = master
            && self.read_at != Some(now)
        {
            self.send(now, master, coupled);
        }
        self.read_at = Some(now);
        self.compare(&state);
        let report = SlaveReport {
            master_in_device: self.master_in_device,
            errors: self.errors,
            force_in_device: self.force,
            feedback: self.feedback.as_ref().map(|feedback| *feedback.report()),
            ..self.slave.report(now, &state)
        };
        self.report = Some(report);
        self.end.told.reports.write(self.report);
        // Whoever unplugs the master's device is told at once; the slave stands.
        master.map(|_| state)
    }

    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        self.force = wrench.force;
        self.slave.feel(&wrench.force);
        let force = self.feedback.as_ref().map_or(Vector3::zeros(), |feedback| *feedback.force_in_device());
        self.master.write(now_ns, &Wrench::from_force(force))
    }

    fn set_intent(&mut self, now_ns: u64, intent: &HandIntent) {
        self.master.set_intent(now_ns, intent);
    }

    fn close(&mut self) {
        self.slave.feel(&Wrench::ZERO.force);
        self.master.close();
    }

    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        let master = self.master.fork()?;
        let (mut end, linked, watched) = exchange(self.number);
        end.masters.write(self.sampled);
        end.told.reports.write(self.report);
        end.told.control.set_stop(self.end.told.control.is_stopped());
        Some(Box::new(Self {
            number: self.number,
            capabilities: self.capabilities.clone(),
            master,
            filter: self.filter,
            slave: self.slave.clone(),
            end,
            history: self.history.clone(),
            taken: self.taken,
            read_at: self.read_at,
            sampled: self.sampled,
            report: self.report,
            feedback: self.feedback.clone(),
            free: Some((linked, watched)),
            ..*self
        }))
    }

    fn as_any(&mut self) -> Option<&mut dyn Any> {
        Some(self)
    }

    /// With nothing under way: the slave stands for a round trip, and then goes to where its master is.
    fn resume(&mut self, now_ns: u64, state: &DeviceState, intent: &HandIntent) {
        let at_master = DeviceState {
            pose_in_device: intent.pose_in_device,
            gripper: intent.gripper,
            buttons: intent.buttons,
            connected: true,
            ..DeviceState::unknown()
        };
        self.master.resume(now_ns, &at_master, intent);
        self.slave.resume(SimTime(now_ns), state);
        if let Some(feedback) = &mut self.feedback {
            feedback.reset();
        }
        self.read_at = Some(SimTime(now_ns));
    }
}

#[cfg(test)]
#[path = "reflected_hand_tests.rs"]
mod tests;
