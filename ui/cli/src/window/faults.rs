//! Faults that are aimed at the windows.

use std::sync::{Arc, Mutex, PoisonError};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink};
use trocar_viewer::window::{EventLoopProxy, Soundness, Told, Trouble};

/// The viewers of all windows, as faults strike them.
pub struct Viewers {
    /// Also where the event loop's channel cannot be shared.
    event_loop: Mutex<EventLoopProxy<Told>>,
    soundness: Arc<Soundness>,
}

impl Viewers {
    /// Of this event loop.
    pub fn new(event_loop: EventLoopProxy<Told>, soundness: Arc<Soundness>) -> Self {
        Self { event_loop: Mutex::new(event_loop), soundness }
    }
}

impl FaultSink for Viewers {
    fn fault(&self, order: &FaultOrder) {
        let trouble = match order.kind {
            FaultKind::Kill if order.begins => Trouble::Panic,
            FaultKind::Unplug if order.begins => Trouble::DeviceLost,
            // The plan's check refuses every other kind before a session starts; and what is lost comes back by itself.
            _ => return,
        };
        let event_loop = self.event_loop.lock().unwrap_or_else(PoisonError::into_inner);
        // Where the windows are closed already, nothing can go wrong with them.
        let _ = event_loop.send_event(Told::Trouble(trouble));
    }
    fn is_sound(&self) -> Option<bool> {
        Some(self.soundness.is_sound())
    }
}
