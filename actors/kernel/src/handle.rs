//! A writer's handle to the Model: a bounded ring of batches, a ring of emptied buffers back, and a doorbell.
//!
//! Nothing here blocks, locks or (after warm-up) allocates. A full ring, or more commands than the writer's
//! [`FlowLimit`], affects only that writer. The Model's ends of the rings belong to the [`Intake`](crate::Intake).

use std::collections::VecDeque;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rtrb::{Consumer, Producer};
use trocar_scene::{Batch, Commands, EntityAllocator, Provenance, Registry, Revision, SimTime, WriterId};

use crate::faults::LinkCounts;
use crate::model_core::Outcome;
use crate::runtime::Clock;
use crate::signal::Signal;
use crate::token_bucket::{FlowLimit, TokenBucket, count};

/// Buffers that a handle starts with: enough for a Model that is occasionally late, so that nothing is allocated after
/// warm-up.
pub(crate) const SPARES: usize = 8;

/// Wakes the Model. Called at most once until the Model begins to drain; must not allocate or block.
pub trait Doorbell: Send + Sync {
    /// Signals that a batch waits.
    fn ring(&self);
}

impl<F: Fn() + Send + Sync> Doorbell for F {
    fn ring(&self) {
        self();
    }
}

/// Counters shared by both ends of a lane; survives restarts of the writer.
#[derive(Debug, Default)]
pub struct LaneStatus {
    sent: AtomicU64,
    dropped: AtomicU64,
    lost: AtomicU64,
    delayed: AtomicU64,
    duplicated: AtomicU64,
    refuse: AtomicBool,
}

impl LaneStatus {
    /// Batches that went into the ring.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }
    /// Batches refused, because the ring was full or the flow limit was exceeded.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
    /// Batches that went into the ring and never reached the scene: lost on a faulty link, or with a Model that ended
    /// before publishing them.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }
    /// Batches delayed or overtaken on a faulty link.
    pub fn delayed(&self) -> u64 {
        self.delayed.load(Ordering::Relaxed)
    }
    /// Batches that arrived twice.
    pub fn duplicated(&self) -> u64 {
        self.duplicated.load(Ordering::Relaxed)
    }
    /// Counts `batches` as lost with a Model that ended.
    pub(crate) fn lose(&self, batches: u64) {
        self.lost.fetch_add(batches, Ordering::Relaxed);
    }
    /// Adds the change of a link's counts since the last call.
    pub(crate) fn count_link(&self, before: &LinkCounts, after: &LinkCounts) {
        let gone = |counts: &LinkCounts| counts.lost + counts.corrupted;
        let late = |counts: &LinkCounts| counts.delayed + counts.reordered;
        self.lost.fetch_add(gone(after) - gone(before), Ordering::Relaxed);
        self.delayed.fetch_add(late(after) - late(before), Ordering::Relaxed);
        self.duplicated.fetch_add(after.duplicated - before.duplicated, Ordering::Relaxed);
    }
    /// Fault hook: while `true` the handle behaves as if its ring were full.
    pub fn set_queue_full(&self, full: bool) {
        self.refuse.store(full, Ordering::Relaxed);
    }
}

/// Result of submitting a tick's commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Submitted {
    /// On its way to the Model.
    Sent,
    /// There were no commands, so nothing was sent.
    Empty,
    /// The ring was full, or the flow limit was exceeded; the commands are dropped and counted.
    Dropped,
}

/// A batch in a ring.
pub(crate) struct SealedBatch {
    pub(crate) at: SimTime,
    pub(crate) batch: Box<Batch>,
}

/// Parts of a handle: the writer's ends of its rings, and the doorbell.
pub(crate) struct HandleParts {
    pub(crate) batches: Producer<SealedBatch>,
    pub(crate) returns: Consumer<Box<Batch>>,
    pub(crate) bell: Arc<CoalescedDoorbell>,
    pub(crate) clock: Clock,
    pub(crate) registry: Arc<Registry>,
}

/// The writer's end.
pub struct WriterHandle {
    writer: WriterId,
    epoch: u32,
    ends: HandleParts,
    allocator: EntityAllocator,
    flow: TokenBucket,
    current: Box<Batch>,
    /// Used round-robin, so that all of them are warm.
    spares: VecDeque<Box<Batch>>,
    status: Arc<LaneStatus>,
}

impl WriterHandle {
    pub(crate) fn new(
        writer: WriterId,
        epoch: u32,
        ends: HandleParts,
        (capacity, flow): (usize, FlowLimit),
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
    ) -> Self {
        let mut spares = VecDeque::with_capacity(capacity + 2);
        spares.extend((0..SPARES.min(capacity)).map(|_| blank(&ends.registry, &allocator, writer, epoch)));
        let current = blank(&ends.registry, &allocator, writer, epoch);
        Self { writer, epoch, ends, flow: TokenBucket::new(flow), current, spares, allocator, status }
    }

    /// The writer's id.
    pub fn writer(&self) -> WriterId {
        self.writer
    }
    /// The writer's epoch.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }
    /// Its counters.
    pub fn status(&self) -> &Arc<LaneStatus> {
        &self.status
    }

    /// Empty commands for a tick at `now`; discards leftovers of an earlier tick.
    pub fn begin(&mut self, now: SimTime) -> &mut Commands {
        self.current.commands.clear();
        self.current.commands.begin(now);
        &mut self.current.commands
    }

    /// Sends the commands since [`Self::begin`] as the batch of tick number `tick` at `time`, which had read the scene
    /// at `based_on`.
    pub fn submit(&mut self, tick: u64, time: SimTime, based_on: Revision) -> Submitted {
        while self.spares.len() < self.spares.capacity()
            && let Ok(spare) = self.ends.returns.pop()
        {
            self.spares.push_back(spare);
        }
        if self.current.commands.is_empty() {
            return Submitted::Empty;
        }
        let now = self.ends.clock.now();
        let full = self.ends.batches.is_full() || self.status.refuse.load(Ordering::Relaxed);
        if full || !self.flow.admit(count(&self.current.commands), now) {
            self.status.dropped.fetch_add(1, Ordering::Relaxed);
            return Submitted::Dropped;
        }
        self.current.commands.seal();
        self.current.provenance = Provenance { writer: self.writer, epoch: self.epoch, tick, time, based_on };
        let next = self.spares.pop_front().unwrap_or_else(|| self.blank());
        // Never full: only this end pushes, and there was room above.
        let batch = std::mem::replace(&mut self.current, next);
        let _ = self.ends.batches.push(SealedBatch { at: now, batch });
        self.status.sent.fetch_add(1, Ordering::Relaxed);
        self.ends.bell.ring();
        Submitted::Sent
    }

    fn blank(&self) -> Box<Batch> {
        blank(&self.ends.registry, &self.allocator, self.writer, self.epoch)
    }
}

fn blank(registry: &Arc<Registry>, allocator: &EntityAllocator, writer: WriterId, epoch: u32) -> Box<Batch> {
    Box::new(Batch {
        provenance: Provenance { writer, epoch, tick: 0, time: SimTime::ZERO, based_on: Revision::ZERO },
        commands: Commands::new(registry.clone(), allocator.clone()),
    })
}

impl fmt::Debug for WriterHandle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("WriterHandle")
            .field("writer", &self.writer)
            .field("epoch", &self.epoch)
            .field("status", &self.status)
            .finish_non_exhaustive()
    }
}

/// The doorbell, which rings once until draining begins.
pub(crate) struct CoalescedDoorbell {
    rung: Signal,
    target: Arc<dyn Doorbell>,
}

impl CoalescedDoorbell {
    pub(crate) fn new(target: Arc<dyn Doorbell>) -> Self {
        Self { rung: Signal::default(), target }
    }
    fn ring(&self) {
        if self.rung.raise() {
            self.target.ring();
        }
    }
    /// Re-arms the bell: later submissions ring again. Batches sent before the ring that this clears are visible.
    pub(crate) fn silence(&self) {
        self.rung.take();
    }
}

/// Receipt of a batch, for a writer that waits for an answer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Receipt {
    /// Number of the batch's tick.
    pub tick: u64,
    /// What the Model decided; `None` when the batch made it panic and was not applied.
    pub outcome: Option<Outcome>,
}
