//! Tests across crates that run one after another.
//!
//! They are tests in real time, of signals, and of processes that must not be disturbed.

mod kills;
mod late_live;
mod live_scenes;
mod pause;
