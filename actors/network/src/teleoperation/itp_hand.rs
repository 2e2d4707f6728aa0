//! A hand whose device is a console of ITP somewhere else: the arm of a robot that the console moves, within the limits of a
//! [`Slave`].
//!
//! The pedal, the clutch and silence are the protocol's own ([`Robot`](crate::itp::Robot)): with the pedal up the arm holds
//! still, without current. Pedals of the current are bits of the console's buttons ([`Pedals`](trocar_devices::Pedals)), and
//! count only when they were seen released since the arm follows. An emergency stop is told to the console as the runlevel.
//! The robot's frame is the device's. `read` and `write` allocate nothing, lock nothing and do not block.

use std::any::Any;

use nalgebra::Vector3;
use trocar_devices::{Capabilities, DeviceError, DeviceState, Dofs, HapticDevice, Workspace, Wrench};
use trocar_scene::{SimTime, TeleoperationEnd};

use super::exchange::{Arrival, LinkReport, SlaveReport, ToldHand, WatchedHand, watched};
use super::slave::{Slave, SlaveConfig, SlaveError};
use crate::hand_sample::HandSample;
use crate::itp::{ArmEnd, ArmPost, RobotCounts, UNPROTECTED_MODEL};

/// A hand that a console of ITP moves.
pub struct ItpHand {
    capabilities: Capabilities,
    slave: Slave,
    arm: ArmEnd,
    /// The newest post that was taken.
    taken: Option<ArmPost>,
    force: Vector3<f64>,
    told: ToldHand,
    watched: Option<WatchedHand>,
    open: bool,
}

impl ItpHand {
    /// What such a hand is: as large as the workspace of a Phantom Omni, and with a robot's forces.
    pub fn device() -> Capabilities {
        Capabilities {
            name: UNPROTECTED_MODEL.to_owned(),
            workspace: Workspace::centred(Vector3::new(0.16, 0.12, 0.07)),
            max_force_newtons: 10.0,
            max_torque: 0.0,
            max_stiffness: 2_000.0,
            input_dofs: Dofs::Six,
            output_dofs: Dofs::Three,
            apparent_mass: 0.1,
        }
    }

    /// The hand of an arm.
    ///
    /// # Errors
    /// [`SlaveError`] when a figure of the slave is out of range.
    pub fn new(arm: ArmEnd, config: SlaveConfig) -> Result<Self, SlaveError> {
        let device = Self::device();
        // The robot's arm stands while the pedal is up, and counts its increments from there.
        let slave = Slave::new(0, config, &device)?.mirroring();
        let (told, watched) = watched();
        Ok(Self {
            capabilities: config.capabilities(&device),
            slave,
            arm,
            taken: None,
            force: Vector3::zeros(),
            told,
            watched: Some(watched),
            open: false,
        })
    }

    /// The end of the actor that shows it, once.
    pub fn take_watched(&mut self) -> Option<WatchedHand> {
        self.watched.take()
    }

    /// Does what the console asks of the arm.
    fn follow(&mut self, now: SimTime, post: ArmPost) {
        let silences = self.taken.map_or(0, |before| before.counts.silences);
        self.taken = Some(post);
        if !post.follows && self.slave.applied().is_some() {
            self.slave.rest(now, post.counts.silences == silences);
            return;
        }
        let mut sample = HandSample::unknown(0);
        sample.state.pose_in_device = post.pose.pose_in_robot();
        sample.state.gripper = post.pose.jaw().max(0.0);
        sample.state.buttons = post.buttons;
        sample.state.connected = true;
        self.slave
            .admit(now, &Arrival { sampled_at: now, sent_at: now, arrived_at: now, sample, coupled: None });
    }
}

/// What is known of the path: how the console's packets fared.
fn link(counts: &RobotCounts) -> LinkReport {
    LinkReport {
        sent: counts.applied + counts.after_gap + counts.missed,
        received: counts.applied,
        late: counts.duplicates + counts.out_of_order,
        refused: counts.malformed + counts.too_far + counts.no_rotation,
        ..LinkReport::default()
    }
}

impl HapticDevice for ItpHand {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn open(&mut self, _now_ns: u64) -> Result<(), DeviceError> {
        self.open = true;
        Ok(())
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        let now = SimTime(now_ns);
        let stop = self.told.control.is_stopped();
        self.slave.set_stop(now, stop);
        self.arm.set_stop(stop);
        let before = self.taken.map(|post| post.number);
        if let Some(post) = self.arm.post().filter(|post| before != Some(post.number)) {
            self.follow(now, post);
        }
        let state = self.slave.step(now);
        let report = SlaveReport {
            end: TeleoperationEnd::Slave,
            force_in_device: self.force,
            silences: self.taken.map_or(0, |post| post.counts.silences),
            link: Some(self.taken.map_or_else(LinkReport::default, |post| link(&post.counts))),
            ..self.slave.report(now, &state)
        };
        self.told.reports.write(Some(report));
        Ok(state)
    }

    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        self.force = wrench.force;
        self.slave.feel(&wrench.force);
        self.arm.feel(&wrench.force);
        Ok(())
    }

    fn close(&mut self) {
        self.open = false;
        self.slave.feel(&Vector3::zeros());
        self.arm.feel(&Vector3::zeros());
    }

    fn as_any(&mut self) -> Option<&mut dyn Any> {
        Some(self)
    }
}
