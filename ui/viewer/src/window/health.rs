//! Health of the windows, by which fault injection detects recovery, and a program the end of its start.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Shared by all windows of a program; readable at any time.
#[derive(Debug, Default)]
pub struct ViewerHealth {
    failing: AtomicUsize,
    shown: AtomicBool,
}

impl ViewerHealth {
    /// Whether every window that failed draws again.
    pub fn is_sound(&self) -> bool {
        self.failing.load(Ordering::Acquire) == 0
    }

    /// Whether a window has shown its first frame, or was closed before.
    pub fn has_shown(&self) -> bool {
        self.shown.load(Ordering::Acquire)
    }
}

/// The health of one window.
pub(super) struct WindowHealth {
    shared: Arc<ViewerHealth>,
    fails: bool,
}

impl WindowHealth {
    pub(super) fn new(shared: Arc<ViewerHealth>) -> Self {
        Self { shared, fails: false }
    }

    /// Its viewer has failed.
    pub(super) fn failed(&mut self) {
        if !std::mem::replace(&mut self.fails, true) {
            self.shared.failing.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// It shows a frame, or was closed by its user.
    pub(super) fn recovered(&mut self) {
        if !self.shared.shown.load(Ordering::Relaxed) {
            self.shared.shown.store(true, Ordering::Release);
        }
        if std::mem::replace(&mut self.fails, false) {
            self.shared.failing.fetch_sub(1, Ordering::AcqRel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_windows_are_well_once_each_of_them_is() {
        let shared = Arc::<ViewerHealth>::default();
        let mut windows = [WindowHealth::new(shared.clone()), WindowHealth::new(shared.clone())];
        assert!(shared.is_sound() && !shared.has_shown());
        windows.iter_mut().for_each(WindowHealth::failed);
        windows[0].failed();
        windows[0].recovered();
        assert!(!shared.is_sound());
        windows[0].recovered();
        windows[1].recovered();
        assert!(shared.is_sound() && shared.has_shown());
    }
}
