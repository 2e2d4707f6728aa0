//! Wake-up flag, many producers to one consumer: writes made before a raise are visible after the take. `tests/loom`
//! tries every interleaving.

use crate::sync::{AtomicBool, Ordering};

/// A flag between the producers of work and its one consumer.
#[derive(Debug, Default)]
pub(crate) struct Signal(AtomicBool);

impl Signal {
    /// Publishes earlier writes. True for the first raise since the last take: that producer must wake the consumer.
    pub(crate) fn raise(&self) -> bool {
        !self.0.swap(true, Ordering::AcqRel)
    }

    /// Clears the flag and returns whether it was raised. Take it before looking for work, not after.
    pub(crate) fn take(&self) -> bool {
        // A swap, not a store: it must see the writes that preceded the raise that it clears.
        self.0.swap(false, Ordering::AcqRel)
    }
}
