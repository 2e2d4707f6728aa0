//! Hands: devices opened for a session, each behind its driver's safety layer, for either time driver.

use std::sync::Arc;
use std::time::Instant;

use trocar_devices::{
    Capabilities, DeviceFaults, DeviceMonitor, DeviceSlot, DeviceState as Measured, DriverConfig, DriverCore,
    DriverResume, DriverThread, DriverThreadConfig, DriverThreadError, Fence as DeviceFence, HandIntent,
    HapticDevice, PassivityConfig, PortEnergy, SessionTime, Wrench, link,
};
use trocar_haptics::pressed;
use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink, Fence, Peer};
use trocar_scene::{
    DeviceForce, DeviceInfo, DeviceState, Entity, HandTarget, HapticStatus, PressTarget, SimTime, Snapshot,
};

/// Steps per second of a driver, live and in lock-step \[Hz\].
pub const DRIVER_RATE_HZ: f64 = 1_000.0;

/// The session's handle to a hand whose device runs elsewhere. Clones share it.
#[derive(Clone)]
pub struct HandPort {
    /// Name in the scenario, such as `left`.
    pub name: String,
    /// The entity with the `hand` component.
    pub entity: Entity,
    /// The slot from which each new haptics controller takes its link.
    pub slot: DeviceSlot,
    /// The driver's newest sample, with its statistics.
    pub monitor: DeviceMonitor,
    /// Faults injected between driver and device.
    pub faults: DeviceFaults,
    /// The device's capabilities.
    pub capabilities: Capabilities,
}

impl HandPort {
    /// Name of the device as a fault target: `device.left`.
    pub fn fault_target(&self) -> String {
        format!("device.{}", self.name)
    }
    /// Name of the controller that serves it: `haptics.left`.
    pub fn controller(&self) -> String {
        format!("haptics.{}", self.name)
    }
}

/// A device with its driver, before it runs.
pub struct OpenedHand {
    port: HandPort,
    core: DriverCore,
    device: Box<dyn HapticDevice>,
}

impl OpenedHand {
    /// Wraps a device in the driver's safety layer.
    pub fn new(name: impl Into<String>, entity: Entity, device: Box<dyn HapticDevice>) -> Self {
        Self::with(DriverConfig::default(), name, entity, device)
    }

    /// The same for a hand whose scene is computed elsewhere. Energy is lent to what moves by itself; what comes late looks
    /// like that, and would be lent the energy that a delay makes. So nothing is lent.
    pub(crate) fn far_from_its_scene(
        name: impl Into<String>,
        entity: Entity,
        device: Box<dyn HapticDevice>,
    ) -> Self {
        let passivity = PassivityConfig { lend_power: 0.0, ..PassivityConfig::default() };
        Self::with(DriverConfig { passivity, ..DriverConfig::default() }, name, entity, device)
    }

    fn with(
        config: DriverConfig,
        name: impl Into<String>,
        entity: Entity,
        device: Box<dyn HapticDevice>,
    ) -> Self {
        let (end, slot, monitor) = link();
        let faults = DeviceFaults::new();
        let core = DriverCore::new(config, device.as_ref(), end, faults.clone());
        let capabilities = device.capabilities().clone();
        let port = HandPort { name: name.into(), entity, slot, monitor, faults, capabilities };
        Self { port, core, device }
    }

    /// The same device in its initial state, or `None` for one that exists only once; `prototype` has never been
    /// opened.
    pub(crate) fn anew(port: &HandPort, prototype: &dyn HapticDevice) -> Option<Self> {
        Some(Self::new(&port.name, port.entity, prototype.fork()?))
    }

    /// A hand that continues from its state in a scene at `time`.
    pub(crate) fn resumed(
        port: &HandPort,
        prototype: &dyn HapticDevice,
        scene: &Snapshot,
        time: SimTime,
    ) -> Option<Self> {
        let mut hand = Self::anew(port, prototype)?;
        if let Some(resume) = driver_resume(scene, port.entity, time) {
            hand.core.resume(&resume, hand.device.as_mut());
        }
        Some(hand)
    }

    /// Goes on from the hand's state in a scene at `time`, if the device is virtual; a physical one is where its person
    /// holds it.
    pub(crate) fn go_on(&mut self, scene: &Snapshot, time: SimTime) {
        if self.device.fork().is_some()
            && let Some(resume) = driver_resume(scene, self.port.entity, time)
        {
            self.core.resume(&resume, self.device.as_mut());
        }
    }

    /// The device, before it is opened: the prototype for [`OpenedHand::anew`]. `None` for a device that exists only
    /// once.
    pub(crate) fn prototype(&self) -> Option<Box<dyn HapticDevice>> {
        self.device.fork()
    }

    /// The device.
    pub(crate) fn device_mut(&mut self) -> &mut dyn HapticDevice {
        self.device.as_mut()
    }

    /// The session's handle.
    pub fn port(&self) -> &HandPort {
        &self.port
    }

    /// The device's capabilities as a component.
    pub fn info(&self) -> DeviceInfo {
        device_info(self.device.capabilities())
    }

    /// The device's capabilities, for the header of a recording.
    pub fn describe(&self) -> serde_json::Value {
        serde_json::to_value(self.info()).unwrap_or_default()
    }

    /// As a peer of the lock-step driver, which steps it in virtual time.
    pub fn into_peer(self) -> Box<dyn Peer> {
        let name = self.port.fault_target();
        Box::new(SteppedHand { name, port: self.port, core: self.core, device: self.device })
    }

    /// Starts its own thread for live sessions, at a higher priority than every actor.
    ///
    /// # Errors
    /// When the system cannot start a thread.
    pub fn into_thread(
        self,
        session_start: Instant,
        session_time: SessionTime,
        priority: u8,
    ) -> Result<DriverThread, DriverThreadError> {
        let mut config = DriverThreadConfig::new(self.port.fault_target(), session_start);
        config.session_time = session_time;
        config.rate_hz = DRIVER_RATE_HZ;
        config.priority = Some(priority);
        DriverThread::spawn(self.core, self.device, config)
    }
}

/// A device's capabilities as the component in the scene.
pub fn device_info(capabilities: &Capabilities) -> DeviceInfo {
    DeviceInfo {
        model: capabilities.name.clone(),
        workspace: capabilities.workspace.size().into(),
        max_force: capabilities.max_force_newtons,
        max_torque: capabilities.max_torque,
        max_stiffness: capabilities.max_stiffness,
        apparent_mass: capabilities.apparent_mass,
        input_dofs: capabilities.input_dofs.count(),
        output_dofs: capabilities.output_dofs.count(),
    }
}

/// A device's measured state, from the component in the scene.
pub(crate) fn measured(state: &DeviceState) -> Measured {
    Measured {
        pose_in_device: state.handle_in_device.isometry(),
        linear_velocity: state.velocity_in_device.linear,
        angular_velocity: state.velocity_in_device.angular,
        gripper: state.gripper,
        buttons: state.buttons,
        connected: state.connected,
    }
}

/// The state of a hand's driver in the scene at `time`, if the device has been measured at all.
fn driver_resume(scene: &Snapshot, hand: Entity, time: SimTime) -> Option<DriverResume> {
    let state = scene.get::<DeviceState>(hand)?;
    let measured = measured(state);
    let commanded = scene.get::<DeviceForce>(hand).copied().unwrap_or_default();
    let wanted = scene.get::<HandTarget>(hand);
    let status = scene.get::<HapticStatus>(hand).copied().unwrap_or_default();
    Some(DriverResume {
        state: measured,
        sampled_at_ns: state.sampled_at.min(time).as_nanos(),
        // The scene does not hold the rendered torque; the commanded one is within the same limits.
        applied: Wrench { force: state.applied_force, torque: commanded.torque },
        commanded: Wrench { force: commanded.force, torque: commanded.torque },
        commanded_at_ns: commanded.at.min(time).as_nanos(),
        intent: HandIntent {
            pose_in_device: wanted.map_or(measured.pose_in_device, |t| t.handle_in_device.isometry()),
            gripper: wanted.map_or(state.gripper, |target| target.gripper),
            buttons: scene.get::<PressTarget>(hand).map_or(0, pressed),
        },
        energy: PortEnergy {
            energy: status.energy,
            energy_min: status.energy_min,
            available: status.energy,
            dissipated: status.dissipated,
            ..PortEnergy::default()
        },
    })
}

/// A driver in virtual time.
pub(crate) struct SteppedHand {
    name: String,
    port: HandPort,
    core: DriverCore,
    device: Box<dyn HapticDevice>,
}

impl SteppedHand {
    /// A copy in the same state, for a branch of the session; `None` for a device that exists only once.
    pub(crate) fn fork(&self) -> Option<OpenedHand> {
        let device = self.device.fork()?;
        let (end, slot, monitor) = link();
        let faults = self.port.faults.fork();
        let core = self.core.fork(end, faults.clone());
        let port = HandPort { slot, monitor, faults, ..self.port.clone() };
        Some(OpenedHand { port, core, device })
    }
}

impl Peer for SteppedHand {
    fn name(&self) -> &str {
        &self.name
    }
    fn period_ns(&self) -> u64 {
        (1e9 / DRIVER_RATE_HZ) as u64
    }
    fn step(&mut self, now: SimTime) {
        self.core.step(now.as_nanos(), self.device.as_mut());
    }
    fn finish(&mut self, now: SimTime) {
        self.core.shut_down(now.as_nanos(), self.device.as_mut());
    }
}

/// Lets the kernel raise a driver's fence when its controller dies or stalls.
pub struct HandFence(pub DeviceFence);

impl Fence for HandFence {
    fn raise(&self, epoch: u32) {
        self.0.raise(epoch);
    }
}

/// How long a killed device stays away before its driver may reopen it.
const KILLED_FOR: SimTime = SimTime::from_millis(100);

/// A device whose latest good reading is older than this, at its driver, counts as unsound.
const STALE_AFTER: SimTime = SimTime::from_millis(5);

/// Receives the faults aimed at a device.
pub struct HandFaults {
    faults: DeviceFaults,
    monitor: DeviceMonitor,
    /// Session time at the start.
    begin: SimTime,
}

impl HandFaults {
    /// For the hand of `port` in a session that starts at the session time `begin`.
    pub fn sink(port: &HandPort, begin: SimTime) -> Arc<dyn FaultSink> {
        Arc::new(Self { faults: port.faults.clone(), monitor: port.monitor.clone(), begin })
    }
}

impl FaultSink for HandFaults {
    fn fault(&self, order: &FaultOrder) {
        let until = if order.begins { DeviceFaults::FOREVER } else { 0 };
        // Instantaneous faults end by themselves, counted from the driver's latest step, or from the start before it.
        let stepped = |at_ns: u64| at_ns.max(self.begin.as_nanos());
        let after =
            |span: SimTime| stepped(self.monitor.sample().published_at_ns).saturating_add(span.as_nanos());
        match order.kind {
            FaultKind::Unplug => self.faults.unplug_until(until),
            FaultKind::Nan => self.faults.nan_until(until),
            FaultKind::Kill => self.faults.unplug_until(after(KILLED_FOR)),
            FaultKind::Stall => self.faults.hold_until(after(order.span)),
            // The plan's check against the target's class has refused every other kind before the session starts.
            _ => {}
        }
    }
    fn is_sound(&self) -> Option<bool> {
        let sample = self.monitor.sample();
        let age_ns = sample.published_at_ns.saturating_sub(sample.sampled_at_ns);
        Some(sample.state.connected && age_ns <= STALE_AFTER.as_nanos())
    }
}
