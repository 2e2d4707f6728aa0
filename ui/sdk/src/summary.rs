//! The machine-readable output of `run --json` and `bench --json`, with its JSON schema.
//!
//! Every field is always present; unknown values are null. Times in seconds, latencies in microseconds.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
pub use trocar_kernel::bench::{Better, Row as BenchResult};
pub use trocar_kernel::runtime::{ControllerReport as ControllerSummary, Hits, Quantiles};
use trocar_kernel::spec::FaultKind;
use trocar_network::control::ExitClass;
pub use trocar_scene::components::{ScoreKind, TeleoperationFigures};

/// Version of the objects in this file; it rises when a field changes its meaning or is removed.
pub const SCHEMA: u32 = 1;

/// What is told of a run that its own program ended before its time.
pub const BY_THE_PROGRAM: &str = "the program";
/// The same at a station whose host has ended the session.
pub const BY_THE_HOST: &str = "the host";

/// Exit codes of this program.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Exit {
    /// Success.
    Ok = 0,
    /// An expectation failed, or the exercise was not completed (and `--seconds` did not cut it off): also when a person
    /// closed the window before it was over.
    Failed = 1,
    /// The command line is invalid.
    Usage = 2,
    /// A requested device is missing, or the graphics adapter for a picture.
    DeviceMissing = 3,
    /// A scenario or another file is invalid, a result could not be written, or a picture could not be made.
    Invalid = 4,
    /// The host of a session cannot be reached, or is gone; or a port is in use.
    Unavailable = 69,
    /// The program itself failed.
    Internal = 70,
    /// A session is full, a hand is taken, a link is too slow: it may work later.
    Later = 75,
    /// Two programs of a session do not understand each other.
    Protocol = 76,
    /// A ticket does not let in, or a role does not allow it.
    NotAllowed = 77,
    /// SIGHUP ended the command: its terminal was closed.
    HungUp = 129,
    /// SIGINT ended the command: Ctrl-C.
    Interrupted = 130,
    /// SIGTERM ended the command.
    Terminated = 143,
}

impl Exit {
    /// Of what a session over a network came to.
    pub const fn of_network(class: ExitClass) -> Self {
        match class {
            ExitClass::Done => Self::Ok,
            ExitClass::Usage => Self::Usage,
            ExitClass::Scenario => Self::Invalid,
            ExitClass::Unavailable => Self::Unavailable,
            ExitClass::Internal => Self::Internal,
            ExitClass::Later => Self::Later,
            ExitClass::Protocol => Self::Protocol,
            ExitClass::NotAllowed => Self::NotAllowed,
        }
    }

    /// The numeric exit code.
    pub const fn code(self) -> u8 {
        self as u8
    }
}

/// How a run went through time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// Every controller on a thread of its own, in real time.
    #[default]
    Live,
    /// One thread, virtual time, the same bits every time.
    Lockstep,
    /// From a recording.
    Replay,
}

/// One run of a scenario.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RunSummary {
    /// Version of this object: 1.
    pub schema: u32,
    /// Version of the program.
    pub version: String,
    /// How time passed.
    pub mode: Mode,
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Simulated time \[s\].
    pub sim_secs: f64,
    /// Time on the wall \[s\].
    pub wall_secs: f64,
    /// Chain over all commits, every component in canonical order, hexadecimal; null when nothing ran.
    pub state_hash: Option<String>,
    /// How the exercise went.
    pub task: TaskSummary,
    /// The controllers, in the order of the scenario.
    pub controllers: Vec<ControllerSummary>,
    /// Controllers that fell below 80 % of their rate, over the whole run or in two seconds of it, the slowest first:
    /// the machine was too slow, or a fault was injected. Empty in virtual time without faults.
    pub slow_actors: Vec<SlowActor>,
    /// Values that were not as in the scenario at the end, by the names of their fields.
    pub tuned: BTreeMap<String, serde_json::Value>,
    /// How well slaves followed their masters, and what the path did, by the names of the hands.
    pub teleoperation: BTreeMap<String, TeleoperationFigures>,
    /// What became of each injected fault.
    pub faults: Vec<FaultSummary>,
    /// Largest force at any driver, after its clamp \[N\].
    pub force_newtons_max: f64,
    /// Greatest age of the last accepted command while a driver still held a force \[µs\]: the promise is 20,000,
    /// and on a machine that keeps drivers waiting that wait comes on top.
    pub force_age_max_us: f64,
    /// Commands that drivers refused because their sender was dead or abandoned.
    pub commands_refused: u64,
    /// Deepest penetration of two bodies \[m\].
    pub penetration_max: f64,
    /// How often a contact was not kept: too deep, or too strong. An exercise with any such contact ends with exit code 1.
    pub contacts_not_kept: u64,
    /// The first 64 of them, in order.
    pub unkept_contacts: Vec<UnkeptContact>,
    /// Number of bodies that stand still, in all or in their heat, because their solver could not go on. An exercise with
    /// any such body ends with exit code 1.
    pub bodies_frozen: u64,
    /// The first 64 of them, in order.
    pub frozen_bodies: Vec<FrozenBody>,
    /// Of a replay: the hash over what the recording stores, as the replay found it.
    pub stored_hash: Option<String>,
    /// File of the recording.
    pub recording: Option<String>,
    /// Bytes of the recording.
    pub recording_bytes: Option<u64>,
    /// Whether the recording has no gaps; false without a recording.
    pub recording_complete: bool,
    /// File of the report.
    pub report: Option<String>,
    /// Files of pictures and films.
    pub pictures: Vec<String>,
    /// Who ended the run before its time: `SIGHUP`, `SIGINT`, `SIGTERM`, `a person at the window`, `the program` that
    /// runs the session, or, at a station, `the host`; null when it ended by itself or by `--seconds`.
    pub cut_off_by: Option<String>,
    /// What the run had to do without, one sentence each: real-time priority that the system refused, or that was
    /// taken away on the way; bodies that went beyond what their method is right for; meshes that were mended; results
    /// that could not be written.
    pub losses: Vec<String>,
    /// What was told before the start, one sentence each: what the scenario's methods cannot bear.
    pub warnings: Vec<String>,
    /// What went wrong, in words.
    pub error: Option<String>,
}

impl RunSummary {
    /// The summary of a run of `scenario` before it starts.
    pub fn new(scenario: impl Into<String>, mode: Mode, seed: u64) -> Self {
        Self {
            schema: SCHEMA,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            mode,
            scenario: scenario.into(),
            seed,
            sim_secs: 0.0,
            wall_secs: 0.0,
            state_hash: None,
            task: TaskSummary::default(),
            controllers: Vec::new(),
            slow_actors: Vec::new(),
            tuned: BTreeMap::new(),
            teleoperation: BTreeMap::new(),
            faults: Vec::new(),
            force_newtons_max: 0.0,
            force_age_max_us: 0.0,
            commands_refused: 0,
            penetration_max: 0.0,
            contacts_not_kept: 0,
            unkept_contacts: Vec::new(),
            bodies_frozen: 0,
            frozen_bodies: Vec::new(),
            stored_hash: None,
            recording: None,
            recording_bytes: None,
            recording_complete: false,
            report: None,
            pictures: Vec::new(),
            cut_off_by: None,
            losses: Vec::new(),
            warnings: Vec::new(),
            error: None,
        }
    }

    /// The names of the bodies that stand still, at most `shown` of them, if there are any.
    pub fn frozen_names(&self, shown: usize) -> Option<String> {
        let names: Vec<String> = self.frozen_bodies.iter().take(shown).map(FrozenBody::title).collect();
        let more = if self.frozen_bodies.len() > names.len() { ", …" } else { "" };
        (!names.is_empty()).then(|| format!("{}{more}", names.join(", ")))
    }

    /// One sentence about the actors that were too slow, if there were any.
    pub fn too_slow(&self) -> Option<String> {
        if self.slow_actors.is_empty() {
            return None;
        }
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        let actors: Vec<String> = self
            .slow_actors
            .iter()
            .map(|actor| {
                let SlowActor { name, share, worst_share, worst_at_secs } = actor;
                let (whole, worst) = (percent(*share), percent(*worst_share));
                if worst == whole {
                    format!("{name} ran at {whole} of its rate")
                } else {
                    format!("{name} ran at {whole} of its rate ({worst} in the two seconds from {worst_at_secs:.1} s)")
                }
            })
            .collect();
        let why = if self.faults.is_empty() {
            "the machine was too slow"
        } else {
            "under faults, actors were too slow"
        };
        Some(format!("{why}: {}", actors.join(", ")))
    }

    /// The exit code of the process, where `expectations_failed` says whether a fault plan's `[expect]` failed. The
    /// caller handles an `error` of the program itself.
    pub fn exit(&self, expectations_failed: bool) -> Exit {
        // An exercise of several stations is the host's to judge.
        let is_its_end = self.cut_off_by.as_deref().is_none_or(|by| by == BY_THE_HOST);
        let finished = self.task.completed || (self.task.cut_off && is_its_end);
        if finished && !expectations_failed { Exit::Ok } else { Exit::Failed }
    }
}

/// How an exercise went. No score is clinically validated.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskSummary {
    /// Whether everything was done.
    pub completed: bool,
    /// Whether `--seconds` (or who is named in `cut_off_by`) ended the run before the exercise was over. An exercise whose own
    /// time limit ran out is over: not completed, score 0, not cut off.
    pub cut_off: bool,
    /// 0–100; null until the exercise is over.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub score: Option<f64>,
    /// Whether actors were too slow during it (`slow_actors`), so that its score and errors say little about the trainee.
    pub disturbed: bool,
    /// What the score is made of.
    pub score_kind: ScoreKind,
    /// Time on the exercise's own clock \[s\].
    pub seconds: f64,
    /// What went wrong, in order.
    pub errors: Vec<TaskErrorSummary>,
    /// Motion metrics: hand → name → value.
    pub metrics: BTreeMap<String, BTreeMap<String, f64>>,
}

/// What a contact that is not kept is like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UnkeptKind {
    /// A penetration deeper than three quarters of the thinner body.
    Penetration,
    /// A force above 100 N.
    Force,
}

/// A contact that was not kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct UnkeptContact {
    /// What it was like.
    pub kind: UnkeptKind,
    /// When it was first found \[s\].
    pub at_secs: f64,
    /// One body.
    pub a: String,
    /// The other one.
    pub b: String,
    /// Where, in world \[m\].
    pub at_in_world: [f64; 3],
    /// The depth \[m\] or the force \[N\].
    pub value: f64,
    /// The largest that counts as kept.
    pub limit: f64,
}

impl std::fmt::Display for UnkeptContact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { kind, at_secs, a, b, at_in_world, value, limit } = self;
        let pair = format!("{a} and {b}");
        let [x, y, z] = at_in_world.map(|at| 1e3 * at);
        let place = format!("at {at_secs:.2} s at [{x:.1}, {y:.1}, {z:.1}] mm");
        match kind {
            UnkeptKind::Penetration => {
                write!(f, "{pair}: {:.1} mm deep {place}; at most {:.1} mm is kept", 1e3 * value, 1e3 * limit)
            }
            UnkeptKind::Force => write!(f, "{pair}: {value:.0} N {place}; at most {limit:.0} N is kept"),
        }
    }
}

/// What of a body stands still.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum FrozenPart {
    /// All of it: it no longer moves.
    Body,
    /// Its temperatures.
    Heat,
}

/// A body that stands still because its solver could not go on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FrozenBody {
    /// Its name.
    pub name: String,
    /// What of it stands still.
    pub part: FrozenPart,
    /// Since when \[s\].
    pub at_secs: f64,
    /// Where its frame was, in world \[m\].
    pub at_in_world: [f64; 3],
    /// Why.
    pub reason: String,
}

impl FrozenBody {
    /// Its name, with the part unless all of it stands still.
    pub fn title(&self) -> String {
        match self.part {
            FrozenPart::Body => self.name.clone(),
            FrozenPart::Heat => format!("the heat of {}", self.name),
        }
    }
}

impl std::fmt::Display for FrozenBody {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} stands still since {:.2} s: {}", self.title(), self.at_secs, self.reason)
    }
}

/// A controller that was too slow.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SlowActor {
    /// Its name.
    pub name: String,
    /// Share of its due ticks that ran, from its first tick to the end, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub share: f64,
    /// The least such share in two seconds of the run.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub worst_share: f64,
    /// When those two seconds began \[s\].
    pub worst_at_secs: f64,
}

impl TaskSummary {
    /// Whether the scenario has an exercise. Without one there is no score, and nothing to complete.
    pub fn is_exercise(&self) -> bool {
        !self.completed || self.score.is_some()
    }
}

/// One error of the trainee.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskErrorSummary {
    /// Kind, such as `drop_in_view`; or the expectation that was not met, with its value and its bound.
    pub kind: String,
    /// When \[s\].
    pub at_secs: f64,
}

/// What became of one fault. Times in seconds of the session; null for what did not happen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FaultSummary {
    /// Its id in the plan.
    pub id: String,
    /// Its target.
    pub target: String,
    /// What it did, such as `kill`.
    pub kind: String,
    /// When it struck \[s\].
    pub injected_secs: Option<f64>,
    /// When it ended by itself \[s\].
    pub healed_secs: Option<f64>,
    /// When it was detected \[s\].
    pub detected_secs: Option<f64>,
    /// When the replacement was built \[s\].
    pub restarted_secs: Option<f64>,
    /// When the target did good work again \[s\].
    pub resumed_secs: Option<f64>,
}

impl FaultSummary {
    /// Whether it was still in progress when the run ended.
    pub fn is_under_way(&self) -> bool {
        let lasts = FaultKind::ALL.iter().any(|kind| kind.name() == self.kind && !kind.is_instant());
        lasts && self.injected_secs.is_some() && self.healed_secs.or(self.resumed_secs).is_none()
    }

    /// From the moment at which only recovery was left to do, to the first good work \[s\].
    pub fn recovery_secs(&self) -> Option<f64> {
        let from = match (self.restarted_secs, self.healed_secs) {
            // What was killed and nobody restarts is back by itself, and counts from the blow.
            (None, Some(healed)) if self.kind != FaultKind::Kill.name() => healed,
            _ => self.injected_secs?,
        };
        Some(self.resumed_secs? - from)
    }
}

/// Measured figures beside their floors and bars.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BenchSummary {
    /// Version of this object: 1.
    pub schema: u32,
    /// Where it was measured.
    pub machine: Machine,
    /// One row for every figure.
    pub results: Vec<BenchResult>,
    /// What went wrong, in words.
    pub error: Option<String>,
}

impl BenchSummary {
    /// A summary without results.
    pub fn new(machine: Machine) -> Self {
        Self { schema: SCHEMA, machine, results: Vec::new(), error: None }
    }
    /// Names of the figures that miss their bar.
    pub fn missed(&self) -> impl Iterator<Item = &str> {
        self.results.iter().filter(|row| !row.holds).map(|row| row.name.as_str())
    }
}

/// The machine on which something was measured.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    /// Model of the processor.
    pub cpu: String,
    /// Processors that this process may use.
    pub cores: u32,
    /// Frequency governor; null when the system does not tell.
    pub governor: Option<String>,
    /// Whether threads got real-time (FIFO) scheduling.
    pub fifo: bool,
}

/// JSON schema of [`RunSummary`].
pub fn run_schema() -> serde_json::Value {
    strict(schemars::schema_for!(RunSummary).to_value())
}

/// JSON schema of [`BenchSummary`].
pub fn bench_schema() -> serde_json::Value {
    strict(schemars::schema_for!(BenchSummary).to_value())
}

/// Marks every property of every object as required: fields are null when unknown, never absent. Descriptions lose the
/// backslashes with which Rust's documentation writes `[s]`.
fn strict(mut schema: serde_json::Value) -> serde_json::Value {
    fn visit(node: &mut serde_json::Value) {
        if let Some(object) = node.as_object_mut() {
            let names = object
                .get("properties")
                .and_then(|properties| properties.as_object())
                .map(|properties| properties.keys().cloned().collect::<Vec<_>>());
            if let Some(names) = names {
                object.insert("required".to_owned(), names.into());
            }
            if let Some(serde_json::Value::String(text)) = object.get_mut("description") {
                *text = text.replace("\\[", "[").replace("\\]", "]");
            }
            object.values_mut().for_each(visit);
        }
        if let Some(list) = node.as_array_mut() {
            list.iter_mut().for_each(visit);
        }
    }
    visit(&mut schema);
    schema
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_that_seconds_cut_off_or_that_was_completed_is_no_failure() {
        let mut summary = RunSummary::new("peg-transfer", Mode::Live, 1);
        assert_eq!(summary.exit(false), Exit::Failed);
        summary.task.cut_off = true;
        assert_eq!(summary.exit(false), Exit::Ok);
        summary.cut_off_by = Some("a person at the window".to_owned());
        assert_eq!(summary.exit(false), Exit::Failed, "a person did not let it come to its end");
        summary.cut_off_by = Some(BY_THE_HOST.to_owned());
        assert_eq!(summary.exit(false), Exit::Ok, "the host judges the exercise");
        summary.cut_off_by = None;
        summary.task = TaskSummary { completed: true, ..TaskSummary::default() };
        assert_eq!(summary.exit(false), Exit::Ok);
        assert_eq!(summary.exit(true), Exit::Failed);
        assert_eq!(summary.exit(true).code(), 1);
    }

    #[test]
    fn the_schemas_require_every_field_that_is_printed() {
        let summary = serde_json::to_value(RunSummary::new("x", Mode::Lockstep, 0)).unwrap();
        let schema = run_schema();
        let required: Vec<_> =
            schema["required"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
        let mut printed: Vec<_> = summary.as_object().unwrap().keys().map(String::as_str).collect();
        printed.sort_unstable();
        let mut sorted = required.clone();
        sorted.sort_unstable();
        assert_eq!(printed, sorted);
        assert_eq!(summary["mode"], "lockstep");
        for schema in [schema, bench_schema()] {
            let text = schema.to_string();
            assert!(!text.contains("\\\\["), "a backslash of Rust's documentation: {text}");
        }
    }
}
