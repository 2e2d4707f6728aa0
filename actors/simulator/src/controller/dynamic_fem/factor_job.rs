//! Background jobs that refactorise the matrix of a body after a topology change: ordering, pattern and values.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::{Job, JobOutput, SimTime};

use super::saved_state::{LentFactor, WantedFactor};
use super::{DynamicFemBody, Solver};
use crate::controller::thermal_damage::ThermalDamage;
use crate::dynamic_fem::{Analysis, DynamicFem};

/// Duration of a job in lock-step, however long it takes.
const JOB: SimTime = SimTime(20_000_000);

/// Result of a job.
pub(crate) type Built = Result<Analysis, String>;

/// A body before its topology changes.
pub(crate) struct Former<'a> {
    pub tets: &'a [[u32; 4]],
    /// Its number of nodes: they come first.
    pub nodes: usize,
}

impl Former<'_> {
    /// A solver of that body at rest.
    pub fn solver(
        &self,
        kind: &DynamicFemBody,
        rest: &[Point3<f64>],
        pinned: &[u32],
        heated: &ThermalDamage,
    ) -> Result<DynamicFem, String> {
        let mesh = DynamicFemBody::mesh(&rest[..self.nodes.min(rest.len())], self.tets, true)?;
        let own: Vec<u32> = pinned.iter().copied().filter(|node| (*node as usize) < self.nodes).collect();
        kind.at_rest(mesh, &own, heated)
    }
}

fn built(
    kind: &DynamicFemBody,
    wanted: &WantedFactor,
    rest: &[Point3<f64>],
    pinned: &[u32],
    heated: &ThermalDamage,
) -> Built {
    let former = Former { tets: &wanted.tets, nodes: wanted.positions.len() };
    let mut solver = former.solver(kind, rest, pinned, heated)?;
    solver.factor_at(&wanted.positions, wanted.dt, &[]).map_err(|error| error.to_string())?;
    Ok(solver.into_analysis())
}

impl Solver {
    /// After a restart: computes the factor in progress again, so that it is used from the same time.
    pub(crate) fn resume(&mut self, body: &Deformable, heated: &ThermalDamage) {
        if !self.solver.has_stale_factor() {
            self.memory.lent = None;
        }
        let wanted = self.memory.lent.as_ref().and_then(|lent| lent.wanted.as_ref());
        self.ready = wanted.map(|wanted| built(&self.kind, wanted, &body.rest, &body.pinned, heated));
    }

    /// Installs the computed factor once it is due.
    ///
    /// # Errors
    /// Why it could not be computed.
    pub(crate) fn take_over(&mut self, site: &StepContext<'_>) -> Result<(), String> {
        let Some(lent) = self.memory.lent.as_mut().filter(|_| self.solver.has_stale_factor()) else {
            return Ok(());
        };
        let Some(wanted) = &lent.wanted else { return Ok(()) };
        if let Some(output) = site.tick.jobs.take(wanted.key) {
            self.ready = output.downcast::<Built>().ok().map(|built| *built);
        }
        if site.tick.time < wanted.due {
            return Ok(());
        }
        let Some(built) = self.ready.take() else { return Ok(()) };
        let known = self.solver.positions().len() - lent.births.len();
        let births = lent.births[wanted.positions.len() - known..].to_vec();
        self.solver.take_over(built?, &births).map_err(|error| error.to_string())?;
        let tets = wanted.tets.clone();
        *lent = LentFactor { tets, births: Arc::new(births), wanted: None };
        self.memory.take(&self.solver);
        Ok(())
    }

    /// Submits a job for the current mesh, if the body uses an outdated factor.
    pub(crate) fn ask(
        &mut self,
        body: &Deformable,
        site: &StepContext<'_>,
        heated: impl FnOnce() -> ThermalDamage,
    ) {
        if !self.solver.has_stale_factor() {
            (self.memory.lent, self.ready) = (None, None);
            return;
        }
        let Some(lent) = self.memory.lent.as_mut().filter(|lent| lent.wanted.is_none()) else { return };
        self.memory.jobs += 1;
        let wanted = WantedFactor {
            tets: body.tets.clone(),
            positions: Arc::new(self.solver.positions().to_vec()),
            dt: site.period_secs(),
            // A tick later than it is delivered.
            due: site.tick.time + JOB + site.tick.period,
            key: body.entity.to_bits() ^ (self.memory.jobs << 48),
        };
        let (kind, rest, pinned) = (self.kind, body.rest.clone(), body.pinned.clone());
        let (of, heated) = (wanted.clone(), heated());
        let work = move || Box::new(built(&kind, &of, &rest, &pinned, &heated)) as JobOutput;
        if site.tick.jobs.submit(Job { key: wanted.key, takes: JOB, work: Box::new(work) }) {
            lent.wanted = Some(wanted);
        }
    }
}
