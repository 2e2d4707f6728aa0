//! Health of the windows, by which fault injection detects recovery.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Shared by all windows of a program; readable at any time.
#[derive(Debug, Default)]
pub struct Soundness {
    failing: AtomicUsize,
}

impl Soundness {
    /// Whether every window that failed draws again.
    pub fn is_sound(&self) -> bool {
        self.failing.load(Ordering::Acquire) == 0
    }
}

/// The health of one window.
pub(super) struct Pulse {
    shared: Arc<Soundness>,
    fails: bool,
}

impl Pulse {
    pub(super) fn new(shared: Arc<Soundness>) -> Self {
        Self { shared, fails: false }
    }

    /// Its viewer has failed.
    pub(super) fn failed(&mut self) {
        if !std::mem::replace(&mut self.fails, true) {
            self.shared.failing.fetch_add(1, Ordering::AcqRel);
        }
    }

    /// It shows a frame, or was closed by its user.
    pub(super) fn well(&mut self) {
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
        let shared = Arc::<Soundness>::default();
        let mut windows = [Pulse::new(shared.clone()), Pulse::new(shared.clone())];
        assert!(shared.is_sound());
        windows.iter_mut().for_each(Pulse::failed);
        windows[0].failed();
        windows[0].well();
        assert!(!shared.is_sound());
        windows[0].well();
        windows[1].well();
        assert!(shared.is_sound());
    }
}
