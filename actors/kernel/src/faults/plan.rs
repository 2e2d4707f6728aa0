//! The fault plan as a Rust type; `plan_file` reads it from TOML.

use serde::Deserialize;
use thiserror::Error;
use trocar_scene::random::{GOLDEN_GAMMA, SplitMix64};
use trocar_scene::{Grasp, SimTime, Snapshot};

use crate::spec::FaultKind;

/// Version of the file format that this library reads.
pub(super) const SCHEMA: u32 = 1;
/// Most faults that one plan may hold.
pub(super) const MAX_FAULTS: usize = 1024;
/// Largest plan file, in bytes.
pub(super) const MAX_FILE_BYTES: u64 = 1 << 20;

/// Condition in the scene that a fault waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum During {
    /// An instrument is grasping.
    Grasp,
}

impl During {
    /// Whether the condition holds in a scene.
    pub fn holds(self, scene: &Snapshot) -> bool {
        match self {
            Self::Grasp => scene.iter::<Grasp>().next().is_some(),
        }
    }
}

/// One fault of a plan.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultSpec {
    /// Id in the report; unique within the plan.
    pub id: String,
    /// When it begins.
    pub at: SimTime,
    /// From `at` on, the fault waits for this condition.
    pub during: Option<During>,
    /// Duration; `None`: until the end of the session, or until the supervisor recovers the target.
    pub lasting: Option<SimTime>,
    /// Name of a controller, a device, `model`, `recorder`, `viewer`, `clock`, or a link.
    pub target: String,
    /// What goes wrong.
    pub kind: FaultKind,
    /// [`FaultKind::Slow`]: extra time of each step. [`FaultKind::ClockAhead`], [`FaultKind::ClockBack`]: by how much.
    pub step: SimTime,
    /// [`FaultKind::Drop`], [`FaultKind::Duplicate`], [`FaultKind::Reorder`], [`FaultKind::Corrupt`]:
    /// share of messages concerned, 0 to 1.
    pub probability: f64,
    /// [`FaultKind::Delay`]: extra latency of messages.
    pub delay: SimTime,
    /// [`FaultKind::Delay`]: variation of the delay, ±; at most the delay itself.
    pub jitter: SimTime,
    /// [`FaultKind::Delay`]: each message has its own delay, so that they overtake each other.
    pub independent: bool,
    /// [`FaultKind::Delay`]: a measured trace: extra latencies, one after the other, over and over again.
    pub delays: Vec<SimTime>,
    /// [`FaultKind::Delay`]: how long each of [`Self::delays`] holds.
    pub every: SimTime,
    /// [`FaultKind::Drop`]: mean number of messages that are lost in a row; 0: each by itself.
    pub burst: f64,
    /// [`FaultKind::RateLimit`]: longest wait in the queue; what would wait longer is lost.
    pub queue: SimTime,
    /// [`FaultKind::DiskSlow`], [`FaultKind::RateLimit`]: rate of the disk or the link [bytes/s].
    pub bytes_per_sec: f64,
}

/// What a run under faults must still achieve; omitted values are not checked.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// Longest time from the injection (or, for faults that heal, the healing) to the first good work
    /// of the target \[s\].
    pub recovery_secs_max: Option<f64>,
    /// Largest force at any driver after its clamp \[N\].
    pub force_newtons_max: Option<f64>,
    /// Most restarts of the Model.
    pub model_restarts_max: Option<u64>,
    /// Whether the exercise must have been completed (`true`) or must not (`false`).
    pub task_completed: Option<bool>,
}

/// A fault plan: faults with their times, and the expectations that must still hold.
///
/// ```
/// use trocar_kernel::faults::{FaultPlan, secs};
/// let plan = FaultPlan::new(42)
///     .at(secs(3.0)).kill("haptics.left")
///     .at(secs(5.0)).lasting(secs(2.0)).queue_full("engine");
/// assert_eq!(plan.faults.len(), 2);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FaultPlan {
    /// Seed of all randomness of the faults.
    pub seed: u64,
    /// The faults in the order of the file.
    pub faults: Vec<FaultSpec>,
    /// Expectations of the run.
    pub expect: Expect,
}

/// A plan that cannot be used.
#[derive(Debug, Error)]
pub enum FaultPlanError {
    /// The file could not be read.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// The file is larger than any plan.
    #[error("{file}: {bytes} bytes; a fault plan has at most {MAX_FILE_BYTES}")]
    TooLarge {
        /// The file.
        file: String,
        /// Its size.
        bytes: u64,
    },
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("{file}: {message}")]
    Syntax {
        /// The file.
        file: String,
        /// Line, column, what is wrong and what is valid.
        message: String,
    },
    /// An unsupported version of the format.
    #[error("{file}: schema = {found} is not known; this version reads schema = {SCHEMA}")]
    Schema {
        /// The file.
        file: String,
        /// The version found.
        found: u32,
    },
    /// More faults than allowed.
    #[error("{file}: {found} faults; a plan has at most {MAX_FAULTS}")]
    TooMany {
        /// The file.
        file: String,
        /// The number found.
        found: usize,
    },
    /// A value out of its valid range.
    #[error("{file}: fault '{id}': {key}: {problem}")]
    Value {
        /// The file.
        file: String,
        /// The fault.
        id: String,
        /// The key.
        key: &'static str,
        /// What is wrong and what is valid.
        problem: String,
    },
    /// No target of the session has this name.
    #[error("fault '{id}': unknown target '{target}'; targets are: {valid}")]
    UnknownTarget {
        /// The fault.
        id: String,
        /// The name given.
        target: String,
        /// The names that exist.
        valid: String,
    },
    /// The target does not support this kind of fault.
    #[error("fault '{id}': '{target}' is a {class} and cannot have '{kind}'; a {class} can have: {valid}")]
    KindNotApplicable {
        /// The fault.
        id: String,
        /// The target.
        target: String,
        /// Class of the target.
        class: &'static str,
        /// The kind given.
        kind: FaultKind,
        /// The kinds that apply.
        valid: String,
    },
}

impl FaultPlan {
    /// An empty plan.
    pub fn new(seed: u64) -> Self {
        Self { seed, ..Self::default() }
    }

    /// Sets the expectations.
    pub fn expecting(mut self, expect: Expect) -> Self {
        self.expect = expect;
        self
    }
}

/// The seed of one fault of a plan.
pub(super) fn seed_of(plan_seed: u64, index: usize) -> u64 {
    plan_seed ^ (index as u64 + 1).wrapping_mul(GOLDEN_GAMMA)
}

/// A number in [0, 1) from a seed.
pub(super) fn unit_of(seed: u64) -> f64 {
    SplitMix64::new(seed).unit()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::secs;

    const PLAN: &str = r#"
schema = 1
seed = 42
[[fault]]
id = "left-hand dies"
at_secs = 3.0
target = "haptics.left"
kind = "kill"
[[fault]]
id = "slow physics"
at_secs = 5.0
for_secs = 10.0
target = "engine"
kind = "slow"
step_secs = 0.004
[[fault]]
at_secs = 6.0
for_secs = 1.0
target = "haptics.left"
kind = "delay"
delay_secs = 0.02
jitter_secs = 0.01
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "drop"
probability = 0.05
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "duplicate"
probability = 0.25
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "reorder"
probability = 0.5
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "corrupt"
probability = 0.75
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "drop"
probability = 0.02
burst_messages = 5
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "delay"
delay_secs = 0.05
jitter_secs = 0.05
independent = true
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "delay"
delays_secs = [0.15, 0.2]
every_secs = 0.5
[[fault]]
at_secs = 7.0
target = "haptics.left"
kind = "rate_limit"
bytes_per_sec = 1e5
queue_secs = 0.2
[[fault]]
at_secs = 8.0
target = "haptics.left"
kind = "partition"
[[fault]]
at_secs = 9.0
target = "recorder"
kind = "disk_slow"
bytes_per_sec = 20000
[expect]
recovery_secs_max = 0.1
force_newtons_max = 3.3
model_restarts_max = 0
"#;

    fn error(text: &str) -> String {
        FaultPlan::parse(text, "plan.toml").expect_err("the plan is wrong").to_string()
    }

    #[test]
    fn file_and_rust_say_the_same() {
        let mut read = FaultPlan::parse(PLAN, "plan.toml").expect("valid");
        let mut built = FaultPlan::new(42)
            .at(secs(3.0))
            .kill("haptics.left")
            .at(secs(5.0))
            .lasting(secs(10.0))
            .slow("engine", SimTime::from_millis(4))
            .at(secs(6.0))
            .lasting(secs(1.0))
            .jitter("haptics.left", SimTime::from_millis(20), SimTime::from_millis(10))
            .at(secs(7.0))
            .drop("haptics.left", 0.05)
            .at(secs(7.0))
            .duplicate("haptics.left", 0.25)
            .at(secs(7.0))
            .reorder("haptics.left", 0.5)
            .at(secs(7.0))
            .corrupt("haptics.left", 0.75)
            .at(secs(7.0))
            .bursts("haptics.left", 0.02, 5.0)
            .at(secs(7.0))
            .scatter("haptics.left", SimTime::from_millis(50), SimTime::from_millis(50))
            .at(secs(7.0))
            .delay_trace(
                "haptics.left",
                vec![SimTime::from_millis(150), SimTime::from_millis(200)],
                secs(0.5),
            )
            .at(secs(7.0))
            .rate_limit("haptics.left", 1e5, SimTime::from_millis(200))
            .at(secs(8.0))
            .partition("haptics.left")
            .at(secs(9.0))
            .disk_slow(20_000.0)
            .expecting(Expect {
                recovery_secs_max: Some(0.1),
                force_newtons_max: Some(3.3),
                model_restarts_max: Some(0),
                task_completed: None,
            });
        for fault in read.faults.iter_mut().chain(&mut built.faults) {
            fault.id.clear();
        }
        assert_eq!(read, built);
    }

    #[test]
    fn a_random_time_depends_on_the_seed_and_the_place_in_the_plan_alone() {
        let text = |seed: u32| {
            let fault =
                "[[fault]]\nbetween_secs = [2, 6]\nduring = 'grasp'\ntarget = 'engine'\nkind = 'kill'\n";
            format!("schema = 1\nseed = {seed}\n{fault}{fault}")
        };
        let times = |seed| {
            let plan = FaultPlan::parse(&text(seed), "plan.toml").expect("valid");
            assert!(plan.faults.iter().all(|fault| fault.during == Some(During::Grasp)));
            plan.faults.iter().map(|fault| fault.at).collect::<Vec<_>>()
        };
        assert_eq!(times(1), times(1));
        assert!(times(1) != times(2) && times(1)[0] != times(1)[1]);
        assert!((0..200).flat_map(times).all(|at| (secs(2.0)..=secs(6.0)).contains(&at)));
        let built = FaultPlan::new(1).between(secs(2.0), secs(6.0)).during(During::Grasp).kill("engine");
        assert_eq!(built.faults[0].at, times(1)[0], "file and Rust say the same");
    }

    #[test]
    fn a_fault_has_exactly_one_time() {
        let fault =
            |when: &str| error(&format!("schema = 1\n[[fault]]\n{when}\ntarget = 'x'\nkind = 'kill'\n"));
        assert!(fault("").contains("between_secs"));
        assert!(fault("at_secs = 1\nbetween_secs = [1, 2]").contains("not both"));
        assert!(fault("between_secs = [2, 1]").contains("before the first"));
        assert!(fault("between_secs = [1, nan]").contains("seconds"));
    }

    #[test]
    fn unknown_keys_and_kinds_list_the_valid_ones() {
        let message = error("schema = 1\n[[fault]]\nat_secs = 1\ntarget = 'x'\nkind = 'kil'\n");
        assert!(message.contains("plan.toml") && message.contains("line 5"), "{message}");
        for kind in FaultKind::ALL {
            assert!(message.contains(kind.name()), "{kind} is missing: {message}");
        }
        let message = error("schema = 1\n[[fault]]\nwhen = 1\n");
        assert!(message.contains("`when`") && message.contains("`at_secs`"), "{message}");
        let message = error("schema = 1\n[expect]\nforce = 1\n");
        assert!(message.contains("force_newtons_max"), "{message}");
    }

    #[test]
    fn senseless_values_are_refused() {
        let fault =
            |rest: &str| format!("schema = 1\n[[fault]]\nid = 'a'\ntarget = 'engine'\nat_secs = 1\n{rest}\n");
        assert!(error("schema = 2").contains("schema = 2"));
        assert!(error(&fault("kind = 'kill'\nfor_secs = 1")).contains("for_secs"));
        assert!(error(&fault("kind = 'slow'")).contains("needs it"));
        assert!(error(&fault("kind = 'drop'\nprobability = 1.5")).contains("between 0 and 1"));
        assert!(error(&fault("kind = 'delay'\ndelay_secs = 0.1\njitter_secs = 0.2")).contains("more than"));
        assert!(error(&fault("kind = 'drop'\nprobability = 1\njitter_secs = 0.2")).contains("jitter_secs"));
        let drop = |rest: &str| error(&fault(&format!("kind = 'drop'\nprobability = 0.9\n{rest}")));
        assert!(drop("burst_messages = 0.5").contains("between 1 and"));
        assert!(
            drop("burst_messages = 2").contains("at least 9.0"),
            "so much is not lost in so short bursts"
        );
        assert!(drop("independent = true").contains("means nothing"));
        let delay = |rest: &str| error(&fault(&format!("kind = 'delay'\n{rest}")));
        assert!(
            delay("jitter_secs = 0").contains("delay_secs")
                && delay("delays_secs = []\nevery_secs = 1").contains("has 0 delays")
        );
        assert!(delay("delay_secs = 1\ndelays_secs = [1]\nevery_secs = 1").contains("not both"));
        assert!(delay("delays_secs = [0.1, -1]\nevery_secs = 1").contains("seconds"));
        assert!(
            delay("delays_secs = [0.1]").contains("every_secs")
                && delay("delay_secs = 1\nevery_secs = 1").contains("every_secs")
        );
        assert!(delay("delays_secs = [0.1]\nevery_secs = 0").contains("every_secs"));
        assert!(error(&fault("kind = 'rate_limit'\nbytes_per_sec = 1")).contains("queue_secs"));
        assert!(error(&fault("kind = 'rate_limit'\nbytes_per_sec = 0\nqueue_secs = 1")).contains("above 0"));
        assert!(error(&fault("kind = 'disk_slow'")).contains("needs it"));
        assert!(error(&fault("kind = 'disk_slow'\nbytes_per_sec = -1")).contains("bytes per second"));
        assert!(error(&fault("kind = 'stall'\nfor_secs = -1")).contains("for_secs"));
        assert!(error(&fault("kind = 'stall'\nfor_secs = nan")).contains("for_secs"));
        assert!(error("schema = 1\n[expect]\nforce_newtons_max = nan").contains("force_newtons_max"));
        let twice = format!(
            "{}[[fault]]\nid = 'a'\ntarget = 'b'\nat_secs = 1\nkind = 'kill'\n",
            fault("kind = 'kill'")
        );
        assert!(error(&twice).contains("same id"));
    }

    proptest::proptest! {
        #[test]
        fn no_text_panics(text in "\\PC{0,200}", cut in 0usize..400) {
            let _ = FaultPlan::parse(&text, "any");
            let cut = cut.min(PLAN.len());
            let _ = FaultPlan::parse(&format!("{}{text}", &PLAN[..cut]), "any");
        }
    }
}
