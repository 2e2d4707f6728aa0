//! Pausing a session: controllers do not tick, session time stands still, and CPU use is near zero.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::LiveSession;

/// Longest wait for controllers in the middle of a step; hanging ones are not waited for.
const REST_MAX: Duration = Duration::from_millis(250);
const LOOK: Duration = Duration::from_millis(1);

impl LiveSession {
    /// Pauses the session. No controller begins another tick; when all running ticks have ended, `quiet` is called
    /// while time still passes – for devices whose forces fade – and then the clock pauses. Ticks that would fall into
    /// the pause are neither run nor counted as missed. The Model, the supervisor and the operator's writes continue.
    ///
    /// False when the session is already paused, or has ended.
    pub fn pause(&self, quiet: impl FnOnce()) -> bool {
        if self.has_ended() || self.shared.resting.swap(true, Ordering::AcqRel) {
            return false;
        }
        let until = Instant::now() + REST_MAX;
        let works = || {
            self.shared
                .writers
                .iter()
                .map(|writer| writer.state.life.load())
                .any(|life| life.running.load(Ordering::Acquire) && !life.at_rest.load(Ordering::Acquire))
        };
        while works() && Instant::now() < until {
            std::thread::sleep(LOOK);
        }
        quiet();
        self.shared.clock.pause();
        true
    }

    /// Resumes the session within 50 ms. False when it is not paused.
    pub fn resume(&self) -> bool {
        if !self.is_paused() {
            return false;
        }
        self.shared.clock.resume();
        self.shared.resting.store(false, Ordering::Release);
        true
    }

    /// Whether the session is paused.
    pub fn is_paused(&self) -> bool {
        self.shared.resting.load(Ordering::Acquire)
    }
}
