//! A new device: a stylus with three driven axes, which speaks a framed protocol over TCP (a serial port through
//! a terminal server, say).
//!
//! A driver has two halves, each in a file of its own. `protocol` handles bytes and no device: it can be tested with
//! every error of a cable. [`Stylus`] handles the device and implements [`HapticDevice`]. Between it and the actors is
//! Trocar's safety layer: clamp, slew limit, watchdog, passivity. The driver does none of that, but the safety layer
//! relies on its [`Capabilities`]: state what the motors and a hand can bear, never more.

pub mod emulator;
pub mod protocol;

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::str::FromStr;
use std::time::Duration;

use protocol::{ForceFrame, FrameReader, StateFrame};
use trocar::devices::{Capabilities, DeviceError, DeviceState, Dofs, HapticDevice, Workspace, Wrench};
use trocar::nalgebra::{Translation3, Vector3};
use trocar::prelude::App;

/// Longest wait for a connection. It blocks the driver's thread, so it must be short.
const CONNECT_MAX: Duration = Duration::from_millis(50);
/// A device that is silent for so long counts as disconnected \[ns\]: an unplugged cable gives no signal.
const SILENCE_MAX_NS: u64 = 50_000_000;
/// Most reads in one step, so that a step is bounded even when a device floods the cable.
const READS_MAX: usize = 4;
/// Cut-off of the velocity filter \[Hz\]: differences of positions in whole micrometres are noisy.
const VELOCITY_CUTOFF_HZ: f64 = 80.0;

/// The driver. It reads no clock, and once open it neither allocates nor blocks: it runs at the highest priority,
/// thousands of times a second.
pub struct Stylus {
    address: SocketAddr,
    capabilities: Capabilities,
    /// `None` while it is unplugged.
    stream: Option<TcpStream>,
    reader: FrameReader,
    state: DeviceState,
    /// The device's own count of states, for time differences without the jitter of the cable.
    sequence: Option<u16>,
    heard_at_ns: u64,
}

impl Stylus {
    /// A driver for the device at this address; it opens nothing yet.
    pub fn new(address: SocketAddr) -> Self {
        let capabilities = Capabilities {
            name: "stylus".to_owned(),
            workspace: Workspace::centred(Vector3::new(0.16, 0.12, 0.12)),
            max_force_newtons: 3.0,
            max_torque: 0.0,
            max_stiffness: 1_000.0,
            input_dofs: Dofs::Three,
            output_dofs: Dofs::Three,
            apparent_mass: 0.05,
        };
        Self {
            address,
            capabilities,
            stream: None,
            reader: FrameReader::new(),
            state: DeviceState::unknown(),
            sequence: None,
            heard_at_ns: 0,
        }
    }

    /// Updates the state from a frame.
    fn hear(&mut self, frame: &StateFrame) {
        let position = Vector3::from(frame.position_um.map(|micrometres| 1e-6 * f64::from(micrometres)));
        let steps = self.sequence.map(|before| frame.sequence.wrapping_sub(before));
        // The first state, or one after a gap, gives no velocity.
        if let Some(steps) = steps.filter(|steps| (1..=100).contains(steps)) {
            let dt = f64::from(steps) * protocol::PERIOD_SECS;
            let velocity = (position - self.state.pose_in_device.translation.vector) / dt;
            let share = 1.0 - (-std::f64::consts::TAU * VELOCITY_CUTOFF_HZ * dt).exp();
            self.state.linear_velocity += share * (velocity - self.state.linear_velocity);
        } else {
            self.state.linear_velocity = Vector3::zeros();
        }
        self.sequence = Some(frame.sequence);
        self.state.pose_in_device.translation = Translation3::from(position);
        self.state.gripper = 1e-3 * f64::from(frame.gripper_mrad);
        self.state.buttons = u32::from(frame.buttons);
        self.state.connected = true;
    }

    fn lost(&mut self) -> DeviceError {
        self.stream = None;
        DeviceError::Disconnected
    }
}

impl HapticDevice for Stylus {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }

    /// Also called repeatedly after the device was unplugged.
    fn open(&mut self, now_ns: u64) -> Result<(), DeviceError> {
        let connect = || -> std::io::Result<TcpStream> {
            let stream = TcpStream::connect_timeout(&self.address, CONNECT_MAX)?;
            // A force delayed to be sent with more bytes comes too late.
            stream.set_nodelay(true)?;
            stream.set_nonblocking(true)?;
            Ok(stream)
        };
        self.stream = Some(connect().map_err(|_| DeviceError::Disconnected)?);
        self.reader = FrameReader::new();
        self.sequence = None;
        self.heard_at_ns = now_ns;
        Ok(())
    }

    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        let mut newest = None;
        for _ in 0..READS_MAX {
            let Some(stream) = &mut self.stream else { return Err(DeviceError::Disconnected) };
            match stream.read(self.reader.room()) {
                Ok(0) => return Err(self.lost()),
                Ok(bytes) => self.reader.filled(bytes),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(self.lost()),
            }
            while let Some(frame) = self.reader.next_state() {
                // Every frame updates the filter; only the newest is kept.
                self.hear(&frame);
                newest = Some(frame);
            }
        }
        if newest.is_some() {
            self.heard_at_ns = now_ns;
            return Ok(self.state);
        }
        if now_ns.saturating_sub(self.heard_at_ns) > SILENCE_MAX_NS {
            return Err(self.lost());
        }
        // "No reading this time": the driver keeps the last one and knows its age.
        Err(DeviceError::Transfer(0))
    }

    /// The safety layer has clamped, limited and checked the wrench.
    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        let bytes = ForceFrame::from_newtons(wrench.force.into()).encode();
        let Some(stream) = &mut self.stream else { return Err(DeviceError::Disconnected) };
        match stream.write(&bytes) {
            Ok(_) => Ok(()),
            // The device does not keep up: newer forces will follow.
            Err(error) if error.kind() == ErrorKind::WouldBlock => Err(DeviceError::Transfer(0)),
            Err(_) => Err(self.lost()),
        }
    }

    /// Switches the motors off. The device must also have its own watchdog.
    fn close(&mut self) {
        if self.stream.is_some() {
            // A failure can no longer be reported.
            let _ = self.write(0, &Wrench::ZERO);
        }
        self.stream = None;
    }
}

impl Drop for Stylus {
    fn drop(&mut self) {
        self.close();
    }
}

/// Parses the text after the colon of `stylus:127.0.0.1:7700`.
impl FromStr for Stylus {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let address = text.trim().parse();
        address.map(Self::new).map_err(|_| format!("'{text}' is no address; valid is such as 127.0.0.1:7700"))
    }
}

/// Trocar with this crate's additions.
pub fn app() -> App {
    App::new().device::<Stylus>("stylus:ADDRESS:PORT", "the stylus of this crate, over TCP")
}
