//! Session specification, as data for both drivers: live (actix) and lock-step.

use std::any::Any;
use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use trocar_scene::{BuildContext, Controller, ControllerError, Registry, SimTime, Snapshot, Store};

use crate::commit::CommitBuffer;
use crate::faults::{FaultPlan, FaultRow};
use crate::runtime::{ControllerReport, Permission};
use crate::state_hash::StateHash;
use crate::supervision::{ChildSpec, GroupSpec, Incident, RuntimeClass};
use crate::token_bucket::FlowLimit;

/// Builds a controller from the scene as it is now; called again for every restart.
pub type Factory = Arc<dyn Fn(&BuildContext) -> Result<Box<dyn Controller>, ControllerError> + Send + Sync>;

/// A consumer outside the scene that must refuse a writer's output from older epochs, such as a device driver that
/// takes its forces. It is notified first when that writer dies or stalls.
///
/// Called from the watchdog's thread: it must neither wait nor allocate.
pub trait Fence: Send + Sync {
    /// Refuses all output with an epoch below `epoch` from now on.
    fn raise(&self, epoch: u32);
}

/// A controller of the session.
#[derive(Clone)]
pub struct ControllerSpec {
    /// Name of the writer, unique in the session; the same as `child.id`.
    pub name: String,
    /// Spawner part of the entities that it allocates, unique in the session; 0 belongs to the scenario.
    pub writer: u16,
    /// Ticks per second, > 0.
    pub rate_hz: f64,
    /// Session time of tick 0; tick `n` is due `n` periods later. Staggers controllers of one rate.
    pub phase: SimTime,
    /// Builds it.
    pub factory: Factory,
    /// How it is supervised.
    pub child: ChildSpec,
    /// Fences raised first when it dies or stalls.
    pub fences: Vec<Arc<dyn Fence>>,
    /// How many batches its ring holds.
    pub ring_capacity: usize,
    /// Flow limit; commands above it are refused at its own handle.
    pub flow: FlowLimit,
}

impl ControllerSpec {
    /// A controller with the default supervision of its class and the default flow limit, no phase, no fence and a
    /// ring of 64.
    pub fn new(
        name: impl Into<String>,
        writer: u16,
        class: RuntimeClass,
        rate_hz: f64,
        factory: impl Fn(&BuildContext) -> Result<Box<dyn Controller>, ControllerError> + Send + Sync + 'static,
    ) -> Self {
        let name = name.into();
        Self {
            child: ChildSpec::new(name.clone(), class, rate_hz),
            name,
            writer,
            rate_hz,
            phase: SimTime::ZERO,
            factory: Arc::new(factory),
            fences: Vec::new(),
            ring_capacity: 64,
            flow: FlowLimit::default(),
        }
    }
    /// Time from one tick to the next, rounded to the nanosecond.
    pub fn period(&self) -> SimTime {
        period_of(self.rate_hz)
    }
}

/// Time from one tick to the next at `rate_hz`, rounded to the nanosecond and at least 1 ns.
pub fn period_of(rate_hz: f64) -> SimTime {
    SimTime::from_secs_f64(1.0 / rate_hz).max(SimTime(1))
}

/// A participant outside the scene that lock-step steps in virtual time, such as a device driver with its virtual hand.
/// In live mode it runs on its own thread, unseen by the kernel.
///
/// Code that branches a session downcasts [`LockstepSession::peers`] to find its own peers and to copy them.
///
/// [`LockstepSession::peers`]: crate::LockstepSession::peers
pub trait Peer: Any + Send {
    /// Name for messages and fault targets.
    fn name(&self) -> &str;
    /// Time between two steps, ns, > 0.
    fn period_ns(&self) -> u64;
    /// One step at `now`.
    fn step(&mut self, now: SimTime);
    /// Called at the end of the session, after [`Self::step`] has seen the order for zero forces.
    fn finish(&mut self, _now: SimTime) {}
}

/// Takes the faults meant for one target that is not a controller: a device, a link, a disk.
pub trait FaultSink: Send + Sync {
    /// A fault begins or ends.
    fn fault(&self, order: &FaultOrder);
    /// Whether the target reports that it works: a change to false detects a fault, a change back to true means that it
    /// resumed. `None`: it cannot tell.
    fn is_sound(&self) -> Option<bool> {
        None
    }
    /// The same of one of the targets of a sink that has [many](takes).
    fn is_target_sound(&self, _target: &str) -> Option<bool> {
        self.is_sound()
    }
}

/// Whether the sink of this name takes the faults of a target: its own, and one whose name ends with a star those of all
/// targets that begin as it does, such as the links to stations that come later.
pub fn takes(sink: &str, target: &str) -> bool {
    sink == target || sink.strip_suffix('*').is_some_and(|begin| target.starts_with(begin))
}

/// Stop condition of a session.
#[derive(Clone)]
pub struct StopWhen {
    /// Interval between checks.
    pub every: SimTime,
    /// `true` ends the session.
    pub check: Arc<dyn Fn(&Snapshot) -> bool + Send + Sync>,
}

/// Called first at every end of a session: sets a device's force to zero.
pub type ZeroForces = Arc<dyn Fn() + Send + Sync>;

/// Receives the Model's commits, for a recorder.
///
/// Called on the Model's thread right after each publication: it must not block, and leaves slow work to another
/// thread. Commits that it cannot take are counted and declared as a gap.
pub trait CommitSink: Send {
    /// Takes the commits up to `snapshot` and returns an empty buffer for the next ones.
    fn committed(&mut self, snapshot: &Arc<Snapshot>, commits: CommitBuffer) -> CommitBuffer;
    /// Flushes and closes the recording, when the last controller and the Model have ended; gives up after `limit`.
    /// `true` when the recording is complete.
    fn close(&mut self, limit: Duration) -> bool;
}

/// Latest [`SessionSpec::begin`]: 2^53 ns, which is 104 days. Up to there an `f64` holds every nanosecond, and so do due
/// times that are computed from rates.
pub const BEGIN_MAX: SimTime = SimTime(1 << 53);

/// A session: the initial scene and all participants.
pub struct SessionSpec {
    /// Name of the scenario.
    pub scenario: String,
    /// This station's number, part of every entity allocated here.
    pub station: u16,
    /// Seed of all randomness: jitter, faults, tremor.
    pub seed: u64,
    /// The known components.
    pub registry: Arc<Registry>,
    /// The scene at the start.
    pub scene: Store,
    /// Session time at the start, at most [`BEGIN_MAX`]. A station that joins a host begins at the host's session time,
    /// so that time stamps in the scene mean the same at both.
    ///
    /// It moves no grid: controllers, peers, publications and stop checks of lock-step are due at the same session times
    /// as in a session that began at zero, from the first one at or after `begin`, and ticks have the same numbers. The
    /// times of a fault plan, of replayed hands and of [`Self::until`] are session times too.
    pub begin: SimTime,
    /// The controllers.
    pub controllers: Vec<ControllerSpec>,
    /// Peers that lock-step steps; ignored in live mode.
    pub peers: Vec<Box<dyn Peer>>,
    /// Fault targets beside the controllers and the Model.
    pub fault_sinks: Vec<(String, Arc<dyn FaultSink>)>,
    /// The faults to inject, at session times. As in a branch, a fault that is over before [`Self::begin`] is never
    /// injected, because there was nothing that it could strike; one that still lasts then is injected at `begin`.
    pub faults: FaultPlan,
    /// Takes the commits; [`Recorder::install`](crate::recorder::Recorder::install) sets it.
    pub commit_sink: Option<Box<dyn CommitSink>>,
    /// Supervisor tree; [`GroupSpec::default_tree`] of the children when absent.
    pub tree: Option<GroupSpec>,
    /// Most abandoned threads before the session gives up.
    pub zombies_max: u32,
    /// Called first at every end.
    pub zero_forces: Vec<ZeroForces>,
    /// Session time of the end; none: until stopped. One that is not after [`Self::begin`] ends the session at once.
    pub until: Option<SimTime>,
    /// HandleParts the session when the goal is reached.
    pub stop_when: Option<StopWhen>,
}

impl SessionSpec {
    /// A session of these controllers on this scene, without devices, faults, recorder or end.
    pub fn new(
        scenario: impl Into<String>,
        seed: u64,
        scene: Store,
        controllers: Vec<ControllerSpec>,
    ) -> Self {
        Self {
            scenario: scenario.into(),
            station: 0,
            seed,
            registry: scene.view().registry().clone(),
            scene,
            begin: SimTime::ZERO,
            controllers,
            peers: Vec::new(),
            fault_sinks: Vec::new(),
            faults: FaultPlan::new(seed),
            commit_sink: None,
            tree: None,
            zombies_max: 4,
            zero_forces: Vec::new(),
            until: None,
            stop_when: None,
        }
    }

    /// The children of the supervisor tree: the Model first, then the controllers.
    pub fn children(&self) -> Vec<ChildSpec> {
        let model = ChildSpec::new(MODEL, RuntimeClass::Model, 0.0);
        std::iter::once(model).chain(self.controllers.iter().map(|spec| spec.child.clone())).collect()
    }
}

/// How a session was run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// In real time, one thread per controller.
    Live,
    /// In virtual time, on one thread, the same bits every time.
    Lockstep,
    /// From a recording.
    Replay,
}

/// Result of a session.
#[derive(Clone)]
pub struct SessionOutcome {
    /// The mode in which it ran.
    pub mode: Mode,
    /// 0, or 70 when the supervisor gave up.
    pub code: i32,
    /// Why it gave up, if it did.
    pub reason: Option<String>,
    /// Session time at the start.
    pub begin: SimTime,
    /// Session time at the end.
    pub sim: SimTime,
    /// Wall-clock duration.
    pub wall: SimTime,
    /// Chain over all commits.
    pub hash: StateHash,
    /// The scene at the end.
    pub snapshot: Arc<Snapshot>,
    /// One row per controller, in the order of the session.
    pub controllers: Vec<ControllerReport>,
    /// The Model's own row: it has no rate; in live mode, its ticks are its wake-ups.
    pub model: ControllerReport,
    /// One row per fault of the plan.
    pub faults: Vec<FaultRow>,
    /// What failed, in order.
    pub incidents: Vec<Incident>,
    /// Children held for failing too often, with the reason.
    pub held: Vec<(String, String)>,
    /// Controllers of which the Model refused every batch, with the number of batches and the first reason.
    pub refused: Vec<(String, String)>,
    /// Threads that had to be abandoned and never ended.
    pub zombies: u32,
    /// Whether the recording has everything; `None` without a recorder.
    pub recording_complete: Option<bool>,
    /// What the operating system refused.
    pub permission: Permission,
}

/// Name of the Model in the supervisor tree and in fault files.
pub const MODEL: &str = "model";

/// Name of the recorder in the supervisor tree and in fault files.
pub const RECORDER: &str = "recorder";

/// Name of the wall clock in fault files, where a session asks one.
pub const CLOCK: &str = "clock";

/// Name of all links of a session at once, of a station's one link, and of a host's links to its stations, in fault files.
pub const LINKS: &str = "links";
/// See [`LINKS`].
pub const LINK: &str = "link";
/// See [`LINKS`].
pub const LINK_OF_STATION: &str = "link.*";

/// Name of the programs of a session's stations in fault files, where whoever runs the session runs them, too.
pub const STATION_PROGRAM: &str = "station.*";

/// Name of a session's windows in fault files, if it has windows.
pub const VIEWER: &str = "viewer";

/// The kinds of fault that a fault file may hold (design §5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// Panic at the start of the next tick.
    Kill,
    /// One step hangs for the given time.
    Stall,
    /// Every step takes the given time longer.
    Slow,
    /// The device is pulled out.
    Unplug,
    /// Messages are lost.
    Drop,
    /// Messages arrive later.
    Delay,
    /// Messages arrive twice.
    Duplicate,
    /// Messages overtake each other.
    Reorder,
    /// Bits of messages flip.
    Corrupt,
    /// No message passes.
    Partition,
    /// So many bytes per second pass; the others wait in a queue.
    RateLimit,
    /// The handle's ring takes no batch.
    QueueFull,
    /// Numbers in the batches become NaN.
    Nan,
    /// Nothing can be written to the disk.
    DiskFull,
    /// The disk's write rate is limited.
    DiskSlow,
    /// The wall clock is stepped ahead.
    ClockAhead,
    /// The wall clock is stepped back.
    ClockBack,
}

impl FaultKind {
    /// All of them, in the order of the design.
    pub const ALL: [Self; 17] = [
        Self::Kill,
        Self::Stall,
        Self::Slow,
        Self::Unplug,
        Self::Drop,
        Self::Delay,
        Self::Duplicate,
        Self::Reorder,
        Self::Corrupt,
        Self::Partition,
        Self::RateLimit,
        Self::QueueFull,
        Self::Nan,
        Self::DiskFull,
        Self::DiskSlow,
        Self::ClockAhead,
        Self::ClockBack,
    ];
    /// Its name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kill => "kill",
            Self::Stall => "stall",
            Self::Slow => "slow",
            Self::Unplug => "unplug",
            Self::Drop => "drop",
            Self::Delay => "delay",
            Self::Duplicate => "duplicate",
            Self::Reorder => "reorder",
            Self::Corrupt => "corrupt",
            Self::Partition => "partition",
            Self::RateLimit => "rate_limit",
            Self::QueueFull => "queue_full",
            Self::Nan => "nan",
            Self::DiskFull => "disk_full",
            Self::DiskSlow => "disk_slow",
            Self::ClockAhead => "clock_ahead",
            Self::ClockBack => "clock_back",
        }
    }
    /// Whether it affects messages in flight.
    pub const fn is_of_link(self) -> bool {
        use FaultKind as K;
        matches!(
            self,
            K::Drop | K::Delay | K::Duplicate | K::Reorder | K::Corrupt | K::Partition | K::RateLimit
        )
    }
    /// Whether it affects the recorder's disk rather than the recorder.
    pub const fn is_of_disk(self) -> bool {
        matches!(self, Self::DiskFull | Self::DiskSlow)
    }
    /// Whether it steps the wall clock, which goes on at once.
    pub const fn is_of_clock(self) -> bool {
        matches!(self, Self::ClockAhead | Self::ClockBack)
    }
    /// Whether it strikes once, without an end of its own.
    pub const fn is_instant(self) -> bool {
        matches!(self, Self::Kill | Self::Stall | Self::ClockAhead | Self::ClockBack)
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// An order of the fault plan to begin or end one fault.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultOrder {
    /// Position of the fault in its plan.
    pub index: u32,
    /// Target: a controller, [`MODEL`], or a fault sink.
    pub target: String,
    /// What happens.
    pub kind: FaultKind,
    /// `true` when it begins (or strikes once), `false` when it heals.
    pub begins: bool,
    /// Length of a stall, extra time per step of `slow`, step of a clock, extra latency of `delay`, longest wait in the queue of
    /// `rate_limit`; ignored by the others.
    pub span: SimTime,
    /// Variation of the extra latency of `delay`, ±.
    pub jitter: SimTime,
    /// Whether the messages of `delay` overtake each other when a later one has the shorter delay.
    pub independent: bool,
    /// Extra latencies of `delay`, one after the other, each for [`Self::every`], over and over again.
    pub delays: Vec<SimTime>,
    /// How long each of the delays holds.
    pub every: SimTime,
    /// Mean number of messages in a row that `drop` loses; 0: each by itself.
    pub burst: f64,
    /// Probability per message or batch, 0 to 1, for the kinds that affect a share of them.
    pub probability: f64,
    /// Write rate of a slow disk, rate of a limited link [bytes/s]; ignored by the others.
    pub bytes_per_sec: f64,
    /// Seed of this fault's own randomness.
    pub seed: u64,
}

/// Outcome of one fault: a row of the report. Times are session seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultRecord {
    /// Its id in the plan.
    pub id: String,
    /// Its target.
    pub target: String,
    /// Its kind.
    pub kind: FaultKind,
    /// Time of injection.
    pub injected_secs: Option<f64>,
    /// When it ended by itself.
    pub healed_secs: Option<f64>,
    /// Time at which the supervisor or the Model detected it.
    pub detected_secs: Option<f64>,
    /// When the replacement was built.
    pub restarted_secs: Option<f64>,
    /// When the replacement's first tick was done.
    pub resumed_secs: Option<f64>,
}
