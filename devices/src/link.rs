//! Link between a driver and successive generations of its controller.
//!
//! A stalled controller cannot be killed: it is abandoned, and may wake up much later still holding its end of the
//! link. Therefore there is a bounded set of [`LANES`] lanes, each a pair of triple buffers (wait-free in both
//! directions). A [`DeviceSlot`] hands the link end of a free lane to each new generation; the driver publishes samples
//! to all lanes, and accepts commands from the lane of the newest generation only. Commands in any other lane are
//! counted and refused, and so is every epoch below the [`Fence`]. A lane is free again when its link is dropped; if
//! zombies hold them all, taking a link fails and the caller escalates.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use thiserror::Error;
use triple_buffer::{Input, Output, triple_buffer};

use crate::device::{DeviceState, HandIntent, Wrench};
use crate::lane_gate::{ActiveLane, LowestEpoch};
use crate::passivity::PortEnergy;

/// How many generations of controllers can hold a link to one device at the same time.
pub const LANES: usize = 8;

/// Command of a controller to a device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeviceCommand {
    /// Generation of the controller.
    pub epoch: u32,
    /// When the command was computed (session time, ns). It must increase from command to command.
    pub time_ns: u64,
    /// Wrench to render, in the device's frame.
    pub wrench: Wrench,
    /// Whether the driver's passivity controller limits the wrench. Otherwise the energy is only observed.
    pub passivity: bool,
    /// The human's target for the handle, if known; for virtual hands.
    pub intent: Option<HandIntent>,
}

/// Counters of a driver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DriverStatistics {
    /// Steps of the driver.
    pub steps: u64,
    /// Commands that were accepted.
    pub accepted: u64,
    /// Commands refused because their epoch is fenced or superseded (the force of a zombie).
    pub refused_epoch: u64,
    /// Commands refused because of a NaN, an infinity or an unnormalised rotation.
    pub refused_invalid: u64,
    /// Commands refused because they are no newer than the last, older than 20 ms, or dated in the future.
    pub refused_stale: u64,
    /// Readings refused because of a NaN, an infinity or an unnormalised rotation.
    pub readings_refused: u64,
    /// Errors of the device other than being unplugged.
    pub device_errors: u64,
    /// Number of times the device was unplugged.
    pub unplugs: u64,
    /// Number of times the device was reopened.
    pub reopens: u64,
    /// Steps in which the commanded wrench exceeded the device's limits.
    pub clamped: u64,
    /// Steps in which the slew limit acted.
    pub slew_limited: u64,
    /// Number of ramps.
    pub ramps: u64,
    /// Greatest force that was rendered, after the clamp \[N\].
    pub force_newtons_max: f64,
    /// Greatest torque that was rendered, after the clamp [N·m].
    pub torque_max: f64,
    /// Time since the last accepted command was computed \[ns\]; `u64::MAX` before the first.
    pub since_command_ns: u64,
    /// Greatest age of the last command that was accepted, while a force was still held \[ns\]: measured in every step,
    /// at the end of the time for which the previous step held its force.
    pub force_age_max_ns: u64,
    /// Number of times a force fell to zero because it was not renewed, or its controller was fenced.
    pub releases: u64,
    /// Age of the last accepted command at the latest release \[ns\].
    pub release_age_ns: u64,
    /// Ticks of a live driver that never ran.
    pub missed: u64,
    /// Greatest lateness of a live driver's tick \[ns\].
    pub lateness_max_ns: u64,
}

/// Sample published by a driver in each step.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DeviceSample {
    /// Measured state.
    pub state: DeviceState,
    /// Wrench that is rendered, after every limit.
    pub applied: Wrench,
    /// Energy through the port up to `state`.
    pub energy: PortEnergy,
    /// When `state` was measured (session time, ns); older than `published_at_ns` when readings fail.
    pub sampled_at_ns: u64,
    /// How long before that the handle was there \[ns\], see [`HapticDevice::lag_ns`](crate::HapticDevice::lag_ns).
    pub lag_ns: u64,
    /// When the sample was published (session time, ns).
    pub published_at_ns: u64,
    /// Generation of the current controller; 0 before the first.
    pub epoch: u32,
    /// Counters since the driver was created.
    pub statistics: DriverStatistics,
}

impl DeviceSample {
    /// The sample before the driver's first step.
    pub fn unknown() -> Self {
        Self {
            state: DeviceState::unknown(),
            applied: Wrench::ZERO,
            energy: PortEnergy::default(),
            sampled_at_ns: 0,
            lag_ns: 0,
            published_at_ns: 0,
            epoch: 0,
            statistics: DriverStatistics { since_command_ns: u64::MAX, ..DriverStatistics::default() },
        }
    }
}

/// Epoch fence: the lowest epoch that a driver accepts. It only rises; any thread may raise it at any time, without
/// blocking.
#[derive(Clone, Debug, Default)]
pub struct Fence {
    lowest: Arc<LowestEpoch>,
}

impl Fence {
    /// Refuses every command of an epoch below `epoch`, from the driver's next step on. The force of a fenced
    /// controller fades to zero within 15 ms.
    pub fn raise(&self, epoch: u32) {
        self.lowest.raise(epoch);
    }

    /// Emergency stop: zero force from the driver's next step on, permanently.
    pub fn zero_all_forces(&self) {
        self.raise(u32::MAX);
    }

    /// The lowest accepted epoch; `u32::MAX` means none.
    pub fn lowest(&self) -> u32 {
        self.lowest.get()
    }

    /// Whether the fence admits commands of this epoch.
    pub fn admits(&self, epoch: u32) -> bool {
        self.lowest.admits(epoch)
    }
}

/// Why no link could be taken from a slot.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum LinkError {
    /// The epoch is below the fence.
    #[error("epoch {epoch} is fenced: the device obeys epochs from {lowest} on")]
    Fenced {
        /// The requested epoch.
        epoch: u32,
        /// Lowest accepted epoch.
        lowest: u32,
    },
    /// A later generation has already taken a link.
    #[error("epoch {epoch} is superseded: epoch {newest} has taken the link already")]
    Superseded {
        /// The requested epoch.
        epoch: u32,
        /// Epoch of the newest link.
        newest: u32,
    },
    /// Abandoned controllers hold every lane.
    #[error("all {LANES} lanes of the link are held by controllers that were abandoned")]
    LanesExhausted,
}

struct ControllerLane {
    index: usize,
    commands: Input<Option<DeviceCommand>>,
    samples: Output<DeviceSample>,
}

struct DriverLane {
    commands: Output<Option<DeviceCommand>>,
    samples: Input<DeviceSample>,
}

struct SlotShared {
    // Locked when a link is made or dropped, never in a tick and never by the driver.
    free: Mutex<Vec<ControllerLane>>,
    active: Arc<ActiveLane>,
    fence: Fence,
}

/// Slot from which each new generation of a controller takes its link; clones share the slot.
#[derive(Clone)]
pub struct DeviceSlot {
    shared: Arc<SlotShared>,
}

impl fmt::Debug for DeviceSlot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DeviceSlot")
            .field("active", &self.shared.active.get())
            .field("free_lanes", &unpoisoned(&self.shared.free).len())
            .finish_non_exhaustive()
    }
}

impl DeviceSlot {
    /// A new link for the controller of generation `epoch`; the driver accepts it, and no earlier one, from its next
    /// step on. Not for real-time paths: it takes a lock briefly.
    ///
    /// # Errors
    /// [`LinkError`] when the generation is fenced or superseded (a zombie that wakes up while it is being
    /// built), or when zombies hold every lane.
    pub fn take(&self, epoch: u32) -> Result<DeviceLink, LinkError> {
        // The lock is held throughout, so that of two generations the later one wins.
        let mut free = unpoisoned(&self.shared.free);
        if !self.shared.fence.admits(epoch) {
            return Err(LinkError::Fenced { epoch, lowest: self.shared.fence.lowest() });
        }
        if let Some((newest, _)) = self.shared.active.get()
            && epoch < newest
        {
            return Err(LinkError::Superseded { epoch, newest });
        }
        let lane = free.pop().ok_or(LinkError::LanesExhausted)?;
        self.shared.active.set(epoch, lane.index);
        Ok(DeviceLink { epoch, lane: Some(lane), slot: self.clone() })
    }

    /// Number of free lanes.
    pub fn free_lanes(&self) -> usize {
        unpoisoned(&self.shared.free).len()
    }

    /// The fence of this device.
    pub fn fence(&self) -> &Fence {
        &self.shared.fence
    }
}

/// A controller's end of the link to a driver. Neither method allocates, locks or blocks.
pub struct DeviceLink {
    epoch: u32,
    lane: Option<ControllerLane>,
    slot: DeviceSlot,
}

impl fmt::Debug for DeviceLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DeviceLink").field("epoch", &self.epoch).finish_non_exhaustive()
    }
}

impl DeviceLink {
    /// Generation for which the link was taken.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }

    /// The newest sample of the driver. Its `published_at_ns` shows whether the driver is alive.
    pub fn sample(&mut self) -> &DeviceSample {
        // The lane is only taken out in `drop`.
        self.lane.as_mut().map(|lane| lane.samples.read()).expect("a link has a lane until it is dropped")
    }

    /// Sends a command; the driver takes the newest at its next step. The driver accepts it only if this link is of the
    /// newest generation and its epoch is not fenced.
    pub fn command(&mut self, command: DeviceCommand) {
        if let Some(lane) = &mut self.lane {
            lane.commands.write(Some(command));
        }
    }
}

impl Drop for DeviceLink {
    fn drop(&mut self) {
        if let Some(lane) = self.lane.take() {
            unpoisoned(&self.slot.shared.free).push(lane);
        }
    }
}

/// A driver's end of the link; consumed by [`crate::DriverCore`].
pub struct DriverEnd {
    lanes: Vec<DriverLane>,
    active: Arc<ActiveLane>,
    monitor: Input<DeviceSample>,
    fence: Fence,
}

impl fmt::Debug for DriverEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DriverEnd").field("lanes", &self.lanes.len()).finish_non_exhaustive()
    }
}

impl DriverEnd {
    /// The fence of this device.
    pub fn fence(&self) -> &Fence {
        &self.fence
    }

    /// Takes the newest command of the newest generation, and the number of other lanes with a command.
    pub(crate) fn intake(&mut self) -> (Option<DeviceCommand>, u64) {
        let active = self.active.get();
        let mut newest = None;
        let mut superseded = 0;
        for (index, lane) in self.lanes.iter_mut().enumerate() {
            if !lane.commands.update() {
                continue;
            }
            let command = *lane.commands.output_buffer();
            match active {
                // In a reused lane, commands left by its last holder have an older epoch than the new holder's.
                Some((epoch, lane)) if lane == index && command.is_some_and(|c| c.epoch >= epoch) => {
                    newest = command;
                }
                _ => superseded += u64::from(command.is_some()),
            }
        }
        (newest, superseded)
    }

    pub(crate) fn publish(&mut self, sample: &DeviceSample) {
        // Published to all lanes, so that a link taken later finds a fresh sample.
        for lane in &mut self.lanes {
            lane.samples.write(*sample);
        }
        self.monitor.write(*sample);
    }
}

/// Monitor of a device for reports, consoles and recorders. Clones share one view.
#[derive(Clone)]
pub struct DeviceMonitor {
    // Shared among readers only; the driver writes through the triple buffer and never blocks on them.
    output: Arc<Mutex<Output<DeviceSample>>>,
}

impl fmt::Debug for DeviceMonitor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DeviceMonitor").finish_non_exhaustive()
    }
}

impl DeviceMonitor {
    /// The newest sample. Takes a lock that only other readers hold.
    pub fn sample(&self) -> DeviceSample {
        *unpoisoned(&self.output).read()
    }
}

/// Makes the link of one device: the driver's end, the slot from which controllers take theirs, and a view
/// for others.
pub fn link() -> (DriverEnd, DeviceSlot, DeviceMonitor) {
    let fence = Fence::default();
    let active = Arc::new(ActiveLane::default());
    let mut driver_lanes = Vec::with_capacity(LANES);
    let mut controller_lanes = Vec::with_capacity(LANES);
    for index in 0..LANES {
        let (command_input, command_output) = triple_buffer(&None);
        let (sample_input, sample_output) = triple_buffer(&DeviceSample::unknown());
        driver_lanes.push(DriverLane { commands: command_output, samples: sample_input });
        controller_lanes.push(ControllerLane { index, commands: command_input, samples: sample_output });
    }
    let (monitor_input, monitor_output) = triple_buffer(&DeviceSample::unknown());
    let driver = DriverEnd {
        lanes: driver_lanes,
        active: Arc::clone(&active),
        monitor: monitor_input,
        fence: fence.clone(),
    };
    let slot =
        DeviceSlot { shared: Arc::new(SlotShared { free: Mutex::new(controller_lanes), active, fence }) };
    (driver, slot, DeviceMonitor { output: Arc::new(Mutex::new(monitor_output)) })
}

/// A driver's end and the link of one controller of generation 0 that is never restarted: for tools and tests.
pub fn pair() -> (DriverEnd, DeviceLink) {
    let (driver, slot, _) = link();
    let link = slot.take(0).expect("a fresh slot has free lanes and no fence");
    (driver, link)
}

/// Ignores poisoning: a panic leaves the data under these locks consistent.
fn unpoisoned<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn command(epoch: u32, newtons: f64) -> DeviceCommand {
        DeviceCommand {
            epoch,
            time_ns: 1,
            wrench: Wrench::from_force(Vector3::new(newtons, 0.0, 0.0)),
            passivity: true,
            intent: None,
        }
    }

    #[test]
    fn both_ends_can_go_to_threads_of_their_own() {
        fn assert_send<T: Send>() {}
        fn assert_shared<T: Send + Sync + Clone>() {}
        assert_send::<DeviceLink>();
        assert_send::<DriverEnd>();
        assert_shared::<DeviceSlot>();
        assert_shared::<DeviceMonitor>();
        assert_shared::<Fence>();
    }

    #[test]
    fn only_the_lane_of_the_newest_generation_is_obeyed() {
        let (mut driver, slot, _) = link();
        let mut zombie = slot.take(1).unwrap();
        zombie.command(command(1, 1.0));
        assert_eq!(driver.intake().0, Some(command(1, 1.0)));

        let mut successor = slot.take(2).unwrap();
        zombie.command(command(1, 100.0));
        assert_eq!(driver.intake(), (None, 1));
        // Refused even with a forged epoch.
        zombie.command(command(9, 100.0));
        successor.command(command(2, 0.5));
        assert_eq!(driver.intake(), (Some(command(2, 0.5)), 1));
        assert_eq!(driver.intake(), (None, 0));
    }

    #[test]
    fn a_generation_that_comes_late_cannot_take_the_link_back() {
        let (_driver, slot, _) = link();
        let _successor = slot.take(5).unwrap();
        assert_eq!(slot.take(4).unwrap_err(), LinkError::Superseded { epoch: 4, newest: 5 });
        slot.fence().raise(7);
        assert_eq!(slot.take(6).unwrap_err(), LinkError::Fenced { epoch: 6, lowest: 7 });
        assert!(slot.take(7).is_ok());
        slot.fence().zero_all_forces();
        assert!(matches!(slot.take(u32::MAX), Err(LinkError::Fenced { .. })));
    }

    #[test]
    fn lanes_are_bounded_and_come_back_when_a_link_is_dropped() {
        let (mut driver, slot, _) = link();
        let mut zombies: Vec<_> = (0..LANES as u32).map(|epoch| slot.take(epoch).unwrap()).collect();
        assert_eq!(slot.take(100).unwrap_err(), LinkError::LanesExhausted);
        let mut last_words = zombies.remove(3);
        last_words.command(command(3, 100.0));
        drop(last_words);
        let mut reused = slot.take(100).unwrap();
        // Commands left in the lane by its last holder are refused.
        assert_eq!(driver.intake(), (None, 1));
        reused.command(command(100, 2.0));
        assert_eq!(driver.intake().0, Some(command(100, 2.0)));
    }

    #[test]
    fn a_link_that_is_taken_later_finds_the_newest_sample() {
        let (mut driver, slot, monitor) = link();
        let mut first = slot.take(1).unwrap();
        assert!(!first.sample().state.connected);
        let sample = DeviceSample { published_at_ns: 42, ..DeviceSample::unknown() };
        driver.publish(&sample);
        assert_eq!(first.sample().published_at_ns, 42);
        assert_eq!(slot.take(2).unwrap().sample().published_at_ns, 42);
        assert_eq!(monitor.clone().sample().published_at_ns, 42);
    }

    #[test]
    fn the_fence_only_rises() {
        let fence = Fence::default();
        assert!(fence.admits(0));
        fence.raise(3);
        fence.clone().raise(2);
        assert_eq!(fence.lowest(), 3);
        assert!(!fence.admits(2) && fence.admits(3) && fence.admits(u32::MAX));
        fence.zero_all_forces();
        assert!(!fence.admits(u32::MAX));
    }
}
