//! A heart that beats at the beginning and at the end of every step, and can be looked at by another thread.
//! `tests/loom` tries every interleaving.

use crate::sync::{AtomicU64, Ordering};

/// Bumped by the thread that works, read by the watchdog.
#[derive(Debug, Default)]
pub(crate) struct Heartbeat {
    count: AtomicU64,
    at_ns: AtomicU64,
}

impl Heartbeat {
    /// A step begins or ends at this time of the session \[ns\].
    pub(crate) fn bump(&self, now_ns: u64) {
        self.at_ns.store(now_ns, Ordering::Relaxed);
        // Releases the time: who sees this beat does not see a time before it, which would look like a stall.
        self.count.fetch_add(1, Ordering::Release);
    }

    /// How often it has beaten, odd while a step runs, and the time of that beat or of a later one \[ns\].
    pub(crate) fn look(&self) -> (u64, u64) {
        let count = self.count.load(Ordering::Acquire);
        (count, self.at_ns.load(Ordering::Relaxed))
    }
}
