//! Controllers: the trait of all behaviours that act on the scene.

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

/// A behaviour that reads a snapshot and writes commands, at its own rate.
///
/// All state needed to resume must be in the scene: after a failure a new controller is built from the latest snapshot
/// and continues there.
pub trait Controller: Send + 'static {
    /// Its read and write access; called once after construction.
    fn access(&self) -> Access;

    /// One step. Must not block; its commands are applied atomically.
    ///
    /// # Errors
    /// An error ends this life of the controller; the supervisor decides about the next one.
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError>;

    /// Called about 20 times a second while a live session is paused: for those who keep something alive that does not
    /// stand still, such as connections. Session time is that of the last step or a little later; `passed` is how long
    /// the pause has lasted by a clock that runs on. Nothing can be written. Must not block.
    fn rest(&mut self, passed: SimTime, scene: &Snapshot) {
        let _ = (passed, scene);
    }
}

/// The circumstances of one step.
pub struct Tick<'a> {
    /// Time for which the step computes: a whole multiple of the period after the start.
    pub time: SimTime,
    /// Time between two steps.
    pub period: SimTime,
    /// Number of the step; skipped steps count.
    pub number: u64,
    /// The controller's own entity.
    pub me: Entity,
    /// The controller's epoch (number of its life).
    pub epoch: u32,
    /// Events since its last step.
    pub events: Events<'a>,
    /// Background jobs.
    pub jobs: &'a Jobs,
}

/// Why a controller gave up.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ControllerError {
    /// Something in the scene is missing or wrong.
    #[error("{0}")]
    Scene(String),
    /// Its device is unavailable.
    #[error("device: {0}")]
    Device(String),
    /// Its computation failed.
    #[error("{0}")]
    Failed(String),
}

/// Context for building a controller, at the start and after every failure.
pub struct BuildContext<'a> {
    /// The latest snapshot.
    pub scene: &'a Snapshot,
    /// Time of construction; in a session resumed from a snapshot, the time of the controller's last tick before it, to
    /// which its rows belong.
    pub time: SimTime,
    /// Length of its steps: the period of its rate.
    pub period: SimTime,
    /// The controller's name.
    pub name: &'a str,
    /// Its own entity.
    pub me: Entity,
    /// Epoch of the new life; the first is 1.
    pub epoch: u32,
    /// The session's seed.
    pub seed: u64,
}

/// Result of a job, to be downcast by its submitter.
pub type JobOutput = Box<dyn Any + Send>;
/// Work that is too long for a step.
pub type JobWork = Box<dyn FnOnce() -> JobOutput + Send>;

/// A submitted job.
pub struct Job {
    /// Key chosen by the submitter.
    pub key: u64,
    /// In lock-step the output is delivered this long after submission, regardless of the actual run time.
    pub takes: SimTime,
    /// The work.
    pub work: JobWork,
}

/// At most this many jobs wait at once.
pub const JOBS_MAX: usize = 16;

/// A controller's background jobs: submitted in one step, delivered to a later one.
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
    /// Submits a job; false when too many jobs are waiting.
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
    /// The host delivers an output, at most [`JOBS_MAX`] between two steps. Beyond that bound the oldest output is
    /// dropped, which the controller did not take in its last step: a controller that takes its outputs in each step
    /// gets all. A job that panics delivers nothing: its controller's life ends, and the next one submits it again.
    pub fn deliver(&self, key: u64, output: JobOutput) {
        let mut inner = self.inner.borrow_mut();
        if inner.delivered.len() >= JOBS_MAX {
            inner.delivered.pop_front();
        }
        inner.delivered.push_back((key, output));
    }
}
