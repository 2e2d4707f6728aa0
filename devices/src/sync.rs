//! The atomics under this crate's own protocols. `tests/loom` builds those protocols on loom's instead.

pub(crate) use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
