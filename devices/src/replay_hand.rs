//! Replay hand: a device that plays back a recorded hand motion.
//!
//! Without force it is the recording: at the time of a recorded point it returns exactly that point, so that a recorded
//! session can be simulated again through the same driver. With force the recording becomes the target of a
//! [`VirtualHand`], which the force deflects from it.

use std::sync::Arc;

use crate::device::{Capabilities, DeviceError, DeviceState, HandIntent, HapticDevice, Wrench};
use crate::hand_config::{HandConfigError, VirtualHandConfig};
use crate::trajectory::{Trajectory, TrajectoryError, TrajectoryPoint};
use crate::virtual_hand::VirtualHand;

/// Plays a [`Trajectory`] through the device interface.
#[derive(Clone, Debug)]
pub struct ReplayHand {
    trajectory: Arc<Trajectory>,
    capabilities: Capabilities,
    follower: Option<VirtualHand>,
    started: bool,
    open: bool,
}

impl ReplayHand {
    /// Plays the trajectory unchanged; force has no effect. The capabilities are those of the default virtual hand, so
    /// that the driver limits forces as it does for that one.
    pub fn new(trajectory: Trajectory) -> Self {
        let mut capabilities = VirtualHandConfig::default().capabilities();
        capabilities.name = "replay hand".to_owned();
        Self { trajectory: Arc::new(trajectory), capabilities, follower: None, started: false, open: false }
    }

    /// Plays points of one of our own recordings, read by another crate; see [`TrajectoryPoint`]'s
    /// `From<&DeviceSample>`.
    ///
    /// # Errors
    /// [`TrajectoryError`] names the point.
    pub fn from_recording(points: Vec<TrajectoryPoint>) -> Result<Self, TrajectoryError> {
        Ok(Self::new(Trajectory::new(points)?))
    }

    /// Lets force act: the trajectory becomes the target of a virtual hand with these parameters. Its stops are
    /// switched off, since the recording may come from a larger device.
    ///
    /// # Errors
    /// Names a parameter that is out of range.
    pub fn with_force(mut self, config: VirtualHandConfig) -> Result<Self, HandConfigError> {
        let hand = VirtualHand::new(VirtualHandConfig { stops: false, ..config })?;
        self.capabilities = hand.capabilities().clone();
        self.capabilities.name = "replay hand with force".to_owned();
        self.follower = Some(hand);
        Ok(self)
    }

    /// Sets the capabilities of the recorded device, so that forces are limited as they were then.
    #[must_use]
    pub fn with_capabilities(mut self, capabilities: Capabilities) -> Self {
        self.capabilities = capabilities;
        self
    }

    /// The trajectory being played.
    pub fn trajectory(&self) -> &Trajectory {
        &self.trajectory
    }
}

fn aim_of(state: &DeviceState) -> HandIntent {
    HandIntent::at(state.pose_in_device, state.gripper)
}

impl HapticDevice for ReplayHand {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        self.open = true;
        if let Some(hand) = &mut self.follower {
            if !self.started {
                hand.place(&aim_of(&self.trajectory.at(now_ns)));
            }
            hand.open(now_ns)?;
        }
        self.started = true;
        Ok(())
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        let recorded = self.trajectory.at(now_ns);
        match &mut self.follower {
            None => Ok(recorded),
            Some(hand) => {
                hand.set_intent(now_ns, &aim_of(&recorded));
                let felt = hand.read(now_ns)?;
                Ok(DeviceState { buttons: recorded.buttons, connected: recorded.connected, ..felt })
            }
        }
    }

    fn write(&mut self, now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        if !self.open {
            return Err(DeviceError::NotOpen);
        }
        match &mut self.follower {
            None => Ok(()),
            Some(hand) => hand.write(now_ns, wrench),
        }
    }

    fn close(&mut self) {
        self.open = false;
        if let Some(hand) = &mut self.follower {
            hand.close();
        }
    }

    fn fork(&self) -> Option<Box<dyn HapticDevice>> {
        Some(Box::new(self.clone()))
    }

    fn resume(&mut self, now_ns: u64, state: &DeviceState, _intent: &HandIntent) {
        if let Some(hand) = &mut self.follower {
            hand.resume(now_ns, state, &aim_of(&self.trajectory.at(now_ns)));
            self.started = true;
        }
    }
}
