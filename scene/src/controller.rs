//! The hot spot: what a behaviour must implement to act on the scene.

use std::any::Any;
use std::cell::RefCell;
use std::collections::VecDeque;

use thiserror::Error;

use crate::access::Access;
use crate::commands::Commands;
use crate::entity::Entity;
use crate::event::Events;
use crate::snapshot::Snapshot;
use crate::time::SimTime;

/// A behaviour: reads a snapshot, writes commands, at a rate of its own.
///
/// Everything needed to resume must be in the scene: after a failure a new one is built from the latest
/// snapshot and continues where the old one stood.
pub trait Controller: Send + 'static {
    /// What it reads and writes; asked once after construction.
    fn access(&self) -> Access;

    /// One step. Must not block; whatever it commands is applied as a whole or not at all.
    ///
    /// # Errors
    /// An error ends this life of the controller; the supervisor decides about the next one.
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError>;
}

/// The circumstances of one step.
pub struct Tick<'a> {
    /// Time for which the step computes: a whole multiple of the period after the start.
    pub time: SimTime,
    /// Time between two steps.
    pub period: SimTime,
    /// Number of the step; skipped ones count.
    pub number: u64,
    /// The controller's own entity.
    pub me: Entity,
    /// Which life of the controller this is.
    pub epoch: u32,
    /// What happened since its last step.
    pub events: Events<'a>,
    /// Long work that runs elsewhere.
    pub jobs: &'a Jobs,
}

/// Why a controller gave up.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ControllerError {
    /// Something in the scene is missing or wrong.
    #[error("{0}")]
    Scene(String),
    /// Its device is gone.
    #[error("device: {0}")]
    Device(String),
    /// Its computation failed.
    #[error("{0}")]
    Failed(String),
}

/// What a controller is built from, at the start and after every failure.
pub struct BuildContext<'a> {
    /// The latest snapshot.
    pub scene: &'a Snapshot,
    /// Time of construction; in a session that goes on from a snapshot, that of the controller's last tick before
    /// it, which is what its rows tell.
    pub time: SimTime,
    /// The controller's name.
    pub name: &'a str,
    /// Its own entity.
    pub me: Entity,
    /// Which life this will be; the first is 1.
    pub epoch: u32,
    /// The session's seed.
    pub seed: u64,
}

/// Result of a job, to be downcast by whoever submitted it.
pub type JobOutput = Box<dyn Any + Send>;
/// Work that is too long for a step.
pub type JobWork = Box<dyn FnOnce() -> JobOutput + Send>;

/// A submitted job.
pub struct Job {
    /// The submitter's name for it.
    pub key: u64,
    /// In lock-step the output is delivered this long after submission, however long the work takes.
    pub takes: SimTime,
    /// The work.
    pub work: JobWork,
}

/// At most this many jobs wait at once.
pub const JOBS_MAX: usize = 16;

/// A controller's long work: submitted in one step, delivered to a later one.
#[derive(Default)]
pub struct Jobs {
    inner: RefCell<JobState>,
}

#[derive(Default)]
struct JobState {
    submitted: VecDeque<Job>,
    delivered: VecDeque<(u64, JobOutput)>,
}

impl Jobs {
    /// Asks for work; false when too many jobs wait already.
    pub fn submit(&self, job: Job) -> bool {
        let mut inner = self.inner.borrow_mut();
        let room = inner.submitted.len() < JOBS_MAX;
        if room {
            inner.submitted.push_back(job);
        }
        room
    }
    /// The output of a finished job, once.
    pub fn take(&self, key: u64) -> Option<JobOutput> {
        let mut inner = self.inner.borrow_mut();
        let at = inner.delivered.iter().position(|(candidate, _)| *candidate == key)?;
        inner.delivered.remove(at).map(|(_, output)| output)
    }
    /// The host takes the submitted jobs.
    pub fn next_submitted(&self) -> Option<Job> {
        self.inner.borrow_mut().submitted.pop_front()
    }
    /// The host delivers an output, at most [`JOBS_MAX`] between two steps. Beyond that bound the oldest one is forgotten, which
    /// then nobody has asked for in the last step: who asks in each gets all. Of a job that panics nothing is delivered: that
    /// ends the life of its controller, and the next one submits it anew.
    pub fn deliver(&self, key: u64, output: JobOutput) {
        let mut inner = self.inner.borrow_mut();
        if inner.delivered.len() >= JOBS_MAX {
            inner.delivered.pop_front();
        }
        inner.delivered.push_back((key, output));
    }
}
