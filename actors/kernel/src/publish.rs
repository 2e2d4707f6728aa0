//! When the Model publishes: after so many batches, after so long, or when nothing is left to apply.
//!
//! A rule, not a timer: publishing "when idle" by a message to oneself starves under load.

use trocar_scene::SimTime;

/// Limits between two publications.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishRule {
    /// Most applied batches that readers do not see yet.
    pub batches_max: u32,
    /// Longest time for which the first of them waits.
    pub age_max: SimTime,
}

impl Default for PublishRule {
    fn default() -> Self {
        Self { batches_max: 32, age_max: SimTime::from_micros(200) }
    }
}

/// Counts what is applied and not yet published.
#[derive(Clone, Copy, Debug, Default)]
pub struct PublishClock {
    rule: PublishRule,
    unpublished: u32,
    first: SimTime,
}

impl PublishClock {
    /// Nothing is unpublished.
    pub fn new(rule: PublishRule) -> Self {
        Self { rule, unpublished: 0, first: SimTime::ZERO }
    }
    /// A batch was applied.
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
    /// How many applied batches readers do not see yet.
    pub fn unpublished(&self) -> u32 {
        self.unpublished
    }
    /// A snapshot with everything applied so far is out.
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
