//! Admission of commands: the lowest accepted epoch, and the lane of the newest generation. `tests/loom` tries every
//! interleaving.

use crate::sync::{AtomicU32, AtomicU64, Ordering};

/// The lowest epoch that a driver accepts; it only rises.
#[derive(Debug, Default)]
pub(crate) struct LowestEpoch(AtomicU32);

impl LowestEpoch {
    /// Refuses all epochs below `epoch`.
    pub(crate) fn raise(&self, epoch: u32) {
        self.0.fetch_max(epoch, Ordering::AcqRel);
    }
    /// The lowest accepted epoch; `u32::MAX` means none.
    pub(crate) fn get(&self) -> u32 {
        self.0.load(Ordering::Acquire)
    }
    /// Whether this epoch is accepted.
    pub(crate) fn admits(&self, epoch: u32) -> bool {
        let lowest = self.get();
        epoch >= lowest && lowest != u32::MAX
    }
}

/// The lane whose commands the driver takes: `(epoch << 32) | (lane + 1)`, 0 before the first.
#[derive(Debug, Default)]
pub(crate) struct ActiveLane(AtomicU64);

impl ActiveLane {
    /// Release ordering: a driver that sees the new lane also sees the fence, and refuses older generations.
    pub(crate) fn set(&self, epoch: u32, lane: usize) {
        self.0.store((u64::from(epoch) << 32) | (lane as u64 + 1), Ordering::Release);
    }
    /// Epoch and lane of the newest generation.
    pub(crate) fn get(&self) -> Option<(u32, usize)> {
        let packed = self.0.load(Ordering::Acquire);
        let lane = (packed & u64::from(u32::MAX)).checked_sub(1)?;
        Some(((packed >> 32) as u32, lane as usize))
    }
}
