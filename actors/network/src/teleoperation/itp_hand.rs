//! A hand whose device is a console of ITP somewhere else: the arm of a robot that the console moves, within the limits of a
//! [`Slave`].
//!
//! The pedal, the clutch and silence are the protocol's own ([`Robot`](crate::itp::Robot)): with the pedal up the arm holds
//! still. The robot's frame is the device's. `read` and `write` allocate nothing, lock nothing and do not block.

use nalgebra::Vector3;
use trocar_devices::{Capabilities, DeviceError, DeviceState, Dofs, HapticDevice, Workspace, Wrench};
use trocar_scene::SimTime;

use super::exchange::Arrival;
use super::slave::{Slave, SlaveConfig, SlaveError};
use crate::hand_sample::HandSample;
use crate::itp::{ArmEnd, UNPROTECTED_MODEL};

/// A hand that a console of ITP moves.
pub struct ItpHand {
    capabilities: Capabilities,
    slave: Slave,
    arm: ArmEnd,
    /// Number of the newest post that was taken.
    taken: Option<u64>,
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
        let slave = Slave::new(0, config, &device)?;
        Ok(Self { capabilities: config.capabilities(&device), slave, arm, taken: None, open: false })
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
        if let Some(post) = self.arm.post().filter(|post| self.taken != Some(post.number)) {
            self.taken = Some(post.number);
            let mut sample = HandSample::unknown(0);
            sample.state.pose_in_device = post.pose.pose_in_robot();
            sample.state.gripper = post.pose.jaw().max(0.0);
            sample.state.buttons = post.buttons;
            sample.state.connected = true;
            self.slave.admit(now, &Arrival { sampled_at: now, sent_at: now, arrived_at: now, sample });
        }
        Ok(self.slave.step(now))
    }

    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        self.slave.feel(&wrench.force);
        self.arm.feel(&wrench.force);
        Ok(())
    }

    fn close(&mut self) {
        self.open = false;
        self.slave.feel(&Vector3::zeros());
        self.arm.feel(&Vector3::zeros());
    }
}
