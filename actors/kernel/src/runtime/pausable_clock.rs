//! Time of a session that can stand still: while it does, nobody who reads it sees any pass.

use std::sync::atomic::{AtomicU64, Ordering};

use trocar_scene::SimTime;

/// What turns the time since a session's origin into its own time. Readers never wait.
///
/// One word, so that no reader can see half of a change: with the upper bit the time at which it stands, without it
/// what was taken off so far \[ns\]. 63 bits of nanoseconds are 292 years.
#[derive(Debug, Default)]
pub struct Standstill(AtomicU64);

const STANDS: u64 = 1 << 63;

impl Standstill {
    /// Time of the session when `elapsed` has passed since its origin.
    pub fn at(&self, elapsed: SimTime) -> SimTime {
        let word = self.0.load(Ordering::Acquire);
        if word & STANDS == 0 { SimTime(elapsed.0.saturating_sub(word)) } else { SimTime(word & !STANDS) }
    }
    /// Whether it stands.
    pub fn is_still(&self) -> bool {
        self.0.load(Ordering::Acquire) & STANDS != 0
    }
    /// It stands from now on.
    pub fn stop(&self, elapsed: SimTime) {
        self.0.store(STANDS | self.at(elapsed).0, Ordering::Release);
    }
    /// It goes on where it stood.
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
