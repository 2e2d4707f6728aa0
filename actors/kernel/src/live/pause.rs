//! A session that rests: its controllers do not tick, its time stands still, and hardly any processor is used.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::LiveSession;

/// Longest wait for controllers in the middle of a step; one that hangs is not waited for.
const REST_MAX: Duration = Duration::from_millis(250);
const LOOK: Duration = Duration::from_millis(1);

impl LiveSession {
    /// Lets the session rest. No controller begins another tick; when none is in the middle of one any more, `quiet` is
    /// called while time still passes – for devices whose forces fade – and then time stands still. Ticks that fall
    /// into a pause do not exist: they are neither run nor missed. The Model, the supervisor and the operator's
    /// writes go on.
    ///
    /// False when it rests already, or has ended.
    pub fn pause(&self, quiet: impl FnOnce()) -> bool {
        if self.has_ended() || self.shared.resting.swap(true, Ordering::AcqRel) {
            return false;
        }
        let until = Instant::now() + REST_MAX;
        let works = || {
            self.shared
                .writers
                .iter()
                .map(|writer| writer.seat.life.load())
                .any(|life| life.running.load(Ordering::Acquire) && !life.at_rest.load(Ordering::Acquire))
        };
        while works() && Instant::now() < until {
            std::thread::sleep(LOOK);
        }
        quiet();
        self.shared.clock.stop();
        true
    }

    /// Lets the session go on where it stood, within 50 ms. False when it does not rest.
    pub fn resume(&self) -> bool {
        if !self.is_paused() {
            return false;
        }
        self.shared.clock.go_on();
        self.shared.resting.store(false, Ordering::Release);
        true
    }

    /// Whether it rests.
    pub fn is_paused(&self) -> bool {
        self.shared.resting.load(Ordering::Acquire)
    }
}
