//! Faults of links, from fault files: the same live and in virtual time, since they are applied to datagrams and bytes between
//! a session and what moves them.
//!
//! [`LinkBoard`] takes the faults. [`FaultyHands`] applies them to the datagrams of a hands link, in both directions, and
//! [`FaultyHostStreams`] and [`FaultyStationStream`] to the control channels, which lose nothing and are late, as TCP is. A
//! session without a fault plan has none of them.
//!
//! | target | at | what is struck |
//! |---|---|---|
//! | `link` | a station | its link to the host |
//! | `link.NAME`, `link.NUMBER` | the host | its link to that station, whenever it is there |
//! | `links` | both | the network itself, at work: it loses all its connections |

mod board;
mod hands;
mod streams;
#[cfg(test)]
mod tests;

pub use board::{LinkBoard, SOUND_FOR};
pub use hands::FaultyHands;
pub use streams::{FaultyHostStreams, FaultyStationStream};
