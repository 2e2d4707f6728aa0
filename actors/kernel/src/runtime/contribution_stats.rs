//! Statistics of a writer's entries in shared lists, such as a detector's contacts in the collision list.

use std::sync::atomic::{AtomicU64, Ordering};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// No list yet.
const NONE: u64 = u64::MAX;

/// Updated by one thread at every tick; read by any thread.
#[derive(Debug)]
pub(super) struct HitCounts {
    now: AtomicU64,
    max: AtomicU64,
    sum: AtomicU64,
    ticks: AtomicU64,
    with_any: AtomicU64,
}

impl Default for HitCounts {
    fn default() -> Self {
        let zero = || AtomicU64::new(0);
        Self { now: AtomicU64::new(NONE), max: zero(), sum: zero(), ticks: zero(), with_any: zero() }
    }
}

impl HitCounts {
    /// Records one tick: `listed` entries, or with `None` as many as before.
    pub(super) fn tick(&self, listed: Option<u64>) {
        if let Some(count) = listed {
            self.now.store(count, Ordering::Relaxed);
        }
        let now = self.now.load(Ordering::Relaxed);
        if now == NONE {
            return;
        }
        self.ticks.fetch_add(1, Ordering::Relaxed);
        if now > 0 {
            self.max.fetch_max(now, Ordering::Relaxed);
            self.sum.fetch_add(now, Ordering::Relaxed);
            self.with_any.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Clears the current count, because a writer's list ends with its life.
    pub(super) fn forget(&self) {
        if self.now.load(Ordering::Relaxed) != NONE {
            self.now.store(0, Ordering::Relaxed);
        }
    }

    /// `None` before the first list.
    pub(super) fn report(&self) -> Option<Hits> {
        let now = Some(self.now.load(Ordering::Relaxed)).filter(|now| *now != NONE)?;
        let ticks = self.ticks.load(Ordering::Relaxed).max(1);
        Some(Hits {
            now,
            mean: self.sum.load(Ordering::Relaxed) as f64 / ticks as f64,
            max: self.max.load(Ordering::Relaxed),
            ticks: self.with_any.load(Ordering::Relaxed),
        })
    }
}

/// How many contacts a detector had in the collision list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Hits {
    /// Count after its last tick.
    pub now: u64,
    /// Mean over all ticks since its first list.
    pub mean: f64,
    /// Largest count after any tick.
    pub max: u64,
    /// Ticks with at least one contact.
    pub ticks: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_listed_anew_still_stands_until_the_life_ends() {
        let counts = HitCounts::default();
        counts.tick(None);
        assert_eq!(counts.report(), None, "nobody that contributes");
        counts.tick(Some(4));
        counts.tick(None);
        assert_eq!(counts.report(), Some(Hits { now: 4, mean: 4.0, max: 4, ticks: 2 }));
        counts.forget();
        counts.tick(None);
        counts.tick(Some(0));
        assert_eq!(counts.report(), Some(Hits { now: 0, mean: 2.0, max: 4, ticks: 2 }));
    }
}
