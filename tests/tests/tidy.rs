//! The invariants of the design that can be read off the sources.

#[path = "tidy/mod.rs"]
mod tidy;
