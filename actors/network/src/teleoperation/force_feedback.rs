//! Force feedback of a reflected hand: what the slave touches is felt at the master's device, over the delay of the path.
//!
//! ```text
//! master's pose ─▶ [ MasterEnd ] ─ packet, one round trip ─▶ [ Slave ] ─▶ [ SlaveEnd ] ─▶ pose of the instrument
//! force on the hand ◀─ [ MasterEnd ] ◀─ packet, one round trip ─ [ SlaveEnd ] ◀─ force on the instrument
//! ```
//!
//! Both ends are those of the [compensation](crate::compensation), in the slave's measure: where motions are scaled down,
//! the hand feels the force scaled down as much, so that the work of both is the same. A contact that the slave tells
//! lies where the master's hand is for the slave to touch it: the clutch is between them. A slave that does not follow
//! tells no force.

use nalgebra::Vector3;
use trocar_devices::{Capabilities, DeviceState};
use trocar_scene::SimTime;

use super::coupled_ends::CoupledEnds;
use super::exchange::Arrival;
use super::slave::{Slave, SlaveConfig};
use crate::compensation::{
    Compensation, CouplingConfig, CouplingSample, MasterEnd, MasterReading, Method, OFFSET_MAX, Payload,
    SlaveEnd,
};

/// Force at the slave \[N\] above which the share that is felt is measured.
const FELT_FROM: f64 = 0.1;

/// What is told of the force feedback of a hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FeedbackReport {
    /// The method that is rendered now.
    pub method: Method,
    /// Force on the master's hand, along the device's axes \[N\].
    pub force_in_device: Vector3<f64>,
    /// Mean of the force on the hand along that at the slave, over the mean of that at the slave, while there was one;
    /// none before. What is scaled counts as if it were not.
    pub felt_share: Option<f64>,
}

/// Both ends of a hand's coupling.
#[derive(Clone, Debug)]
pub struct ForceFeedback {
    choice: Compensation,
    config: CouplingConfig,
    scale: f64,
    master: MasterEnd,
    slave: SlaveEnd,
    /// What both tell.
    told: CoupledEnds,
    /// The newest that has arrived, and where the master was.
    heard: Option<(CoupledEnds, DeviceState)>,
    /// Whether it arrived since the last step.
    is_news: bool,
    /// From a motion of the master's hand to the force that it gets for it.
    round_trip: SimTime,
    /// Sums of the force felt and of the force at the slave \[N\].
    felt: (f64, f64),
    report: FeedbackReport,
}

impl ForceFeedback {
    /// Ends at rest, between this device and an instrument of this coupling stiffness [N/m].
    pub fn new(
        choice: Compensation,
        slave: &SlaveConfig,
        device: &Capabilities,
        coupling_stiffness: f64,
    ) -> Self {
        let defaults = CouplingConfig::default();
        let scale = slave.scale;
        // The master's bounds as the slave's measure has them: force by its scale, stiffness and damping by its square.
        let positive = |limit: f64, otherwise: f64| if limit > 0.0 { limit } else { otherwise };
        let config = CouplingConfig {
            stiffness_max: positive(device.max_stiffness, defaults.stiffness_max) / (scale * scale),
            damping_max: defaults.damping_max / (scale * scale),
            fill_damping: defaults.fill_damping / (scale * scale),
            force_max: device.max_force_newtons.max(0.0) / scale,
            coupling_stiffness,
            speed_max: slave.linear_speed,
            ..defaults
        };
        Self {
            choice,
            config,
            scale,
            master: MasterEnd::new(choice, config),
            slave: SlaveEnd::new(config),
            told: CoupledEnds::default(),
            heard: None,
            is_news: false,
            round_trip: SimTime::ZERO,
            felt: (0.0, 0.0),
            report: FeedbackReport::default(),
        }
    }

    /// Begins anew, with nothing under way.
    pub fn reset(&mut self) {
        (self.master, self.slave) = (MasterEnd::new(self.choice, self.config), SlaveEnd::new(self.config));
        (self.told, self.heard, self.is_news) = (CoupledEnds::default(), None, false);
        self.report = FeedbackReport { felt_share: self.report.felt_share, ..FeedbackReport::default() };
    }

    /// Takes what both ends had said when this was sent.
    pub fn hear(&mut self, arrival: &Arrival) {
        let Some(coupled) = arrival.coupled else { return };
        self.heard = Some((coupled, arrival.sample.state));
        self.is_news = true;
        let one_way = arrival.arrived_at.since(arrival.sent_at);
        self.round_trip = one_way + one_way;
    }

    /// A step of both ends at `now`: the master's with its device's state, and the slave's under a force on its instrument, as
    /// a hand there would feel it \[N\]. `shown` is where the slave wants to be and becomes where it is. Returns what is
    /// sent.
    pub fn step(
        &mut self,
        now: SimTime,
        master: &DeviceState,
        slave: &Slave,
        force: &Vector3<f64>,
        shown: &mut DeviceState,
    ) -> CoupledEnds {
        self.step_master(now, master);
        self.step_slave(now, slave, force, shown);
        self.told
    }

    /// Where the slave is between two steps.
    pub fn place(&self, shown: &mut DeviceState) {
        if let Some(command) = self.slave.port().command() {
            shown.pose_in_device.translation.vector = *command;
        }
    }

    /// The force on the master's hand, along the device's axes \[N\].
    pub fn force_in_device(&self) -> &Vector3<f64> {
        &self.report.force_in_device
    }

    /// No force until the next step: the device cannot be read.
    pub fn release(&mut self) {
        self.report.force_in_device = Vector3::zeros();
    }

    /// What is told of it.
    pub fn report(&self) -> &FeedbackReport {
        &self.report
    }

    fn step_master(&mut self, now: SimTime, state: &DeviceState) {
        let sample = |(coupled, _): &(CoupledEnds, DeviceState)| CouplingSample {
            position: Vector3::zeros(),
            velocity: Vector3::zeros(),
            force: coupled.slave_force,
            block: coupled.slave,
        };
        let received = self.heard.as_ref().filter(|_| self.is_news).map(sample);
        self.is_news = false;
        let reading = MasterReading {
            position: state.pose_in_device.translation.vector * self.scale,
            velocity: state.linear_velocity * self.scale,
            round_trip: self.round_trip,
        };
        let sent = self.master.step(now, &reading, received.as_ref());
        self.told.master = sent.block;
        self.report.method = self.master.method();
        self.report.force_in_device = sent.force * self.scale;
        let at_slave = self.heard.as_ref().map_or(Vector3::zeros(), |(coupled, _)| coupled.slave_force);
        let size = at_slave.norm();
        if size > FELT_FROM {
            let (felt, there) = &mut self.felt;
            (*felt, *there) = (*felt + sent.force.dot(&at_slave) / size, *there + size);
            self.report.felt_share = Some(*felt / *there);
        }
    }

    fn step_slave(&mut self, now: SimTime, slave: &Slave, force: &Vector3<f64>, shown: &mut DeviceState) {
        let Some((heard, master)) = &self.heard else { return };
        let wanted = shown.pose_in_device.translation.vector;
        let sample = CouplingSample {
            position: wanted,
            velocity: Vector3::zeros(),
            force: Vector3::zeros(),
            block: heard.master,
        };
        let goal = slave.wanted(&master.pose_in_device);
        let told = match &goal {
            Some(_) => self.slave.step(now, force, Some(&sample)),
            None => self.slave.rest(now, Some(&sample)),
        };
        let Some(mut told) = told else { return };
        if let (Payload::Contact(contact), Some(goal)) = (&mut told.block.payload, &goal) {
            // From where the slave has it to where the master's hand has it: the clutch is between.
            let shift = goal.translation.vector - master.pose_in_device.translation.vector * self.scale;
            contact.offset -= contact.normal.dot(&shift);
            if contact.offset.abs() > OFFSET_MAX {
                told.block.payload = Payload::None;
            }
        }
        (self.told.slave_force, self.told.slave) = (told.force, told.block);
        shown.pose_in_device.translation.vector = told.position;
        shown.linear_velocity = told.velocity;
    }
}
