//! Pairs of stations: the hands of one go to another directly, under keys of a TLS session of their own.
//!
//! Two stations know each other by their host alone. The one with the lower number invites the other: its addresses, the
//! fingerprint of its certificate and a token for this pair go over both control channels, and the other one dials. Where that
//! does not work (a firewall between both) hands come by way of the host as before; where it works they come sooner, and the
//! later ones are not newer.
//!
//! ```text
//!  lower  ── invitation, by the host ──▶  higher
//!  lower  ◀── TLS 1.3, pinned; then its number (2 bytes) and the token (32 bytes) ──  higher
//!  lower  ── 1 (one byte) ──▶  higher
//!  lower  ◀── sealed datagrams of hands, both ways ──▶  higher
//! ```
//!
//! The stream stays open for as long as the pair does: whichever end closes it ends the pair, and the higher one dials again.
//! A station takes from a pair only the hands that the host says the other one serves.

mod invitation;
mod pair_machine;
#[cfg(test)]
mod pair_tests;

pub use invitation::{Invitation, InvitationError, TOKEN_BYTES};
pub use pair_machine::{DIAL_EVERY, INVITE_EVERY, OPENING_MAX, PairDoor, PairMachine};
