//! Heartbeat of a controller thread: bumped at the beginning and at the end of every step, read by the watchdog.
//! `tests/loom` tries every interleaving.

use crate::sync::{AtomicU64, Ordering};

/// Written by the controller's thread, read by the watchdog.
#[derive(Debug, Default)]
pub(crate) struct Heartbeat {
    count: AtomicU64,
    at_ns: AtomicU64,
}

impl Heartbeat {
    /// Records that a step begins or ends at this session time \[ns\].
    pub(crate) fn bump(&self, now_ns: u64) {
        self.at_ns.store(now_ns, Ordering::Relaxed);
        // Release ordering: a reader that sees this count must not see an older time, which would look like a stall.
        self.count.fetch_add(1, Ordering::Release);
    }

    /// Number of beats (odd while a step runs) and the time of that beat or of a later one \[ns\].
    pub(crate) fn look(&self) -> (u64, u64) {
        let count = self.count.load(Ordering::Acquire);
        (count, self.at_ns.load(Ordering::Relaxed))
    }
}
