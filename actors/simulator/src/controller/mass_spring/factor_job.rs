//! The factor that the implicit steps of a sheet are solved with, while the sheet comes apart: until it has been whole for a
//! while it goes on without, and then a job makes the next one beside the ticks.

use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::{Component, ComponentError, Entity, Job, JobOutput, SimTime};

use crate::mass_spring::{Config, MassSpring, Network, SheetFactor};

/// For so long nothing may have come apart before a factor is worth making.
const WHOLE: SimTime = SimTime(300_000_000);
/// What one takes in lock-step, however long it takes.
const JOB: SimTime = SimTime(100_000_000);

/// What another life needs to know of the factor of a sheet's springs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpringFactor {
    /// When it came apart last, if it has no factor since.
    pub parted_at: Option<SimTime>,
    /// The one that is being made.
    pub wanted: Option<WantedSheetFactor>,
    /// Jobs so far.
    pub jobs: u64,
}
impl Component for SpringFactor {
    const NAME: &'static str = "spring_factor";
    fn check(&self) -> Result<(), ComponentError> {
        Ok(())
    }
}

/// A factor that is made beside the ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WantedSheetFactor {
    /// From when on it is to serve, if it is there.
    pub due: SimTime,
    /// The number of the job.
    pub key: u64,
}

/// Who sees to it that a sheet has its factor.
pub(crate) struct FactorKeeper {
    memory: SpringFactor,
    is_changed: bool,
    /// What a former life has asked for is asked for again.
    is_new: bool,
    ready: Option<SheetFactor>,
    /// Jobs whose sheet has come apart since.
    stale: Vec<u64>,
}

impl FactorKeeper {
    /// Goes on with what an earlier life knew.
    pub fn new(memory: Option<&SpringFactor>) -> Self {
        let memory = memory.copied().unwrap_or_default();
        Self { memory, is_changed: false, is_new: true, ready: None, stale: Vec::new() }
    }

    /// The springs have followed a sheet that has come apart.
    pub fn parted(&mut self, at: SimTime) {
        self.memory.parted_at = Some(at);
        self.stale.extend(self.memory.wanted.take().map(|wanted| wanted.key));
        (self.ready, self.is_changed) = (None, true);
    }

    /// Gives springs the factor that is due, or has one made.
    pub fn serve(&mut self, springs: &mut MassSpring, entity: Entity, site: &StepContext<'_>) {
        let Some(parted_at) = self.memory.parted_at else { return };
        let jobs = site.tick.jobs;
        if std::mem::take(&mut self.is_new) {
            springs.forget_factor();
            if self.memory.wanted.is_some() {
                // That it serves when it would have.
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

    /// What a later life needs, if it is not what was told before.
    pub fn news(&mut self) -> Option<SpringFactor> {
        std::mem::take(&mut self.is_changed).then_some(self.memory)
    }
}

fn made(network: &Network, mobility: &[f64], dt: f64, config: &Config) -> SheetFactor {
    SheetFactor::new(network, mobility, dt, config)
}
