//! The safety that lies below every actor, as a sans-IO state machine.
//!
//! One [`DriverCore::step`] reads the device, takes the newest command, decides which wrench may be rendered,
//! renders it and publishes a [`DeviceSample`]. It reads no clock, allocates nothing and waits for nobody, so
//! that the same code runs live ([`crate::DriverThread`]) and in lock-step.
//!
//! The promises, whatever the controllers do:
//!
//! - nothing above the device's own limits is rendered, and no NaN;
//! - a controller below the [`Fence`], or of an earlier generation than the newest, is refused;
//! - a force that is not renewed fades from 5 ms and is zero at 20 ms, at the motors: a step that would hold it
//!   beyond that holds none; so does every force while the device
//!   gives no valid reading;
//! - force ramps in after a start, a restart, an interruption and a re-plug;
//! - no force gives the hand energy that the hand has not paid, but for what [`PassivityConfig`] lends (unless the
//!   controller waives that: what goes through the port is observed either way);
//! - an unplugged device is rendered nothing, and is opened again when it comes back;
//! - after [`Fence::zero_all_forces`] the next step renders nothing, and so does every later one.

use crate::device::{DeviceError, DeviceState, HandIntent, HapticDevice, Wrench};
use crate::faults::DeviceFaults;
use crate::force_guard::{DECAY_END_NS, DECAY_START_NS, ForceGuard, GuardConfig, Request, SLEW_STEP_MAX_NS};
use crate::link::{DeviceCommand, DeviceSample, DriverEnd, DriverStatistics, Fence};
use crate::passivity::{PassivityConfig, PassivityController, PortEnergy};

/// Time without a valid reading after which a device counts as unplugged \[ns\].
const LOST_AFTER_NS: u64 = 200_000_000;

/// Readings kept for the delay fault.
const DELAY_LINE: usize = 1024;

/// How a [`DriverCore`] behaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Limits of what is felt.
    pub guard: GuardConfig,
    /// How forces are kept passive.
    pub passivity: PassivityConfig,
    /// Time between two attempts to open a device that is not there \[ns\].
    pub reopen_period_ns: u64,
}

impl Default for DriverConfig {
    fn default() -> Self {
        Self {
            guard: GuardConfig::default(),
            passivity: PassivityConfig::default(),
            reopen_period_ns: 100_000_000,
        }
    }
}

/// Whether the device is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Connection {
    /// Not there; the next attempt to open it is due at this time \[ns\].
    Absent { retry_at_ns: u64 },
    /// Open.
    Present,
}

/// The command that is being rendered.
#[derive(Clone, Copy, Debug)]
struct Accepted {
    epoch: u32,
    // When it was computed; moved back when its epoch is fenced, so that the fade starts at once.
    fresh_at_ns: u64,
    taken_at_ns: u64,
    wrench: Wrench,
    passivity: bool,
}

/// What a step renders, and what passivity keeps of it.
struct Decision {
    wrench: Wrench,
    withheld: Wrench,
}

/// Readings of the recent past, so that they can be delivered late.
#[derive(Debug)]
struct DelayLine {
    readings: Vec<(u64, DeviceState)>,
    next: usize,
}

impl DelayLine {
    fn push(&mut self, at_ns: u64, state: DeviceState) {
        if self.readings.len() < DELAY_LINE {
            // Within the capacity reserved at construction.
            self.readings.push((at_ns, state));
        } else {
            self.readings[self.next] = (at_ns, state);
        }
        self.next = (self.next + 1) % DELAY_LINE;
    }

    /// The newest reading of `at_ns` or before, else the oldest there is.
    fn at(&self, at_ns: u64) -> Option<(u64, DeviceState)> {
        let count = self.readings.len();
        let newest_first =
            (1..=count).map(|back| &self.readings[(self.next + DELAY_LINE - back) % DELAY_LINE]);
        let mut oldest = None;
        for reading in newest_first {
            if reading.0 <= at_ns {
                return Some(*reading);
            }
            oldest = Some(*reading);
        }
        oldest
    }
}

/// The driver of one device; see the module for what it promises.
#[derive(Debug)]
pub struct DriverCore {
    config: DriverConfig,
    end: DriverEnd,
    faults: DeviceFaults,
    guard: ForceGuard,
    passivity: PassivityController,
    connection: Connection,
    state: DeviceState,
    sampled_at_ns: u64,
    last_reading_ns: u64,
    delay_line: DelayLine,
    accepted: Option<Accepted>,
    epoch: u32,
    last_command_ns: Option<u64>,
    last_step_ns: Option<u64>,
    opened_before: bool,
    statistics: DriverStatistics,
}

/// What the scene tells of a driver at one moment: enough for another one to go on from there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverResume {
    /// What the device had measured.
    pub state: DeviceState,
    /// When \[ns\].
    pub sampled_at_ns: u64,
    /// What the motors held.
    pub applied: Wrench,
    /// What the controller had commanded last.
    pub commanded: Wrench,
    /// When \[ns\].
    pub commanded_at_ns: u64,
    /// Where the hand was wanted.
    pub intent: HandIntent,
    /// What had gone through the port, as far as somebody kept account.
    pub energy: PortEnergy,
}

/// Epoch of the first controller of a session, which takes over from the one that a branch left behind.
const FIRST_EPOCH: u32 = 1;

impl DriverCore {
    /// A driver for a device with these capabilities. The device is opened by the first step.
    pub fn new(
        config: DriverConfig,
        device: &dyn HapticDevice,
        end: DriverEnd,
        faults: DeviceFaults,
    ) -> Self {
        Self {
            config,
            end,
            faults,
            guard: ForceGuard::new(config.guard, device.capabilities()),
            passivity: PassivityController::new(config.passivity, device.capabilities()),
            connection: Connection::Absent { retry_at_ns: 0 },
            state: DeviceState::unknown(),
            sampled_at_ns: 0,
            last_reading_ns: 0,
            delay_line: DelayLine { readings: Vec::with_capacity(DELAY_LINE), next: 0 },
            accepted: None,
            epoch: 0,
            last_command_ns: None,
            last_step_ns: None,
            opened_before: false,
            statistics: DriverStatistics { since_command_ns: u64::MAX, ..DriverStatistics::default() },
        }
    }

    /// A driver of its own in the same state, for a branch of a session in virtual time; its device is a
    /// [fork](HapticDevice::fork) of this one's. It obeys a controller of the first epoch as if it were the one that
    /// this driver obeys, so that the force goes on without a ramp. Readings for a delay that is still to be injected
    /// begin anew.
    pub fn fork(&self, end: DriverEnd, faults: DeviceFaults) -> Self {
        let mut fork = Self {
            config: self.config,
            end,
            faults,
            guard: self.guard.clone(),
            passivity: self.passivity.clone(),
            delay_line: DelayLine { readings: Vec::with_capacity(DELAY_LINE), next: 0 },
            accepted: self.accepted.map(|accepted| Accepted { epoch: FIRST_EPOCH, ..accepted }),
            epoch: self.last_command_ns.map_or(0, |_| FIRST_EPOCH),
            ..*self
        };
        fork.publish(self.last_step_ns.unwrap_or(0));
        fork
    }

    /// Opens `device` and goes on from what a scene tells of another driver.
    pub fn resume(&mut self, resume: &DriverResume, device: &mut dyn HapticDevice) {
        let DriverResume { state, sampled_at_ns, applied, commanded, commanded_at_ns, intent, energy } =
            resume;
        self.state = *state;
        self.sampled_at_ns = *sampled_at_ns;
        self.last_step_ns = Some(*sampled_at_ns);
        self.last_reading_ns = *sampled_at_ns;
        self.opened_before = true;
        device.resume(*sampled_at_ns, state, intent);
        self.passivity.resume(*sampled_at_ns, energy, applied);
        if state.connected && device.open(*sampled_at_ns).is_ok() {
            self.connection = Connection::Present;
            self.guard.resume(*sampled_at_ns, applied);
            if device.write(*sampled_at_ns, self.guard.applied()).is_err() {
                self.statistics.device_errors += 1;
            }
            self.passivity.observe(*sampled_at_ns, &state.pose_in_device);
            if commanded.is_finite() {
                self.epoch = FIRST_EPOCH;
                self.last_command_ns = Some(*commanded_at_ns);
                self.accepted = Some(Accepted {
                    epoch: FIRST_EPOCH,
                    fresh_at_ns: *commanded_at_ns,
                    taken_at_ns: *commanded_at_ns,
                    wrench: *commanded,
                    // Until the controller says that it waives that.
                    passivity: true,
                });
            }
        }
        self.publish(*sampled_at_ns);
    }

    /// One step at session time `now_ns`, which must not decrease. Real-time safe if the device is.
    pub fn step(&mut self, now_ns: u64, device: &mut dyn HapticDevice) {
        self.statistics.steps += 1;
        let held = self.held_until(now_ns);
        self.sense(now_ns, device);
        if let Some(command) = self.take_command(now_ns)
            && let Some(intent) = &command.intent
        {
            device.set_intent(now_ns, intent);
        }
        self.release_fenced(now_ns);
        let Decision { wrench, withheld } = self.decide(now_ns);
        self.last_step_ns = Some(now_ns);
        self.actuate(now_ns, device, &wrench);
        self.note_release(held);
        self.passivity.hold(now_ns, self.guard.applied(), &withheld);
        self.publish(now_ns);
    }

    /// One step while the session's time stands still at `now_ns`: the device is read, and rendered nothing, whatever is
    /// commanded. A controller that hung since before the pause may wake up in it, and at a time that does not pass its
    /// command would be fresh for ever. Afterwards force grows from nothing.
    pub fn rest(&mut self, now_ns: u64, device: &mut dyn HapticDevice) {
        self.statistics.steps += 1;
        let held = self.held_until(now_ns);
        self.sense(now_ns, device);
        let (command, superseded) = self.end.intake();
        self.statistics.refused_epoch += superseded;
        self.statistics.refused_stale += u64::from(command.is_some());
        self.accepted = None;
        let released = self.guard.release(now_ns);
        self.last_step_ns = Some(now_ns);
        self.actuate(now_ns, device, &released);
        self.note_release(held);
        self.passivity.hold(now_ns, self.guard.applied(), &Wrench::ZERO);
        self.publish(now_ns);
    }

    /// Leaves the device without force and closed, and publishes that it is gone.
    pub fn shut_down(&mut self, now_ns: u64, device: &mut dyn HapticDevice) {
        self.accepted = None;
        let held = self.held_until(now_ns);
        let released = self.guard.release(now_ns);
        self.note_release(held);
        if self.connection == Connection::Present && device.write(now_ns, &released).is_err() {
            self.statistics.device_errors += 1;
        }
        device.close();
        self.abandon(now_ns);
    }

    /// Age of the last accepted command, if its force was held until now.
    fn held_until(&mut self, now_ns: u64) -> Option<u64> {
        let age_ns = now_ns.saturating_sub(self.last_command_ns?);
        if *self.guard.applied() == Wrench::ZERO {
            return None;
        }
        self.statistics.force_age_max_ns = self.statistics.force_age_max_ns.max(age_ns);
        Some(age_ns)
    }

    /// A force that was `held` is no more, and it is not that a new command says so.
    fn note_release(&mut self, held: Option<u64>) {
        let Some(age_ns) = held else { return };
        let renewed = self.accepted.is_some_and(|accepted| self.last_step_ns == Some(accepted.taken_at_ns));
        if *self.guard.applied() == Wrench::ZERO && !renewed {
            self.statistics.releases += 1;
            self.statistics.release_age_ns = age_ns;
        }
    }

    /// Publishes that the device is gone without touching it: for a driver whose device panicked.
    pub fn abandon(&mut self, now_ns: u64) {
        self.accepted = None;
        self.guard.release(now_ns);
        self.connection = Connection::Absent { retry_at_ns: u64::MAX };
        self.state = self.state.unplugged();
        self.publish(now_ns);
    }

    /// What a live driver knows of its own timing: ticks that never ran, and how late \[ns\] this one is.
    pub fn note_timing(&mut self, missed: u64, lateness_ns: u64) {
        self.statistics.missed += missed;
        self.statistics.lateness_max_ns = self.statistics.lateness_max_ns.max(lateness_ns);
    }

    /// Counts since the core was made.
    pub fn statistics(&self) -> &DriverStatistics {
        &self.statistics
    }

    /// The fence of this device.
    pub fn fence(&self) -> &Fence {
        self.end.fence()
    }

    /// The faults that can be injected here.
    pub fn faults(&self) -> &DeviceFaults {
        &self.faults
    }

    fn sense(&mut self, now_ns: u64, device: &mut dyn HapticDevice) {
        if let Connection::Absent { retry_at_ns } = self.connection {
            if self.faults.unplugged(now_ns) {
                // The fault lies between device and driver: a virtual hand goes on moving meanwhile.
                if self.opened_before
                    && let Err(error) = device.read(now_ns)
                {
                    self.count(error);
                }
                return;
            }
            if now_ns < retry_at_ns {
                return;
            }
            match device.open(now_ns) {
                Ok(()) => self.reconnected(now_ns),
                Err(error) => {
                    self.count(error);
                    let retry_at_ns = now_ns.saturating_add(self.config.reopen_period_ns);
                    self.connection = Connection::Absent { retry_at_ns };
                    return;
                }
            }
        }
        let reading = device.read(now_ns);
        let reading = if self.faults.unplugged(now_ns) { Err(DeviceError::Disconnected) } else { reading };
        match reading {
            Ok(state) => self.take_reading(now_ns, state),
            Err(DeviceError::Disconnected) => self.disconnected(now_ns, device),
            Err(error) => self.count(error),
        }
        if now_ns.saturating_sub(self.last_reading_ns) >= LOST_AFTER_NS {
            self.disconnected(now_ns, device);
        }
    }

    fn take_reading(&mut self, now_ns: u64, mut state: DeviceState) {
        if self.faults.nan(now_ns) {
            state.pose_in_device.translation.vector.fill(f64::NAN);
        }
        if !state.is_valid() {
            self.statistics.readings_refused += 1;
            return;
        }
        self.delay_line.push(now_ns, state);
        if self.faults.held(now_ns) {
            return;
        }
        // A late reading still proves that the device is alive; a controller sees its age in the sample.
        self.last_reading_ns = now_ns;
        self.sampled_at_ns = now_ns;
        self.state = state;
        let delay_ns = self.faults.delay_ns(now_ns);
        if delay_ns > 0
            && let Some((at_ns, late)) = self.delay_line.at(now_ns.saturating_sub(delay_ns))
        {
            self.sampled_at_ns = at_ns;
            self.state = late;
        }
        self.passivity.observe(now_ns, &self.state.pose_in_device);
    }

    fn reconnected(&mut self, now_ns: u64) {
        self.connection = Connection::Present;
        self.last_reading_ns = now_ns;
        self.guard.restart_ramp();
        if self.opened_before {
            self.statistics.reopens += 1;
        }
        self.opened_before = true;
    }

    fn disconnected(&mut self, now_ns: u64, device: &mut dyn HapticDevice) {
        if self.connection == Connection::Present {
            self.statistics.unplugs += 1;
            // It may still hear us, for instance when only its readings fail.
            if device.write(now_ns, &Wrench::ZERO).is_err() {
                self.statistics.device_errors += 1;
            }
        }
        self.connection =
            Connection::Absent { retry_at_ns: now_ns.saturating_add(self.config.reopen_period_ns) };
        self.state = self.state.unplugged();
        self.accepted = None;
        self.passivity.interrupt();
    }

    fn count(&mut self, error: DeviceError) {
        if error != DeviceError::Disconnected {
            self.statistics.device_errors += 1;
        }
    }

    /// The newest command, if it is accepted.
    fn take_command(&mut self, now_ns: u64) -> Option<DeviceCommand> {
        let (command, superseded) = self.end.intake();
        self.statistics.refused_epoch += superseded;
        let command = command?;
        if !self.end.fence().admits(command.epoch) || command.epoch < self.epoch {
            self.statistics.refused_epoch += 1;
            return None;
        }
        if !command.wrench.is_finite() || command.intent.is_some_and(|intent| !intent.is_valid()) {
            self.statistics.refused_invalid += 1;
            return None;
        }
        let newer =
            command.epoch > self.epoch || self.last_command_ns.is_none_or(|last| command.time_ns > last);
        if !newer || command.time_ns.abs_diff(now_ns) >= DECAY_END_NS {
            self.statistics.refused_stale += 1;
            return None;
        }
        if command.epoch > self.epoch || self.last_command_ns.is_none() {
            self.guard.restart_ramp();
        }
        self.epoch = command.epoch;
        self.last_command_ns = Some(command.time_ns);
        self.accepted = Some(Accepted {
            epoch: command.epoch,
            fresh_at_ns: command.time_ns.min(now_ns),
            taken_at_ns: now_ns,
            wrench: command.wrench,
            passivity: command.passivity,
        });
        self.statistics.accepted += 1;
        Some(command)
    }

    /// The last force of a controller that was fenced since starts to fade now; in an emergency it is gone.
    fn release_fenced(&mut self, now_ns: u64) {
        let fence = self.end.fence();
        if fence.lowest() == u32::MAX {
            self.accepted = None;
        } else if let Some(accepted) = &mut self.accepted
            && !fence.admits(accepted.epoch)
        {
            accepted.fresh_at_ns = accepted.fresh_at_ns.min(now_ns.saturating_sub(DECAY_START_NS));
        }
    }

    fn decide(&mut self, now_ns: u64) -> Decision {
        match &self.accepted {
            Some(accepted) if self.state.connected && self.connection == Connection::Present => {
                let wanted = self.guard.step(
                    now_ns,
                    &Request {
                        wrench: accepted.wrench,
                        command_age_ns: now_ns.saturating_sub(accepted.fresh_at_ns),
                        reading_age_ns: now_ns.saturating_sub(self.last_reading_ns),
                        // As long as the step before was, but for one that came late.
                        hold_ns: self
                            .last_step_ns
                            .map_or(0, |last| now_ns.saturating_sub(last))
                            .min(SLEW_STEP_MAX_NS),
                        linear_velocity: self.state.linear_velocity,
                    },
                );
                let share = if accepted.passivity { self.passivity.share(now_ns, &wanted) } else { 1.0 };
                Decision { wrench: self.guard.shorten(share), withheld: wanted * (1.0 - share) }
            }
            _ => Decision { wrench: self.guard.release(now_ns), withheld: Wrench::ZERO },
        }
    }

    fn actuate(&mut self, now_ns: u64, device: &mut dyn HapticDevice, wrench: &Wrench) {
        if self.connection == Connection::Present {
            match device.write(now_ns, wrench) {
                Ok(()) => {
                    self.statistics.force_newtons_max =
                        self.statistics.force_newtons_max.max(wrench.force.norm());
                    self.statistics.torque_max = self.statistics.torque_max.max(wrench.torque.norm());
                }
                Err(error) => {
                    self.count(error);
                    self.guard.release(now_ns);
                    if error == DeviceError::Disconnected {
                        self.disconnected(now_ns, device);
                    }
                }
            }
        }
    }

    fn publish(&mut self, now_ns: u64) {
        self.statistics.since_command_ns =
            self.last_command_ns.map_or(u64::MAX, |command_ns| now_ns.saturating_sub(command_ns));
        self.statistics.clamped = self.guard.clamped();
        self.statistics.slew_limited = self.guard.slew_limited();
        self.statistics.ramps = self.guard.ramps();
        self.end.publish(&DeviceSample {
            state: self.state,
            applied: *self.guard.applied(),
            energy: *self.passivity.port(),
            sampled_at_ns: self.sampled_at_ns,
            published_at_ns: now_ns,
            epoch: self.epoch,
            statistics: self.statistics,
        });
    }
}
