//! Inbox: what arrives for the node's thread, bounded. The library's threads put it here and never wait.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use zenoh::query::Query;

/// Most that waits.
pub(super) const WAITING_MAX: usize = 256;

/// What arrives.
pub(super) enum Arrival {
    /// Somebody asks for the claim of a hand.
    HandClaim(String, Query),
    /// Somebody asks for the claim of a controller, by its place in the list.
    ControllerClaim(usize, Query),
    /// A batch of a controller.
    Batch(usize, Vec<u8>),
    /// Somebody asks what the session is.
    Info(Query),
    /// Somebody asks who takes part.
    Roster(Query),
}

/// See the module.
#[derive(Default)]
pub(super) struct Inbox {
    waiting: Mutex<VecDeque<Arrival>>,
    arrived: Condvar,
    /// What found no room.
    refused: AtomicU64,
}

impl Inbox {
    /// Puts something in, or counts it where there is no room.
    pub fn put(&self, arrival: Arrival) {
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        if waiting.len() >= WAITING_MAX {
            self.refused.fetch_add(1, Ordering::Relaxed);
            return;
        }
        waiting.push_back(arrival);
        self.arrived.notify_one();
    }

    /// Waits until something has arrived or the time is up, and takes all of it.
    pub fn take(&self, limit: Duration) -> VecDeque<Arrival> {
        let waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.arrived.wait_timeout_while(waiting, limit, |waiting| waiting.is_empty());
        let (mut waiting, _) = waited.unwrap_or_else(PoisonError::into_inner);
        std::mem::take(&mut *waiting)
    }

    /// What found no room.
    pub fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_finds_no_room_is_counted_and_nobody_waits() {
        let inbox = Inbox::default();
        for _ in 0..WAITING_MAX + 7 {
            inbox.put(Arrival::Batch(0, Vec::new()));
        }
        assert_eq!((inbox.take(Duration::ZERO).len(), inbox.refused()), (WAITING_MAX, 7));
        assert_eq!(inbox.take(Duration::ZERO).len(), 0);
    }
}
