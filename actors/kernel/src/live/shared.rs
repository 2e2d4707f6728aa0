//! State shared by the threads of a live session. Ticks use only atomics and `ArcSwap`; the locks are for starting and
//! ending.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use arc_swap::ArcSwap;
use tokio::sync::oneshot;
use trocar_scene::{Access, EntityAllocator, Revision, SimTime, Snapshot, WriterId};

use crate::handle::{LaneStatus, WriterHandle};
use crate::heartbeat::Heartbeat;
use crate::intake::{Arrival, Intake};
use crate::runtime::{Account, Clock, ControllerReport, Permission, TickStats, guarded};
use crate::signal::Signal;
use crate::spec::{CommitSink, ControllerSpec, FaultKind, FaultOrder};
use crate::state_hash::StateHash;
use crate::supervision::{Cause, ChildId, Event, RuntimeClass};

/// One life of a child, from its construction to its end; an abandoned thread keeps its own record.
#[derive(Default)]
pub(crate) struct Life {
    pub(crate) incarnation: u32,
    pub(crate) heartbeat: Heartbeat,
    /// Thread id; 0 before it runs.
    pub(crate) tid: AtomicU32,
    /// Construction is done: the watchdog may check it.
    pub(crate) running: AtomicBool,
    /// Its first step is done.
    pub(crate) settled: AtomicBool,
    /// It is asked to end in good order.
    pub(crate) stop: AtomicBool,
    /// It was abandoned.
    pub(crate) abandoned: AtomicBool,
    /// It misses ticks.
    pub(crate) late: AtomicBool,
    /// It does not tick, because the session is paused.
    pub(crate) at_rest: AtomicBool,
}

impl Life {
    pub(crate) fn new(incarnation: u32) -> Arc<Self> {
        Arc::new(Self { incarnation, ..Self::default() })
    }
    pub(crate) fn should_end(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.abandoned.load(Ordering::Relaxed)
    }
    pub(crate) fn is_abandoned(&self) -> bool {
        self.abandoned.load(Ordering::Acquire)
    }
    /// Records that a step begins or ends.
    pub(crate) fn bump(&self, now: SimTime) {
        self.heartbeat.bump(now.0);
    }
}

/// State of a child that persists across its lives.
pub(crate) struct ChildState {
    pub(crate) child: ChildId,
    pub(crate) name: String,
    pub(crate) class: RuntimeClass,
    /// Heartbeat limits before and after the first step of a life.
    pub(crate) limits: [SimTime; 2],
    /// Whether it ticks periodically rather than on messages.
    pub(crate) ticks: bool,
    pub(crate) life: ArcSwap<Life>,
    pub(crate) stats: TickStats,
    pub(crate) fault_hooks: FaultHooks,
}

impl ChildState {
    /// Heartbeat limit of a life, depending on whether its first step is done.
    pub(crate) fn limit(&self, settled: bool) -> SimTime {
        self.limits[usize::from(settled)]
    }
}

/// Injection point of faults: flags that the host checks, so that controllers need no annotations.
#[derive(Default)]
pub(crate) struct FaultHooks {
    kill: AtomicBool,
    stall: AtomicU64,
    slow: AtomicU64,
    nan: AtomicBool,
    held: AtomicBool,
    stall_ended: AtomicBool,
}

impl FaultHooks {
    pub(crate) fn apply(&self, order: &FaultOrder) {
        match order.kind {
            FaultKind::Kill => self.kill.store(order.begins, Ordering::Relaxed),
            FaultKind::Stall => {
                self.stall.store(if order.begins { order.span.0 } else { 0 }, Ordering::Relaxed);
            }
            FaultKind::Slow => {
                self.slow.store(if order.begins { order.span.0 } else { 0 }, Ordering::Relaxed);
            }
            FaultKind::Nan => self.nan.store(order.begins, Ordering::Relaxed),
            _ => {}
        }
    }
    pub(crate) fn take_kill(&self) -> bool {
        self.kill.load(Ordering::Relaxed) && self.kill.swap(false, Ordering::Relaxed)
    }
    pub(crate) fn take_stall(&self) -> Option<SimTime> {
        if self.stall.load(Ordering::Relaxed) == 0 {
            return None;
        }
        Some(SimTime(self.stall.swap(0, Ordering::Relaxed)))
    }
    pub(crate) fn slow(&self) -> Option<SimTime> {
        Some(self.slow.load(Ordering::Relaxed)).filter(|span| *span > 0).map(SimTime)
    }
    pub(crate) fn nan(&self) -> bool {
        self.nan.load(Ordering::Relaxed)
    }
    pub(crate) fn set_held(&self, held: bool) {
        self.held.store(held, Ordering::Relaxed);
    }
    pub(crate) fn is_held(&self) -> bool {
        self.held.load(Ordering::Relaxed)
    }
    pub(crate) fn end_stall(&self) {
        self.stall_ended.store(true, Ordering::Relaxed);
    }
    pub(crate) fn take_stall_ended(&self) -> bool {
        self.stall_ended.swap(false, Ordering::Relaxed)
    }
}

/// A controller's writer state, shared with the Model.
pub(crate) struct Writer {
    pub(crate) state: ChildState,
    pub(crate) spec: ControllerSpec,
    pub(crate) id: WriterId,
    pub(crate) allocator: EntityAllocator,
    pub(crate) lane: Arc<LaneStatus>,
    /// The lowest epoch that the Model accepts.
    pub(crate) epoch: AtomicU32,
    /// Batches applied, to detect the end of a fault.
    pub(crate) applied: AtomicU64,
    /// 1 while the Model is applying a batch of this writer, else 0.
    pub(crate) taken: AtomicU64,
    /// Batches that the Model has applied and not yet published.
    pub(crate) unpublished: AtomicU64,
    /// Tick at which the next life continues.
    pub(crate) next_tick: AtomicU64,
    pub(crate) events_seen: AtomicU64,
    /// Access declared to the Model.
    pub(crate) declared: Mutex<Option<Access>>,
}

impl Writer {
    /// Its row of the report; `elapsed` is the time since the session began.
    pub(crate) fn report(&self, elapsed: SimTime) -> ControllerReport {
        self.state.stats.set_account(Account {
            sent: self.lane.sent(),
            applied: self.applied.load(Ordering::Relaxed),
            lost: self.lane.lost(),
            delayed: self.lane.delayed(),
            duplicated: self.lane.duplicated(),
        });
        self.state.stats.report(elapsed)
    }
    /// Counts batches as lost that the Model took and did not publish before it failed.
    pub(crate) fn lose_unpublished(&self) {
        let unpublished = self.unpublished.swap(0, Ordering::Relaxed);
        self.applied.fetch_sub(unpublished, Ordering::Relaxed);
        self.lane.lose(unpublished + self.taken.swap(0, Ordering::Relaxed));
    }
}

/// A declared guest, recorded for a Model that takes over from an unreachable one.
#[derive(Clone)]
pub(crate) struct GuestDeclaration {
    pub(crate) name: String,
    pub(crate) id: WriterId,
    pub(crate) access: Access,
}

/// State shared by all handles of the operator.
pub(crate) struct OperatorState {
    pub(crate) allocator: EntityAllocator,
    /// Number of its next batch.
    pub(crate) tick: AtomicU64,
    /// How many handles there are.
    pub(crate) handles: AtomicU32,
}

impl OperatorState {
    pub(crate) fn new(allocator: EntityAllocator) -> Self {
        Self { allocator, tick: AtomicU64::new(0), handles: AtomicU32::new(0) }
    }
}

/// Message that declares a writer to the Model.
pub(crate) struct DeclareWriter {
    pub(crate) name: String,
    pub(crate) id: WriterId,
    pub(crate) access: Access,
    pub(crate) reply: oneshot::Sender<Result<(), String>>,
}

/// Message to the supervisor's thread.
pub(crate) enum Report {
    /// Something happened to a child.
    Event(Event),
    /// A fault injected outside of the plan.
    Inject(FaultOrder),
    /// Pause or resume a child.
    Hold(ChildId, bool),
    /// The operating system's answer to a thread's request for priority.
    Permission(Permission),
}

pub(crate) struct Shared {
    pub(crate) clock: Clock,
    /// Session time at the start.
    pub(crate) begin: SimTime,
    pub(crate) seed: u64,
    pub(crate) station: u16,
    pub(crate) published: Arc<ArcSwap<Snapshot>>,
    pub(crate) intake: Arc<Intake>,
    pub(crate) bell: Arc<tokio::sync::Notify>,
    pub(crate) model: ChildState,
    /// Ordered by writer id.
    pub(crate) writers: Vec<Arc<Writer>>,
    pub(crate) reports: SyncSender<Report>,
    pub(crate) declares: Mutex<Vec<DeclareWriter>>,
    pub(crate) guests: Mutex<Vec<GuestDeclaration>>,
    pub(crate) declares_waiting: Signal,
    /// A fence was raised that the Model has not handled yet.
    pub(crate) fences_waiting: Signal,
    pub(crate) sink: Mutex<Option<Box<dyn CommitSink>>>,
    pub(crate) has_sink: bool,
    /// State hash of the published scene, for a Model that takes over from an unreachable one.
    pub(crate) published_hash: Mutex<Option<(Revision, StateHash)>>,
    /// Final state hash, set when the Model ends.
    pub(crate) final_hash: Mutex<Option<StateHash>>,
    pub(crate) batches: AtomicU64,
    pub(crate) operator: OperatorState,
    /// The session has ended: injected stalls return.
    pub(crate) over: AtomicBool,
    /// The session is paused: no controller ticks.
    pub(crate) resting: AtomicBool,
}

/// Ignores poisoning: these locks guard single values, which a panic leaves consistent.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Shared {
    pub(crate) fn state_of(&self, child: ChildId) -> Option<&ChildState> {
        if child == self.model.child {
            return Some(&self.model);
        }
        self.writers.iter().map(|writer| &writer.state).find(|state| state.child == child)
    }
    pub(crate) fn writer_of(&self, child: ChildId) -> Option<&Arc<Writer>> {
        self.writers.iter().find(|writer| writer.state.child == child)
    }
    pub(crate) fn writer_index(&self, id: WriterId) -> Option<usize> {
        self.writers.binary_search_by_key(&id, |writer| writer.id).ok()
    }
    /// All states: the Model's, then the writers'.
    pub(crate) fn child_states(&self) -> impl Iterator<Item = &ChildState> {
        std::iter::once(&self.model).chain(self.writers.iter().map(|writer| &writer.state))
    }

    /// Makes the devices and the Model refuse output of `child` below `epoch`. Devices first, because users hold them.
    /// Neither blocks nor allocates.
    pub(crate) fn fence(&self, child: ChildId, epoch: u32) {
        let Some(writer) = self.writer_of(child) else { return };
        for fence in &writer.spec.fences {
            // A fence that panics must not keep the others from being raised.
            let _ = guarded(|| fence.raise(epoch));
        }
        writer.epoch.fetch_max(epoch, Ordering::AcqRel);
        self.fences_waiting.raise();
        self.bell.notify_one();
    }

    /// Sends an event to the supervisor. The queue is long, and its thread always reads it.
    pub(crate) fn report(&self, event: Event) {
        let _ = self.reports.send(Report::Event(event));
    }
    pub(crate) fn died(&self, state: &ChildState, life: &Life, cause: Cause) {
        self.report(Event::Died { child: state.child, incarnation: life.incarnation, cause });
    }

    /// Counts all batches still waiting as lost, because the session is over.
    pub(crate) fn lose_rest(&self) {
        let mut lanes = self.intake.take();
        lanes.begin_pass();
        while let Some(Arrival { batch, .. }) = lanes.pop(SimTime(u64::MAX)) {
            if let Some(index) = self.writer_index(batch.provenance.writer) {
                self.writers[index].lane.lose(1);
            }
        }
    }

    /// Opens a new ring for this life of the writer.
    pub(crate) fn open(&self, writer: &Writer, life: &Life) -> WriterHandle {
        self.intake.open(
            writer.id,
            life.incarnation,
            (writer.spec.ring_capacity, writer.spec.flow),
            writer.allocator.clone(),
            writer.lane.clone(),
        )
    }

    /// Declares a writer to the Model; the answer arrives when the Model accepts it.
    pub(crate) fn request_declaration(
        &self,
        name: &str,
        id: WriterId,
        access: &Access,
    ) -> oneshot::Receiver<Result<(), String>> {
        let (reply, answer) = oneshot::channel();
        lock(&self.declares).push(DeclareWriter { name: name.to_owned(), id, access: access.clone(), reply });
        self.declares_waiting.raise();
        self.bell.notify_one();
        answer
    }

    /// Declares a writer to the Model and waits for its answer; returns at once if the declaration is unchanged.
    pub(crate) async fn declare(&self, writer: &Writer, access: &Access) -> Result<(), String> {
        if lock(&writer.declared).as_ref() == Some(access) {
            return Ok(());
        }
        let answer = self.request_declaration(&writer.state.name, writer.id, access);
        let limit = writer.spec.child.start_limit.to_duration();
        match tokio::time::timeout(limit, answer).await {
            Ok(Ok(answer)) => answer,
            Ok(Err(_)) | Err(_) => Err("the Model did not answer".to_owned()),
        }
    }
}
