//! Slot of one controller in a lock-step session: its life, its current batch, its jobs.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_scene::controller::JOBS_MAX;
use trocar_scene::{
    Batch, Commands, Controller, ControllerError, Entity, EntityAllocator, Events, JobOutput, Jobs,
    Provenance, Registry, Revision, SimTime, Snapshot, Tick, WriterId,
};

use crate::faults::{BatchInFlight, LinkCounts, LinkFaults};
use crate::runtime::panics::guarded;
use crate::runtime::{Account, ControllerReport, TickStats};
use crate::spec::ControllerSpec;
use crate::supervision::{Cause, ChildId};
use crate::token_bucket::{TokenBucket, count};

/// Due time of an event that never happens.
pub(super) const NEVER: SimTime = SimTime(u64::MAX);

/// A delayed step, as on a stalled thread: it reads the scene and sends its batch when the delay ends.
#[derive(Clone, Copy)]
pub(super) struct Pending {
    pub(super) at: SimTime,
    number: u64,
    due: SimTime,
}

/// A life abandoned during a step.
pub(super) struct Zombie {
    pub(super) slot: usize,
    pub(super) pending: Pending,
    controller: Box<dyn Controller>,
    batch: Box<Batch>,
    period: SimTime,
    epoch: u32,
    cursor: u64,
    jobs: Jobs,
}

impl Zombie {
    /// Finishes the delayed step and ends the life; returns its batch.
    pub(super) fn wake(mut self, scene: &Snapshot) -> Box<Batch> {
        let tick = Tick {
            time: self.pending.due,
            period: self.period,
            number: self.pending.number,
            me: self.batch.commands.me(),
            epoch: self.epoch,
            events: Events::new(scene.events(), self.cursor),
            jobs: &self.jobs,
        };
        let outcome = step(&mut *self.controller, &tick, scene, &mut self.batch);
        let controller = self.controller;
        let _ = guarded(move || drop(controller));
        if outcome.is_some() {
            self.batch.commands.clear();
        }
        self.batch
    }
}

/// Runs one step of a controller into a batch; returns why it failed, if it did.
fn step(
    controller: &mut dyn Controller,
    tick: &Tick<'_>,
    scene: &Snapshot,
    batch: &mut Batch,
) -> Option<Cause> {
    batch.commands.clear();
    batch.commands.begin(tick.time);
    batch.provenance.epoch = tick.epoch;
    batch.provenance.tick = tick.number;
    batch.provenance.time = tick.time;
    batch.provenance.based_on = scene.revision();
    let commands = &mut batch.commands;
    failure(guarded(|| controller.tick(tick, scene, commands)))
}

/// A finished job to be delivered.
struct Delivery {
    at: SimTime,
    key: u64,
    /// The job's output, or its panic message.
    output: Result<JobOutput, String>,
}

/// The active faults of a controller.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ActiveFaults {
    pub(super) kill: bool,
    /// Length of the stall of the next step; zero: none.
    pub(super) stall: SimTime,
    /// Extra time of each step.
    pub(super) slow: SimTime,
    pub(super) queue_full: bool,
    pub(super) nan: bool,
}

pub(super) struct Slot {
    pub(super) spec: ControllerSpec,
    pub(super) child: ChildId,
    pub(super) writer: WriterId,
    pub(super) me: Entity,
    pub(super) stats: TickStats,
    /// Number and time of the next tick that is due.
    number: u64,
    pub(super) next: SimTime,
    pub(super) allocator: EntityAllocator,
    /// Alive between [`Slot::start`] and the end of this life.
    controller: Option<Box<dyn Controller>>,
    pub(super) epoch: u32,
    jobs: Jobs,
    deliveries: Vec<Delivery>,
    /// Run time of the last step's jobs, which run in parallel in a live session.
    pub(super) beside: Duration,
    pub(super) cursor: u64,
    spare: Option<Box<Batch>>,
    /// The unfinished step.
    pub(super) pending: Option<Pending>,
    /// Time at which the watchdog reports a stall.
    pub(super) stalls_at: SimTime,
    /// Batches that wait while the Model is down.
    pub(super) queue: VecDeque<Box<Batch>>,
    /// It was asked to end, and ends after its step.
    pub(super) stopping: bool,
    pub(super) resumed: bool,
    pub(super) active_faults: ActiveFaults,
    pub(super) late: bool,
    /// The link to the Model.
    pub(super) link: LinkFaults<BatchInFlight>,
    flow: TokenBucket,
    pub(super) sent: u64,
    pub(super) applied: u64,
    /// Batches applied since the last publication.
    pub(super) unpublished: u64,
    /// Batches lost in roll-backs of the Model.
    pub(super) forgotten: u64,
}

/// Result of a tick.
pub(super) enum Ticked {
    /// Nothing to apply.
    Idle,
    /// A batch to be applied now.
    Ready(Box<Batch>),
    /// The step continues until the time in [`Slot::pending`].
    Busy,
    /// The step ended this life.
    Died(Cause),
}

impl Slot {
    pub(super) fn new(spec: ControllerSpec, child: ChildId, station: u16) -> Self {
        Self {
            writer: WriterId(spec.writer),
            me: Entity::of_writer(station, spec.writer),
            stats: TickStats::new(spec.name.clone(), spec.rate_hz),
            number: 0,
            next: spec.phase,
            allocator: EntityAllocator::new(station, spec.writer),
            controller: None,
            epoch: 0,
            jobs: Jobs::default(),
            deliveries: Vec::new(),
            beside: Duration::ZERO,
            cursor: 0,
            spare: None,
            pending: None,
            stalls_at: NEVER,
            queue: VecDeque::new(),
            stopping: false,
            resumed: false,
            active_faults: ActiveFaults::default(),
            late: false,
            link: LinkFaults::default(),
            flow: TokenBucket::new(spec.flow),
            sent: 0,
            applied: 0,
            unpublished: 0,
            forgotten: 0,
            child,
            spec,
        }
    }

    /// Time at which this slot next needs attention.
    pub(super) fn wakes_at(&self) -> SimTime {
        let pending = self.pending.as_ref().map_or(NEVER, |pending| pending.at);
        let arrives = self.link.next_due().unwrap_or(NEVER);
        self.next.min(pending).min(self.stalls_at).min(arrives)
    }

    /// Begins a new life with this controller.
    pub(super) fn start(&mut self, controller: Box<dyn Controller>, epoch: u32) {
        self.controller = Some(controller);
        self.epoch = epoch;
        self.jobs = Jobs::default();
        self.deliveries.clear();
        self.flow = TokenBucket::new(self.spec.flow);
        self.resumed = false;
        self.stopping = false;
    }

    pub(super) fn is_alive(&self) -> bool {
        self.controller.is_some()
    }

    /// Whether it can take a step now.
    pub(super) fn is_free(&self) -> bool {
        self.is_alive() && self.pending.is_none() && !self.stopping
    }

    /// HandleParts this life. A panic in the controller's destructor is contained.
    pub(super) fn end(&mut self) {
        let controller = self.controller.take();
        let _ = guarded(move || drop(controller));
        self.pending = None;
        self.stalls_at = NEVER;
        self.stopping = false;
        self.late = false;
    }

    /// Leaves the stuck controller behind with the step it is stuck in; `slot` is this slot's number.
    pub(super) fn abandon(&mut self, slot: usize, registry: &Arc<Registry>) -> Option<Zombie> {
        let left = self.controller.take().zip(self.pending.take());
        let left = left.map(|(controller, pending)| Zombie {
            slot,
            pending,
            controller,
            batch: blank(registry, &self.allocator, self.writer),
            period: self.spec.period(),
            epoch: self.epoch,
            cursor: self.cursor,
            jobs: std::mem::take(&mut self.jobs),
        });
        self.end();
        left
    }

    /// The time of tick `number`.
    fn time_of(&self, number: u64) -> SimTime {
        // Computed from the tick number rather than summed, so that no rate drifts.
        self.spec.phase + SimTime((number as f64 * 1e9 / self.spec.rate_hz).round() as u64)
    }

    /// The time of the tick before the next one; `begin`, that of the session, before the first.
    pub(super) fn last_tick(&self, begin: SimTime) -> SimTime {
        self.number.checked_sub(1).map_or(begin, |number| self.time_of(number).max(begin))
    }

    /// Continues at `now`, before the ticks due then; earlier ticks count as done.
    pub(super) fn skip_to(&mut self, now: SimTime) {
        let guess = (now.since(self.spec.phase).0 as f64 * 1e-9 * self.spec.rate_hz) as u64;
        self.number = guess.saturating_sub(1);
        while self.time_of(self.number) < now {
            self.number += 1;
        }
        self.next = self.time_of(self.number);
    }

    /// Its row of the report; `elapsed` is the time since the session began.
    pub(super) fn report(&self, elapsed: SimTime) -> ControllerReport {
        let LinkCounts { lost, corrupted, delayed, duplicated, reordered } = *self.link.counts();
        self.stats.set_account(Account {
            sent: self.sent,
            applied: self.applied,
            lost: lost + corrupted + self.forgotten,
            delayed: delayed + reordered,
            duplicated,
        });
        self.stats.report(elapsed)
    }

    /// Advances to the next due time and returns the number of the tick due now.
    pub(super) fn advance(&mut self) -> u64 {
        let number = self.number;
        self.number += 1;
        self.next = self.time_of(self.number);
        number
    }

    /// Runs the tick that is due at `now`.
    pub(super) fn tick(
        &mut self,
        number: u64,
        now: SimTime,
        scene: &Snapshot,
        registry: &Arc<Registry>,
    ) -> Ticked {
        if !self.is_alive() {
            return Ticked::Idle;
        }
        if std::mem::take(&mut self.active_faults.kill) {
            return Ticked::Died(Cause::Panic("killed by a fault".into()));
        }
        let extra = self.active_faults.slow + std::mem::take(&mut self.active_faults.stall);
        if extra > SimTime::ZERO {
            self.pending = Some(Pending { at: now + extra, number, due: now });
            let limit = self.spec.child.silence_limit(self.resumed);
            self.stalls_at = if extra > limit { now + limit } else { NEVER };
            return Ticked::Busy;
        }
        self.step((number, now), now, scene, registry)
    }

    /// Runs the delayed step.
    pub(super) fn late_step(
        &mut self,
        pending: Pending,
        now: SimTime,
        scene: &Snapshot,
        registry: &Arc<Registry>,
    ) -> Ticked {
        self.step((pending.number, pending.due), now, scene, registry)
    }

    fn step(
        &mut self,
        (number, due): (u64, SimTime),
        now: SimTime,
        scene: &Snapshot,
        registry: &Arc<Registry>,
    ) -> Ticked {
        if self.controller.is_some()
            && let Err(panic) = self.deliver_jobs(now)
        {
            return Ticked::Died(Cause::Panic(panic));
        }
        let Some(controller) = self.controller.as_mut() else { return Ticked::Idle };
        let mut batch = match self.spare.take() {
            Some(batch) => batch,
            None => blank(registry, &self.allocator, self.writer),
        };
        let tick = Tick {
            time: due,
            period: self.spec.period(),
            number,
            me: self.me,
            epoch: self.epoch,
            events: Events::new(scene.events(), self.cursor),
            jobs: &self.jobs,
        };
        let failed = step(&mut **controller, &tick, scene, &mut batch);
        self.cursor = scene.events().next();
        self.take_jobs(now);
        match failed {
            Some(cause) => {
                self.give_back(batch);
                Ticked::Died(cause)
            }
            None => self.hand_over(batch, now),
        }
    }

    /// Passes a step's batch through the controller's handle.
    fn hand_over(&mut self, mut batch: Box<Batch>, now: SimTime) -> Ticked {
        if self.active_faults.nan {
            batch.commands.event("fault.nan", self.me, None, f64::NAN);
        }
        if batch.commands.is_empty() {
            self.give_back(batch);
            return Ticked::Idle;
        }
        if self.active_faults.queue_full || !self.flow.admit(count(&batch.commands), now) {
            self.stats.dropped();
            self.give_back(batch);
            return Ticked::Idle;
        }
        batch.commands.seal();
        Ticked::Ready(batch)
    }

    /// Queues a batch while the Model is down; drops it when the queue is full.
    pub(super) fn enqueue(&mut self, batch: Box<Batch>) {
        if self.queue.len() < self.spec.ring_capacity {
            self.queue.push_back(batch);
        } else {
            // In a live session the ring would have refused it.
            self.sent -= 1;
            self.stats.dropped();
        }
    }

    /// Keeps an emptied batch for the next tick.
    pub(super) fn give_back(&mut self, batch: Box<Batch>) {
        self.spare = Some(batch);
    }

    /// Delivers the finished jobs that are due, as in a live session: at most as many as the inbox holds, the rest
    /// before the next step.
    ///
    /// # Errors
    /// The panic message of a job: its controller would otherwise wait for ever.
    fn deliver_jobs(&mut self, now: SimTime) -> Result<(), String> {
        for due in self.deliveries.extract_if(.., |delivery| delivery.at <= now).take(JOBS_MAX) {
            let output = due.output.map_err(|panic| format!("job {}: {panic}", due.key))?;
            self.jobs.deliver(due.key, output);
        }
        Ok(())
    }

    /// Runs submitted jobs at once, to their end; each is delivered at its declared time.
    fn take_jobs(&mut self, now: SimTime) {
        let begun = Instant::now();
        while let Some(job) = self.jobs.next_submitted() {
            let output = guarded(job.work);
            self.deliveries.push(Delivery { at: now + job.takes, key: job.key, output });
        }
        self.beside = begun.elapsed();
    }
}

pub(super) fn blank(registry: &Arc<Registry>, allocator: &EntityAllocator, writer: WriterId) -> Box<Batch> {
    Box::new(Batch {
        provenance: Provenance { writer, epoch: 0, tick: 0, time: SimTime::ZERO, based_on: Revision::ZERO },
        commands: Commands::new(registry.clone(), allocator.clone()),
    })
}

/// Why a step failed, if it did.
fn failure(result: Result<Result<(), ControllerError>, String>) -> Option<Cause> {
    match result {
        Ok(Ok(())) => None,
        Ok(Err(error)) => Some(Cause::Error(error.to_string())),
        Err(text) => Some(Cause::Panic(text)),
    }
}
