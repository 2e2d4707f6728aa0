//! Admissions: what a host asks of its tickets.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink};

use crate::control::{Credential, Refusal};
use crate::ticket::{Admission, HostTime, Refused, Role, TicketBook, TicketId};

/// Seconds since 1970, for the expiry of tickets alone: nothing else in a session asks what day it is.
pub trait UnixClock: Send + 'static {
    /// Now.
    fn now(&self) -> HostTime;
}

/// A clock that stands still, for sessions in virtual time.
impl UnixClock for u64 {
    fn now(&self) -> HostTime {
        (*self).into()
    }
}

/// Seconds by which a fault has stepped a wall clock.
#[derive(Debug, Default)]
pub struct SteppedClock(AtomicI64);

impl SteppedClock {
    /// What a clock shows that would show `unix_secs`.
    pub fn stepped(&self, unix_secs: u64) -> u64 {
        unix_secs.saturating_add_signed(self.0.load(Ordering::Relaxed))
    }
}

impl FaultSink for SteppedClock {
    fn fault(&self, order: &FaultOrder) {
        let secs = i64::try_from(order.span.as_nanos() / 1_000_000_000).unwrap_or(i64::MAX);
        let by = match order.kind {
            FaultKind::ClockAhead => secs,
            FaultKind::ClockBack => -secs,
            _ => return,
        };
        // A plan has too few steps of too few seconds for more than the type holds.
        self.0.fetch_add(by, Ordering::Relaxed);
    }
}

/// What a host asks of its tickets.
pub trait Admissions: Send + 'static {
    /// What a credential would let in as, and the station's number if it was there before. Nothing is spent.
    ///
    /// # Errors
    /// [`Refusal`].
    fn examine(&mut self, credential: &Credential) -> Result<(Option<u16>, Role), Refusal>;
    /// Lets a station in, and spends the token of a ticket.
    ///
    /// # Errors
    /// [`Refusal`]; then nothing is spent.
    fn admit(&mut self, credential: &Credential) -> Result<Admission, Refusal>;
    /// Takes in what others changed, such as a command that withdraws a ticket; to be called about once a second.
    ///
    /// # Errors
    /// In words, when the tickets cannot be read; nobody is let in then.
    fn refresh(&mut self) -> Result<(), String>;
    /// Whether the ticket with which a station came in was withdrawn.
    fn is_revoked(&self, ticket: TicketId) -> bool;
    /// Seconds since 1970, by the wall clock.
    fn unix_secs(&self) -> u64;
}

/// Admissions of a book that is on no disk, for sessions that end with the program.
pub struct BookAdmissions<C> {
    /// The book, which the program that gives out tickets shares.
    pub book: Arc<Mutex<TicketBook>>,
    /// The clock.
    pub clock: C,
}

impl<C> BookAdmissions<C> {
    fn book(&self) -> MutexGuard<'_, TicketBook> {
        // A book is changed by one assignment after everything was checked.
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// What a book says of a credential, without spending it.
pub fn examine(
    book: &TicketBook,
    credential: &Credential,
    now: HostTime,
) -> Result<(Option<u16>, Role), Refused> {
    match credential {
        Credential::Ticket { token, resume } => {
            book.examine(token, resume, now).map(|(role, _)| (None, role))
        }
        Credential::Resume { resume } => {
            book.resume(resume, now).map(|admission| (Some(admission.station), admission.role))
        }
    }
}

/// Every number of a station is in use.
pub fn no_station() -> Refusal {
    Refusal::HostTrouble(crate::control::PlainText::new("it has no number left for another station"))
}

impl<C: UnixClock> Admissions for BookAdmissions<C> {
    fn examine(&mut self, credential: &Credential) -> Result<(Option<u16>, Role), Refusal> {
        examine(&self.book(), credential, self.clock.now()).map_err(Refusal::Ticket)
    }

    fn admit(&mut self, credential: &Credential) -> Result<Admission, Refusal> {
        let now = self.clock.now();
        let mut book = self.book();
        let admitted = match credential {
            Credential::Ticket { token, resume } => {
                let station = book.free_station().ok_or_else(no_station)?;
                book.redeem(token, station, resume, now)
            }
            Credential::Resume { resume } => book.resume(resume, now),
        };
        admitted.map_err(Refusal::Ticket)
    }

    fn refresh(&mut self) -> Result<(), String> {
        Ok(())
    }

    fn is_revoked(&self, ticket: TicketId) -> bool {
        self.book().is_revoked(ticket)
    }

    fn unix_secs(&self) -> u64 {
        self.clock.now().wall
    }
}
