//! "There is something to look at": raised by many, taken by one, and nothing that was written before a raise is
//! missed after the take. `tests/loom` tries every interleaving.

use crate::sync::{AtomicBool, Ordering};

/// A flag between those who leave something and the one who looks for it.
#[derive(Debug, Default)]
pub(crate) struct Signal(AtomicBool);

impl Signal {
    /// Whoever looks from now on finds what was written before; true for the first since the last take, whose duty it
    /// is to wake the one who looks.
    pub(crate) fn raise(&self) -> bool {
        !self.0.swap(true, Ordering::AcqRel)
    }

    /// Whether it was raised; down again. Take it before looking, not after.
    pub(crate) fn take(&self) -> bool {
        // A swap, not a store: it must see what came before the raise that it takes down.
        self.0.swap(false, Ordering::AcqRel)
    }
}
