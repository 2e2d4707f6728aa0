//! Pausable session clock: while it is paused, readers see a constant time.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_scene::SimTime;

/// Converts the time since a session's origin to session time. Readers never block.
///
/// One word, so that every read is atomic. Upper bit set: the time at which the clock is paused; clear: the total
/// paused time so far \[ns\]. 63 bits of nanoseconds are 292 years.
#[derive(Debug, Default)]
pub struct Standstill(AtomicU64);

const STANDS: u64 = 1 << 63;

impl Standstill {
    /// Session time when `elapsed` has passed since the origin.
    pub fn at(&self, elapsed: SimTime) -> SimTime {
        let word = self.0.load(Ordering::Acquire);
        if word & STANDS == 0 { SimTime(elapsed.0.saturating_sub(word)) } else { SimTime(word & !STANDS) }
    }
    /// Whether the clock is paused.
    pub fn is_still(&self) -> bool {
        self.0.load(Ordering::Acquire) & STANDS != 0
    }
    /// Pauses the clock.
    pub fn stop(&self, elapsed: SimTime) {
        self.0.store(STANDS | self.at(elapsed).0, Ordering::Release);
    }
    /// Resumes the clock at the time where it was paused.
    pub fn go_on(&self, elapsed: SimTime) {
        if self.is_still() {
            let stood_at = self.at(elapsed);
            self.0.store(elapsed.since(stood_at).0, Ordering::Release);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_that_stands_goes_on_where_it_stood_as_often_as_one_likes() {
        let (still, secs) = (Standstill::default(), |secs: u64| SimTime::from_millis(1_000 * secs));
        assert_eq!(still.at(secs(3)), secs(3));
        still.stop(secs(5));
        still.stop(secs(6));
        assert!(still.is_still());
        assert_eq!(still.at(secs(50)), secs(5));
        still.go_on(secs(105));
        still.go_on(secs(106));
        assert!(!still.is_still());
        assert_eq!(still.at(secs(107)), secs(7));
        still.stop(secs(110));
        still.go_on(secs(210));
        assert_eq!(still.at(secs(211)), secs(11));
    }
}
