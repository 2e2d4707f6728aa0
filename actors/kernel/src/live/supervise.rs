//! Supervisor thread of a live session: executes the supervisor core's actions. It starts and abandons arbiters, raises
//! fences, injects the plan's faults and ends the session.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use actix::prelude::*;
use trocar_scene::{Access, SimTime};

use super::host::{self, HostActor};
use super::model::{self, ModelActor};
use super::shared::{Life, Report, Shared, Writer, lock};
use crate::faults::{FaultLog, FaultRow, FaultSchedule, soundness};
use crate::model_core::ModelCore;
use crate::runtime::{Permission, guarded, sched};
use crate::spec::{FaultKind, FaultOrder, FaultSink, MODEL, StopWhen, ZeroForces, takes};
use crate::supervision::{Action, Cause, ChildId, Event, Health, Incident, RuntimeClass, Supervisor as Tree};

/// Longest pause between two polls.
const PAUSE_MAX: SimTime = SimTime::from_millis(500);
/// Polling period while a fault is active.
const FAULT_PAUSE: SimTime = SimTime::from_millis(2);
/// Longest wait for a recording to be closed.
const CLOSE_MAX: Duration = Duration::from_millis(900);
/// Ticks for which the session's last publication is awaited.
const SINK_TRIES: u32 = 60;

/// Publicly visible status of the session.
#[derive(Default)]
pub(super) struct Status {
    pub(super) health: BTreeMap<String, Health>,
    pub(super) incidents: Vec<Incident>,
    pub(super) faults: Vec<FaultRow>,
    pub(super) held: Vec<(String, String)>,
    pub(super) zombies: u32,
    pub(super) up: bool,
    pub(super) permission: Option<Permission>,
    pub(super) ended: Option<Ended>,
}

/// How it ended.
#[derive(Clone)]
pub(super) struct Ended {
    pub(super) code: i32,
    pub(super) reason: Option<String>,
    pub(super) at: SimTime,
    pub(super) recording_complete: Option<bool>,
}

/// The status, with a notification of its end.
#[derive(Default)]
pub(super) struct StatusBoard {
    pub(super) status: Mutex<Status>,
    pub(super) changed: Condvar,
}

/// The plan's counters of one target when its fault began.
#[derive(Clone, Copy, Default)]
struct Counters {
    /// Batches applied, or ticks for a target that commits nothing.
    good: u64,
    dropped: u64,
    rejected: u64,
    slow: u64,
    /// Batches that a faulty link lost, delayed or duplicated.
    link: u64,
}

pub(super) struct SupervisorThread {
    pub(super) shared: Arc<Shared>,
    pub(super) board: Arc<StatusBoard>,
    pub(super) tree: Tree,
    pub(super) inbox: Receiver<Report>,
    pub(super) log: SyncSender<String>,
    pub(super) zero_forces: Vec<ZeroForces>,
    pub(super) sinks: Vec<(String, Arc<dyn FaultSink>)>,
    pub(super) schedule: FaultSchedule,
    pub(super) faults: FaultLog,
    pub(super) until: Option<SimTime>,
    pub(super) stop_when: Option<StopWhen>,
    pub(super) core: Option<ModelCore>,
    pub(super) system: System,
}

enum ChildActor {
    Model(Addr<ModelActor>),
    Host(Addr<HostActor>),
}

/// Further state of the supervisor thread.
struct Run {
    addresses: BTreeMap<ChildId, ChildActor>,
    next_check: SimTime,
    begun: BTreeMap<String, Counters>,
    incidents_told: usize,
    faults_shown_open: bool,
    recording_complete: Option<bool>,
}

impl SupervisorThread {
    /// The thread's main function; returns when the session has ended.
    pub(super) fn run(mut self) {
        System::set_current(self.system.clone());
        let permission = sched::promote_current(RuntimeClass::Watchdog);
        let mut run = Run {
            addresses: BTreeMap::new(),
            next_check: SimTime::ZERO,
            begun: BTreeMap::new(),
            incidents_told: 0,
            faults_shown_open: false,
            recording_complete: None,
        };
        self.note_permission(permission);
        self.dispatch(Event::Tick, &mut run);
        while self.tree.exit_code().is_none() {
            let now = self.shared.clock.now();
            let pause = self.next_wake(now, &run).since(now).max(SimTime::from_micros(50));
            match self.inbox.recv_timeout(Duration::from_nanos(pause.0)) {
                Ok(report) => self.handle_report(report, &mut run),
                Err(RecvTimeoutError::Timeout) => self.dispatch(Event::Tick, &mut run),
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.run_due_work(&mut run);
        }
        self.end(&run);
    }

    fn next_wake(&self, now: SimTime, run: &Run) -> SimTime {
        let mut at = now + PAUSE_MAX;
        let checks = self.stop_when.as_ref().map(|_| run.next_check);
        let looking =
            self.faults.is_open() || self.shared.intake.is_any_link_bad() || self.schedule.is_waiting(now);
        let looks = if looking { Some(now + FAULT_PAUSE) } else { self.schedule.next_waiting() };
        for next in [self.tree.next_deadline(now), self.schedule.next_at(), self.until, checks, looks] {
            at = at.min(next.unwrap_or(at));
        }
        at
    }

    fn handle_report(&mut self, report: Report, run: &mut Run) {
        match report {
            Report::Event(event) => self.dispatch(event, run),
            Report::Inject(order) => self.inject(&order),
            Report::Hold(child, held) => {
                if let Some(state) = self.shared.state_of(child) {
                    state.fault_hooks.set_held(held);
                }
                self.dispatch(Event::Held { child, held }, run);
            }
            Report::Permission(permission) => self.note_permission(permission),
        }
    }

    fn note_permission(&self, permission: Permission) {
        let mut status = lock(&self.board.status);
        if status.permission.as_ref().is_none_or(|known| known.fifo) {
            status.permission = Some(permission);
        }
    }

    /// Feeds an event to the tree and executes its actions.
    fn dispatch(&mut self, event: Event, run: &mut Run) {
        let now = self.shared.clock.now();
        self.note_for_faults(&event, now);
        let mut actions = Vec::new();
        self.tree.apply(event, now, &mut actions);
        for action in actions {
            self.act(action, run);
        }
        self.update_status(run);
    }

    fn note_for_faults(&mut self, event: &Event, now: SimTime) {
        if !self.faults.is_open() {
            return;
        }
        let name = |child: &ChildId| self.shared.state_of(*child).map(|state| state.name.clone());
        match event {
            Event::Died { child, cause, .. } if cause.is_abnormal() => {
                if let Some(name) = name(child) {
                    self.faults.detected(&name, now);
                }
            }
            Event::Stalled { child, .. } => {
                if let Some(name) = name(child) {
                    self.faults.detected(&name, now);
                }
            }
            Event::Started { child, .. } => {
                if let Some(name) = name(child) {
                    self.faults.restarted(&name, now);
                }
            }
            Event::Resumed { child, .. } => {
                if let Some(name) = name(child) {
                    self.faults.resumed(&name, now);
                }
            }
            _ => {}
        }
    }

    fn act(&mut self, action: Action, run: &mut Run) {
        match action {
            Action::Fence { child, epoch } => self.shared.fence(child, epoch),
            Action::Start { child, incarnation, fresh } => self.start(child, incarnation, fresh, run),
            Action::Stop { child } => {
                if let Some(state) = self.shared.state_of(child) {
                    state.life.load().stop.store(true, Ordering::Relaxed);
                    if child == self.shared.model.child {
                        self.shared.bell.notify_one();
                    }
                }
            }
            Action::Abandon { child, incarnation } => {
                run.addresses.remove(&child);
                if let Some(state) = self.shared.state_of(child) {
                    let life = state.life.load();
                    if life.incarnation == incarnation {
                        life.abandoned.store(true, Ordering::Release);
                        let tid = life.tid.load(Ordering::Relaxed);
                        if tid != 0
                            && let Err(error) = sched::demote(tid)
                        {
                            self.print(format!("{}: its thread could not be demoted: {error}", state.name));
                        }
                    }
                }
            }
            Action::ZeroForces => {
                for zero in &self.zero_forces {
                    if let Err(panic) = guarded(|| zero()) {
                        self.print(format!("a device's force could not be set to zero: {panic}"));
                    }
                }
            }
            Action::CloseRecording => run.recording_complete = self.close_recording(),
            Action::Exit(_) => {}
        }
    }

    fn start(&mut self, child: ChildId, incarnation: u32, fresh: bool, run: &mut Run) {
        let shared = self.shared.clone();
        let Some(state) = shared.state_of(child) else { return };
        let life = Life::new(incarnation);
        state.life.store(life.clone());
        if incarnation > 1 {
            state.stats.restarted();
        }
        let fresh = fresh || !run.addresses.contains_key(&child);
        let failed = if fresh { self.start_actor_thread(child, run).err() } else { None };
        let failed = failed.or_else(|| {
            let sent = match run.addresses.get(&child) {
                Some(ChildActor::Model(to)) => to.try_send(model::BeginLife(life.clone())).is_ok(),
                Some(ChildActor::Host(to)) => to.try_send(host::BeginLife(life.clone())).is_ok(),
                None => false,
            };
            (!sent).then(|| "its actor does not take the order to start".to_owned())
        });
        if let Some(error) = failed {
            run.addresses.remove(&child);
            self.shared.died(state, &life, Cause::Error(error));
        }
    }

    /// Starts a thread, a runtime and an actor for `child`.
    fn start_actor_thread(&mut self, child: ChildId, run: &mut Run) -> Result<(), String> {
        let shared = self.shared.clone();
        let Some(state) = shared.state_of(child) else { return Ok(()) };
        let (name, class, reports) = (state.name.clone(), state.class, shared.reports.clone());
        let start_actor_thread = Arbiter::try_with_tokio_rt(move || {
            sched::name_current(&name);
            let _ = reports.try_send(Report::Permission(sched::promote_current(class)));
            tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()
        })
        .map_err(|error| format!("no thread for it: {error}"))?;
        let address = if child == shared.model.child {
            let (shared, core) = (shared.clone(), self.core.take());
            let make = move |_: &mut Context<ModelActor>| ModelActor::new(shared, core);
            ChildActor::Model(ModelActor::start_in_arbiter(&start_actor_thread.handle(), make))
        } else {
            let Some(writer) = shared.writer_of(child).cloned() else { return Ok(()) };
            let shared = shared.clone();
            let make = move |_: &mut Context<HostActor>| HostActor::new(shared, writer);
            ChildActor::Host(HostActor::start_in_arbiter(&start_actor_thread.handle(), make))
        };
        // Dropping the start_actor_thread detaches its thread, because a hanging thread must never be joined.
        run.addresses.insert(child, address);
        Ok(())
    }

    /// Handles everything that is due by time rather than by report.
    fn run_due_work(&mut self, run: &mut Run) {
        let now = self.shared.clock.now();
        while let Some(order) = self.schedule.due(now, &self.shared.published.load()) {
            if order.begins {
                self.faults.injected(order.index as usize, now);
                run.begun.insert(order.target.clone(), self.counters(&order.target));
            } else {
                self.faults.healed(order.index as usize, now);
                run.begun.insert(order.target.clone(), self.counters(&order.target));
            }
            self.inject(&order);
        }
        if self.shared.intake.is_any_link_bad() {
            // No doorbell announces delayed messages.
            self.shared.bell.notify_one();
        }
        let open = self.faults.is_open();
        if open || run.faults_shown_open {
            self.check_faults(run, now);
            // One more poll after the last fault ends, to record its end.
            run.faults_shown_open = open;
            lock(&self.board.status).faults = self.faults.rows().to_vec();
        }
        let mut shut = self.until.is_some_and(|until| now >= until);
        if let Some(stop) = &self.stop_when
            && now >= run.next_check
        {
            run.next_check = now + stop.every;
            let snapshot = self.shared.published.load_full();
            shut |= guarded(|| (stop.check)(&snapshot)).unwrap_or(false);
        }
        if shut {
            self.until = None;
            self.stop_when = None;
            self.dispatch(Event::ShutdownRequested { code: 0 }, run);
        }
    }

    fn inject(&self, order: &FaultOrder) {
        if order.target == MODEL {
            self.shared.model.fault_hooks.apply(order);
            // An idle Model would not notice the change otherwise.
            self.shared.bell.notify_one();
        } else if let Some(writer) = self.shared.writers.iter().find(|w| w.state.name == order.target) {
            writer.state.fault_hooks.apply(order);
            if order.kind == FaultKind::QueueFull {
                writer.lane.set_queue_full(order.begins);
            }
            if order.kind.is_of_link() {
                self.shared.intake.fault(writer.id, &writer.lane, order);
                self.shared.bell.notify_one();
            }
        }
        // The recorder is both a controller and the disk behind it.
        for (_, sink) in self.sinks.iter().filter(|(name, _)| takes(name, &order.target)) {
            sink.fault(order);
        }
    }

    fn counters(&self, target: &str) -> Counters {
        if target == MODEL {
            return Counters { good: self.shared.batches.load(Ordering::Relaxed), ..Counters::default() };
        }
        let Some(writer) = self.shared.writers.iter().find(|w| w.state.name == target) else {
            return Counters::default();
        };
        count(writer)
    }

    /// Handles non-fatal faults: detected by lost or late batches, resumed when batches are applied again.
    fn check_faults(&mut self, run: &mut Run, now: SimTime) {
        let open: Vec<(String, bool)> = self
            .faults
            .rows()
            .iter()
            .filter(|row| row.injected.is_some() && row.resumed.is_none())
            .map(|row| (row.target.clone(), row.healed.is_some()))
            .collect();
        for (target, healed) in open {
            if target == MODEL {
                if self.shared.model.fault_hooks.take_stall_ended() {
                    self.faults.stall_ended(MODEL, now);
                }
                let then = run.begun.get(MODEL).copied().unwrap_or_default();
                if healed && self.counters(MODEL).good > then.good {
                    self.faults.resumed(MODEL, now);
                }
                continue;
            }
            let Some(writer) = self.shared.writers.iter().find(|w| w.state.name == target).cloned() else {
                continue;
            };
            let (then, is) = (run.begun.get(&target).copied().unwrap_or_default(), count(&writer));
            if is.dropped > then.dropped
                || is.rejected > then.rejected
                || is.slow > then.slow
                || is.link > then.link
            {
                self.faults.detected(&target, now);
            }
            if writer.state.fault_hooks.take_stall_ended() {
                self.faults.stall_ended(&target, now);
            }
            if healed && is.good > then.good {
                self.faults.resumed(&target, now);
            }
        }
        for (name, sink) in &self.sinks {
            if let Some(sound) = sink.is_sound() {
                self.faults.looked_at(name, sound, now);
            }
            for (target, sound) in soundness(&self.faults, name, sink.as_ref()) {
                self.faults.looked_at(&target, sound, now);
            }
        }
    }

    fn close_recording(&self) -> Option<bool> {
        if !self.shared.has_sink {
            return None;
        }
        // The Model has ended or was given up; if it hangs in the recorder, the recording stays open.
        for _ in 0..SINK_TRIES {
            if let Ok(mut sink) = self.shared.sink.try_lock() {
                return Some(match sink.as_mut() {
                    Some(sink) => guarded(|| sink.close(CLOSE_MAX)).unwrap_or(false),
                    None => false,
                });
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        Some(false)
    }

    /// Publishes the tree's state.
    fn update_status(&mut self, run: &mut Run) {
        let incidents = self.tree.incidents();
        for incident in &incidents[run.incidents_told.min(incidents.len())..] {
            self.print(format!("{}: {}", incident.child, describe(&incident.cause)));
        }
        run.incidents_told = incidents.len();
        let mut status = lock(&self.board.status);
        for state in self.shared.child_states() {
            if let Some(health) = self.tree.health(state.child)
                && status.health.get(&state.name) != Some(&health)
            {
                status.health.insert(state.name.clone(), health);
            }
        }
        status.zombies = self.tree.zombies();
        status.held = self.tree.given_up();
        status.incidents.clear();
        status.incidents.extend_from_slice(self.tree.incidents());
        let up = self.tree.is_up();
        if up != status.up {
            status.up = up;
            drop(status);
            self.board.changed.notify_all();
        }
    }

    fn print(&self, line: String) {
        // A full log queue loses a message, which is better than blocking here.
        let _ = self.log.try_send(line);
    }

    fn end(self, run: &Run) {
        self.shared.over.store(true, Ordering::Relaxed);
        // Responsive threads stop; hanging threads are abandoned.
        self.system.stop();
        let mut status = lock(&self.board.status);
        status.faults = self.faults.rows().to_vec();
        status.ended = Some(Ended {
            code: self.tree.exit_code().unwrap_or(crate::supervision::EXIT_GAVE_UP),
            reason: self.tree.reason().map(str::to_owned),
            at: self.shared.clock.now(),
            recording_complete: run.recording_complete,
        });
        drop(status);
        self.board.changed.notify_all();
    }
}

fn count(writer: &Writer) -> Counters {
    let row = &writer.state.stats;
    let silent = lock(&writer.declared).as_ref().is_some_and(|access| *access == Access::new());
    let applied = writer.applied.load(Ordering::Relaxed);
    Counters {
        good: if silent { row.ticks() } else { applied },
        dropped: writer.lane.dropped(),
        rejected: row.rejections(),
        slow: row.ticks_missed() + row.ticks_late(),
        link: writer.lane.lost() + writer.lane.delayed() + writer.lane.duplicated(),
    }
}

fn describe(cause: &Cause) -> String {
    match cause {
        Cause::Panic(text) => format!("panicked: {text}"),
        Cause::Error(text) => format!("failed: {text}"),
        Cause::Stop => "ended".to_owned(),
        Cause::Stall => "stalled; its thread was fenced and left behind".to_owned(),
        Cause::StartTimeout => "was not built in time; its thread was fenced and left behind".to_owned(),
    }
}
