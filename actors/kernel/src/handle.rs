//! A writer's way to the Model: a bounded ring of batches, a ring of emptied buffers back, and a doorbell.
//!
//! Nothing here waits, locks or (once warmed) allocates on the writer's side. A full ring costs only its
//! own writer. The Model's ends of the rings belong to the [`Intake`], not to the Model: whoever drains
//! them borrows them as [`Lanes`], and when that drainer dies they come back with whatever was not applied.

use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rtrb::{Consumer, Producer, RingBuffer};
use trocar_scene::{Batch, Commands, EntityAllocator, Provenance, Registry, Revision, SimTime, WriterId};

use crate::model_core::Outcome;
use crate::signal::Signal;

/// Buffers that a handle has from the beginning: enough for a Model that is late now and then, so that
/// nothing is allocated for it once they have all been used.
const SPARES: usize = 8;

/// Wakes the Model. Called at most once until the Model begins to drain; must not allocate or wait.
pub trait Doorbell: Send + Sync {
    /// There is something to drain.
    fn ring(&self);
}

impl<F: Fn() + Send + Sync> Doorbell for F {
    fn ring(&self) {
        self();
    }
}

/// What both ends of a lane count and see; survives restarts of the writer.
#[derive(Debug, Default)]
pub struct LaneStatus {
    sent: AtomicU64,
    dropped: AtomicU64,
    refuse: AtomicBool,
}

impl LaneStatus {
    /// Batches that went into the ring.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }
    /// Batches that did not, because the ring was full.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
    /// Fault hook: while `true` the handle behaves as if its ring were full.
    pub fn set_queue_full(&self, full: bool) {
        self.refuse.store(full, Ordering::Relaxed);
    }
}

/// What became of a tick's commands at the handle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Submitted {
    /// On its way to the Model.
    Sent,
    /// Nothing was commanded, so nothing was sent.
    Empty,
    /// The ring was full; the commands are gone and counted.
    Dropped,
}

/// The writer's end.
pub struct WriterHandle {
    writer: WriterId,
    epoch: u32,
    registry: Arc<Registry>,
    allocator: EntityAllocator,
    batches: Producer<Box<Batch>>,
    returns: Consumer<Box<Batch>>,
    current: Box<Batch>,
    /// Used in turn, so that all of them are warm.
    spares: VecDeque<Box<Batch>>,
    status: Arc<LaneStatus>,
    bell: Arc<Bell>,
}

impl WriterHandle {
    /// Which writer this is.
    pub fn writer(&self) -> WriterId {
        self.writer
    }
    /// Which life of the writer.
    pub fn epoch(&self) -> u32 {
        self.epoch
    }
    /// Its counters.
    pub fn status(&self) -> &Arc<LaneStatus> {
        &self.status
    }

    /// Empty commands for a tick at `now`; discards what an earlier tick left behind.
    pub fn begin(&mut self, now: SimTime) -> &mut Commands {
        self.current.commands.clear();
        self.current.commands.begin(now);
        &mut self.current.commands
    }

    /// Sends what was commanded since [`Self::begin`] as the batch of tick number `tick` at `time`, which had
    /// read the scene at `based_on`.
    pub fn submit(&mut self, tick: u64, time: SimTime, based_on: Revision) -> Submitted {
        while self.spares.len() < self.spares.capacity()
            && let Ok(spare) = self.returns.pop()
        {
            self.spares.push_back(spare);
        }
        if self.current.commands.is_empty() {
            return Submitted::Empty;
        }
        if self.batches.is_full() || self.status.refuse.load(Ordering::Relaxed) {
            self.status.dropped.fetch_add(1, Ordering::Relaxed);
            return Submitted::Dropped;
        }
        self.current.commands.seal();
        self.current.provenance = Provenance { writer: self.writer, epoch: self.epoch, tick, time, based_on };
        let next = self.spares.pop_front().unwrap_or_else(|| self.blank());
        // Never full: only this end pushes, and there was room above.
        let _ = self.batches.push(std::mem::replace(&mut self.current, next));
        self.status.sent.fetch_add(1, Ordering::Relaxed);
        self.bell.ring();
        Submitted::Sent
    }

    fn blank(&self) -> Box<Batch> {
        blank(&self.registry, &self.allocator, self.writer, self.epoch)
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

struct Bell {
    rung: Signal,
    target: Arc<dyn Doorbell>,
}

impl Bell {
    fn ring(&self) {
        if self.rung.raise() {
            self.target.ring();
        }
    }
}

/// What became of a batch, for a writer that waits for an answer.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Receipt {
    /// Number of the batch's tick.
    pub tick: u64,
    /// What the Model decided; `None` when the batch made it panic, and nothing of it is in the scene.
    pub outcome: Option<Outcome>,
}

/// The Model's end of one writer's rings.
struct Lane {
    writer: WriterId,
    batches: Consumer<Box<Batch>>,
    returns: Producer<Box<Batch>>,
    receipts: Option<Producer<Receipt>>,
}

impl Lane {
    /// Its writer is gone and everything it sent has been drained.
    fn is_spent(&self) -> bool {
        self.batches.is_abandoned() && self.batches.is_empty()
    }
}

/// Owns the Model's ends of all rings; outlives every Model.
pub struct Intake {
    registry: Arc<Registry>,
    bell: Arc<Bell>,
    /// Lanes that nobody drains at the moment.
    home: Mutex<Vec<Lane>>,
    /// Whether `home` holds lanes that a drainer should fetch.
    arrived: AtomicBool,
}

impl Intake {
    /// Without writers; `bell` wakes the Model.
    pub fn new(registry: Arc<Registry>, bell: Arc<dyn Doorbell>) -> Arc<Self> {
        Arc::new(Self {
            registry,
            bell: Arc::new(Bell { rung: Signal::default(), target: bell }),
            home: Mutex::new(Vec::new()),
            arrived: AtomicBool::new(false),
        })
    }

    /// Gives a life of a writer rings of its own, for `capacity` batches (at least 1).
    ///
    /// A writer that was fenced keeps its old rings, so that a zombie can neither disturb its successor nor
    /// be disturbed; what it still sends is refused by its epoch. `allocator` and `status` are shared by all
    /// lives of a writer.
    pub fn open(
        &self,
        writer: WriterId,
        epoch: u32,
        capacity: usize,
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
    ) -> WriterHandle {
        self.open_lane(writer, epoch, capacity, allocator, status, None)
    }

    /// The same for a writer that is told what became of its batches, once they are published. It must have taken
    /// the receipts of all but `capacity` of them when it sends another; more are lost.
    pub(crate) fn open_with_receipts(
        &self,
        writer: WriterId,
        epoch: u32,
        capacity: usize,
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
    ) -> (WriterHandle, Consumer<Receipt>) {
        let (receipts, answers) = RingBuffer::new(2 * capacity.max(1));
        (self.open_lane(writer, epoch, capacity, allocator, status, Some(receipts)), answers)
    }

    fn open_lane(
        &self,
        writer: WriterId,
        epoch: u32,
        capacity: usize,
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
        receipts: Option<Producer<Receipt>>,
    ) -> WriterHandle {
        let capacity = capacity.max(1);
        let (batches, from_writer) = RingBuffer::new(capacity);
        // Everything that can be in flight fits into the way back.
        let (to_writer, returns) = RingBuffer::new(capacity + 2);
        let mut spares = VecDeque::with_capacity(capacity + 2);
        spares.extend((0..SPARES.min(capacity)).map(|_| blank(&self.registry, &allocator, writer, epoch)));
        let lane = Lane { writer, batches: from_writer, returns: to_writer, receipts };
        self.home().push(lane);
        self.arrived.store(true, Ordering::Release);
        WriterHandle {
            writer,
            epoch,
            registry: self.registry.clone(),
            batches,
            returns,
            current: blank(&self.registry, &allocator, writer, epoch),
            spares,
            allocator,
            status,
            bell: self.bell.clone(),
        }
    }

    /// Borrows the lanes for draining. Only one drainer has them at a time; a second one gets those that are
    /// opened after the first took its own.
    pub fn take(self: &Arc<Self>) -> Lanes {
        // An unanswered ring of a dead drainer must not keep the bell silent.
        self.bell.rung.take();
        let mut lanes = Lanes { intake: self.clone(), lanes: Vec::new(), next: 0 };
        lanes.fetch();
        lanes
    }

    fn home(&self) -> MutexGuard<'_, Vec<Lane>> {
        // A panic while the list was held cannot have left it half changed: it is only pushed to or taken.
        self.home.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The rings as the Model drains them; goes back to the [`Intake`] when dropped, also while unwinding.
pub struct Lanes {
    intake: Arc<Intake>,
    lanes: Vec<Lane>,
    next: usize,
}

/// Which lane a batch came through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaneIndex(usize);

impl Lanes {
    /// Begins a pass: from here on a submission rings the bell again. Call it before the first
    /// [`Iterator::next`] of a pass, so that nothing sent in between is missed.
    pub fn begin_pass(&mut self) {
        self.intake.bell.rung.take();
        if self.intake.arrived.load(Ordering::Acquire) {
            self.fetch();
        }
        if self.lanes.iter().any(Lane::is_spent) {
            self.lanes.retain(|lane| !lane.is_spent());
            self.next = 0;
        }
    }

    /// Whether nothing waits.
    pub fn is_drained(&self) -> bool {
        self.lanes.iter().all(|lane| lane.batches.is_empty())
    }

    /// Returns an applied or refused batch's buffers to its writer. Clears them here, so that values are
    /// freed on the Model's thread and not on the writer's. Valid until the next [`Self::begin_pass`].
    pub fn give_back(&mut self, lane: LaneIndex, mut batch: Box<Batch>) {
        batch.commands.clear();
        if let Some(lane) = self.lanes.get_mut(lane.0).filter(|lane| lane.writer == batch.provenance.writer) {
            // Full only when the writer is gone; then the buffers go too.
            let _ = lane.returns.push(batch);
        }
    }

    /// Whether the writer of this lane waits for answers.
    pub(crate) fn wants_receipt(&self, lane: LaneIndex) -> bool {
        self.lanes.get(lane.0).is_some_and(|lane| lane.receipts.is_some())
    }

    /// Tells the writer what became of a batch, if it wants to know. Valid until the next
    /// [`Self::begin_pass`].
    pub(crate) fn answer(&mut self, lane: LaneIndex, receipt: Receipt) {
        if let Some(receipts) = self.lanes.get_mut(lane.0).and_then(|lane| lane.receipts.as_mut()) {
            // Full only when nobody reads it any more.
            let _ = receipts.push(receipt);
        }
    }

    fn fetch(&mut self) {
        let mut home = self.intake.home();
        self.intake.arrived.store(false, Ordering::Release);
        self.lanes.append(&mut home);
    }
}

/// The batches that wait, one per lane in turn; `None` when all lanes are empty, and again `Some` when more
/// came.
impl Iterator for Lanes {
    type Item = (LaneIndex, Box<Batch>);
    fn next(&mut self) -> Option<Self::Item> {
        let count = self.lanes.len();
        for step in 0..count {
            let index = (self.next + step) % count;
            if let Ok(batch) = self.lanes[index].batches.pop() {
                self.next = (index + 1) % count;
                return Some((LaneIndex(index), batch));
            }
        }
        None
    }
}

impl Drop for Lanes {
    fn drop(&mut self) {
        let mut home = self.intake.home();
        home.append(&mut self.lanes);
        self.intake.arrived.store(true, Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::AtomicUsize;

    use super::*;
    use crate::testing::{Count, registry};

    struct Desk {
        intake: Arc<Intake>,
        rings: Arc<AtomicUsize>,
    }

    fn desk() -> Desk {
        let rings = Arc::new(AtomicUsize::new(0));
        let counter = rings.clone();
        let bell: Arc<dyn Doorbell> = Arc::new(move || {
            counter.fetch_add(1, Ordering::Relaxed);
        });
        Desk { intake: Intake::new(registry(), bell), rings }
    }

    impl Desk {
        fn open(&self, writer: u16, epoch: u32, capacity: usize) -> WriterHandle {
            let allocator = EntityAllocator::new(0, writer);
            self.intake.open(WriterId(writer), epoch, capacity, allocator, Arc::default())
        }
        fn rings(&self) -> usize {
            self.rings.load(Ordering::Relaxed)
        }
    }

    fn send(handle: &mut WriterHandle, tick: u64) -> Submitted {
        handle.begin(SimTime(tick)).contribute(Count(tick));
        handle.submit(tick, SimTime(tick), Revision::ZERO)
    }

    fn drain(lanes: &mut Lanes) -> Vec<(u16, u64)> {
        lanes.begin_pass();
        let mut seen = Vec::new();
        while let Some((lane, batch)) = lanes.next() {
            seen.push((batch.provenance.writer.0, batch.provenance.tick));
            lanes.give_back(lane, batch);
        }
        seen
    }

    #[test]
    fn a_flood_costs_only_its_sender() {
        let desk = desk();
        let (mut loud, mut quiet) = (desk.open(1, 1, 4), desk.open(2, 1, 4));
        for tick in 0..10 {
            send(&mut loud, tick);
        }
        assert_eq!(send(&mut quiet, 7), Submitted::Sent);
        assert_eq!((loud.status().sent(), loud.status().dropped()), (4, 6));
        let mut lanes = desk.intake.take();
        assert_eq!(drain(&mut lanes), [(1, 0), (2, 7), (1, 1), (1, 2), (1, 3)], "in turn");
    }

    #[test]
    fn the_bell_rings_once_until_the_model_begins_to_drain() {
        let desk = desk();
        let mut handle = desk.open(1, 1, 8);
        let mut lanes = desk.intake.take();
        for tick in 0..3 {
            send(&mut handle, tick);
        }
        assert_eq!(desk.rings(), 1);
        assert_eq!(drain(&mut lanes).len(), 3);
        handle.begin(SimTime(0));
        assert_eq!(handle.submit(3, SimTime(0), Revision::ZERO), Submitted::Empty);
        assert_eq!(desk.rings(), 1, "nothing to say, nothing rung");
        send(&mut handle, 4);
        assert_eq!(desk.rings(), 2);
    }

    #[test]
    fn batches_of_a_dead_model_wait_for_the_next_one() {
        let desk = desk();
        let mut handle = desk.open(1, 1, 8);
        for tick in 0..4 {
            send(&mut handle, tick);
        }
        let died = catch_unwind(AssertUnwindSafe(|| {
            let mut lanes = desk.intake.take();
            lanes.begin_pass();
            let _first = lanes.next();
            std::panic::resume_unwind(Box::new("the Model dies"));
        }));
        assert!(died.is_err());
        send(&mut handle, 4);
        let mut lanes = desk.intake.take();
        assert_eq!(drain(&mut lanes), [(1, 1), (1, 2), (1, 3), (1, 4)]);
        let before = desk.rings();
        send(&mut handle, 5);
        assert_eq!(desk.rings(), before + 1, "the bell of a dead Model rings for the next one");
    }

    #[test]
    fn a_new_life_gets_rings_of_its_own_and_spent_ones_go() {
        let desk = desk();
        let mut zombie = desk.open(1, 1, 2);
        let mut lanes = desk.intake.take();
        let mut reborn = desk.open(1, 2, 2);
        for tick in 0..5 {
            send(&mut zombie, tick);
        }
        assert_eq!(send(&mut reborn, 9), Submitted::Sent, "a zombie's flood does not fill it");
        assert_eq!(drain(&mut lanes).len(), 3);
        drop(zombie);
        lanes.begin_pass();
        assert_eq!(lanes.lanes.len(), 1);
        send(&mut reborn, 10);
        assert_eq!(drain(&mut lanes), [(1, 10)]);
    }

    #[test]
    fn queue_full_is_a_fault_that_can_be_injected() {
        let desk = desk();
        let mut handle = desk.open(1, 1, 8);
        handle.status().clone().set_queue_full(true);
        assert_eq!(send(&mut handle, 0), Submitted::Dropped);
        handle.status().clone().set_queue_full(false);
        assert_eq!(send(&mut handle, 1), Submitted::Sent);
    }

    #[test]
    fn buffers_come_back_and_are_used_again() {
        let desk = desk();
        let mut handle = desk.open(1, 1, 8);
        let mut lanes = desk.intake.take();
        let mut addresses = Vec::new();
        for tick in 0..50 {
            send(&mut handle, tick);
            lanes.begin_pass();
            let (lane, batch) = lanes.next().expect("sent");
            addresses.push(std::ptr::from_ref(&*batch) as usize);
            lanes.give_back(lane, batch);
        }
        addresses.sort_unstable();
        addresses.dedup();
        assert!(addresses.len() <= SPARES + 1, "{} buffers for one batch in flight", addresses.len());
    }
}
