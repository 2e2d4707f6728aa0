//! Admissions of a host whose tickets are on its disk.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::control::{Credential, PlainText, Refusal};
use crate::session::{Admissions, SteppedClock, examine, no_station};
use crate::ticket::{Admission, Role, StoreError, TicketId, TicketStore};

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
}

impl StoreAdmissions {
    /// Of this book.
    pub fn new(store: TicketStore) -> Self {
        Self { store: Arc::new(Mutex::new(store)), clock: Arc::default() }
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
        examine(store.book(), credential, self.clock.stepped(unix_secs())).map_err(Refusal::Ticket)
    }

    fn admit(&mut self, credential: &Credential) -> Result<Admission, Refusal> {
        let (mut store, now) = (self.store(), self.clock.stepped(unix_secs()));
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
        self.clock.stepped(unix_secs())
    }
}
