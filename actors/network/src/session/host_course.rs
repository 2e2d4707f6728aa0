//! Course of the host's session: what the machine of a station tells whoever runs the station's own session.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};

use crate::control::ControlError;

/// Whether the host has paused the session, and whether it is over for the station, so that the station's own is to pause, or
/// to end, as well; clones share it.
#[derive(Clone, Debug, Default)]
pub struct HostCourse(Arc<Course>);

#[derive(Debug, Default)]
struct Course {
    is_paused: AtomicBool,
    end: OnceLock<ControlError>,
}

impl HostCourse {
    /// Whether the host has paused the session.
    pub fn is_paused(&self) -> bool {
        self.0.is_paused.load(Ordering::Acquire)
    }

    /// Why the session is over for the station, once it is.
    pub fn end(&self) -> Option<&ControlError> {
        self.0.end.get()
    }

    /// Whether that is news.
    pub(super) fn pause(&self, is_paused: bool) -> bool {
        self.0.is_paused.swap(is_paused, Ordering::AcqRel) != is_paused
    }

    /// A session ends once, with its first reason.
    pub(super) fn finish(&self, error: ControlError) {
        let _ = self.0.end.set(error);
    }
}
