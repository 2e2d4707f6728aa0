//! Admissions of a host whose tickets are on its disk.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::control::{Credential, PlainText, Refusal};
use crate::session::{Admissions, SteppedClock, examine, no_station};
use crate::ticket::{Admission, HostTime, Role, StoreError, TicketId, TicketStore};

/// Tries before a book that another program is changing counts as busy; a change takes milliseconds.
const TRIES_MAX: u32 = 200;

/// Seconds since 1970 by the system's clock; 0 if it is before that.
pub fn unix_secs() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

/// Waits for another program that changes the book: [`Wait`](crate::ticket::Wait).
pub fn wait_for_the_book(tries: u32) -> bool {
    std::thread::sleep(Duration::from_millis(5));
    tries < TRIES_MAX
}

/// A host's book of tickets on disk, shared by the session, which lets in, and the program, which gives tickets out.
#[derive(Clone)]
pub struct StoreAdmissions {
    store: Arc<Mutex<TicketStore>>,
    clock: Arc<SteppedClock>,
    /// The steady clock: when it began, and what the wall clock showed then. It stands still while the computer sleeps.
    begun: (Instant, u64),
}

impl StoreAdmissions {
    /// Of this book.
    pub fn new(store: TicketStore) -> Self {
        let begun = (Instant::now(), unix_secs());
        Self { store: Arc::new(Mutex::new(store)), clock: Arc::default(), begun }
    }

    fn now(&self) -> HostTime {
        let (instant, begun_unix_secs) = self.begun;
        let steady = begun_unix_secs.saturating_add(instant.elapsed().as_secs());
        HostTime { wall: self.clock.stepped(unix_secs()), steady }
    }

    /// What faults have done to the wall clock by which tickets expire.
    pub fn clock(&self) -> &Arc<SteppedClock> {
        &self.clock
    }

    /// The book, for a short time.
    pub fn store(&self) -> MutexGuard<'_, TicketStore> {
        // A panic under way leaves a book that equals its file, or is read again.
        self.store.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn trouble(error: &StoreError) -> Refusal {
    Refusal::HostTrouble(PlainText::new(format!("its tickets cannot be read: {error}")))
}

impl Admissions for StoreAdmissions {
    fn examine(&mut self, credential: &Credential) -> Result<(Option<u16>, Role), Refusal> {
        let mut store = self.store();
        store.refresh().map_err(|error| trouble(&error))?;
        examine(store.book(), credential, self.now()).map_err(Refusal::Ticket)
    }

    fn admit(&mut self, credential: &Credential) -> Result<Admission, Refusal> {
        let (mut store, now) = (self.store(), self.now());
        let admitted = match credential {
            Credential::Ticket { token, resume } => {
                let station = store.book().free_station().ok_or_else(no_station)?;
                store.redeem(token, station, resume, now)
            }
            Credential::Resume { resume } => store.resume(resume, now),
        };
        admitted.map_err(|error| trouble(&error))?.map_err(Refusal::Ticket)
    }

    fn refresh(&mut self) -> Result<(), String> {
        self.store().refresh().map(|_| ()).map_err(|error| error.to_string())
    }

    fn is_revoked(&self, ticket: TicketId) -> bool {
        self.store().book().is_revoked(ticket)
    }

    fn unix_secs(&self) -> u64 {
        self.now().wall
    }
}
