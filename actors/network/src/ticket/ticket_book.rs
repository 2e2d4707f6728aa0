//! What a host remembers: its certificate, the tickets that it gave out, and who came in with them.
//!
//! An entry is open until its token is redeemed, and lives on for the station's resume secret. One that is over stays for
//! the list until its room is needed: then the one that was over first is forgotten, and what belongs to it is refused as
//! unknown. So no clock that goes wrong for a while lets a ticket in again.
//!
//! Nothing here reads a clock or touches a file: times come in as seconds since 1970 by the host's clock, and
//! [`TicketStore`](super::TicketStore) keeps the book on disk. A session without a disk uses the book as it is.

use std::fmt;
use std::str::FromStr;

use ring::rand::SecureRandom;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::host_address::HostAddress;
use super::host_time::HostTime;
use super::identity::{Identity, IdentityError};
use super::join_ticket::{Ticket, TicketError};
use super::plain_name::PlainName;
use super::refused::Refused;
use super::role::Role;
use super::secret::{NoRandomness, ResumeSecret, SecretHash, Token};
use super::unix_time::CLOCK_TOLERANCE_SECS;

/// Most entries. Those that are over make room for new ones.
pub const ENTRIES_MAX: usize = 10_000;
/// How long a station can come back after its ticket was redeemed \[s\]: a working day.
pub const RESUME_LIFE_SECS: u64 = 12 * 3_600;

/// Number of a ticket at its host, from 1. It is no secret, and is never given twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct TicketId(u32);

impl fmt::Display for TicketId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl FromStr for TicketId {
    type Err = std::num::ParseIntError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.parse().map(Self)
    }
}

/// What a new ticket is to carry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// What its holder may do.
    pub role: Role,
    /// For whom it is.
    pub person: PlainName,
    /// When it expires \[s since 1970\].
    pub expires: u64,
    /// Name of the session.
    pub session: PlainName,
    /// Where the host can be reached.
    pub addresses: Vec<HostAddress>,
}

/// Somebody who may come in, and as what.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Admission {
    /// The ticket that let in.
    pub ticket: TicketId,
    /// The number of the station.
    pub station: u16,
    /// What it may do.
    pub role: Role,
    /// Who it is.
    pub person: PlainName,
}

/// Why no ticket is issued.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum IssueError {
    /// The ticket cannot be made.
    #[error(transparent)]
    Ticket(#[from] TicketError),
    /// No secret can be made.
    #[error(transparent)]
    NoRandomness(#[from] NoRandomness),
    /// It would never let in.
    #[error("the ticket would expire {0} s ago; name a time in the future")]
    Past(u64),
    /// All entries are in use.
    #[error("{ENTRIES_MAX} tickets are neither expired nor withdrawn; withdraw those that nobody needs")]
    Full,
    /// All numbers are used up.
    #[error("this host has given out all the tickets that it can number; move its file away to start anew")]
    NumbersUsedUp,
}

/// Whose tickets are withdrawn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Whom {
    /// One ticket, and the station that came in with it.
    Ticket(TicketId),
    /// Every ticket and station of a person.
    Person(PlainName),
}

/// Nothing is withdrawn.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RevokeError {
    /// No such ticket.
    #[error("this host has no ticket {0}; the list of tickets names all")]
    NoTicket(TicketId),
    /// No ticket of this person.
    #[error("this host has no ticket for '{0}'; the list of tickets names all")]
    NoPerson(PlainName),
}

/// What was withdrawn just now.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Revoked {
    /// The tickets, those that nobody had used among them.
    pub tickets: Vec<TicketId>,
    /// The stations that came in with them and are to be cut off.
    pub stations: Vec<u16>,
}

/// How it stands with a ticket.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum TicketState {
    /// Nobody has used it yet.
    Open,
    /// A station came in with it, and can come back.
    Redeemed,
    /// Nobody can come in or back with it any more.
    Expired,
    /// It was withdrawn.
    Revoked,
}

/// A ticket as it is listed. Times are in seconds since 1970.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct TicketListing {
    /// Its number.
    pub id: TicketId,
    /// How it stands with it.
    pub state: TicketState,
    /// What its holder may do.
    pub role: Role,
    /// For whom it is.
    pub person: PlainName,
    /// When it was given out.
    pub issued_at: u64,
    /// When it expires.
    pub expires: u64,
    /// When it was used.
    pub redeemed_at: Option<u64>,
    /// The station that came in with it.
    pub station: Option<u16>,
    /// Until when that station can come back.
    pub resume_expires: Option<u64>,
    /// When it was withdrawn.
    pub revoked_at: Option<u64>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Redeemed {
    at: u64,
    station: u16,
    resume: SecretHash,
    resume_expires: u64,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Entry {
    id: TicketId,
    role: Role,
    person: PlainName,
    issued_at: u64,
    expires: u64,
    token: SecretHash,
    redeemed: Option<Redeemed>,
    revoked_at: Option<u64>,
}

/// Refuses what is over.
fn check_expiry(expired_at: u64, now: u64) -> Result<(), Refused> {
    if now > expired_at.saturating_add(CLOCK_TOLERANCE_SECS) {
        return Err(Refused::Expired { expired_at, now });
    }
    Ok(())
}

impl Entry {
    /// When nobody can come in or back with it any more.
    fn over_at(&self) -> u64 {
        self.redeemed.as_ref().map_or(self.expires, |redeemed| redeemed.resume_expires)
    }

    fn is_over(&self, now: u64) -> bool {
        now > self.over_at().saturating_add(CLOCK_TOLERANCE_SECS)
    }

    fn state(&self, now: u64) -> TicketState {
        match self.redeemed {
            _ if self.revoked_at.is_some() => TicketState::Revoked,
            _ if self.is_over(now) => TicketState::Expired,
            Some(_) => TicketState::Redeemed,
            None => TicketState::Open,
        }
    }

    fn admission(&self, station: u16) -> Admission {
        Admission { ticket: self.id, station, role: self.role, person: self.person.clone() }
    }

    fn listing(&self, now: u64) -> TicketListing {
        let redeemed = self.redeemed.as_ref();
        TicketListing {
            id: self.id,
            state: self.state(now),
            role: self.role,
            person: self.person.clone(),
            issued_at: self.issued_at,
            expires: self.expires,
            redeemed_at: redeemed.map(|redeemed| redeemed.at),
            station: redeemed.map(|redeemed| redeemed.station),
            resume_expires: redeemed.map(|redeemed| redeemed.resume_expires),
            revoked_at: self.revoked_at,
        }
    }
}

/// The memory of a host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TicketBook {
    identity: Identity,
    last_id: TicketId,
    /// In the order of their numbers.
    entries: Vec<Entry>,
}

impl TicketBook {
    /// An empty one.
    pub fn new(identity: Identity) -> Self {
        Self { identity, last_id: TicketId(0), entries: Vec::new() }
    }

    /// Certificate and key of the host.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Gives out a ticket.
    ///
    /// # Errors
    /// [`IssueError`].
    pub fn issue(
        &mut self,
        offer: Offer,
        now: u64,
        random: &dyn SecureRandom,
    ) -> Result<(TicketId, Ticket), IssueError> {
        let Offer { role, person, expires, session, addresses } = offer;
        if expires <= now {
            return Err(IssueError::Past(now - expires));
        }
        let token = Token::random(random)?;
        let hash = token.hash();
        let ticket = Ticket::new(addresses, self.identity.fingerprint(), token, role, expires, session)?;
        let id = TicketId(self.last_id.0.checked_add(1).ok_or(IssueError::NumbersUsedUp)?);
        self.make_room(now)?;
        self.last_id = id;
        let (issued_at, token) = (now, hash);
        self.entries.push(Entry {
            id,
            role,
            person,
            issued_at,
            expires,
            token,
            redeemed: None,
            revoked_at: None,
        });
        Ok((id, ticket))
    }

    /// Forgets the entry that was over first when there is no room for another one.
    fn make_room(&mut self, now: u64) -> Result<(), IssueError> {
        if self.entries.len() < ENTRIES_MAX {
            return Ok(());
        }
        // A station that is there has to be told from one that was withdrawn, so those are kept until they are over.
        let is_done =
            |entry: &Entry| entry.is_over(now) || (entry.revoked_at.is_some() && entry.redeemed.is_none());
        let done = self.entries.iter().enumerate().filter(|(_, entry)| is_done(entry));
        let (at, _) = done.min_by_key(|(_, entry)| entry.over_at()).ok_or(IssueError::Full)?;
        self.entries.remove(at);
        Ok(())
    }

    /// The entry that this token would redeem.
    fn open_entry(&self, token: &Token, resume: &ResumeSecret, now: HostTime) -> Result<usize, Refused> {
        let (hash, resume) = (token.hash(), resume.hash());
        let is_in_use = self
            .entries
            .iter()
            .filter_map(|entry| entry.redeemed.as_ref())
            .any(|known| known.resume == resume);
        let at = self.entries.iter().position(|entry| entry.token == hash).ok_or(Refused::Unknown)?;
        let entry = &self.entries[at];
        if let Some(at) = entry.revoked_at {
            return Err(Refused::Revoked { at });
        }
        if let Some(redeemed) = &entry.redeemed {
            return Err(Refused::Spent { at: redeemed.at });
        }
        let (issued_at, now) = (entry.issued_at, now.latest());
        if now.saturating_add(CLOCK_TOLERANCE_SECS) < issued_at {
            return Err(Refused::ClockWentBack { issued_at, now });
        }
        // Tickets that were given out later were not given out earlier, whatever the clocks show now.
        let later = self.entries[at + 1..].iter().map(|later| later.issued_at).max().unwrap_or(0);
        check_expiry(entry.expires, now.max(later).max(self.joined_after(at)))?;
        if is_in_use {
            return Err(Refused::SecretInUse);
        }
        Ok(at)
    }

    /// When somebody came in with a ticket that was given out later than that of this entry; 0 if nobody has.
    fn joined_after(&self, at: usize) -> u64 {
        let joins = self.entries[at + 1..].iter().filter_map(|later| later.redeemed.as_ref());
        joins.map(|join| join.at).max().unwrap_or(0)
    }

    /// What a token would let in as; nothing is spent.
    ///
    /// # Errors
    /// Those of [`Self::redeem`].
    pub fn examine(
        &self,
        token: &Token,
        resume: &ResumeSecret,
        now: impl Into<HostTime>,
    ) -> Result<(Role, PlainName), Refused> {
        let entry = &self.entries[self.open_entry(token, resume, now.into())?];
        Ok((entry.role, entry.person.clone()))
    }

    /// A number for a new station, from 1, that no station has had as long as the book remembers it; `None` when all are
    /// in use.
    pub fn free_station(&self) -> Option<u16> {
        let taken = |number: &u16| {
            self.entries
                .iter()
                .filter_map(|entry| entry.redeemed.as_ref())
                .any(|known| known.station == *number)
        };
        (1..=u16::MAX).find(|number| !taken(number))
    }

    /// Lets a station in by its token, which then lets nobody in any more. The station can come back with `resume` until
    /// [`RESUME_LIFE_SECS`] later. When the station makes that secret and shows it with its token, it can come back even
    /// if the answer to this is lost.
    ///
    /// # Errors
    /// [`Refused`]; then nothing has changed.
    pub fn redeem(
        &mut self,
        token: &Token,
        station: u16,
        resume: &ResumeSecret,
        now: impl Into<HostTime>,
    ) -> Result<Admission, Refused> {
        let now = now.into();
        let at = self.open_entry(token, resume, now)?;
        let entry = &mut self.entries[at];
        let (at, resume) = (now.steady, resume.hash());
        let resume_expires = at.saturating_add(RESUME_LIFE_SECS);
        entry.redeemed = Some(Redeemed { at, station, resume, resume_expires });
        Ok(entry.admission(station))
    }

    /// Lets a station come back, as often as it needs, also if the host's clock has gone back since it came in: that it was
    /// let in is known.
    ///
    /// # Errors
    /// [`Refused`].
    pub fn resume(&self, secret: &ResumeSecret, now: impl Into<HostTime>) -> Result<Admission, Refused> {
        let hash = secret.hash();
        let found = self.entries.iter().enumerate().find_map(|(at, entry)| {
            let redeemed = entry.redeemed.as_ref()?;
            (redeemed.resume == hash).then_some((at, entry, redeemed))
        });
        let (at, entry, redeemed) = found.ok_or(Refused::Unknown)?;
        if let Some(at) = entry.revoked_at {
            return Err(Refused::Revoked { at });
        }
        check_expiry(redeemed.resume_expires, now.into().steady.max(self.joined_after(at)))?;
        Ok(entry.admission(redeemed.station))
    }

    /// Withdraws tickets, and the right of their stations to come back. The caller cuts off the stations.
    ///
    /// # Errors
    /// [`RevokeError`]. It is no error if they were withdrawn before.
    pub fn revoke(&mut self, whom: &Whom, now: u64) -> Result<Revoked, RevokeError> {
        let mut revoked = Revoked::default();
        let mut is_known = false;
        let is_meant = |entry: &Entry| match whom {
            Whom::Ticket(id) => entry.id == *id,
            Whom::Person(person) => entry.person == *person,
        };
        for entry in self.entries.iter_mut().filter(|entry| is_meant(entry)) {
            is_known = true;
            if entry.revoked_at.is_none() {
                entry.revoked_at = Some(now);
                revoked.tickets.push(entry.id);
                revoked.stations.extend(entry.redeemed.as_ref().map(|redeemed| redeemed.station));
            }
        }
        match whom {
            _ if is_known => Ok(revoked),
            Whom::Ticket(id) => Err(RevokeError::NoTicket(*id)),
            Whom::Person(person) => Err(RevokeError::NoPerson(person.clone())),
        }
    }

    /// Whether a ticket was withdrawn. A host asks this of every station that is there after
    /// [`TicketStore::refresh`](super::TicketStore::refresh).
    pub fn is_revoked(&self, ticket: TicketId) -> bool {
        let found = self.entries.binary_search_by_key(&ticket, |entry| entry.id);
        found.is_ok_and(|at| self.entries[at].revoked_at.is_some())
    }

    /// Every ticket that is remembered, by number.
    pub fn list(&self, now: u64) -> Vec<TicketListing> {
        self.entries.iter().map(|entry| entry.listing(now)).collect()
    }

    /// What is kept on disk.
    pub(super) fn encode(&self) -> Result<Vec<u8>, postcard::Error> {
        postcard::to_stdvec(&(
            self.identity.certificate_pem(),
            self.identity.key_pem(),
            self.last_id,
            &self.entries,
        ))
    }

    /// The book of [`Self::encode`].
    pub(super) fn decode(bytes: &[u8]) -> Result<Self, BookError> {
        let (kept, rest): ((String, String, TicketId, Vec<Entry>), _) = postcard::take_from_bytes(bytes)?;
        let (certificate, key, last_id, entries) = kept;
        let is_in_order = entries.is_sorted_by(|one, next| one.id < next.id)
            && entries.last().is_none_or(|last| last.id <= last_id);
        if !rest.is_empty() || entries.len() > ENTRIES_MAX || !is_in_order {
            return Err(BookError::Entries);
        }
        Ok(Self { identity: Identity::from_pem(certificate, key)?, last_id, entries })
    }
}

/// Why bytes are no book.
#[derive(Debug, Error)]
pub enum BookError {
    /// They are nothing that postcard wrote.
    #[error(transparent)]
    Postcard(#[from] postcard::Error),
    /// Certificate or key.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// Too many entries, or not in order.
    #[error("its tickets are more than {ENTRIES_MAX}, or not in the order of their numbers")]
    Entries,
}
