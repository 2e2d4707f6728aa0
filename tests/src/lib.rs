//! What crosses crates: scenarios, faults, determinism, benches, tidy checks.
