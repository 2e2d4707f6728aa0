//! Who is obeyed: the lowest epoch that still counts, and the lane of the newest generation. `tests/loom` tries every
//! interleaving.

use crate::sync::{AtomicU32, AtomicU64, Ordering};

/// The lowest epoch that a driver obeys; it only rises.
#[derive(Debug, Default)]
pub(crate) struct LowestEpoch(AtomicU32);

impl LowestEpoch {
    /// Nobody below `epoch` counts any more.
    pub(crate) fn raise(&self, epoch: u32) {
        self.0.fetch_max(epoch, Ordering::AcqRel);
    }
    /// The lowest that counts; `u32::MAX` means that none does.
    pub(crate) fn get(&self) -> u32 {
        self.0.load(Ordering::Acquire)
    }
    /// Whether this one counts.
    pub(crate) fn admits(&self, epoch: u32) -> bool {
        let lowest = self.get();
        epoch >= lowest && lowest != u32::MAX
    }
}

/// Which lane the driver obeys: `(epoch << 32) | (lane + 1)`, 0 before the first.
#[derive(Debug, Default)]
pub(crate) struct ActiveLane(AtomicU64);

impl ActiveLane {
    /// Releases the fence that the new generation has seen: a driver that obeys it refuses its predecessors.
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
