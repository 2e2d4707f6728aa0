//! Atomics used by this crate's lock-free protocols. `tests/loom` builds the protocols on loom's atomics instead.

pub(crate) use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
