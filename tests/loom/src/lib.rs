//! The files of the workspace that have protocols over raw atomics, built on loom's atomics. Everything else that
//! threads share is an `ArcSwap`, a triple buffer, an SPSC ring, a bounded channel or a lock, which are tested where
//! they come from.
#![cfg_attr(not(test), allow(dead_code))]

mod sync {
    pub(crate) use loom::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
}

#[path = "../../../actors/kernel/src/heartbeat.rs"]
mod heartbeat;
#[path = "../../../devices/src/lane_gate.rs"]
mod lane_gate;
#[path = "../../../actors/kernel/src/signal.rs"]
mod signal;

#[cfg(test)]
mod models;
