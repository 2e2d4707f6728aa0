//! The fault plan: TOML file format and Rust type.

use std::path::Path;

use serde::Deserialize;
use thiserror::Error;
use trocar_scene::random::{GOLDEN_GAMMA, SplitMix64};
use trocar_scene::{Grasp, SimTime, Snapshot};

use crate::spec::FaultKind;

/// Version of the file format that this library reads.
const SCHEMA: u32 = 1;
/// Most faults that one plan may hold.
const MAX_FAULTS: usize = 1024;
/// Largest plan file, in bytes.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Latest time of a fault, in seconds: well beyond any session, well within the clock.
const MAX_SECS: f64 = 1e6;
/// Fastest slow disk, in bytes per second: beyond any disk.
const MAX_BYTES_PER_SEC: f64 = 1e12;

/// Whether a fault of this kind can heal, and so may have `for_secs`.
const fn can_heal(kind: FaultKind) -> bool {
    !matches!(kind, FaultKind::Kill)
}
const fn takes_probability(kind: FaultKind) -> bool {
    matches!(kind, FaultKind::Drop | FaultKind::Duplicate | FaultKind::Reorder | FaultKind::Corrupt)
}

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
    /// Name of a controller, a device, `model`, `recorder`, `viewer` or a link.
    pub target: String,
    /// What goes wrong.
    pub kind: FaultKind,
    /// [`FaultKind::Slow`]: extra time of each step.
    pub step: SimTime,
    /// [`FaultKind::Drop`], [`FaultKind::Duplicate`], [`FaultKind::Reorder`], [`FaultKind::Corrupt`]:
    /// share of messages concerned, 0 to 1.
    pub probability: f64,
    /// [`FaultKind::Delay`]: extra latency of messages.
    pub delay: SimTime,
    /// [`FaultKind::Delay`]: variation of the delay, ±; at most the delay itself.
    pub jitter: SimTime,
    /// [`FaultKind::DiskSlow`]: write rate of the disk [bytes/s].
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

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    schema: u32,
    #[serde(default)]
    seed: u64,
    #[serde(default)]
    fault: Vec<FileFault>,
    #[serde(default)]
    expect: Expect,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FileFault {
    id: Option<String>,
    at_secs: Option<f64>,
    between_secs: Option<[f64; 2]>,
    during: Option<During>,
    for_secs: Option<f64>,
    target: String,
    kind: FaultKind,
    step_secs: Option<f64>,
    probability: Option<f64>,
    delay_secs: Option<f64>,
    jitter_secs: Option<f64>,
    bytes_per_sec: Option<f64>,
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

    /// Reads a plan file.
    ///
    /// # Errors
    /// [`FaultPlanError`], naming the file, the place and what is valid.
    pub fn read(path: &Path) -> Result<Self, FaultPlanError> {
        let file = path.display().to_string();
        let io = |source| FaultPlanError::Io { file: file.clone(), source };
        let bytes = std::fs::metadata(path).map_err(io)?.len();
        if bytes > MAX_FILE_BYTES {
            return Err(FaultPlanError::TooLarge { file, bytes });
        }
        let text = std::fs::read_to_string(path).map_err(io)?;
        Self::parse(&text, &file)
    }

    /// Parses the text of a plan; `file` names it in errors.
    ///
    /// # Errors
    /// [`FaultPlanError`], naming the place and what is valid.
    pub fn parse(text: &str, file: &str) -> Result<Self, FaultPlanError> {
        let parsed: File = toml::from_str(text).map_err(|error| {
            // An error without a place, such as nesting beyond TOML's limit, is about the whole document.
            let place = if error.span().is_none() { "line 1 and below: " } else { "" };
            FaultPlanError::Syntax { file: file.to_owned(), message: format!("{place}{error}") }
        })?;
        if parsed.schema != SCHEMA {
            return Err(FaultPlanError::Schema { file: file.to_owned(), found: parsed.schema });
        }
        if parsed.fault.len() > MAX_FAULTS {
            return Err(FaultPlanError::TooMany { file: file.to_owned(), found: parsed.fault.len() });
        }
        let mut plan = Self { seed: parsed.seed, faults: Vec::new(), expect: parsed.expect };
        plan.check_expect(file)?;
        for (index, fault) in parsed.fault.into_iter().enumerate() {
            let id = fault.id.clone().unwrap_or_else(|| format!("fault {}", index + 1));
            if plan.faults.iter().any(|other| other.id == id) {
                return Err(value_error(file, &id, "id", "another fault has the same id"));
            }
            let unit = unit_of(seed_of(plan.seed, index));
            plan.faults.push(fault.into_spec(id, file, unit)?);
        }
        Ok(plan)
    }

    fn check_expect(&self, file: &str) -> Result<(), FaultPlanError> {
        let figures = [
            ("recovery_secs_max", self.expect.recovery_secs_max),
            ("force_newtons_max", self.expect.force_newtons_max),
        ];
        for (key, figure) in figures {
            if figure.is_some_and(|figure| !figure.is_finite() || figure < 0.0) {
                return Err(value_error(file, "[expect]", key, "must be a number of at least 0"));
            }
        }
        Ok(())
    }
}

impl FileFault {
    /// A fault of the plan; `unit` in [0, 1) chooses within `between_secs`.
    fn into_spec(self, id: String, file: &str, unit: f64) -> Result<FaultSpec, FaultPlanError> {
        let time = |key, value: f64| {
            if (0.0..=MAX_SECS).contains(&value) {
                Ok(SimTime::from_secs_f64(value))
            } else {
                Err(value_error(file, &id, key, &format!("{value} is not between 0 and {MAX_SECS} seconds")))
            }
        };
        let only = |key, given: bool, taken: bool| {
            if given && !taken {
                Err(value_error(file, &id, key, &format!("means nothing for kind '{}'", self.kind)))
            } else {
                Ok(())
            }
        };
        let needed = |key, missing: bool, taken: bool| {
            if missing && taken {
                Err(value_error(file, &id, key, &format!("kind '{}' needs it", self.kind)))
            } else {
                Ok(())
            }
        };
        let kind = self.kind;
        only("for_secs", self.for_secs.is_some(), can_heal(kind))?;
        only("step_secs", self.step_secs.is_some(), kind == FaultKind::Slow)?;
        needed("step_secs", self.step_secs.is_none(), kind == FaultKind::Slow)?;
        only("delay_secs", self.delay_secs.is_some(), kind == FaultKind::Delay)?;
        needed("delay_secs", self.delay_secs.is_none(), kind == FaultKind::Delay)?;
        only("jitter_secs", self.jitter_secs.is_some(), kind == FaultKind::Delay)?;
        only("bytes_per_sec", self.bytes_per_sec.is_some(), kind == FaultKind::DiskSlow)?;
        needed("bytes_per_sec", self.bytes_per_sec.is_none(), kind == FaultKind::DiskSlow)?;
        only("probability", self.probability.is_some(), takes_probability(kind))?;
        needed("probability", self.probability.is_none(), takes_probability(kind))?;
        let probability = self.probability.unwrap_or(1.0);
        if !(0.0..=1.0).contains(&probability) {
            let problem = format!("{probability} is not between 0 and 1");
            return Err(value_error(file, &id, "probability", &problem));
        }
        let bytes_per_sec = self.bytes_per_sec.unwrap_or(0.0);
        if !(0.0..=MAX_BYTES_PER_SEC).contains(&bytes_per_sec) {
            let problem =
                format!("{bytes_per_sec} is not between 0 and {MAX_BYTES_PER_SEC} bytes per second");
            return Err(value_error(file, &id, "bytes_per_sec", &problem));
        }
        let (delay, jitter) = (self.delay_secs.unwrap_or(0.0), self.jitter_secs.unwrap_or(0.0));
        if jitter > delay {
            let problem =
                format!("{jitter} is more than delay_secs = {delay}: nothing arrives before it is sent");
            return Err(value_error(file, &id, "jitter_secs", &problem));
        }
        let at = match (self.at_secs, self.between_secs) {
            (Some(at), None) => time("at_secs", at)?,
            (None, Some([from, to])) => {
                let (from, to) = (time("between_secs", from)?, time("between_secs", to)?);
                if to < from {
                    return Err(value_error(
                        file,
                        &id,
                        "between_secs",
                        "the second time is before the first",
                    ));
                }
                from + SimTime::from_secs_f64(to.since(from).as_secs_f64() * unit)
            }
            (Some(_), Some(_)) => {
                return Err(value_error(file, &id, "at_secs", "say either this or between_secs, not both"));
            }
            (None, None) => {
                return Err(value_error(
                    file,
                    &id,
                    "at_secs",
                    "say when: this, or between_secs = [from, to]",
                ));
            }
        };
        Ok(FaultSpec {
            at,
            during: self.during,
            lasting: self.for_secs.map(|secs| time("for_secs", secs)).transpose()?,
            step: time("step_secs", self.step_secs.unwrap_or(0.0))?,
            delay: time("delay_secs", delay)?,
            jitter: time("jitter_secs", jitter)?,
            bytes_per_sec,
            target: self.target,
            kind,
            probability,
            id,
        })
    }
}

fn value_error(file: &str, id: &str, key: &'static str, problem: &str) -> FaultPlanError {
    FaultPlanError::Value { file: file.to_owned(), id: id.to_owned(), key, problem: problem.to_owned() }
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
