//! Fault injection into the windows.

use std::sync::{Arc, Mutex, PoisonError};

use trocar_kernel::spec::{FaultKind, FaultOrder, FaultSink};
use trocar_viewer::window::{EventLoopProxy, LoopMessage, ViewerFault, ViewerHealth};

/// The viewers of all windows as a fault target.
pub struct Viewers {
    /// Behind a mutex, for platforms where the event loop's channel is not `Sync`.
    event_loop: Mutex<EventLoopProxy<LoopMessage>>,
    health: Arc<ViewerHealth>,
}

impl Viewers {
    /// For this event loop.
    pub fn new(event_loop: EventLoopProxy<LoopMessage>, health: Arc<ViewerHealth>) -> Self {
        Self { event_loop: Mutex::new(event_loop), health }
    }

    /// Whether a window has shown its first frame.
    pub fn have_shown(&self) -> bool {
        self.health.has_shown()
    }
}

impl FaultSink for Viewers {
    fn fault(&self, order: &FaultOrder) {
        let trouble = match order.kind {
            FaultKind::Kill if order.begins => ViewerFault::Panic,
            FaultKind::Unplug if order.begins => ViewerFault::DeviceLost,
            // The plan's check refuses every other kind before a session starts; a lost device recovers by itself.
            _ => return,
        };
        let event_loop = self.event_loop.lock().unwrap_or_else(PoisonError::into_inner);
        // If the windows are closed already, the fault has no effect.
        let _ = event_loop.send_event(LoopMessage::ViewerFault(trouble));
    }
    fn is_sound(&self) -> Option<bool> {
        Some(self.health.is_sound())
    }
}
