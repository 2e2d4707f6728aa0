//! The Model actor, runtimes and rates, supervision, faults, recording, clock and lock-step.

pub mod spec;
pub mod supervision;
