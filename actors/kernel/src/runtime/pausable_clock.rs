//! Pausable session clock: while it is paused, readers see a constant time.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_scene::SimTime;

/// Converts the time since a session's time zero to session time. Readers never block.
///
/// One word, so that every read is atomic. Upper bit set: the time at which the clock is paused; clear: the total
/// paused time so far \[ns\]. 63 bits of nanoseconds are 292 years.
#[derive(Debug, Default)]
pub struct PausableClock(AtomicU64);

const PAUSED: u64 = 1 << 63;

impl PausableClock {
    /// Session time when `elapsed` has passed since time zero, or would have in a session that began later.
    pub fn at(&self, elapsed: SimTime) -> SimTime {
        let word = self.0.load(Ordering::Acquire);
        if word & PAUSED == 0 { SimTime(elapsed.0.saturating_sub(word)) } else { SimTime(word & !PAUSED) }
    }
    /// Whether the clock is paused.
    pub fn is_paused(&self) -> bool {
        self.0.load(Ordering::Acquire) & PAUSED != 0
    }
    /// Pauses the clock.
    pub fn pause(&self, elapsed: SimTime) {
        self.0.store(PAUSED | self.at(elapsed).0, Ordering::Release);
    }
    /// Resumes the clock at the time where it was paused.
    pub fn resume(&self, elapsed: SimTime) {
        if self.is_paused() {
            let paused_at = self.at(elapsed);
            self.0.store(elapsed.since(paused_at).0, Ordering::Release);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_that_stands_goes_on_where_it_stood_as_often_as_one_likes() {
        let (clock, secs) = (PausableClock::default(), |secs: u64| SimTime::from_millis(1_000 * secs));
        assert_eq!(clock.at(secs(3)), secs(3));
        clock.pause(secs(5));
        clock.pause(secs(6));
        assert!(clock.is_paused());
        assert_eq!(clock.at(secs(50)), secs(5));
        clock.resume(secs(105));
        clock.resume(secs(106));
        assert!(!clock.is_paused());
        assert_eq!(clock.at(secs(107)), secs(7));
        clock.pause(secs(110));
        clock.resume(secs(210));
        assert_eq!(clock.at(secs(211)), secs(11));
    }
}
