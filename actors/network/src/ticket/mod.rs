//! Tickets: how a person gets into a session, and what the host remembers of it across restarts.
//!
//! A host [issues](TicketStore::issue) one [`Ticket`] for each person and role, and prints it as one line. The station
//! that joins pins the fingerprint of the host's certificate and shows the token of the ticket inside the TLS session. The
//! host [redeems](TicketStore::redeem) the token once, and from then on the station comes back with its resume secret.
//!
//! | what | known to | on the host's disk |
//! |---|---|---|
//! | token, 16 bytes | whoever has the ticket | its hash |
//! | resume secret, 32 bytes | the station | its hash |
//! | certificate | everybody | PEM |
//! | key of the certificate | the host | PEM |
//!
//! Whoever reads the host's file can stand in for the host, so it has mode 0600, but cannot join with what is in it.
//!
//! Only the host's clocks judge an expiry, with a tolerance of [`CLOCK_TOLERANCE_SECS`]: [`HostTime`] says which one when.
//! A station whose clock is wrong can join all the same; [`clock_difference`] says in words what is wrong.

mod base32_line;
mod byte_reader;
mod fingerprint;
mod host_address;
mod host_time;
mod identity;
mod join_ticket;
mod plain_name;
pub mod private_file;
mod refused;
mod role;
mod secret;
mod ticket_book;
#[cfg(test)]
mod ticket_book_tests;
mod ticket_store;
#[cfg(test)]
mod ticket_store_tests;
mod unix_time;

pub use base32_line::{LINE_MAX, LineError};
pub use fingerprint::{FINGERPRINT_BYTES, Fingerprint};
pub use host_address::{AddressError, DNS_NAME_MAX, HostAddress, HostPlace, ZONE_MAX};
pub use host_time::HostTime;
pub use identity::{Identity, IdentityError, SERVER_NAME};
pub use join_ticket::{ADDRESSES_MAX, EXPIRY_MAX_SECS, Ticket, TicketError};
pub use plain_name::{NAME_MAX, NameError, PlainName};
pub use refused::Refused;
pub use role::Role;
pub use secret::{NoRandomness, ResumeSecret, Secret, SecretHash, Token};
pub use ticket_book::{
    Admission, ENTRIES_MAX, IssueError, Offer, RESUME_LIFE_SECS, RevokeError, Revoked, TicketBook, TicketId,
    TicketListing, TicketState, Whom,
};
pub use ticket_store::{STORE_BYTES_MAX, StoreError, TicketStore, Wait};
pub use unix_time::{CLOCK_TOLERANCE_SECS, clock_difference, utc};
