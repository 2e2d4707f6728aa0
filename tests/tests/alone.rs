//! Tests across crates that run one after another.
//!
//! They are tests in real time, of signals, and of processes that must not be disturbed.

mod kills;
mod late_under_load;
mod live_scenes;
mod pause;
mod too_slow;
