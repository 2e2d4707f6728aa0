//! The library at work: nodes on threads of their own.
//!
//! The library blocks on runtimes of its own, with several threads, and panics where it is asked to do so on a runtime with
//! one, such as that of an actor. So it is called from plain threads only, which this module starts: its functions can be
//! called from anywhere.

mod bridge;
mod inbox;
mod node;
mod roster;

pub use bridge::{Bridge, BridgeCounts, SessionFacts, SessionGuests};
pub use node::{NodeError, Router};
pub use roster::{SeenSession, Watch, list};
