//! The live driver: real time, one thread per controller, actix underneath.
//!
//! [`LiveSession::start`] takes the same [`SessionSpec`] as lock-step. No thread blocks another: a controller reads the
//! latest snapshot, pushes its batch into its ring and continues; the Model drains the rings and publishes; a watchdog
//! detects hanging threads; the supervisor replaces failed ones.

mod actors;
mod guest;
mod host;
mod model;
mod operator;
mod pause;
mod shared;
mod supervise;
mod watchdog;

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use actix::prelude::{Actor, Context, System};
use arc_swap::ArcSwap;
use thiserror::Error;
use tokio::sync::Notify;
use trocar_scene::{Access, ComponentError, EntityAllocator, SimTime, Snapshot, Store, WriterId};

use crate::admission::all_refused;
use crate::faults::{FaultLog, FaultPlanError, FaultRow, FaultSchedule, TargetClass, Targets};
use crate::handle::LaneStatus;
use crate::intake::Intake;
use crate::model_core::ModelCore;
use crate::operator::{OPERATOR, OperatorError};
use crate::runtime::{Clock, ControllerReport, Permission, TickStats};
use crate::signal::Signal;
use crate::spec::{BEGIN_MAX, ControllerSpec, FaultOrder, MODEL, Mode, SessionOutcome, SessionSpec};
use crate::state_hash::StateHash;
use crate::supervision::{
    ChildId, ChildSpec, EXIT_GAVE_UP, Event, GroupSpec, Health, Incident, Supervisor, TreeError,
};
use guest::GuestIdentity;
use shared::{ChildState, FaultHooks, Life, OperatorState, Report, Shared, Writer, lock};
use supervise::{StatusBoard, SupervisorThread};

pub use actors::HostedActor;
pub use guest::Guest;
pub use operator::{OPERATORS_MAX, Operator};

/// Longest wait for a session to end; after it this thread sets the forces to zero and abandons the session.
pub const STOP_MAX: Duration = Duration::from_millis(1_900);
/// Batches of an actor that may wait for the Model.
const ACTOR_CAPACITY: usize = 64;
/// Reports that wait for the supervisor.
const REPORTS_MAX: usize = 4_096;
/// Messages that wait to be printed.
const MESSAGES_MAX: usize = 256;

/// Why a session did not start.
#[derive(Debug, Error)]
pub enum LiveError {
    /// Two controllers with one name or number, or an invalid rate.
    #[error("controller '{name}': {reason}")]
    Controller {
        /// Which one.
        name: String,
        /// What is wrong.
        reason: String,
    },
    /// An invalid tree, or one whose children are not those of the session.
    #[error(transparent)]
    Tree(#[from] TreeError),
    /// A fault plan that does not fit the session.
    #[error(transparent)]
    Faults(#[from] FaultPlanError),
    /// A scene that cannot be encoded.
    #[error("the scene at the start: {0}")]
    Scene(#[from] ComponentError),
    /// The session begins too late.
    #[error("begin: {0}; valid: up to {BEGIN_MAX}")]
    Begin(SimTime),
    /// The operating system gave no thread.
    #[error("no thread for the session: {0}")]
    Thread(#[from] std::io::Error),
    /// A child could not be built.
    #[error("{0}")]
    Start(String),
}

/// A running session. Dropping it stops it.
pub struct LiveSession {
    shared: Arc<Shared>,
    board: Arc<StatusBoard>,
    tree: Arc<GroupSpec>,
    zero_forces: Vec<crate::spec::ZeroForces>,
    /// Indices in the order of the session, which differs from the order of ids.
    order: Vec<usize>,
    begun: Instant,
    stopped: bool,
}

impl LiveSession {
    /// Starts the session, at [`SessionSpec::begin`], and returns when every child runs.
    ///
    /// # Errors
    /// [`LiveError`]; nothing is left running then.
    pub fn start(spec: SessionSpec) -> Result<Self, LiveError> {
        Self::start_at(spec, Instant::now())
    }

    /// Like [`Self::start`], with the session's begin at `origin`, which device drivers share.
    ///
    /// # Errors
    /// [`LiveError`]; nothing is left running then.
    pub fn start_at(spec: SessionSpec, origin: Instant) -> Result<Self, LiveError> {
        let clock = Clock::since(origin).beginning_at(spec.begin);
        Self::start_on(spec, clock)
    }

    /// Like [`Self::start_at`], with the session's clock, which device drivers share and which pauses them as well. It
    /// shows session time, so for a session that begins now it is [`Clock::starting_at`] the session's begin; while it
    /// shows an earlier time, no controller ticks.
    ///
    /// # Errors
    /// [`LiveError`]; nothing is left running then.
    pub fn start_on(spec: SessionSpec, clock: Clock) -> Result<Self, LiveError> {
        let mut session = Self::launch(spec, clock)?;
        let limit = Instant::now() + Duration::from_secs(30);
        loop {
            let status = lock(&session.board.status);
            if status.up {
                break;
            }
            if let Some(ended) = &status.ended {
                let reason = ended.reason.clone().unwrap_or_else(|| "it ended at once".to_owned());
                return Err(LiveError::Start(reason));
            }
            if Instant::now() > limit {
                drop(status);
                session.end(EXIT_GAVE_UP);
                return Err(LiveError::Start("not every child was up within 30 s".to_owned()));
            }
            drop(
                session
                    .board
                    .changed
                    .wait_timeout(status, Duration::from_millis(20))
                    .unwrap_or_else(std::sync::PoisonError::into_inner),
            );
        }
        session.begun = Instant::now();
        Ok(session)
    }

    fn launch(spec: SessionSpec, clock: Clock) -> Result<Self, LiveError> {
        if spec.begin > BEGIN_MAX {
            return Err(LiveError::Begin(spec.begin));
        }
        check_controllers(&spec.controllers)?;
        let children = spec.children();
        let root = spec.tree.clone().unwrap_or_else(|| GroupSpec::default_tree(children.clone()));
        let supervisor = Supervisor::new(root, spec.seed, spec.zombies_max)?;
        let tree = supervisor.tree().clone();
        let mut targets = Targets::new();
        for controller in &spec.controllers {
            targets = targets.with(&controller.name, TargetClass::Controller);
        }
        for (name, _) in &spec.fault_sinks {
            targets = targets.with(name, TargetClass::of_sink(name));
        }
        let mut schedule = FaultSchedule::new(&spec.faults, &targets)?;
        schedule.skip_to(spec.begin);
        let faults = FaultLog::new(&spec.faults);
        let core = ModelCore::new(Store::from_snapshot(spec.scene.view()), spec.station)?;
        let (reports, inbox) = sync_channel(REPORTS_MAX);
        let order: Vec<String> = spec.controllers.iter().map(|controller| controller.name.clone()).collect();
        let shared = share(
            &spec.scene,
            (clock, spec.begin),
            (spec.station, spec.seed),
            spec.controllers,
            spec.commit_sink,
            &supervisor,
            reports,
        )?;
        let order = order
            .iter()
            .filter_map(|name| shared.writers.iter().position(|writer| writer.state.name == *name))
            .collect();
        let system = start_system()?;
        let log = start_log()?;
        let board = Arc::new(StatusBoard::default());
        let crew = SupervisorThread {
            shared: shared.clone(),
            board: board.clone(),
            tree: supervisor,
            inbox,
            log,
            zero_forces: spec.zero_forces.clone(),
            sinks: spec.fault_sinks,
            schedule,
            faults,
            until: spec.until,
            stop_when: spec.stop_when,
            core: Some(core),
            system,
        };
        watchdog::start(shared.clone())?;
        std::thread::Builder::new().name("trocar-superv".into()).spawn(move || crew.run())?;
        Ok(Self {
            shared,
            board,
            tree,
            zero_forces: spec.zero_forces,
            order,
            begun: Instant::now(),
            stopped: false,
        })
    }

    /// The latest snapshot.
    pub fn snapshot(&self) -> Arc<Snapshot> {
        self.shared.published.load_full()
    }
    /// Shared pointer to the latest snapshot, for viewers and other readers on their own threads.
    pub fn snapshots(&self) -> Arc<ArcSwap<Snapshot>> {
        self.shared.published.clone()
    }
    /// Session time at the start.
    pub fn begin(&self) -> SimTime {
        self.shared.begin
    }
    /// Session time.
    pub fn elapsed(&self) -> SimTime {
        match &lock(&self.board.status).ended {
            Some(ended) => ended.at,
            None => self.shared.clock.now(),
        }
    }
    /// One row per controller, in the order of the session, as it is now.
    pub fn stats(&self) -> Vec<ControllerReport> {
        let elapsed = self.elapsed().since(self.begin());
        self.order.iter().map(|index| self.shared.writers[*index].report(elapsed)).collect()
    }
    /// How many ticks each controller has run so far, in the order of the session.
    pub fn ticks(&self) -> impl Iterator<Item = u64> + '_ {
        self.order.iter().map(|index| self.shared.writers[*index].state.stats.ticks())
    }
    /// What every controller has declared to the Model, with its rate \[Hz\], in the order of the session.
    pub fn accesses(&self) -> Vec<(String, f64, Access)> {
        let writers = self.order.iter().map(|index| &self.shared.writers[*index]);
        writers
            .filter_map(|writer| {
                let access = lock(&writer.declared).clone()?;
                Some((writer.state.name.clone(), writer.spec.rate_hz, access))
            })
            .collect()
    }
    /// The Model's row: it has no rate; its ticks are its wake-ups.
    pub fn model_stats(&self) -> ControllerReport {
        self.shared.model.stats.report(self.elapsed().since(self.begin()))
    }
    /// How many batches the Model has taken.
    pub fn batches(&self) -> u64 {
        self.shared.batches.load(Ordering::Relaxed)
    }
    /// CPU time of the Model's thread.
    pub fn model_cpu(&self) -> SimTime {
        self.shared.model.stats.cpu()
    }
    /// The supervisor tree.
    pub fn tree(&self) -> &Arc<GroupSpec> {
        &self.tree
    }
    /// Health of every child, by name.
    pub fn health(&self) -> Vec<(String, Health)> {
        lock(&self.board.status).health.iter().map(|(name, health)| (name.clone(), *health)).collect()
    }
    /// Health of one child.
    pub fn health_of(&self, name: &str) -> Option<Health> {
        lock(&self.board.status).health.get(name).copied()
    }
    /// The failures so far.
    pub fn incidents(&self) -> Vec<Incident> {
        lock(&self.board.status).incidents.clone()
    }
    /// Threads that were abandoned and have not ended.
    pub fn zombies(&self) -> u32 {
        lock(&self.board.status).zombies
    }
    /// What the operating system refused.
    pub fn permission(&self) -> Permission {
        let known = lock(&self.board.status).permission.clone();
        known.unwrap_or(Permission { fifo: false, refused: "not known yet".to_owned() })
    }
    /// Injects a fault now; its plan's report does not count it.
    pub fn inject(&self, order: FaultOrder) {
        let _ = self.shared.reports.try_send(Report::Inject(order));
    }
    /// Pauses or resumes a controller; `false` when there is none of that name.
    pub fn hold(&self, name: &str, held: bool) -> bool {
        let state = self.shared.writers.iter().map(|writer| &writer.state).find(|state| state.name == name);
        state.is_some_and(|state| self.shared.reports.try_send(Report::Hold(state.child, held)).is_ok())
    }
    /// Whether the session has ended.
    pub fn has_ended(&self) -> bool {
        lock(&self.board.status).ended.is_some()
    }
    /// Waits for the end of the session, at most `limit`; returns whether it has ended.
    pub fn wait(&self, limit: Duration) -> bool {
        let until = Instant::now() + limit;
        let mut status = lock(&self.board.status);
        while status.ended.is_none() {
            let left = until.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            status = match self.board.changed.wait_timeout(status, left) {
                Ok((status, _)) => status,
                Err(poisoned) => poisoned.into_inner().0,
            };
        }
        true
    }

    /// Adds a participant that is no controller: a console, a viewer, a measurement. A guest is neither ticked nor
    /// supervised, and has no flow limit but its ring. `capacity` is how many of its batches may wait for the Model.
    ///
    /// # Errors
    /// When the name or number is taken, the access overlaps with others', or the Model does not answer.
    pub fn guest(
        &self,
        name: &str,
        id: WriterId,
        access: &Access,
        capacity: usize,
    ) -> Result<Guest, LiveError> {
        self.identity(name, id, access, capacity).accept()
    }

    /// The same for one that wants to know what the Model says of each of its batches ([`Guest::answer`]), such as somebody
    /// who passes on the commands of others. Each batch is then published by itself.
    ///
    /// # Errors
    /// As [`Self::guest`].
    pub fn guest_with_answers(
        &self,
        name: &str,
        id: WriterId,
        access: &Access,
        capacity: usize,
    ) -> Result<Guest, LiveError> {
        GuestIdentity { is_answered: true, ..self.identity(name, id, access, capacity) }.accept()
    }

    /// Adds a plain actix actor, on its own thread and actix system. `build` makes it from its guest handle, at the
    /// start and after each death; it ends with the session.
    ///
    /// # Errors
    /// As [`Self::guest`], and when the system gives no thread.
    pub fn actor<A>(
        &self,
        name: &str,
        id: WriterId,
        access: &Access,
        build: impl Fn(Guest) -> A + Send + 'static,
    ) -> Result<HostedActor, LiveError>
    where
        A: Actor<Context = Context<A>>,
    {
        HostedActor::start(self.identity(name, id, access, ACTOR_CAPACITY), build)
    }

    fn identity(&self, name: &str, id: WriterId, access: &Access, capacity: usize) -> GuestIdentity {
        let (shared, name, access) = (self.shared.clone(), name.to_owned(), access.clone());
        GuestIdentity { shared, name, id, access, capacity, is_answered: false }
    }

    /// A handle that may write any row of the running session, from any thread: for a researcher's program, a tuning
    /// panel, a console. See [`Operator::apply`].
    ///
    /// # Errors
    /// [`OperatorError::TooMany`] when [`OPERATORS_MAX`] of them exist.
    pub fn operator(&self) -> Result<Operator, OperatorError> {
        Operator::new(self.shared.clone())
    }

    /// HandleParts the session within two seconds, even if threads hang: first forces to zero, then controllers, Model,
    /// recording. `code` is the exit code unless the supervisor has given up before.
    pub fn stop(mut self, code: i32) -> SessionOutcome {
        self.end(code);
        self.shared.lose_rest();
        let status = lock(&self.board.status);
        let ended = status.ended.clone();
        let sim = ended.as_ref().map_or_else(|| self.shared.clock.now(), |ended| ended.at);
        let elapsed = sim.since(self.begin());
        let snapshot = self.snapshot();
        let hash = *lock(&self.shared.final_hash);
        let refused = self.order.iter().filter_map(|index| {
            let writer = &self.shared.writers[*index];
            all_refused(&writer.report(elapsed), writer.state.stats.refusal()?, &snapshot)
        });
        SessionOutcome {
            refused: refused.collect(),
            mode: Mode::Live,
            code: ended.as_ref().map_or(EXIT_GAVE_UP, |ended| ended.code),
            reason: match &ended {
                Some(ended) => ended.reason.clone(),
                None => Some("the supervisor did not end within its limit".to_owned()),
            },
            begin: self.begin(),
            sim,
            wall: SimTime::from(self.begun.elapsed()),
            hash: hash.unwrap_or(StateHash([0; 32])),
            snapshot,
            controllers: self.order.iter().map(|index| self.shared.writers[*index].report(elapsed)).collect(),
            model: self.shared.model.stats.report(elapsed),
            faults: status.faults.clone(),
            incidents: status.incidents.clone(),
            held: status.held.clone(),
            zombies: status.zombies,
            recording_complete: ended.as_ref().and_then(|ended| ended.recording_complete),
            permission: status
                .permission
                .clone()
                .unwrap_or(Permission { fifo: false, refused: "never asked".to_owned() }),
        }
    }

    /// The faults of the plan so far; complete after the end.
    pub fn faults(&self) -> Vec<FaultRow> {
        lock(&self.board.status).faults.clone()
    }

    fn end(&mut self, code: i32) {
        if self.stopped {
            return;
        }
        self.stopped = true;
        // Time limits apply to the end as well.
        self.shared.clock.resume();
        let asked = self.shared.reports.try_send(Report::Event(Event::ShutdownRequested { code })).is_ok();
        let ended = if asked { self.wait(STOP_MAX) } else { self.has_ended() };
        if !ended {
            for zero in &self.zero_forces {
                let _ = crate::runtime::guarded(|| zero());
            }
            self.shared.over.store(true, Ordering::Relaxed);
        }
    }
}

impl Drop for LiveSession {
    fn drop(&mut self) {
        self.end(0);
    }
}

fn check_controllers(controllers: &[ControllerSpec]) -> Result<(), LiveError> {
    let wrong = |name: &str, reason: String| LiveError::Controller { name: name.to_owned(), reason };
    for (i, controller) in controllers.iter().enumerate() {
        let name = &controller.name;
        if !(controller.rate_hz.is_finite() && controller.rate_hz > 0.0) {
            return Err(wrong(name, format!("rate is {} Hz; valid: more than 0", controller.rate_hz)));
        }
        if controller.writer == trocar_scene::SCENARIO_SPAWNER {
            return Err(wrong(name, "writer 0 belongs to the scenario; valid: 1 to 65535".to_owned()));
        }
        if controller.child.id != *name {
            return Err(wrong(name, format!("is supervised under another name, '{}'", controller.child.id)));
        }
        for other in &controllers[..i] {
            if other.name == *name {
                return Err(wrong(name, "there are two of this name".to_owned()));
            }
            if other.writer == controller.writer {
                return Err(wrong(name, format!("is writer {} like '{}'", other.writer, other.name)));
            }
        }
    }
    Ok(())
}

fn share(
    scene: &Store,
    (clock, begin): (Clock, SimTime),
    (station, seed): (u16, u64),
    controllers: Vec<ControllerSpec>,
    commit_sink: Option<Box<dyn crate::spec::CommitSink>>,
    tree: &Supervisor,
    reports: SyncSender<Report>,
) -> Result<Arc<Shared>, LiveError> {
    let state_of_child = |name: &str, child: &ChildSpec| -> Result<ChildState, LiveError> {
        let id: ChildId = tree.find(name).ok_or_else(|| LiveError::Controller {
            name: name.to_owned(),
            reason: "does not stand in the supervisor tree".to_owned(),
        })?;
        let spec = tree.spec(id).unwrap_or(child);
        Ok(ChildState {
            child: id,
            name: name.to_owned(),
            class: spec.class,
            limits: [spec.silence_limit(false), spec.silence_limit(true)],
            ticks: spec.rate_hz > 0.0,
            life: ArcSwap::from(Life::new(0)),
            stats: TickStats::new(name, spec.rate_hz),
            fault_hooks: FaultHooks::default(),
        })
    };
    let model = ChildSpec::new(MODEL, crate::supervision::RuntimeClass::Model, 0.0);
    let model = state_of_child(MODEL, &model)?;
    let mut writers = Vec::with_capacity(controllers.len());
    for spec in controllers {
        let allocator = EntityAllocator::new(station, spec.writer);
        allocator.skip_to(scene.view().first_free(station, spec.writer));
        writers.push(Arc::new(Writer {
            state: state_of_child(&spec.name, &spec.child)?,
            id: WriterId(spec.writer),
            allocator,
            lane: Arc::<LaneStatus>::default(),
            epoch: AtomicU32::new(1),
            applied: AtomicU64::new(0),
            taken: AtomicU64::new(0),
            unpublished: AtomicU64::new(0),
            next_tick: AtomicU64::new(0),
            events_seen: AtomicU64::new(0),
            declared: Mutex::new(None),
            spec,
        }));
    }
    writers.sort_by_key(|writer| writer.id);
    let operator = EntityAllocator::new(station, OPERATOR.0);
    operator.skip_to(scene.view().first_free(station, OPERATOR.0));
    let bell = Arc::new(Notify::new());
    let ring = bell.clone();
    Ok(Arc::new(Shared {
        clock: clock.clone(),
        begin,
        seed,
        station,
        published: Arc::new(ArcSwap::from_pointee(scene.snapshot())),
        intake: Intake::new(scene.view().registry().clone(), clock, Arc::new(move || ring.notify_one())),
        bell,
        model,
        writers,
        reports,
        declares: Mutex::new(Vec::new()),
        guests: Mutex::new(Vec::new()),
        declares_waiting: Signal::default(),
        fences_waiting: Signal::default(),
        has_sink: commit_sink.is_some(),
        sink: Mutex::new(commit_sink),
        published_hash: Mutex::new(None),
        final_hash: Mutex::new(None),
        batches: AtomicU64::new(0),
        operator: OperatorState::new(operator),
        over: AtomicBool::new(false),
        resting: AtomicBool::new(false),
    }))
}

/// Starts the actix system on its own thread: the main thread belongs to the windows.
fn start_system() -> Result<System, LiveError> {
    let (send, receive) = sync_channel(1);
    std::thread::Builder::new().name("trocar-system".into()).spawn(move || {
        let runner = System::new();
        let _ = send.send(System::current());
        if let Err(error) = runner.run() {
            tracing::error!("the actor system ended badly: {error}");
        }
    })?;
    receive.recv().map_err(|_| LiveError::Start("the actor system did not start".to_owned()))
}

/// Starts the log thread, the only one of the session that prints.
fn start_log() -> Result<SyncSender<String>, LiveError> {
    let (send, receive) = sync_channel::<String>(MESSAGES_MAX);
    std::thread::Builder::new().name("trocar-log".into()).spawn(move || {
        for line in receive {
            tracing::error!("{line}");
        }
    })?;
    Ok(send)
}
