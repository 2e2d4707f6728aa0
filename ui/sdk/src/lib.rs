//! The facade that users depend on: the standard controllers wired to scenarios.

pub mod app;
pub mod assembly;
pub mod decimate;
pub mod graph;
pub mod hands;
mod kinds;
pub mod outline;
pub mod plans;
pub mod prelude;
pub mod recorded_hand;
pub mod run;
pub mod session;
pub mod soak;
pub mod summary;
pub mod trace;
pub mod tuning;
