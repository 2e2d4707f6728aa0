//! The TOML format of fault plans: reading and checking a file.

use std::path::Path;

use serde::Deserialize;
use trocar_scene::SimTime;

use super::plan::{
    During, Expect, FaultPlan, FaultPlanError, FaultSpec, MAX_FAULTS, MAX_FILE_BYTES, SCHEMA, seed_of,
    unit_of,
};
use crate::spec::FaultKind;

/// Latest time of a fault, in seconds: well beyond any session, well within the clock.
const MAX_SECS: f64 = 1e6;
/// Fastest slow disk or link, in bytes per second: beyond any.
const MAX_BYTES_PER_SEC: f64 = 1e12;
/// Most messages that are lost in a row on average.
const MAX_BURST: f64 = 1e4;
/// Most delays of a trace.
const MAX_DELAYS: usize = 100_000;

/// Whether a fault of this kind can heal, and so may have `for_secs`.
const fn can_heal(kind: FaultKind) -> bool {
    !matches!(kind, FaultKind::Kill | FaultKind::ClockAhead | FaultKind::ClockBack)
}
const fn takes_probability(kind: FaultKind) -> bool {
    matches!(kind, FaultKind::Drop | FaultKind::Duplicate | FaultKind::Reorder | FaultKind::Corrupt)
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
    independent: Option<bool>,
    delays_secs: Option<Vec<f64>>,
    every_secs: Option<f64>,
    burst_messages: Option<f64>,
    queue_secs: Option<f64>,
    bytes_per_sec: Option<f64>,
}

impl FaultPlan {
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
        let steps = kind == FaultKind::Slow || kind.is_of_clock();
        only("step_secs", self.step_secs.is_some(), steps)?;
        needed("step_secs", self.step_secs.is_none(), steps)?;
        let (is_delay, is_trace) = (kind == FaultKind::Delay, self.delays_secs.is_some());
        let is_rate = matches!(kind, FaultKind::DiskSlow | FaultKind::RateLimit);
        only("delay_secs", self.delay_secs.is_some(), is_delay)?;
        needed("delay_secs", self.delay_secs.is_none(), is_delay && !is_trace)?;
        only("jitter_secs", self.jitter_secs.is_some(), is_delay && !is_trace)?;
        only("independent", self.independent.is_some(), is_delay)?;
        only("delays_secs", is_trace, is_delay)?;
        only("every_secs", self.every_secs.is_some(), is_delay && is_trace)?;
        needed("every_secs", self.every_secs.is_none(), is_delay && is_trace)?;
        only("burst_messages", self.burst_messages.is_some(), kind == FaultKind::Drop)?;
        only("bytes_per_sec", self.bytes_per_sec.is_some(), is_rate)?;
        needed("bytes_per_sec", self.bytes_per_sec.is_none(), is_rate)?;
        only("queue_secs", self.queue_secs.is_some(), kind == FaultKind::RateLimit)?;
        needed("queue_secs", self.queue_secs.is_none(), kind == FaultKind::RateLimit)?;
        only("probability", self.probability.is_some(), takes_probability(kind))?;
        needed("probability", self.probability.is_none(), takes_probability(kind))?;
        let probability = self.probability.unwrap_or(1.0);
        if !(0.0..=1.0).contains(&probability) {
            let problem = format!("{probability} is not between 0 and 1");
            return Err(value_error(file, &id, "probability", &problem));
        }
        let wrong = |key, problem: String| Err(value_error(file, &id, key, &problem));
        if let Some(burst) = self.burst_messages {
            if !(1.0..=MAX_BURST).contains(&burst) {
                return wrong("burst_messages", format!("{burst} is not between 1 and {MAX_BURST}"));
            }
            // A good message stands between two bursts.
            if probability > burst / (burst + 1.0) {
                let least = probability / (1.0 - probability);
                let problem = format!("of {probability} lost, at least {least:.1} are in a row on average");
                return wrong("burst_messages", problem);
            }
        }
        let delays = self.delays_secs.unwrap_or_default();
        if is_trace && (delays.is_empty() || delays.len() > MAX_DELAYS) {
            return wrong("delays_secs", format!("has {} delays, not 1 to {MAX_DELAYS}", delays.len()));
        }
        if is_trace && self.delay_secs.is_some() {
            return wrong("delay_secs", "say either this or delays_secs, not both".to_owned());
        }
        let delays =
            delays.into_iter().map(|delay| time("delays_secs", delay)).collect::<Result<Vec<_>, _>>()?;
        let every = time("every_secs", self.every_secs.unwrap_or(0.0))?;
        if is_trace && every == SimTime::ZERO {
            return wrong("every_secs", "must be above 0".to_owned());
        }
        let bytes_per_sec = self.bytes_per_sec.unwrap_or(0.0);
        if kind == FaultKind::RateLimit && bytes_per_sec == 0.0 {
            return wrong("bytes_per_sec", "must be above 0: 'partition' lets nothing pass".to_owned());
        }
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
            independent: self.independent.unwrap_or(false),
            delays,
            every,
            burst: self.burst_messages.unwrap_or(0.0),
            queue: time("queue_secs", self.queue_secs.unwrap_or(0.0))?,
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
