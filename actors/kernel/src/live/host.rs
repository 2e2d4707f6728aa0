//! Host of a controller: an actix actor on its own arbiter. It survives its controller's panics, errors and restarts;
//! only a stall costs its thread.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use actix::prelude::*;
use trocar_scene::{
    BuildContext, Commands, Controller, ControllerError, Events, Jobs, SimTime, Snapshot, Tick,
};

use super::shared::{Life, Shared, Writer};
use crate::handle::{Submitted, WriterHandle};
use crate::runtime::{Budget, Due, JobRunner, Schedule, Ticker, Verdict, guarded, sched, ticker};
use crate::supervision::{Cause, Event};

/// Ticks over which lateness is judged.
const LATE_WINDOW: u32 = 128;
/// Late or missed ticks within the window that make a controller late.
const LATE_MAX: u64 = 8;

/// Message that begins a life.
#[derive(Message)]
#[rtype(result = "()")]
pub(super) struct BeginLife(pub(super) Arc<Life>);

/// The actor.
pub(super) struct HostActor {
    shared: Arc<Shared>,
    writer: Arc<Writer>,
}

impl HostActor {
    pub(super) fn new(shared: Arc<Shared>, writer: Arc<Writer>) -> Self {
        Self { shared, writer }
    }
}

impl Actor for HostActor {
    type Context = Context<Self>;
}

impl Handler<BeginLife> for HostActor {
    type Result = ();
    fn handle(&mut self, BeginLife(life): BeginLife, _: &mut Self::Context) {
        let (shared, writer) = (self.shared.clone(), self.writer.clone());
        actix_rt::spawn(async move {
            let cause = live(&shared, &writer, &life).await;
            life.running.store(false, Ordering::Relaxed);
            if life.is_abandoned() {
                shared.report(Event::ZombieEnded);
                Arbiter::current().stop();
            } else {
                writer.state.stats.leave_thread();
                shared.died(&writer.state, &life, cause);
            }
        });
    }
}

/// One life, from construction to the drop of the controller; returns why it ended.
async fn live(shared: &Shared, writer: &Writer, life: &Life) -> Cause {
    let tid = sched::current_tid();
    life.tid.store(tid, Ordering::Relaxed);
    writer.state.stats.enter_thread(tid);
    let controller = match build(shared, writer, life) {
        Ok(controller) => controller,
        Err(cause) => return cause,
    };
    let access = match guarded(|| controller.access()) {
        Ok(access) => access,
        Err(panic) => return drop_after(controller, Cause::Panic(panic)),
    };
    if let Err(error) = shared.declare(writer, &access).await {
        return drop_after(controller, Cause::Error(error));
    }
    let schedule = schedule(shared, writer, life);
    let ticker = match Ticker::new(schedule, shared.clock.clone()) {
        Ok(ticker) => ticker,
        Err(error) => return drop_after(controller, Cause::Error(format!("timer: {error}"))),
    };
    let mut hosted = HostedController {
        handle: shared.open(writer, life),
        shared,
        writer,
        life,
        controller,
        jobs: Jobs::default(),
        runner: JobRunner::new(&writer.state.name),
        resumed: false,
        late_ticks: 0,
        window: 0,
    };
    life.running.store(true, Ordering::Release);
    shared.report(Event::Started { child: writer.state.child, incarnation: life.incarnation });
    let cause = hosted.run(ticker).await;
    drop_after(hosted.controller, cause)
}

/// The first tick of a session is the next one of the schedule, and not before the session begins; a later life
/// continues where the last one stopped.
fn schedule(shared: &Shared, writer: &Writer, life: &Life) -> Schedule {
    let (phase, period) = (writer.spec.phase, writer.spec.period());
    let now = shared.clock.now().max(shared.begin);
    let next = if life.incarnation > 1 && writer.state.stats.ticks() > 0 {
        writer.next_tick.load(Ordering::Relaxed)
    } else if now <= phase {
        0
    } else {
        now.since(phase).0.div_ceil(period.0)
    };
    Schedule::new(phase, period, next)
}

fn build(shared: &Shared, writer: &Writer, life: &Life) -> Result<Box<dyn Controller>, Cause> {
    let scene = shared.published.load_full();
    if life.incarnation == 1 {
        writer.events_seen.store(scene.events().next(), Ordering::Relaxed);
    }
    let context = BuildContext {
        scene: &scene,
        time: shared.clock.now(),
        period: writer.spec.period(),
        name: &writer.state.name,
        me: writer.allocator.me(),
        epoch: life.incarnation,
        seed: shared.seed,
    };
    match guarded(|| (writer.spec.factory)(&context)) {
        Ok(Ok(controller)) => Ok(controller),
        Ok(Err(error)) => Err(Cause::Error(error.to_string())),
        Err(panic) => Err(Cause::Panic(panic)),
    }
}

/// Drops a controller, which may panic as well; the first thing that went wrong is the cause.
fn drop_after(controller: Box<dyn Controller>, cause: Cause) -> Cause {
    match guarded(|| drop(controller)) {
        Err(panic) if cause == Cause::Stop => Cause::Panic(format!("while it was dropped: {panic}")),
        _ => cause,
    }
}

/// An injected stall: blocks until its duration is over, the life is abandoned or the session ends.
pub(super) fn stall(shared: &Shared, span: SimTime) {
    let begun = shared.clock.now();
    while shared.clock.now().since(begun) < span && !shared.over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

struct HostedController<'a> {
    shared: &'a Shared,
    writer: &'a Writer,
    life: &'a Life,
    controller: Box<dyn Controller>,
    handle: WriterHandle,
    jobs: Jobs,
    runner: JobRunner,
    resumed: bool,
    late_ticks: u64,
    window: u32,
}

impl HostedController<'_> {
    async fn run(&mut self, mut ticker: Ticker) -> Cause {
        let mut budget = Budget::new(self.writer.spec.period(), ticker::LEAD);
        ticker.set_spinning(budget.may_spin());
        loop {
            if self.shared.resting.load(Ordering::Acquire) {
                if let Err(cause) = self.rest(&mut ticker).await {
                    return cause;
                }
                if self.life.should_end() {
                    return Cause::Stop;
                }
            }
            let due = ticker.next().await;
            if self.life.should_end() {
                return Cause::Stop;
            }
            let due = match due {
                Ok(Some(due)) => due,
                Ok(None) => {
                    // Slow, not stalled.
                    let now = self.shared.clock.now();
                    self.life.bump(now);
                    self.life.bump(now);
                    continue;
                }
                Err(error) => return Cause::Error(format!("timer: {error}")),
            };
            let stats = &self.writer.state.stats;
            if due.missed > 0 {
                stats.missed(due.missed);
            }
            let begun = self.shared.clock.now();
            self.life.bump(begun);
            let held = self.writer.state.fault_hooks.is_held();
            let outcome = if held {
                Ok(())
            } else {
                guarded(|| self.step(due)).unwrap_or_else(|panic| Err(Cause::Panic(panic)))
            };
            let ended = self.shared.clock.now();
            self.life.bump(ended);
            // Set after the beat: in the other order the watchdog would take a long first step for a stall.
            if !held {
                self.life.settled.store(true, Ordering::Release);
            }
            if self.life.is_abandoned() {
                return Cause::Stop;
            }
            let step = ended.since(begun);
            let lateness = begun.since(due.at);
            if let Err(cause) = outcome {
                // The next life repeats the tick in which this one died, instead of waiting for another.
                self.writer.next_tick.store(due.number, Ordering::Relaxed);
                return cause;
            }
            self.writer.next_tick.store(due.number + 1, Ordering::Relaxed);
            stats.ran(due.at, lateness, step);
            self.judge_lateness(due.missed + u64::from(lateness.0 >= self.writer.spec.period().0));
            if !self.resumed {
                self.resumed = true;
                let (child, incarnation) = (self.writer.state.child, self.life.incarnation);
                self.shared.report(Event::Resumed { child, incarnation });
            }
            match budget.observe(step) {
                Verdict::Keep => {}
                Verdict::StopSpinning => ticker.set_spinning(false),
                Verdict::Spin => ticker.set_spinning(true),
                // The controller continues without real-time priority, and the report shows it. Only a thread that had
                // the priority is demoted.
                Verdict::Demote => {
                    if sched::is_real_time() && sched::normal_current().is_ok() {
                        stats.demoted();
                    }
                }
            }
        }
    }

    /// Waits without ticks until the session resumes or this life ends.
    async fn rest(&mut self, ticker: &mut Ticker) -> Result<(), Cause> {
        self.life.at_rest.store(true, Ordering::Release);
        let begun = Instant::now();
        let mut outcome = Ok(());
        while outcome.is_ok() && self.shared.resting.load(Ordering::Acquire) && !self.life.should_end() {
            let scene = self.shared.published.load();
            let controller = &mut self.controller;
            outcome = guarded(|| controller.rest(begun.elapsed().into(), &scene)).map_err(Cause::Panic);
            drop(scene);
            if let (Ok(()), Err(error)) = (&outcome, ticker.rest().await) {
                outcome = Err(Cause::Error(format!("timer: {error}")));
            }
        }
        ticker.skip_to_now();
        // The watchdog checks again from here on; the beat restarts its limit.
        let now = self.shared.clock.now();
        self.life.bump(now);
        self.life.bump(now);
        self.life.at_rest.store(false, Ordering::Release);
        outcome
    }

    /// One step, from the snapshot to the ring. After warm-up it allocates nothing of its own.
    fn step(&mut self, due: Due) -> Result<(), Cause> {
        let fault_hooks = &self.writer.state.fault_hooks;
        if fault_hooks.take_kill() {
            panic!("fault injected: kill");
        }
        if let Some(span) = fault_hooks.take_stall() {
            stall(self.shared, span);
            fault_hooks.end_stall();
        }
        if let Some(span) = fault_hooks.slow() {
            std::thread::sleep(span.to_duration());
        }
        self.runner.deliver(&self.jobs).map_err(Cause::Panic)?;
        let scene = self.shared.published.load();
        let me = self.writer.allocator.me();
        let tick = Tick {
            time: due.at,
            period: self.writer.spec.period(),
            number: due.number,
            me,
            epoch: self.life.incarnation,
            events: Events::new(scene.events(), self.writer.events_seen.load(Ordering::Relaxed)),
            jobs: &self.jobs,
        };
        let out = self.handle.begin(due.at);
        tick_controller(&mut *self.controller, &tick, &scene, out)?;
        self.writer.state.stats.found(out.listed());
        if fault_hooks.nan() {
            out.event("fault_nan", me, None, f64::NAN);
        }
        self.writer.events_seen.store(scene.events().next(), Ordering::Relaxed);
        if self.handle.submit(due.number, due.at, scene.revision()) == Submitted::Dropped {
            self.writer.state.stats.dropped();
        }
        self.runner.collect(&self.jobs).map_err(|error| Cause::Error(format!("jobs: {error}")))
    }

    fn judge_lateness(&mut self, late: u64) {
        self.late_ticks += late;
        self.window += 1;
        if self.late_ticks > LATE_MAX || self.window >= LATE_WINDOW {
            self.life.late.store(self.late_ticks > LATE_MAX, Ordering::Relaxed);
            self.late_ticks = 0;
            self.window = 0;
        }
    }
}

fn tick_controller(
    controller: &mut dyn Controller,
    tick: &Tick<'_>,
    scene: &Snapshot,
    out: &mut Commands,
) -> Result<(), Cause> {
    controller.tick(tick, scene, out).map_err(|error: ControllerError| Cause::Error(error.to_string()))
}
