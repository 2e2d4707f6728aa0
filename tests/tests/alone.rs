//! What crosses crates.
//!
//! Tests in real time, of signals, and of processes that must not be disturbed: one after another.

mod kills;
mod live_scenes;
mod pause;
