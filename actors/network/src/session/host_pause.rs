//! Host pause: what the machine of a station tells whoever runs the station's own session.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the host has paused the session, so that the station's own is to pause as well; clones share it.
#[derive(Clone, Debug, Default)]
pub struct HostPause(Arc<AtomicBool>);

impl HostPause {
    /// Whether it has.
    pub fn is_on(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }

    /// Whether that is news.
    pub(super) fn set(&self, is_on: bool) -> bool {
        self.0.swap(is_on, Ordering::AcqRel) != is_on
    }
}
