//! Receiving ends of all writers' rings. They outlive any one Model: the Model that drains them holds [`Lanes`], a
//! ticket that the next Model's ticket revokes, so that batches left by a dead or hung Model wait for its successor.
//!
//! The lock around the rings is held for one pop. Only the current drainer takes it; a superseded drainer checks its
//! ticket before it tries.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rtrb::{Consumer, Producer, RingBuffer};
use trocar_scene::{Batch, EntityAllocator, Registry, SimTime, WriterId};

use crate::faults::{BatchInFlight, FaultOrder, LinkCounts, LinkFaults};
use crate::handle::{
    CoalescedDoorbell, Doorbell, HandleParts, LaneStatus, Receipt, SealedBatch, WriterHandle,
};
use crate::runtime::Clock;
use crate::token_bucket::FlowLimit;

/// The Model's end of one writer's rings.
struct Lane {
    writer: WriterId,
    batches: Consumer<SealedBatch>,
    returns: Producer<Box<Batch>>,
    receipts: Option<Producer<Receipt>>,
}

impl Lane {
    /// Whether the writer has ended and all its batches are drained.
    fn is_spent(&self) -> bool {
        self.batches.is_abandoned() && self.batches.is_empty()
    }
}

/// A faulty link between the rings of one writer and the Model.
struct Link {
    writer: WriterId,
    status: Arc<LaneStatus>,
    faults: LinkFaults<BatchInFlight>,
    counted: LinkCounts,
}

impl Link {
    fn send(&mut self, now: SimTime, batch_in_flight: BatchInFlight) {
        self.faults.send(now, batch_in_flight);
        self.status.count_link(&self.counted, self.faults.counts());
        self.counted = *self.faults.counts();
    }
}

/// Newly opened lanes and ordered faults that the drainer has not seen yet.
#[derive(Default)]
struct Arrivals {
    lanes: Vec<Lane>,
    orders: Vec<(WriterId, Arc<LaneStatus>, FaultOrder)>,
}

#[derive(Default)]
struct Active {
    lanes: Vec<Lane>,
    /// Lane at which the next round-robin turn begins.
    next: usize,
    /// One per writer whose link is faulty; usually empty.
    links: Vec<Link>,
}

/// Owns the Model's ends of all rings; outlives every Model.
pub struct Intake {
    registry: Arc<Registry>,
    clock: Clock,
    bell: Arc<CoalescedDoorbell>,
    arrivals: Mutex<Arrivals>,
    /// Whether there are arrivals.
    arrived: AtomicBool,
    /// Number of the current drainer.
    drainer: AtomicU64,
    active: Mutex<Active>,
    /// Whether any link is faulty: messages delayed on it become due without a ring of the doorbell.
    is_any_link_bad: AtomicBool,
}

impl Intake {
    /// An intake without writers; `bell` wakes the Model, `clock` dates the sealing of batches.
    pub fn new(registry: Arc<Registry>, clock: Clock, bell: Arc<dyn Doorbell>) -> Arc<Self> {
        Arc::new(Self {
            registry,
            clock,
            bell: Arc::new(CoalescedDoorbell::new(bell)),
            arrivals: Mutex::default(),
            arrived: AtomicBool::new(false),
            drainer: AtomicU64::new(0),
            active: Mutex::default(),
            is_any_link_bad: AtomicBool::new(false),
        })
    }

    /// Opens rings for one life of a writer, for `capacity` batches (at least 1), with its flow limit.
    ///
    /// A fenced writer keeps its old rings, so that a zombie cannot disturb its successor; its late batches are refused
    /// by their epoch. `allocator` and `status` are shared by all lives of a writer.
    pub fn open(
        &self,
        writer: WriterId,
        epoch: u32,
        (capacity, flow): (usize, FlowLimit),
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
    ) -> WriterHandle {
        self.open_lane(writer, epoch, (capacity, flow), allocator, status, None)
    }

    /// The same without a flow limit, for a writer that gets a receipt for each batch once it is published. At most
    /// `capacity` receipts may be outstanding when it sends another batch; further receipts are lost.
    pub(crate) fn open_with_receipts(
        &self,
        writer: WriterId,
        epoch: u32,
        capacity: usize,
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
    ) -> (WriterHandle, Consumer<Receipt>) {
        let (receipts, answers) = RingBuffer::new(2 * capacity.max(1));
        let bounds = (capacity, FlowLimit::UNLIMITED);
        (self.open_lane(writer, epoch, bounds, allocator, status, Some(receipts)), answers)
    }

    fn open_lane(
        &self,
        writer: WriterId,
        epoch: u32,
        (capacity, flow): (usize, FlowLimit),
        allocator: EntityAllocator,
        status: Arc<LaneStatus>,
        receipts: Option<Producer<Receipt>>,
    ) -> WriterHandle {
        let capacity = capacity.max(1);
        let (batches, from_writer) = RingBuffer::new(capacity);
        // The return ring holds everything that can be in flight.
        let (to_writer, returns) = RingBuffer::new(capacity + 2);
        let lane = Lane { writer, batches: from_writer, returns: to_writer, receipts };
        unpoisoned(&self.arrivals).lanes.push(lane);
        self.arrived.store(true, Ordering::Release);
        let (bell, clock, registry) = (self.bell.clone(), self.clock.clone(), self.registry.clone());
        let ends = HandleParts { batches, returns, bell, clock, registry };
        WriterHandle::new(writer, epoch, ends, (capacity, flow), allocator, status)
    }

    /// Begins or ends a fault of the link between a writer and the Model, from the next pass on.
    pub(crate) fn fault(&self, writer: WriterId, status: &Arc<LaneStatus>, order: &FaultOrder) {
        unpoisoned(&self.arrivals).orders.push((writer, status.clone(), order.clone()));
        self.arrived.store(true, Ordering::Release);
    }

    /// Whether a message may become due without a ring of the doorbell.
    pub(crate) fn is_any_link_bad(&self) -> bool {
        self.is_any_link_bad.load(Ordering::Relaxed)
    }

    /// Makes the caller the drainer: the returned lanes replace those returned before.
    pub fn take(self: &Arc<Self>) -> Lanes {
        let ticket = self.drainer.fetch_add(1, Ordering::AcqRel) + 1;
        // A ring that a dead drainer never answered must not keep the bell silent.
        self.bell.silence();
        Lanes { intake: self.clone(), ticket }
    }
}

/// Ignores poisoning: data under these locks is only pushed or popped, so a panic leaves it consistent.
fn unpoisoned<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Active {
    fn welcome(&mut self, arrivals: &mut Arrivals) {
        self.lanes.append(&mut arrivals.lanes);
        for (writer, status, order) in arrivals.orders.drain(..) {
            let known = self.links.iter().position(|link| link.writer == writer);
            let at = known.unwrap_or_else(|| {
                let (faults, counted) = (LinkFaults::default(), LinkCounts::default());
                self.links.push(Link { writer, status, faults, counted });
                self.links.len() - 1
            });
            self.links[at].faults.apply(&order);
        }
    }

    /// The next waiting batch, round-robin over the lanes.
    fn in_turn(&mut self) -> Option<(usize, SealedBatch)> {
        let count = self.lanes.len();
        for step in 0..count {
            let index = (self.next + step) % count;
            if let Ok(sealed) = self.lanes[index].batches.pop() {
                self.next = (index + 1) % count;
                return Some((index, sealed));
            }
        }
        None
    }

    fn next_off_links(&mut self, now: SimTime) -> Option<Arrival> {
        for link in &mut self.links {
            if let Some(BatchInFlight { sealed_at, batch, .. }) = link.faults.due(now) {
                let lane = self.lanes.iter().rposition(|lane| lane.writer == link.writer);
                return Some(Arrival { lane: LaneIndex(lane.unwrap_or(usize::MAX)), sealed_at, batch });
            }
        }
        None
    }

    fn pop(&mut self, now: SimTime) -> Option<Arrival> {
        loop {
            if !self.links.is_empty()
                && let Some(arrival) = self.next_off_links(now)
            {
                return Some(arrival);
            }
            let (index, SealedBatch { at, batch }) = self.in_turn()?;
            let writer = self.lanes[index].writer;
            match self.links.iter_mut().find(|link| link.writer == writer) {
                Some(link) => link.send(now, BatchInFlight { sealed_at: at, batch }),
                None => return Some(Arrival { lane: LaneIndex(index), sealed_at: at, batch }),
            }
        }
    }
}

/// The rings as one drainer sees them.
pub struct Lanes {
    intake: Arc<Intake>,
    ticket: u64,
}

/// Index of the lane that a batch came through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaneIndex(usize);

/// A received batch.
pub struct Arrival {
    /// The lane it came through.
    pub lane: LaneIndex,
    /// When its writer sealed it.
    pub sealed_at: SimTime,
    /// The batch.
    pub batch: Box<Batch>,
}

impl Lanes {
    /// Whether this ticket is still the current drainer.
    pub fn is_current(&self) -> bool {
        self.intake.drainer.load(Ordering::Acquire) == self.ticket
    }

    fn active(&self) -> Option<MutexGuard<'_, Active>> {
        // Checked before the lock, so that a superseded thread does not contend for it, and again under it.
        if !self.is_current() {
            return None;
        }
        let active = unpoisoned(&self.intake.active);
        self.is_current().then_some(active)
    }

    /// Begins a pass: later submissions ring the bell again. Call it before the first [`Self::pop`] of a pass, so that
    /// no batch sent in between is missed.
    pub fn begin_pass(&mut self) {
        let Some(mut active) = self.active() else { return };
        self.intake.bell.silence();
        if self.intake.arrived.swap(false, Ordering::AcqRel) {
            active.welcome(&mut unpoisoned(&self.intake.arrivals));
        }
        if active.lanes.iter().any(Lane::is_spent) {
            active.lanes.retain(|lane| !lane.is_spent());
            active.next = 0;
        }
        if !active.links.is_empty() {
            active.links.retain(|link| !link.faults.is_idle());
        }
        self.intake.is_any_link_bad.store(!active.links.is_empty(), Ordering::Relaxed);
    }

    /// The next batch that has arrived by `now`, round-robin; `None` when there is none or this ticket is superseded.
    pub fn pop(&mut self, now: SimTime) -> Option<Arrival> {
        self.active()?.pop(now)
    }

    /// Whether the writer of this lane expects receipts.
    pub(crate) fn wants_receipt(&self, lane: LaneIndex) -> bool {
        let waits = |active: MutexGuard<'_, Active>| {
            active.lanes.get(lane.0).is_some_and(|lane| lane.receipts.is_some())
        };
        self.active().is_some_and(waits)
    }

    /// Sends the writer the receipt of a batch, if it expects receipts. Valid until the next [`Self::begin_pass`].
    pub(crate) fn answer(&mut self, lane: LaneIndex, receipt: Receipt) {
        let Some(mut active) = self.active() else { return };
        if let Some(receipts) = active.lanes.get_mut(lane.0).and_then(|lane| lane.receipts.as_mut()) {
            // The ring is full only when its reader has ended.
            let _ = receipts.push(receipt);
        }
    }

    /// Returns an applied or refused batch's buffers to its writer. Clears them here, so that values are freed on the
    /// Model's thread, not on the writer's. Valid until the next [`Self::begin_pass`].
    pub fn give_back(&mut self, lane: LaneIndex, mut batch: Box<Batch>) {
        batch.commands.clear();
        let Some(mut active) = self.active() else { return };
        let writer = batch.provenance.writer;
        if let Some(lane) = active.lanes.get_mut(lane.0).filter(|lane| lane.writer == writer) {
            // The ring is full only when the writer has ended, or when it got a duplicate's buffers as well.
            let _ = lane.returns.push(batch);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::atomic::AtomicUsize;

    use super::*;
    use crate::handle::{SPARES, Submitted};
    use crate::spec::FaultKind;
    use crate::testing::{Count, registry};
    use trocar_scene::Revision;

    struct TestIntake {
        intake: Arc<Intake>,
        rings: Arc<AtomicUsize>,
    }

    fn test_intake() -> TestIntake {
        let rings = Arc::new(AtomicUsize::new(0));
        let counter = rings.clone();
        let bell: Arc<dyn Doorbell> = Arc::new(move || {
            counter.fetch_add(1, Ordering::Relaxed);
        });
        TestIntake { intake: Intake::new(registry(), Clock::start(), bell), rings }
    }

    impl TestIntake {
        fn open(&self, writer: u16, epoch: u32, capacity: usize) -> WriterHandle {
            let allocator = EntityAllocator::new(0, writer);
            self.open_limited(writer, epoch, capacity, FlowLimit::UNLIMITED, allocator)
        }
        fn open_limited(
            &self,
            writer: u16,
            epoch: u32,
            capacity: usize,
            flow: FlowLimit,
            allocator: EntityAllocator,
        ) -> WriterHandle {
            self.intake.open(WriterId(writer), epoch, (capacity, flow), allocator, Arc::default())
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
        while let Some(Arrival { lane, batch, .. }) = lanes.pop(SimTime::ZERO) {
            seen.push((batch.provenance.writer.0, batch.provenance.tick));
            lanes.give_back(lane, batch);
        }
        seen
    }

    #[test]
    fn a_flood_costs_only_its_sender() {
        let test_intake = test_intake();
        let (mut loud, mut quiet) = (test_intake.open(1, 1, 4), test_intake.open(2, 1, 4));
        for tick in 0..10 {
            send(&mut loud, tick);
        }
        assert_eq!(send(&mut quiet, 7), Submitted::Sent);
        assert_eq!((loud.status().sent(), loud.status().dropped()), (4, 6));
        let mut lanes = test_intake.intake.take();
        assert_eq!(drain(&mut lanes), [(1, 0), (2, 7), (1, 1), (1, 2), (1, 3)], "in turn");
    }

    #[test]
    fn the_bell_rings_once_until_the_model_begins_to_drain() {
        let test_intake = test_intake();
        let mut handle = test_intake.open(1, 1, 8);
        let mut lanes = test_intake.intake.take();
        for tick in 0..3 {
            send(&mut handle, tick);
        }
        assert_eq!(test_intake.rings(), 1);
        assert_eq!(drain(&mut lanes).len(), 3);
        handle.begin(SimTime(0));
        assert_eq!(handle.submit(3, SimTime(0), Revision::ZERO), Submitted::Empty);
        assert_eq!(test_intake.rings(), 1, "nothing to say, nothing rung");
        send(&mut handle, 4);
        assert_eq!(test_intake.rings(), 2);
    }

    #[test]
    fn batches_of_a_dead_model_wait_for_the_next_one() {
        let test_intake = test_intake();
        let mut handle = test_intake.open(1, 1, 8);
        for tick in 0..4 {
            send(&mut handle, tick);
        }
        let died = catch_unwind(AssertUnwindSafe(|| {
            let mut lanes = test_intake.intake.take();
            lanes.begin_pass();
            let _first = lanes.pop(SimTime::ZERO);
            std::panic::resume_unwind(Box::new("the Model dies"));
        }));
        assert!(died.is_err());
        send(&mut handle, 4);
        let mut lanes = test_intake.intake.take();
        assert_eq!(drain(&mut lanes), [(1, 1), (1, 2), (1, 3), (1, 4)]);
        let before = test_intake.rings();
        send(&mut handle, 5);
        assert_eq!(test_intake.rings(), before + 1, "the bell of a dead Model rings for the next one");
    }

    #[test]
    fn a_new_life_gets_rings_of_its_own_and_spent_ones_go() {
        let test_intake = test_intake();
        let mut zombie = test_intake.open(1, 1, 2);
        let mut lanes = test_intake.intake.take();
        let mut reborn = test_intake.open(1, 2, 2);
        for tick in 0..5 {
            send(&mut zombie, tick);
        }
        assert_eq!(send(&mut reborn, 9), Submitted::Sent, "a zombie's flood does not fill it");
        assert_eq!(drain(&mut lanes).len(), 3);
        drop(zombie);
        lanes.begin_pass();
        assert_eq!(unpoisoned(&test_intake.intake.active).lanes.len(), 1);
        send(&mut reborn, 10);
        assert_eq!(drain(&mut lanes), [(1, 10)]);
    }

    #[test]
    fn queue_full_is_a_fault_that_can_be_injected() {
        let test_intake = test_intake();
        let mut handle = test_intake.open(1, 1, 8);
        handle.status().clone().set_queue_full(true);
        assert_eq!(send(&mut handle, 0), Submitted::Dropped);
        handle.status().clone().set_queue_full(false);
        assert_eq!(send(&mut handle, 1), Submitted::Sent);
    }

    #[test]
    fn buffers_come_back_and_are_used_again() {
        let test_intake = test_intake();
        let mut handle = test_intake.open(1, 1, 8);
        let mut lanes = test_intake.intake.take();
        let mut addresses = Vec::new();
        for tick in 0..50 {
            send(&mut handle, tick);
            lanes.begin_pass();
            let Arrival { lane, batch, .. } = lanes.pop(SimTime::ZERO).expect("sent");
            addresses.push(std::ptr::from_ref(&*batch) as usize);
            lanes.give_back(lane, batch);
        }
        addresses.sort_unstable();
        addresses.dedup();
        assert!(addresses.len() <= SPARES + 1, "{} buffers for one batch in flight", addresses.len());
    }

    #[test]
    fn a_drainer_that_was_left_behind_gets_nothing_and_what_waits_is_its_successors() {
        let test_intake = test_intake();
        let mut handle = test_intake.open(1, 1, 8);
        let mut old = test_intake.intake.take();
        old.begin_pass();
        for tick in 0..3 {
            send(&mut handle, tick);
        }
        let taken = old.pop(SimTime::ZERO).expect("sent");
        let mut new = test_intake.intake.take();
        assert!(!old.is_current() && new.is_current());
        assert_eq!(drain(&mut old), []);
        assert_eq!(drain(&mut new), [(1, 1), (1, 2)], "only the one that was taken is gone");
        old.give_back(taken.lane, taken.batch);
        send(&mut handle, 3);
        assert_eq!(drain(&mut new), [(1, 3)]);
    }

    #[test]
    fn who_sends_more_commands_than_it_may_is_refused_at_its_own_handle() {
        let test_intake = test_intake();
        let limit = FlowLimit { commands_per_sec: 1e-3, burst: 10 };
        let mut loud = test_intake.open_limited(1, 1, 64, limit, EntityAllocator::new(0, 1));
        let mut quiet = test_intake.open(2, 1, 64);
        for tick in 0..20 {
            send(&mut loud, tick);
            send(&mut quiet, tick);
        }
        assert_eq!((loud.status().sent(), loud.status().dropped()), (10, 10));
        assert_eq!((quiet.status().sent(), quiet.status().dropped()), (20, 0));
        let commands = loud.begin(SimTime::ZERO);
        (0..11).for_each(|_| {
            commands.spawn();
        });
        assert_eq!(loud.submit(20, SimTime::ZERO, Revision::ZERO), Submitted::Dropped, "too many at once");
    }

    #[test]
    fn a_bad_link_touches_its_own_writer_only_and_outlives_a_drainer() {
        let test_intake = test_intake();
        let (mut near, mut far) = (test_intake.open(1, 1, 64), test_intake.open(2, 1, 64));
        let delay = FaultOrder {
            index: 0,
            target: "far".to_owned(),
            kind: FaultKind::Delay,
            begins: true,
            span: SimTime::from_millis(20),
            jitter: SimTime::ZERO,
            independent: false,
            delays: Vec::new(),
            every: SimTime::ZERO,
            burst: 0.0,
            probability: 1.0,
            bytes_per_sec: 0.0,
            seed: 1,
        };
        test_intake.intake.fault(WriterId(2), far.status(), &delay);
        let mut lanes = test_intake.intake.take();
        send(&mut near, 0);
        send(&mut far, 0);
        assert_eq!(drain(&mut lanes), [(1, 0)]);
        assert!(test_intake.intake.is_any_link_bad());
        let mut lanes = test_intake.intake.take();
        lanes.begin_pass();
        assert!(lanes.pop(SimTime::from_millis(19)).is_none());
        let late = lanes.pop(SimTime::from_millis(20)).expect("it has come");
        assert_eq!((late.batch.provenance.writer.0, far.status().delayed()), (2, 1));
        test_intake.intake.fault(WriterId(2), far.status(), &FaultOrder { begins: false, ..delay });
        send(&mut far, 1);
        assert_eq!(drain(&mut lanes), [(2, 1)]);
        assert!(!test_intake.intake.is_any_link_bad());
    }
}
