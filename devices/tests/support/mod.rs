//! What the tests of drivers share: a device whose answers are scripted, and a bench around it.

#![allow(dead_code)]

use nalgebra::Vector3;
use trocar_devices::{
    Capabilities, DeviceCommand, DeviceError, DeviceFaults, DeviceLink, DeviceMonitor, DeviceSample,
    DeviceSlot, DeviceState, Dofs, DriverConfig, DriverCore, HandIntent, HapticDevice, Workspace, Wrench,
    link,
};

/// One millisecond [ns].
pub const MS: u64 = 1_000_000;

/// A device that answers as told and remembers what it was told.
pub struct ScriptedDevice {
    pub capabilities: Capabilities,
    pub state: DeviceState,
    pub read_error: Option<DeviceError>,
    pub write_error: Option<DeviceError>,
    pub open_error: Option<DeviceError>,
    pub rendered: Wrench,
    pub opens: u32,
    pub closed: bool,
    pub intent: Option<HandIntent>,
}

impl ScriptedDevice {
    pub fn new() -> Self {
        Self {
            capabilities: Capabilities {
                name: "scripted".to_owned(),
                workspace: Workspace::centred(Vector3::new(0.16, 0.12, 0.07)),
                max_force_newtons: 3.3,
                max_torque: 0.0,
                max_stiffness: 1020.0,
                input_dofs: Dofs::Six,
                output_dofs: Dofs::Three,
                apparent_mass: 0.045,
            },
            state: DeviceState { connected: true, ..DeviceState::unknown() },
            read_error: None,
            write_error: None,
            open_error: None,
            rendered: Wrench::ZERO,
            opens: 0,
            closed: false,
            intent: None,
        }
    }
}

impl HapticDevice for ScriptedDevice {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }
    fn open(&mut self, _now_ns: u64) -> Result<(), DeviceError> {
        self.opens += 1;
        self.open_error.map_or(Ok(()), Err)
    }
    fn read(&mut self, _now_ns: u64) -> Result<DeviceState, DeviceError> {
        self.read_error.map_or(Ok(self.state), Err)
    }
    fn write(&mut self, _now_ns: u64, wrench: &Wrench) -> Result<(), DeviceError> {
        self.rendered = *wrench;
        self.write_error.map_or(Ok(()), Err)
    }
    fn set_intent(&mut self, _now_ns: u64, intent: &HandIntent) {
        self.intent = Some(*intent);
    }
    fn close(&mut self) {
        self.closed = true;
    }
}

/// A driver in virtual time with a device and the slot of its link.
pub struct Bench<D: HapticDevice> {
    pub device: D,
    pub core: DriverCore,
    pub slot: DeviceSlot,
    pub monitor: DeviceMonitor,
    pub faults: DeviceFaults,
    pub now_ns: u64,
    pub period_ns: u64,
}

impl<D: HapticDevice> Bench<D> {
    pub fn new(device: D) -> Self {
        let (end, slot, monitor) = link();
        let faults = DeviceFaults::new();
        let core = DriverCore::new(DriverConfig::default(), &device, end, faults.clone());
        Self { device, core, slot, monitor, faults, now_ns: 0, period_ns: MS }
    }

    /// One step of the driver after one period; what it published.
    pub fn step(&mut self) -> DeviceSample {
        self.now_ns += self.period_ns;
        self.core.step(self.now_ns, &mut self.device);
        self.monitor.sample()
    }

    /// One step of the driver at the time at which it stands; what it published.
    pub fn rest(&mut self) -> DeviceSample {
        self.core.rest(self.now_ns, &mut self.device);
        self.monitor.sample()
    }

    /// Steps for a while with nobody commanding.
    pub fn idle(&mut self, span_ns: u64) -> DeviceSample {
        (0..span_ns / self.period_ns).fold(self.monitor.sample(), |_, _| self.step())
    }

    /// Steps for a while with a force along x commanded before each step.
    pub fn push(&mut self, link: &mut DeviceLink, newtons: f64, span_ns: u64) -> DeviceSample {
        (0..span_ns / self.period_ns).fold(self.monitor.sample(), |_, _| {
            link.command(force(link.epoch(), self.now_ns + self.period_ns, newtons));
            self.step()
        })
    }
}

/// A command of a force along x.
pub fn force(epoch: u32, time_ns: u64, newtons: f64) -> DeviceCommand {
    DeviceCommand {
        epoch,
        time_ns,
        wrench: Wrench::from_force(Vector3::new(newtons, 0.0, 0.0)),
        passivity: true,
        intent: None,
    }
}
