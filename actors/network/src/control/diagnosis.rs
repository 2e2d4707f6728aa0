//! A diagnosis: what somebody with a ticket asks in place of the session, to learn what the path to the host carries.
//!
//! The opening shows the ticket's token, which the host looks up and does not spend. Then the host says whether the ticket
//! would let in and what its clock shows, and echoes datagrams under keys of this TLS session, each to where it came from
//! and as long as it came: nobody gets an answer before the host knows the token, and nobody more bytes than he sent.

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

use super::credential::Credential;
use super::plain_text::PlainText;
use crate::ticket::Role;

/// Most diagnoses at once. Who comes later is asked to try again.
pub const DIAGNOSES_MAX: usize = 4;
/// Longest time of one.
pub const DIAGNOSIS_TIME_MAX: SimTime = SimTime::from_millis(15_000);

/// First message of somebody who wants to know what the path carries.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnose {
    /// Version of the program, for people.
    pub program: PlainText,
    /// What would let a station in.
    pub credential: Credential,
}

/// What a ticket is worth, of those that the host has given out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TicketVerdict {
    /// It would let in.
    LetsIn(Role),
    /// It has let somebody in before. Whoever has it may still look at the path, since a station that is in has it, too.
    Spent {
        /// When \[s since 1970\].
        at: u64,
    },
}

/// The host's answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Diagnosed {
    /// Number of the connection in datagrams.
    pub connection: u32,
    /// What the ticket is worth.
    pub ticket: TicketVerdict,
    /// The host's clock \[s since 1970\].
    pub host_unix_secs: u64,
}

/// Datagrams of a diagnosis that have come to the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EchoCounts {
    /// Short ones.
    pub short: u32,
    /// Those as long as a datagram can be.
    pub long: u32,
}
