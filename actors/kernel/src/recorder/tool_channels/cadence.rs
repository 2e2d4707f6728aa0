//! When the next message of a topic is due.

use trocar_scene::SimTime;

/// A period and the end of the current one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cadence {
    period: SimTime,
    next: SimTime,
}

impl Cadence {
    pub(super) const fn new(period: SimTime) -> Self {
        Self { period, next: SimTime::ZERO }
    }

    /// Whether a message is due; if so, the next period begins.
    pub(super) fn is_due(&mut self, now: SimTime) -> bool {
        let due = now >= self.next;
        if due {
            // Counted from the due time, so that irregular publications do not lower the rate.
            let next = self.next + self.period;
            self.next = if next < now { now + self.period } else { next };
        }
        due
    }

    /// A message is due at once.
    pub(super) fn hurry(&mut self) {
        self.next = SimTime::ZERO;
    }
}
