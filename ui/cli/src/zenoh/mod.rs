//! Sessions beyond one machine: `--zenoh`, `zenoh:NAME` as a hand, and `trocar zenoh`.
//!
//! The library takes minutes to build, so it is part of the program with the feature `zenoh` only. Command lines are the same
//! without it, and say what is missing.

// Compiled in every build, so that none finds it broken.
#[cfg_attr(feature = "zenoh", allow(dead_code, reason = "it stands in for what is not there"))]
mod absent;
#[cfg(feature = "zenoh")]
mod commands;
#[cfg(feature = "zenoh")]
mod present;
mod wish;

#[cfg(not(feature = "zenoh"))]
pub use absent::{Beyond, command, with_devices};
#[cfg(feature = "zenoh")]
pub use commands::command;
#[cfg(feature = "zenoh")]
pub use present::{Beyond, with_devices};
pub use wish::Wish;
