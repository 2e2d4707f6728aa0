//! Driver thread: steps a driver core in real time, on an OS thread that owns the device.
//!
//! The thread sleeps until shortly before each tick and spins for the rest (bounded), at FIFO priority where the system
//! permits it. Missed ticks are skipped and counted, never run in a burst. When it is stopped or dropped it sets the
//! device's force to zero; a panic of the device ends only this thread, after one more attempt to render zero.

use std::fmt;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::device::{HapticDevice, Wrench};
use crate::driver_core::DriverCore;
use crate::link::{DriverStatistics, Fence};
use crate::sched;

/// Lowest rate \[Hz\], so that the thread notices a stop within 10 ms.
const RATE_MIN_HZ: f64 = 100.0;
/// Highest rate \[Hz\].
const RATE_MAX_HZ: f64 = 10_000.0;
/// How long a stop waits for a hanging device before the thread is abandoned.
const STOP_LIMIT: Duration = Duration::from_millis(200);

/// Period of steps while session time is paused \[ns\]: short enough to detect an unplugged device.
const STILL_PERIOD_NS: u64 = 50_000_000;

/// Session time \[ns\], as a function of the time since the session's start \[ns\], and whether it is paused. Called at
/// every step: it must neither block nor allocate.
#[derive(Clone)]
pub struct SessionTime(Arc<dyn Fn(u64) -> (u64, bool) + Send + Sync>);

impl SessionTime {
    /// Time given by `of_elapsed`; it must never decrease.
    pub fn new(of_elapsed: impl Fn(u64) -> (u64, bool) + Send + Sync + 'static) -> Self {
        Self(Arc::new(of_elapsed))
    }
}

/// Time from zero, without pauses.
impl Default for SessionTime {
    fn default() -> Self {
        Self::new(|elapsed_ns| (elapsed_ns, false))
    }
}

impl fmt::Debug for SessionTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SessionTime").finish_non_exhaustive()
    }
}

/// Parameters of a [`DriverThread`].
#[derive(Clone, Debug)]
pub struct DriverThreadConfig {
    /// Name of the thread, for debuggers and system monitors; the system shows its first 15 bytes.
    pub name: String,
    /// Steps per second \[Hz\], 100 to 10,000.
    pub rate_hz: f64,
    /// FIFO priority (1 to 99), or `None` for the ordinary scheduler.
    pub priority: Option<u8>,
    /// How long before a tick the thread wakes to spin \[ns\]; at most 30 % of a period is used.
    pub spin_ns: u64,
    /// Start of the session, from which [`Self::session_time`] counts. Shared by all users of the driver.
    pub session_start: Instant,
    /// Session time since then. While it is paused the driver steps 20 times per second.
    pub session_time: SessionTime,
}

impl DriverThreadConfig {
    /// 1 kHz, 30 µs of spin, ordinary scheduler.
    pub fn new(name: impl Into<String>, session_start: Instant) -> Self {
        let session_time = SessionTime::default();
        Self {
            name: name.into(),
            rate_hz: 1_000.0,
            priority: None,
            spin_ns: 30_000,
            session_start,
            session_time,
        }
    }
}

/// Why no driver thread was started.
#[derive(Debug, Error)]
pub enum DriverThreadError {
    /// The rate is out of range.
    #[error("driver rate {rate_hz} Hz is out of range ({RATE_MIN_HZ} to {RATE_MAX_HZ} Hz)")]
    Rate {
        /// The requested rate \[Hz\].
        rate_hz: f64,
    },
    /// The system started no thread.
    #[error("the driver thread could not be started: {0}")]
    Spawn(#[source] io::Error),
    /// The device did not answer in time when the driver was stopped; the thread was abandoned, and the device may
    /// still be rendering its last force.
    #[error("the driver thread of the device hung for more than {} ms and was abandoned", STOP_LIMIT.as_millis())]
    Hung,
    /// The device panicked; the thread rendered zero, as far as it could, and ended.
    #[error("the driver of the device panicked: {0}")]
    Panicked(String),
}

/// Scheduling of a driver thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Scheduling {
    /// FIFO with this priority.
    Fifo(u8),
    /// FIFO was requested and refused; the ordinary scheduler is used.
    Refused {
        /// The requested priority.
        priority: u8,
        /// The system's error.
        reason: String,
    },
    /// The ordinary scheduler, as requested.
    Ordinary,
}

/// A running driver; dropping it stops the thread and sets the device's force to zero.
#[derive(Debug)]
pub struct DriverThread {
    stop: Arc<AtomicBool>,
    fence: Fence,
    scheduling: Arc<OnceLock<Scheduling>>,
    thread: Option<JoinHandle<Result<DriverStatistics, DriverThreadError>>>,
}

impl DriverThread {
    /// Starts a thread that owns the core and its device and steps them at the configured rate.
    ///
    /// # Errors
    /// [`DriverThreadError::Rate`] or [`DriverThreadError::Spawn`]. A refused priority is no error: see
    /// [`DriverThread::scheduling`].
    pub fn spawn(
        core: DriverCore,
        device: Box<dyn HapticDevice>,
        config: DriverThreadConfig,
    ) -> Result<Self, DriverThreadError> {
        if !(RATE_MIN_HZ..=RATE_MAX_HZ).contains(&config.rate_hz) {
            return Err(DriverThreadError::Rate { rate_hz: config.rate_hz });
        }
        let stop = Arc::new(AtomicBool::new(false));
        let scheduling = Arc::new(OnceLock::new());
        let fence = core.fence().clone();
        // Thread names must not contain NUL, and a bad name must not cause a panic.
        let name = config.name.replace('\0', "");
        let (thread_stop, thread_scheduling) = (Arc::clone(&stop), Arc::clone(&scheduling));
        let thread = std::thread::Builder::new()
            .name(name)
            .spawn(move || {
                // It was just created, so it cannot have been set before.
                let _ = thread_scheduling.set(apply_scheduling(config.priority));
                run(core, device, &config, &thread_stop)
            })
            .map_err(DriverThreadError::Spawn)?;
        Ok(Self { stop, fence, scheduling, thread: Some(thread) })
    }

    /// Emergency stop, from any thread: zero force from the driver's next step on, permanently.
    pub fn zero_all_forces(&self) {
        self.fence.zero_all_forces();
    }

    /// Scheduling of the thread; `None` until it is known (the first microseconds).
    pub fn scheduling(&self) -> Option<&Scheduling> {
        self.scheduling.get()
    }

    /// Whether the thread still steps its device; false after a panic of the device.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }

    /// Stops the thread and sets the device's force to zero; returns the driver's counters.
    ///
    /// # Errors
    /// [`DriverThreadError::Hung`] when the device does not return in time, [`DriverThreadError::Panicked`] when it
    /// panicked at any time.
    pub fn stop(mut self) -> Result<DriverStatistics, DriverThreadError> {
        self.finish()
    }

    fn finish(&mut self) -> Result<DriverStatistics, DriverThreadError> {
        self.stop.store(true, Ordering::Release);
        let Some(thread) = self.thread.take() else { return Ok(DriverStatistics::default()) };
        let mut waited = Duration::ZERO;
        let nap = Duration::from_micros(200);
        while !thread.is_finished() {
            if waited >= STOP_LIMIT {
                return Err(DriverThreadError::Hung);
            }
            sched::nap(nap);
            waited += nap;
        }
        match thread.join() {
            Ok(result) => result,
            Err(payload) => Err(DriverThreadError::Panicked(panic_text(payload.as_ref()))),
        }
    }
}

impl Drop for DriverThread {
    fn drop(&mut self) {
        if self.thread.is_some() {
            // Errors of a hung or panicked device cannot be returned from `drop`; `stop` returns them.
            let _ = self.finish();
        }
    }
}

fn apply_scheduling(priority: Option<u8>) -> Scheduling {
    let Some(priority) = priority else {
        // Without this every sleep is up to 50 µs late; a refusal only costs accuracy.
        let _ = sched::sharpen_timers();
        return Scheduling::Ordinary;
    };
    match sched::set_fifo(priority) {
        Ok(()) => Scheduling::Fifo(priority),
        Err(error) => {
            let _ = sched::sharpen_timers();
            Scheduling::Refused { priority, reason: error.to_string() }
        }
    }
}

fn run(
    mut core: DriverCore,
    mut device: Box<dyn HapticDevice>,
    config: &DriverThreadConfig,
    stop: &AtomicBool,
) -> Result<DriverStatistics, DriverThreadError> {
    let origin_ns = origin_of(config.session_start);
    let period_ns = (1e9 / config.rate_hz).round() as u64;
    let spin_ns = config.spin_ns.min(period_ns * 3 / 10);
    let session_time = |now_ns: u64| (config.session_time.0)(now_ns.saturating_sub(origin_ns));
    let outcome = catch_unwind(AssertUnwindSafe(|| {
        let mut deadline_ns = sched::monotonic_ns();
        while !stop.load(Ordering::Acquire) {
            let now_ns = wait_for(deadline_ns, spin_ns);
            let (session_ns, still) = session_time(now_ns);
            if still {
                core.rest(session_ns, device.as_mut());
                deadline_ns = now_ns + STILL_PERIOD_NS;
                continue;
            }
            let lateness_ns = now_ns.saturating_sub(deadline_ns);
            let missed = lateness_ns / period_ns;
            core.note_timing(missed, lateness_ns);
            core.step(session_ns, device.as_mut());
            deadline_ns += (missed + 1) * period_ns;
        }
        core.shut_down(session_time(sched::monotonic_ns()).0, device.as_mut());
    }));
    match outcome {
        Ok(()) => Ok(*core.statistics()),
        Err(payload) => {
            let now_ns = session_time(sched::monotonic_ns()).0;
            core.abandon(now_ns);
            // The device is in an unknown state; it may panic again, which must not unwind further.
            let _ = catch_unwind(AssertUnwindSafe(|| {
                let _ = device.write(now_ns, &Wrench::ZERO);
                device.close();
            }));
            let _ = catch_unwind(AssertUnwindSafe(move || drop(device)));
            Err(DriverThreadError::Panicked(panic_text(payload.as_ref())))
        }
    }
}

/// Sleeps until `spin_ns` before the deadline and spins for the rest; the time at the end \[ns\].
fn wait_for(deadline_ns: u64, spin_ns: u64) -> u64 {
    let wake_ns = deadline_ns.saturating_sub(spin_ns);
    let mut now_ns = sched::monotonic_ns();
    while now_ns < wake_ns {
        sched::sleep_until(wake_ns);
        now_ns = sched::monotonic_ns();
    }
    while now_ns < deadline_ns {
        std::hint::spin_loop();
        now_ns = sched::monotonic_ns();
    }
    now_ns
}

/// Time of the monotonic clock at this instant \[ns\].
fn origin_of(session_start: Instant) -> u64 {
    let now = Instant::now();
    let now_ns = sched::monotonic_ns();
    let nanos = |span: Duration| u64::try_from(span.as_nanos()).unwrap_or(u64::MAX);
    if session_start > now {
        now_ns.saturating_add(nanos(session_start - now))
    } else {
        now_ns.saturating_sub(nanos(now - session_start))
    }
}

fn panic_text(payload: &(dyn std::any::Any + Send)) -> String {
    if let Some(text) = payload.downcast_ref::<&str>() {
        (*text).to_owned()
    } else if let Some(text) = payload.downcast_ref::<String>() {
        text.clone()
    } else {
        "no message".to_owned()
    }
}
