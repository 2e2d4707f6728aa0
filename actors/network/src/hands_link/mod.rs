//! Hands link: the datagrams of a connection, on the thread that has nothing else to do.
//!
//! A session has two threads for its network at each station. The *controller* of the network keeps the control channel, and
//! sends and takes rows: it works at the rate of an actor, and may be late. The *hands link* is below all actors, as the
//! driver of a device is: it brings each hand's newest sample where it is needed within a millisecond, whatever the
//! controller does, and also while the controller is restarted. Two bounded rings of whole messages are between them
//! ([`hands_channel`]); the link never waits for one, and allocates nothing.
//!
//! ```text
//!   controller ──HandsOrder──▶ hands link ◀──▶ datagrams
//!              ◀──HandsNews───     │ ▲
//!                             samples answers      (triple buffers of each hand)
//! ```
//!
//! Where datagrams do not arrive, the controller carries the newest of them ([`Way`]).
//!
//! [`Connection`] is one end of one connection's datagrams. [`HandsHost`] has all connections of a host, and
//! [`HandsStation`] the one of a station. All are sans-IO: a driver brings datagrams with the address that they came from.

mod connection;
#[cfg(test)]
mod connection_tests;
mod exchange;
mod hands_host;
mod hands_station;
mod order;
mod path;
pub mod playout;
mod way;

use trocar_scene::SimTime;

pub use connection::{Arrived, Connection, ConnectionCounts, ConnectionError, Reply};
pub use hands_host::{HandsHost, HostHand, StrangerCounts};
pub use hands_station::{HOST, HandsStation, StationHand};
pub use order::{
    ControllerEnd, HandNumbers, HandsNews, HandsOrder, LinkEnd, NEWS_MAX, ORDERS_MAX, Parcel, Sealed,
    hands_channel,
};
pub use path::{CHALLENGE_BYTES, CHALLENGE_EVERY, Path, PathNews};
pub use way::{CARRY_EVERY, FIRST_MAX, LOST_AFTER, TRY_EVERY, Way};

/// The hands link of a host or a station, as its driver sees it.
pub trait HandsLink<A>: Send + 'static {
    /// A datagram came from `from`; it is decrypted in place. Replies go out by `send`, which says whether the system took
    /// them.
    fn receive(&mut self, now: SimTime, from: A, datagram: &mut [u8], send: &mut dyn FnMut(A, &[u8]) -> bool);
    /// Sends what is due; to be called every millisecond, and at least ten times a second while it is
    /// [idle](Self::is_idle).
    fn tick(&mut self, now: SimTime, send: &mut dyn FnMut(A, &[u8]) -> bool);
    /// Whether there is no connection.
    fn is_idle(&self) -> bool;
}
