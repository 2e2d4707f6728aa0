//! Child specifications and supervisor groups as data, after Erlang/OTP's `supervisor` behaviour
//! (Armstrong, "Making reliable distributed systems in the presence of software errors", 2003, ch. 5).

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

/// Restart policy of a child.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Restart {
    /// Always, whatever the reason.
    Permanent,
    /// Only after a panic, an error or a stall.
    Transient,
    /// Never, not even when a sibling's end stopped it.
    Temporary,
}

/// Which children of a group are restarted when one of them ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Strategy {
    /// Only the child that ended.
    OneForOne,
    /// That child and those started after it.
    RestForOne,
    /// All of them.
    OneForAll,
}

/// Policy of a group when a child needs more restarts than the intensity allows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Exhausted {
    /// The group gives up, and its parent decides, as in OTP.
    #[default]
    Escalate,
    /// The child is held: fenced and not restarted until requested. The others continue.
    Hold,
}

/// Kind of work of a child's thread, which determines its scheduling priority and its place in the default tree.
///
/// In order of priority: a class is never delayed by a later one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RuntimeClass {
    /// A device driver's thread, which enforces the force limits.
    Driver,
    /// The thread that detects stalls.
    Watchdog,
    /// The Model: short, bounded work on which all others depend.
    Model,
    /// Force rendering.
    Haptics,
    /// Collision detection.
    Collision,
    /// Physics.
    Simulation,
    /// Exercises and virtual trainees.
    Task,
    /// Links to other stations.
    Network,
    /// Recorders and viewers.
    Recorder,
}

/// At most `restarts` restarts within `period`; one more and the group gives up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Intensity {
    /// How many restarts are tolerated.
    pub restarts: u32,
    /// The sliding window.
    pub period: SimTime,
}

/// Pause before a restart: none before the first, then `base`, growing by `factor` up to `max`, each
/// spread by ± `jitter`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Backoff {
    /// Pause before the second restart in a row.
    pub base: SimTime,
    /// Growth from one restart in a row to the next, ≥ 1.
    pub factor: f64,
    /// Longest pause before jitter.
    pub max: SimTime,
    /// Relative spread, 0 to 1.
    pub jitter: f64,
    /// After this uptime a child's next restart has no pause again.
    pub reset_after: SimTime,
}

/// Specification of one child for the supervisor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChildSpec {
    /// Name, unique in the tree (`haptics.left`).
    pub id: String,
    /// When it is started again.
    pub restart: Restart,
    /// Longest time without a heartbeat while it runs; longer is a stall.
    pub heartbeat_limit: SimTime,
    /// The same limit for the first step of each life, in which it builds data from the whole scene: meshes, factors,
    /// trees. Never less than `heartbeat_limit`.
    pub first_step_limit: SimTime,
    /// Longest time from the start order to the end of construction.
    pub start_limit: SimTime,
    /// Longest time from the stop order to its end; a slower child is abandoned.
    pub shutdown_limit: SimTime,
    /// Ticks per second; 0 for children driven by messages only.
    pub rate_hz: f64,
    /// What its thread does.
    pub class: RuntimeClass,
}

impl ChildSpec {
    /// The defaults of a controller of `class` that ticks at `rate_hz`: permanent, a stall after 50 ms but no less than
    /// twenty periods, 5 s to start, 200 ms to stop. Drivers, haptics, the Model and the watchdog get no longer for
    /// their first step; the other classes, on which no force depends, get 5 s.
    pub fn new(id: impl Into<String>, class: RuntimeClass, rate_hz: f64) -> Self {
        let twenty_periods =
            if rate_hz > 0.0 { SimTime::from_secs_f64(20.0 / rate_hz) } else { SimTime::ZERO };
        let heartbeat_limit = twenty_periods.max(SimTime::from_millis(50));
        let start_limit = SimTime::from_millis(5_000);
        Self {
            id: id.into(),
            restart: if class == RuntimeClass::Recorder { Restart::Transient } else { Restart::Permanent },
            heartbeat_limit,
            first_step_limit: if class.takes_in_the_scene() {
                heartbeat_limit.max(start_limit)
            } else {
                heartbeat_limit
            },
            start_limit,
            shutdown_limit: SimTime::from_millis(200),
            rate_hz,
            class,
        }
    }
    /// The same with another restart policy.
    pub fn with_restart(mut self, restart: Restart) -> Self {
        self.restart = restart;
        self
    }
    /// The same with another heartbeat limit, and no shorter a first step.
    pub fn with_heartbeat_limit(mut self, limit: SimTime) -> Self {
        self.heartbeat_limit = limit;
        self.first_step_limit = self.first_step_limit.max(limit);
        self
    }
    /// Heartbeat limit of a life, depending on whether its first step is done.
    pub fn silence_limit(&self, settled: bool) -> SimTime {
        if settled { self.heartbeat_limit } else { self.first_step_limit.max(self.heartbeat_limit) }
    }
}

impl RuntimeClass {
    /// Whether children of this class build data from the whole scene in their first step, while no other thread waits
    /// for them.
    const fn takes_in_the_scene(self) -> bool {
        matches!(self, Self::Collision | Self::Simulation | Self::Task | Self::Recorder)
    }
}

/// A child or a group of children.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Node {
    /// A leaf: something that runs.
    Child(ChildSpec),
    /// A supervisor with children of its own.
    Group(GroupSpec),
}

/// A supervisor: its children in the order in which they start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroupSpec {
    /// Name, unique in the tree.
    pub id: String,
    /// Which siblings are restarted together.
    pub strategy: Strategy,
    /// Restarts tolerated before the group gives up and its parent decides.
    pub intensity: Intensity,
    /// Pauses between restarts.
    pub backoff: Backoff,
    /// Policy when the intensity is exceeded.
    pub exhausted: Exhausted,
    /// Children, in start order.
    pub children: Vec<Node>,
}

impl Strategy {
    /// Display name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::OneForOne => "one for one",
            Self::RestForOne => "rest for one",
            Self::OneForAll => "one for all",
        }
    }
}

impl Default for Intensity {
    fn default() -> Self {
        Self { restarts: 5, period: SimTime::from_millis(10_000) }
    }
}

/// 10 ms, doubling up to 1 s, ± 20 %.
///
/// Five of the longest pauses (6 s) fit into the default intensity's 10 s, so that a child that always fails at once
/// exceeds it even with the longest pauses.
impl Default for Backoff {
    fn default() -> Self {
        Self {
            base: SimTime::from_millis(10),
            factor: 2.0,
            max: SimTime::from_millis(1_000),
            jitter: 0.2,
            reset_after: SimTime::from_millis(5_000),
        }
    }
}

impl GroupSpec {
    /// A group with the default intensity (5 in 10 s) and back-off.
    pub fn new(id: impl Into<String>, strategy: Strategy) -> Self {
        Self {
            id: id.into(),
            strategy,
            intensity: Intensity::default(),
            backoff: Backoff::default(),
            exhausted: Exhausted::default(),
            children: Vec::new(),
        }
    }
    /// Adds a child at the end.
    pub fn child(mut self, spec: ChildSpec) -> Self {
        self.children.push(Node::Child(spec));
        self
    }
    /// Adds a group at the end.
    pub fn group(mut self, spec: Self) -> Self {
        self.children.push(Node::Group(spec));
        self
    }
    /// The same with another intensity.
    pub fn with_intensity(mut self, restarts: u32, period: SimTime) -> Self {
        self.intensity = Intensity { restarts, period };
        self
    }
    /// The same with another back-off.
    pub fn with_backoff(mut self, backoff: Backoff) -> Self {
        self.backoff = backoff;
        self
    }
    /// The same, but a child that fails too often is held instead of taking the group down.
    pub fn holding(mut self) -> Self {
        self.exhausted = Exhausted::Hold;
        self
    }
    /// All nodes below in start order, depth first, each with its depth; children of this group have depth 1.
    pub fn walk(&self) -> Vec<(usize, &Node)> {
        fn descend<'a>(group: &'a GroupSpec, depth: usize, found: &mut Vec<(usize, &'a Node)>) {
            for node in &group.children {
                found.push((depth, node));
                if let Node::Group(group) = node {
                    descend(group, depth + 1, found);
                }
            }
        }
        let mut found = Vec::new();
        descend(self, 1, &mut found);
        found
    }
    /// Whether the group has no child at any depth.
    pub fn is_empty(&self) -> bool {
        self.children.iter().all(|node| match node {
            Node::Child(_) => false,
            Node::Group(group) => group.is_empty(),
        })
    }

    /// The default tree: root (rest-for-one) → model; simulation (rest-for-one: collision before physics);
    /// devices (one-for-one); tasks (one-for-one); network and recorder (one-for-one, patient back-off).
    ///
    /// A child that always fails at once is held within 8 s (a link or the recorder: within 40 s): each period is long
    /// enough for a round of the longest pauses. The Model's group gives up instead, and after six times of that the
    /// root does, within 60 s. A child that fails once a minute is restarted for ever.
    ///
    /// The Model has a group of its own: it resumes from the last published snapshot, which its clients already have,
    /// so they restart with it only if it keeps failing. Without a Model there is no session; any other child that
    /// fails too often is held, and the rest continues.
    pub fn default_tree(children: impl IntoIterator<Item = ChildSpec>) -> Self {
        let mut model = Self::new("group.model", Strategy::OneForOne);
        let mut simulation = Self::new("group.simulation", Strategy::RestForOne).holding();
        let mut devices = Self::new("group.devices", Strategy::OneForOne).holding();
        let mut tasks = Self::new("group.tasks", Strategy::OneForOne).holding();
        // A link or a disk may hang for long: five of the longest pauses are 30 s.
        let patient = |name: &str| {
            Self::new(name, Strategy::OneForOne)
                .holding()
                .with_intensity(5, SimTime::from_millis(60_000))
                .with_backoff(Backoff {
                    base: SimTime::from_millis(200),
                    max: SimTime::from_millis(5_000),
                    reset_after: SimTime::from_millis(30_000),
                    ..Backoff::default()
                })
        };
        let mut network = patient("group.network");
        let mut recorder = patient("group.recorder");
        let mut all: Vec<ChildSpec> = children.into_iter().collect();
        // Stable: children of one class keep the order in which they were given.
        all.sort_by_key(|child| child.class);
        for child in all {
            let group = match child.class {
                RuntimeClass::Model => &mut model,
                RuntimeClass::Collision | RuntimeClass::Simulation => &mut simulation,
                RuntimeClass::Driver | RuntimeClass::Watchdog | RuntimeClass::Haptics => &mut devices,
                RuntimeClass::Task => &mut tasks,
                RuntimeClass::Network => &mut network,
                RuntimeClass::Recorder => &mut recorder,
            };
            group.children.push(Node::Child(child));
        }
        // Between two times that the Model's group gives up lie six of the longest pauses, 7.2 s.
        let mut root =
            Self::new("root", Strategy::RestForOne).with_intensity(5, SimTime::from_millis(60_000));
        for group in [model, simulation, devices, tasks, network, recorder] {
            if !group.is_empty() {
                root.children.push(Node::Group(group));
            }
        }
        root
    }
}
