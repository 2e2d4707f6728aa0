//! Driver core: the safety layer below every actor, as a sans-IO state machine.
//!
//! One [`DriverCore::step`] reads the device, takes the newest command, decides which wrench may be rendered, renders
//! it and publishes a [`DeviceSample`]. It reads no clock, allocates nothing and never blocks, so that the same code
//! runs live ([`crate::DriverThread`]) and in lock-step.
//!
//! Guarantees, independent of the controllers:
//!
//! - no wrench above the device's own limits is rendered, and no NaN;
//! - a controller below the [`Fence`], or of an earlier generation than the newest, is refused;
//! - a force that is not renewed fades from 5 ms and is zero at 20 ms, at the motors: a step that would hold it longer
//!   holds zero; the same applies to every force while the device gives no valid reading;
//! - force ramps in after a start, a restart, an interruption and a re-plug;
//! - no force gives the hand more energy than the hand has put in, except for the loans of [`PassivityConfig`] (unless
//!   the controller waives this; the port's energy is observed in any case);
//! - an unplugged device gets no force, and is opened again when it returns;
//! - after [`Fence::zero_all_forces`] the next step and all later ones render zero.

use crate::device::{DeviceError, DeviceState, HandIntent, HapticDevice, Wrench};
use crate::faults::DeviceFaults;
use crate::force_guard::{DECAY_END_NS, DECAY_START_NS, ForceGuard, GuardConfig, Request, SLEW_STEP_MAX_NS};
use crate::link::{DeviceCommand, DeviceSample, DriverEnd, DriverStatistics, Fence};
use crate::passivity::{PassivityConfig, PassivityController, PortEnergy};

/// Time without a valid reading after which a device counts as unplugged \[ns\].
const LOST_AFTER_NS: u64 = 200_000_000;

/// Readings kept for the delay fault.
const DELAY_LINE: usize = 1024;

/// Parameters of a [`DriverCore`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Limits of the force guard.
    pub guard: GuardConfig,
    /// Parameters of the passivity controller.
    pub passivity: PassivityConfig,
    /// Time between two attempts to open an absent device \[ns\].
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

/// Connection state of the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Connection {
    /// Absent; the next attempt to open it is due at this time \[ns\].
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

/// The wrench that a step renders, and the part withheld for passivity.
struct Decision {
    wrench: Wrench,
    withheld: Wrench,
}

/// Recent readings, for the delay fault.
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

    /// The newest reading of `at_ns` or before, else the oldest.
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

/// The driver of one device; see the module for its guarantees.
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
    lag_ns: u64,
    last_reading_ns: u64,
    delay_line: DelayLine,
    accepted: Option<Accepted>,
    epoch: u32,
    last_command_ns: Option<u64>,
    last_step_ns: Option<u64>,
    opened_before: bool,
    statistics: DriverStatistics,
}

/// State of a driver as recorded in the scene, from which another driver can continue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverResume {
    /// Last measured state.
    pub state: DeviceState,
    /// When \[ns\].
    pub sampled_at_ns: u64,
    /// Wrench held by the motors.
    pub applied: Wrench,
    /// Last commanded wrench.
    pub commanded: Wrench,
    /// When \[ns\].
    pub commanded_at_ns: u64,
    /// Target of the hand.
    pub intent: HandIntent,
    /// Energy through the port, as far as recorded.
    pub energy: PortEnergy,
}

/// Epoch of a session's first controller, which in a branch takes over from the original session's.
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
            lag_ns: 0,
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
    /// [fork](HapticDevice::fork) of this one's. It accepts a controller of the first epoch in place of this driver's
    /// controller, so that the force continues without a ramp. The history of readings for delay faults starts empty.
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

    /// Opens `device` and continues from another driver's state in the scene.
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
                    // Until the controller waives passivity.
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

    /// One step while session time is paused at `now_ns`: the device is read, and gets zero force regardless of
    /// commands. A controller that hung before the pause may wake up during it, and in paused time its command would
    /// never become stale. Afterwards force ramps up from zero.
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

    /// Sets the force to zero, closes the device, and publishes that it is disconnected.
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

    /// Counts the release of a `held` force that ended without a new command.
    fn note_release(&mut self, held: Option<u64>) {
        let Some(age_ns) = held else { return };
        let renewed = self.accepted.is_some_and(|accepted| self.last_step_ns == Some(accepted.taken_at_ns));
        if *self.guard.applied() == Wrench::ZERO && !renewed {
            self.statistics.releases += 1;
            self.statistics.release_age_ns = age_ns;
        }
    }

    /// Publishes that the device is disconnected, without accessing it: for a device that panicked.
    pub fn abandon(&mut self, now_ns: u64) {
        self.accepted = None;
        self.guard.release(now_ns);
        self.connection = Connection::Absent { retry_at_ns: u64::MAX };
        self.state = self.state.unplugged();
        self.publish(now_ns);
    }

    /// Records a live driver's timing: ticks that never ran, and the lateness of this one \[ns\].
    pub fn note_timing(&mut self, missed: u64, lateness_ns: u64) {
        self.statistics.missed += missed;
        self.statistics.lateness_max_ns = self.statistics.lateness_max_ns.max(lateness_ns);
    }

    /// Counters since the core was created.
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
                // The fault acts between device and driver: a virtual hand keeps moving meanwhile.
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
            Ok(state) => self.take_reading(now_ns, state, device.lag_ns()),
            Err(DeviceError::Disconnected) => self.disconnected(now_ns, device),
            Err(error) => self.count(error),
        }
        if now_ns.saturating_sub(self.last_reading_ns) >= LOST_AFTER_NS {
            self.disconnected(now_ns, device);
        }
    }

    fn take_reading(&mut self, now_ns: u64, mut state: DeviceState, lag_ns: u64) {
        if self.faults.nan(now_ns) {
            state.pose_in_device.translation.vector.fill(f64::NAN);
        }
        if !state.is_valid() {
            self.statistics.readings_refused += 1;
            return;
        }
        // Whoever uses the state, the passivity controller as well, uses what is recorded of it.
        let state = state.rounded();
        self.delay_line.push(now_ns, state);
        if self.faults.held(now_ns) {
            return;
        }
        // A late reading still proves that the device is alive; a controller sees its age in the sample.
        self.last_reading_ns = now_ns;
        self.sampled_at_ns = now_ns;
        self.lag_ns = lag_ns;
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
            // The device may still take commands, for instance when only its readings fail.
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

    /// Starts to fade the last force of a controller fenced since; in an emergency it is zero at once.
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
                        // As long as the previous step, unless that was late.
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
            applied: self.guard.applied().rounded(),
            energy: *self.passivity.port(),
            sampled_at_ns: self.sampled_at_ns,
            lag_ns: self.lag_ns,
            published_at_ns: now_ns,
            epoch: self.epoch,
            statistics: self.statistics,
        });
    }
}
