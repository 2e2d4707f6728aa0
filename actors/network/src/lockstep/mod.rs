//! The driver in virtual time: links inside the process, with the same luck for the same seed.

mod hands_peer;
mod pair_doors;
mod reflected_peer;
mod wire;
mod wire_streams;

pub use hands_peer::{HandsPeer, PairWires, Wires};
pub use pair_doors::{PairDoors, WirePairDoor};
pub use reflected_peer::ReflectedPeer;
pub use wire::{End, Wire};
pub use wire_streams::{WireHostStreams, WireStationStream};
