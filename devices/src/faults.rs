//! Fault injection between a driver and its device, live and in lock-step alike.
//!
//! A fault is data: a kind and the session time until which it lasts. The driver core checks at each step; devices are
//! unaware of it. All state is in plain atomics, so that injection never blocks the driver.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Handle on the faults of one device; clones act on the same device.
#[derive(Clone, Debug, Default)]
pub struct DeviceFaults {
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    unplugged_until_ns: AtomicU64,
    nan_until_ns: AtomicU64,
    held_until_ns: AtomicU64,
    delayed_until_ns: AtomicU64,
    delay_ns: AtomicU64,
}

impl DeviceFaults {
    /// Lasts until [`DeviceFaults::heal`].
    pub const FOREVER: u64 = u64::MAX;

    /// No faults.
    pub fn new() -> Self {
        Self::default()
    }

    /// Makes the device appear unplugged until `until_ns` (session time, ns).
    pub fn unplug_until(&self, until_ns: u64) {
        self.shared.unplugged_until_ns.store(until_ns, Relaxed);
    }

    /// Makes the device's readings NaN until `until_ns` (session time, ns).
    pub fn nan_until(&self, until_ns: u64) {
        self.shared.nan_until_ns.store(until_ns, Relaxed);
    }

    /// Holds the last reading until `until_ns` (session time, ns).
    pub fn hold_until(&self, until_ns: u64) {
        self.shared.held_until_ns.store(until_ns, Relaxed);
    }

    /// Delays readings by `delay_ns` until `until_ns` (session time, ns). The driver keeps the last 1,024 readings: a
    /// longer delay than they cover (about 1 s at 1 kHz) gives the oldest of them.
    pub fn delay_until(&self, delay_ns: u64, until_ns: u64) {
        self.shared.delay_ns.store(delay_ns, Relaxed);
        self.shared.delayed_until_ns.store(until_ns, Relaxed);
    }

    /// An independent copy of the faults, for a branch of the session.
    #[must_use]
    pub fn fork(&self) -> Self {
        let copy = |value: &AtomicU64| AtomicU64::new(value.load(Relaxed));
        let Shared { unplugged_until_ns, nan_until_ns, held_until_ns, delayed_until_ns, delay_ns } =
            &*self.shared;
        Self {
            shared: Arc::new(Shared {
                unplugged_until_ns: copy(unplugged_until_ns),
                nan_until_ns: copy(nan_until_ns),
                held_until_ns: copy(held_until_ns),
                delayed_until_ns: copy(delayed_until_ns),
                delay_ns: copy(delay_ns),
            }),
        }
    }

    /// Ends every fault.
    pub fn heal(&self) {
        let shared = &self.shared;
        for until in [
            &shared.unplugged_until_ns,
            &shared.nan_until_ns,
            &shared.held_until_ns,
            &shared.delayed_until_ns,
        ] {
            until.store(0, Relaxed);
        }
    }

    /// Whether the device seems to be unplugged at `now_ns`.
    pub fn unplugged(&self, now_ns: u64) -> bool {
        now_ns < self.shared.unplugged_until_ns.load(Relaxed)
    }

    /// Whether readings are NaN at `now_ns`.
    pub fn nan(&self, now_ns: u64) -> bool {
        now_ns < self.shared.nan_until_ns.load(Relaxed)
    }

    /// Whether the last reading is held at `now_ns`.
    pub fn held(&self, now_ns: u64) -> bool {
        now_ns < self.shared.held_until_ns.load(Relaxed)
    }

    /// Delay of readings at `now_ns` \[ns\].
    pub fn delay_ns(&self, now_ns: u64) -> u64 {
        if now_ns < self.shared.delayed_until_ns.load(Relaxed) {
            self.shared.delay_ns.load(Relaxed)
        } else {
            0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_end_by_themselves_and_by_healing() {
        let faults = DeviceFaults::new();
        assert!(!faults.unplugged(0) && !faults.nan(0) && !faults.held(0) && faults.delay_ns(0) == 0);
        let other_handle = faults.clone();
        other_handle.unplug_until(10);
        other_handle.delay_until(3, 20);
        assert!(faults.unplugged(9) && !faults.unplugged(10));
        assert_eq!((faults.delay_ns(19), faults.delay_ns(20)), (3, 0));
        faults.nan_until(DeviceFaults::FOREVER);
        faults.hold_until(DeviceFaults::FOREVER);
        assert!(faults.nan(1 << 60) && faults.held(1 << 60));
        faults.heal();
        assert!(!faults.nan(1) && !faults.held(1) && faults.delay_ns(1) == 0);
    }
}
