//! Replication: the scene of a host at the stations that hold a copy of it.
//!
//! A host has immutable snapshots, in which each row carries the revision of its last change. Rows go two ways:
//!
//! - *reliably*, over the control channel: a [`delta`] lists what was spawned, despawned, put and removed between two
//!   snapshots, exactly and in order. One that cannot be sent yet grows no queue: the next one covers more.
//! - *unreliably*, in datagrams: the newest quantised value of what moves, again until it is acknowledged. A lost value
//!   is never sent again, only the newest one in its place.
//!
//! [`choice`] says which column goes which way. A row that a station has not got yet always goes reliably first, with
//! the mesh that its vertices belong to; datagrams then only move it. Each value carries its row's revision on both
//! ways, and a value that is not newer than the one at hand is dropped: rows never go back.
//!
//! [`SceneFeed`] is the host's end for one station, [`Replica`] the station's end. Neither knows sockets or clocks.
//! [`StateDigest`] compares both, and after a break the chunks of entities that differ are all that moves.

pub mod acknowledgement;
pub mod choice;
pub mod delta;
mod delta_reader;
pub mod known_rows;
pub mod pieces;
pub mod positions;
pub mod quantised_row;
pub mod replica;
pub mod rotation;
pub mod round_trip;
mod row_places;
mod row_receiver;
pub mod row_sender;
pub mod scene_feed;
pub mod send_budget;
pub mod sent_datagrams;
pub mod state_digest;
mod vertex_chunks;
pub(crate) mod wire_reader;

#[cfg(test)]
mod bandwidth_tests;
#[cfg(test)]
mod convergence_tests;
#[cfg(test)]
mod damage_tests;
#[cfg(test)]
mod scene_testing;

use thiserror::Error;
use trocar_scene::ComponentError;

pub use acknowledgement::RowWindow;
pub use choice::{ChoiceError, ColumnRates, Delivery, ReplicatedColumns};
pub use delta::{DELTA_BYTES_MAX, ExcludedRows, Scope};
pub use delta_reader::DeltaSummary;
pub use pieces::{PIECE_BYTES_MAX, Pieces};
pub use replica::{Replica, ReplicaCounts};
pub use row_sender::{RowSender, RowSenderCounts};
pub use scene_feed::{FeedLimits, Resumed, SceneFeed};
pub use state_digest::StateDigest;

/// Most bytes of a payload of rows: what a datagram of 1,200 bytes leaves beside its header and its tag.
pub const ROWS_PAYLOAD_MAX: usize = crate::datagram::PAYLOAD_MAX;

/// What makes a message of the other station unusable.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ReplicationError {
    /// It ends too early.
    #[error("{what} ends at byte {at}, in the middle of a value")]
    Short {
        /// The message.
        what: &'static str,
        /// Where.
        at: usize,
    },
    /// A number that cannot stand there.
    #[error("{what}, byte {at}: {found} is not {valid}")]
    Number {
        /// The message.
        what: &'static str,
        /// Where.
        at: usize,
        /// The number.
        found: u64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A value that its component refuses.
    #[error("{component}: {error}")]
    Value {
        /// The component.
        component: &'static str,
        /// Why.
        error: ComponentError,
    },
    /// It refers to a state that is not the one at hand.
    #[error("the delta begins at revision {from}, but this replica is at revision {at}")]
    OtherBase {
        /// Where the delta begins.
        from: u64,
        /// Where the replica is.
        at: u64,
    },
}
