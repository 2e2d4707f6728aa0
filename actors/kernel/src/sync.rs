//! Atomics used by this crate's lock-free protocols. `tests/loom` builds the protocols on loom's atomics instead.

pub(crate) use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
