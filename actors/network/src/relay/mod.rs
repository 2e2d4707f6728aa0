//! Relay: forwards the sealed bytes of sessions whose hosts cannot be dialled. It has no key of any session.
//!
//! A host behind a router that forwards nothing dials out to a relay, and gets a port there, for TCP and UDP. Its tickets
//! carry that address, and stations join by it as by any host's: TLS goes through to the host, whose certificate the ticket
//! pins, and datagrams are sealed for it.
//!
//! ```text
//! station ──TCP──▶ port of the session ══╗ spliced ╔══ one more stream, which the host dials after a knock
//! station ──UDP──▶ port of the session ──▶ relay ──▶ number of the station, datagram ──▶ host's socket
//! ```
//!
//! Only hosts that have the relay's key get a port. The key is never sent: the relay asks with a nonce, and the host answers
//! with a code of it ([`RelayKey`]). The host's datagrams come from the address of its newest [`Bind`], which has such a code
//! and a number that only rises.
//!
//! | what | limit |
//! |---|---|
//! | sessions; lines that have not said who they are | [`SESSIONS_MAX`] 64; [`OPENERS_MAX`] 64, each for [`OPENING_TIME_MAX`] 5 s |
//! | streams of a session, of one address | [`STREAMS_MAX`] 64, [`STREAMS_OF_ONE_MAX`] 8 |
//! | time for the host to fetch a stream | [`FETCH_TIME_MAX`] 10 s |
//! | stations with datagrams, silence of one | [`STATIONS_MAX`](crate::control::STATIONS_MAX) 64, [`STATION_IDLE_MAX`] 60 s |
//! | bytes of datagrams of a session, each way | [`BYTES_PER_SEC`] 16 MB/s |
//! | silence of a host | [`HOST_SILENCE_MAX`] 20 s |
//!
//! A datagram is forwarded to a host only from an address from which a stream of that session has come, so that a stranger's
//! flood with forged senders ends here; and it is never answered by the relay itself.

mod switch;
#[cfg(test)]
mod switch_tests;
mod wire;

pub use switch::{
    BYTES_PER_SEC, FETCH_TIME_MAX, HOST_SILENCE_MAX, LineNews, OPENERS_MAX, OPENING_TIME_MAX, Overdue,
    PING_EVERY, RelayCounts, RelaySwitch, SESSIONS_MAX, STATION_IDLE_MAX, STREAMS_MAX, STREAMS_OF_ONE_MAX,
    Stopped, StreamId,
};
pub use wire::{
    BIND_BYTES, Bind, FromHost, FromRelay, KEY_TEXT_BYTES, LineDecoder, MESSAGE_MAX, NONCE_BYTES,
    NUMBER_BYTES, NoKey, Nonce, RELAY_VERSION, RelayKey, RelayRefusal, WireError, numbered, split_number,
};
