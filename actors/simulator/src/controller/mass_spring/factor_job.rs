//! Factor for a sheet's implicit steps while it is being cut: without a factor until nothing has been cut for a while;
//! then a background job computes the next one.

use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::{Component, ComponentError, Entity, Job, JobOutput, SimTime};

use crate::mass_spring::{Config, MassSpring, Network, SheetFactor};

/// Time without cuts after which a new factor is computed.
const WHOLE: SimTime = SimTime(300_000_000);
/// Duration of a job in lock-step, however long it takes.
const JOB: SimTime = SimTime(100_000_000);

/// State of the sheet's factor that a restart needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpringFactor {
    /// Time of the last cut, if there is no factor since.
    pub parted_at: Option<SimTime>,
    /// The factor in progress.
    pub wanted: Option<WantedSheetFactor>,
    /// Number of jobs so far.
    pub jobs: u64,
}
impl Component for SpringFactor {
    const NAME: &'static str = "spring_factor";
    fn check(&self) -> Result<(), ComponentError> {
        Ok(())
    }
}

/// A factor that a background job computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedSheetFactor {
    /// Time from which it is used, if it is ready.
    pub due: SimTime,
    /// Number of the job.
    pub key: u64,
}

/// Keeps the factor of a sheet up to date.
pub(crate) struct FactorKeeper {
    memory: SpringFactor,
    is_changed: bool,
    /// After a restart, a factor in progress is computed again.
    is_new: bool,
    ready: Option<SheetFactor>,
    /// Jobs whose sheet was cut since they began.
    stale: Vec<u64>,
}

impl FactorKeeper {
    /// Resumes from the state before a restart.
    pub fn new(memory: Option<&SpringFactor>) -> Self {
        let memory = memory.copied().unwrap_or_default();
        Self { memory, is_changed: false, is_new: true, ready: None, stale: Vec::new() }
    }

    /// The sheet was cut, and the springs updated.
    pub fn parted(&mut self, at: SimTime) {
        self.memory.parted_at = Some(at);
        self.stale.extend(self.memory.wanted.take().map(|wanted| wanted.key));
        (self.ready, self.is_changed) = (None, true);
    }

    /// Hands a due factor to the springs, or submits a job for one.
    pub fn provide(&mut self, springs: &mut MassSpring, entity: Entity, site: &StepContext<'_>) {
        let Some(parted_at) = self.memory.parted_at else { return };
        let jobs = site.tick.jobs;
        if std::mem::take(&mut self.is_new) {
            springs.forget_factor();
            if self.memory.wanted.is_some() {
                // So that it is used from the same time as without the restart.
                self.ready =
                    Some(made(springs.network(), springs.mobility(), site.period_secs(), springs.config()));
            }
        }
        self.stale.retain(|key| jobs.take(*key).is_none());
        let Some(wanted) = self.memory.wanted else {
            if site.tick.time >= parted_at + WHOLE {
                self.ask(springs, entity, site);
            }
            return;
        };
        if let Some(output) = jobs.take(wanted.key) {
            self.ready = output.downcast::<SheetFactor>().ok().map(|factor| *factor);
        }
        if site.tick.time >= wanted.due
            && let Some(factor) = self.ready.take()
        {
            springs.take_factor(factor);
            self.memory = SpringFactor { jobs: self.memory.jobs, ..SpringFactor::default() };
            self.is_changed = true;
        }
    }

    fn ask(&mut self, springs: &MassSpring, entity: Entity, site: &StepContext<'_>) {
        let (network, mobility) = (springs.network().clone(), springs.mobility().to_vec());
        let (dt, config) = (site.period_secs(), *springs.config());
        let work = move || Box::new(made(&network, &mobility, dt, &config)) as JobOutput;
        let key = entity.to_bits() ^ ((self.memory.jobs + 1) << 48);
        if site.tick.jobs.submit(Job { key, takes: JOB, work: Box::new(work) }) {
            self.memory.jobs += 1;
            // A tick later than it is delivered.
            let due = site.tick.time + JOB + site.tick.period;
            self.memory.wanted = Some(WantedSheetFactor { due, key });
            self.is_changed = true;
        }
    }

    /// The state that a restart needs, if it has changed.
    pub fn take_changes(&mut self) -> Option<SpringFactor> {
        std::mem::take(&mut self.is_changed).then_some(self.memory)
    }
}

fn made(network: &Network, mobility: &[f64], dt: f64, config: &Config) -> SheetFactor {
    SheetFactor::new(network, mobility, dt, config)
}
