//! The facade that users depend on: the standard controllers wired to scenarios.

pub mod decimate;
pub mod graph;
pub mod summary;
pub mod trace;
