//! Fault injection into the windows.

use std::sync::{Arc, Mutex, PoisonError};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink};
use trocar_viewer::window::{EventLoopProxy, Soundness, Told, Trouble};

/// The viewers of all windows as a fault target.
pub struct Viewers {
    /// Behind a mutex, for platforms where the event loop's channel is not `Sync`.
    event_loop: Mutex<EventLoopProxy<Told>>,
    soundness: Arc<Soundness>,
}

impl Viewers {
    /// For this event loop.
    pub fn new(event_loop: EventLoopProxy<Told>, soundness: Arc<Soundness>) -> Self {
        Self { event_loop: Mutex::new(event_loop), soundness }
    }
}

impl FaultSink for Viewers {
    fn fault(&self, order: &FaultOrder) {
        let trouble = match order.kind {
            FaultKind::Kill if order.begins => Trouble::Panic,
            FaultKind::Unplug if order.begins => Trouble::DeviceLost,
            // The plan's check refuses every other kind before a session starts; a lost device recovers by itself.
            _ => return,
        };
        let event_loop = self.event_loop.lock().unwrap_or_else(PoisonError::into_inner);
        // If the windows are closed already, the fault has no effect.
        let _ = event_loop.send_event(Told::Trouble(trouble));
    }
    fn is_sound(&self) -> Option<bool> {
        Some(self.soundness.is_sound())
    }
}
