//! Sessions beyond one machine, by [Zenoh](https://zenoh.io): telemetry, discovery, liveliness, hands and controllers that are
//! somewhere else.
//!
//! ```text
//! Model ─▶ snapshot ─▶ Telemetry ─▶ node ═ Zenoh ═▶ whoever may read
//!        ◀─ batches ─ RemoteController ◀─ node ◀═ who has the claim and the right
//! haptics ◀─ driver ◀─ ZenohHand { Door } ◀─ node ◀═ who has the claim and the right
//! ```
//!
//! Everything but `live/` is plain data and state machines; `live/` has the library. Haptics never go by Zenoh: that is
//! `trocar-network`'s affair. The program has this crate with its feature `zenoh` only, since the library takes minutes to build.

pub mod certificates;
pub mod claim;
pub mod hand;
#[cfg(test)]
mod json_testing;
pub mod keys;
pub mod live;
pub mod node_config;
pub mod presence;
pub mod remote_controller;
pub mod rights;
pub mod settings;
pub mod telemetry;
