//! Publication rule of the Model: after a number of batches, after a time, or when no batch waits.
//!
//! A rule, not a timer: publishing "when idle" through a message to itself would starve under load.

use trocar_scene::SimTime;

/// Limits between two publications.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishRule {
    /// Most applied batches before a publication.
    pub batches_max: u32,
    /// Longest time that the first of them waits for publication.
    pub age_max: SimTime,
}

impl Default for PublishRule {
    fn default() -> Self {
        Self { batches_max: 32, age_max: SimTime::from_micros(200) }
    }
}

/// Tracks the applied, unpublished batches.
#[derive(Clone, Copy, Debug, Default)]
pub struct PublishClock {
    rule: PublishRule,
    unpublished: u32,
    first: SimTime,
}

impl PublishClock {
    /// A clock without unpublished batches.
    pub fn new(rule: PublishRule) -> Self {
        Self { rule, unpublished: 0, first: SimTime::ZERO }
    }
    /// Records that a batch was applied.
    pub fn applied(&mut self, now: SimTime) {
        if self.unpublished == 0 {
            self.first = now;
        }
        self.unpublished += 1;
    }
    /// Whether to publish now; `drained` says that no batch waits.
    pub fn is_due(&self, now: SimTime, drained: bool) -> bool {
        self.unpublished > 0
            && (drained
                || self.unpublished >= self.rule.batches_max
                || now.since(self.first) >= self.rule.age_max)
    }
    /// Number of applied, unpublished batches.
    pub fn unpublished(&self) -> u32 {
        self.unpublished
    }
    /// Records that everything applied so far was published.
    pub fn published(&mut self) {
        self.unpublished = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_applied_publishes_nothing() {
        let clock = PublishClock::default();
        assert!(!clock.is_due(SimTime::from_millis(1_000), true));
    }

    #[test]
    fn a_flood_is_published_after_32_batches_and_a_trickle_after_200_us() {
        let mut clock = PublishClock::default();
        for _ in 0..31 {
            clock.applied(SimTime(5));
            assert!(!clock.is_due(SimTime(5), false));
        }
        clock.applied(SimTime(5));
        assert!(clock.is_due(SimTime(5), false));
        clock.published();
        clock.applied(SimTime::from_micros(1_000));
        clock.applied(SimTime::from_micros(1_100));
        assert!(!clock.is_due(SimTime::from_micros(1_199), false));
        assert!(clock.is_due(SimTime::from_micros(1_199), true), "drained");
        assert!(clock.is_due(SimTime::from_micros(1_200), false), "old enough");
    }
}
