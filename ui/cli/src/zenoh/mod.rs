//! Sessions beyond one machine: `--zenoh`, `zenoh:NAME` as a hand, and `trocar zenoh`.
//!
//! The library takes minutes to build, so it is part of the program with the feature `zenoh` only. Command lines are the same
//! without it, and say what is missing.

// Compiled in every build, so that none finds it broken.
#[cfg_attr(feature = "zenoh", allow(dead_code))]
mod absent;
#[cfg(feature = "zenoh")]
mod commands;
#[cfg(feature = "zenoh")]
mod present;

#[cfg(not(feature = "zenoh"))]
pub use absent::{Beyond, command, with_devices};
#[cfg(feature = "zenoh")]
pub use commands::command;
#[cfg(feature = "zenoh")]
pub use present::{Beyond, with_devices};

use trocar::network::Network;
use trocar_scene::Snapshot;
use trocar_scene::scenario::Scenario;

/// What a session that is reached by Zenoh is told at its start.
pub struct Wish<'a> {
    /// The text of `--zenoh`, if it was given.
    pub text: Option<&'a str>,
    /// What is run.
    pub scenario: &'a Scenario,
    /// Its first scene.
    pub first: &'a Snapshot,
    /// Whether others may join it.
    pub network: &'a Network,
    /// Whether nothing is told on the terminal.
    pub is_silent: bool,
}
