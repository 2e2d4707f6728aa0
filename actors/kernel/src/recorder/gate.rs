//! Write gate of a recording: an epoch fence checked before every write, so that an abandoned recorder writes no more.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

/// No injected limit of the disk's rate.
const UNLIMITED: u64 = u64::MAX;

/// The fence of a recording and the state of its disk, for threads that must not block.
pub(super) struct Gate {
    /// The lowest epoch that may still write.
    fence: AtomicU32,
    /// Fault hook: the disk refuses all writes.
    full: AtomicBool,
    /// Fault hook: write rate of the disk [bytes/s].
    bytes_per_sec: AtomicU64,
    /// Whether the last write attempt wrote everything due.
    sound: AtomicBool,
}

/// The right of one life of the recorder to write; it ends when the fence is raised.
#[derive(Clone, Copy)]
pub(super) struct WritePermit<'a> {
    gate: &'a Gate,
    epoch: u32,
}

impl Gate {
    pub(super) fn new() -> Self {
        Self {
            fence: AtomicU32::new(0),
            full: AtomicBool::new(false),
            bytes_per_sec: AtomicU64::new(UNLIMITED),
            sound: AtomicBool::new(true),
        }
    }
    pub(super) fn raise(&self, epoch: u32) {
        self.fence.fetch_max(epoch, Ordering::AcqRel);
    }
    pub(super) fn permit(&self, epoch: u32) -> WritePermit<'_> {
        WritePermit { gate: self, epoch }
    }
    pub(super) fn set_disk_full(&self, full: bool) {
        self.full.store(full, Ordering::Relaxed);
    }
    pub(super) fn set_disk_slow(&self, bytes_per_sec: Option<f64>) {
        let rate = bytes_per_sec.map_or(UNLIMITED, |rate| rate as u64);
        self.bytes_per_sec.store(rate, Ordering::Relaxed);
    }
    pub(super) fn set_sound(&self, sound: bool) {
        self.sound.store(sound, Ordering::Relaxed);
    }
    pub(super) fn is_sound(&self) -> bool {
        self.sound.load(Ordering::Relaxed)
    }
}

impl WritePermit<'_> {
    pub(super) fn is_valid(self) -> bool {
        self.epoch >= self.gate.fence.load(Ordering::Acquire)
    }
    /// Write rate of a slow disk [bytes/s].
    pub(super) fn disk_rate(self) -> Option<f64> {
        let rate = self.gate.bytes_per_sec.load(Ordering::Relaxed);
        (rate != UNLIMITED).then_some(rate as f64)
    }
    pub(super) fn is_disk_full(self) -> bool {
        self.gate.full.load(Ordering::Relaxed)
    }
}
