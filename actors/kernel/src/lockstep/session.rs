//! The lock-step session: its parts, its clock and its event order.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use thiserror::Error;
use trocar_scene::{Batch, ComponentError, EntityAllocator, Registry, SimTime, Snapshot};

use super::branching::{IssuedSnapshot, Moment};
use super::faulting::ModelHang;
use super::operating::OperatorWriter;
use super::slot::{NEVER, Slot, Ticked, Zombie};
use crate::admission::all_refused;
use crate::commit::CommitBuffer;
use crate::faults::{FaultLog, FaultPlanError, FaultSchedule};
use crate::model_core::{ModelCore, Outcome};
use crate::operator::OPERATOR;
use crate::runtime::panics::guarded;
use crate::runtime::{ControllerReport, Permission, TickStats};
use crate::spec::{
    BEGIN_MAX, CommitSink, FaultKind, FaultSink, MODEL, Mode, Peer, SessionOutcome, SessionSpec, StopWhen,
    ZeroForces,
};
use crate::state_hash::StateHash;
use crate::supervision::{Action, ChildId, Event, GroupSpec, Supervisor, TreeError};

/// Publication period of the Model, and so the most that a roll-back after a panic can lose. Publications and goal
/// checks have their own time grid, independent of other due times, so that a read-only participant (a recorder)
/// changes nothing.
pub(super) const PUBLISH_EVERY: SimTime = SimTime::from_millis(10);

/// Longest wait for closing a recording; long, because virtual time has no deadline.
const CLOSE_MAX: Duration = Duration::from_secs(60);

/// Why a session cannot begin.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The scene cannot be encoded.
    #[error("the scene at the start: {0}")]
    Scene(#[from] ComponentError),
    /// The supervisor tree is wrong.
    #[error("{0}")]
    Tree(#[from] TreeError),
    /// A rate cannot be scheduled.
    #[error("controller '{name}': rate {rate_hz} Hz; valid: above 0, up to 1e6")]
    Rate {
        /// The controller.
        name: String,
        /// Its rate.
        rate_hz: f64,
    },
    /// A peer has a period of zero.
    #[error("device '{0}': its period is 0 ns; valid: above 0")]
    Period(String),
    /// A controller is missing from the tree.
    #[error("controller '{0}' does not stand in the supervisor tree")]
    NotSupervised(String),
    /// The session begins too late.
    #[error("begin: {0}; valid: up to {BEGIN_MAX}")]
    Begin(SimTime),
    /// A fault does not fit the session.
    #[error(transparent)]
    Fault(#[from] FaultPlanError),
    /// A first start failed.
    #[error("{0}")]
    Start(String),
}

pub(super) struct PeerSlot {
    pub(super) peer: Box<dyn Peer>,
    pub(super) next: SimTime,
}

/// A session on one thread in virtual time.
pub struct LockstepSession {
    /// Session time at the start; in a branch, that of the session from which it stems.
    pub(super) begin: SimTime,
    pub(super) now: SimTime,
    pub(super) registry: Arc<Registry>,
    pub(super) seed: u64,
    pub(super) core: ModelCore,
    pub(super) slots: Vec<Slot>,
    pub(super) operator: OperatorWriter,
    pub(super) peers: Vec<PeerSlot>,
    pub(super) supervisor: Supervisor,
    pub(super) model: ChildId,
    pub(super) model_up: bool,
    pub(super) model_resumed: bool,
    /// A kill of the Model is ordered and pending.
    pub(super) model_kill: bool,
    pub(super) model_stall: SimTime,
    /// The hang of the Model, if it hangs.
    pub(super) model_hangs: Option<ModelHang>,
    /// Times at which abandoned Models end.
    pub(super) model_zombies: Vec<SimTime>,
    /// Whether a batch may be waiting for the Model.
    pub(super) queued: bool,
    pub(super) zombies: Vec<Zombie>,
    deadline: SimTime,
    pub(super) next_publish: SimTime,
    pub(super) fault_sinks: Vec<(String, Arc<dyn FaultSink>)>,
    pub(super) faults: FaultSchedule,
    pub(super) fault_log: FaultLog,
    pub(super) zero_forces: Vec<ZeroForces>,
    pub(super) stop_when: Option<StopWhen>,
    pub(super) next_stop_check: SimTime,
    pub(super) until: SimTime,
    /// Whether the first lives of a resumed session are being built.
    pub(super) resuming: bool,
    /// The latest issued snapshots, oldest first.
    pub(super) given: VecDeque<IssuedSnapshot>,
    pub(super) exit: Option<i32>,
    actions: Vec<Action>,
    commit_sink: Option<Box<dyn CommitSink>>,
    recording_complete: Option<bool>,
    spare_commits: CommitBuffer,
    pub(super) model_stats: TickStats,
    begun: Instant,
}

impl LockstepSession {
    /// Starts a session at [`SessionSpec::begin`] with all its controllers.
    ///
    /// # Errors
    /// [`SessionError`]; a controller whose first construction fails ends the session, as in live mode.
    pub fn new(spec: SessionSpec) -> Result<Self, SessionError> {
        Self::start_at(spec, None)
    }

    /// Starts all controllers at the session's begin, or at the moment of another session.
    pub(super) fn start_at(mut spec: SessionSpec, moment: Option<Moment>) -> Result<Self, SessionError> {
        if spec.begin > BEGIN_MAX {
            return Err(SessionError::Begin(spec.begin));
        }
        let children = spec.children();
        let mut core = match &moment {
            Some(moment) => moment.core(spec.scene, spec.station),
            None => ModelCore::new(spec.scene, spec.station)?,
        };
        core.keep_commits(spec.commit_sink.is_some());
        for controller in &spec.controllers {
            if !(controller.rate_hz > 0.0 && controller.rate_hz <= 1e6) {
                let (name, rate_hz) = (controller.name.clone(), controller.rate_hz);
                return Err(SessionError::Rate { name, rate_hz });
            }
        }
        let tree = spec.tree.take().unwrap_or_else(|| GroupSpec::default_tree(children));
        let supervisor = Supervisor::new(tree, spec.seed, spec.zombies_max)?;
        let supervised =
            |name: &str| supervisor.find(name).ok_or_else(|| SessionError::NotSupervised(name.to_owned()));
        let model = supervised(MODEL)?;
        let mut slots = Vec::with_capacity(spec.controllers.len());
        for controller in spec.controllers {
            let child = supervised(&controller.name)?;
            slots.push(Slot::new(controller, child, spec.station));
        }
        let mut peers = Vec::with_capacity(spec.peers.len());
        for peer in spec.peers {
            if peer.period_ns() == 0 {
                return Err(SessionError::Period(peer.name().to_owned()));
            }
            peers.push(PeerSlot { peer, next: spec.begin });
        }
        let operator = EntityAllocator::new(spec.station, OPERATOR.0);
        operator.skip_to(core.view().first_free(spec.station, OPERATOR.0));
        let mut session = Self {
            begin: spec.begin,
            now: spec.begin,
            registry: core.view().registry().clone(),
            seed: spec.seed,
            core,
            slots,
            operator: OperatorWriter::new(operator, 0),
            peers,
            supervisor,
            model,
            model_up: false,
            model_resumed: true,
            model_kill: false,
            model_stall: SimTime::ZERO,
            model_hangs: None,
            model_zombies: Vec::new(),
            queued: false,
            zombies: Vec::new(),
            deadline: SimTime::ZERO,
            next_publish: spec.begin,
            fault_sinks: spec.fault_sinks,
            faults: FaultSchedule::default(),
            fault_log: FaultLog::new(&spec.faults),
            zero_forces: spec.zero_forces,
            stop_when: spec.stop_when,
            next_stop_check: spec.begin,
            until: spec.until.unwrap_or(NEVER),
            resuming: false,
            given: VecDeque::new(),
            exit: None,
            actions: Vec::new(),
            commit_sink: spec.commit_sink,
            recording_complete: None,
            spare_commits: CommitBuffer::new(),
            model_stats: TickStats::new(MODEL, 0.0),
            begun: Instant::now(),
        };
        session.faults = FaultSchedule::new(&spec.faults, &session.fault_targets())?;
        match moment {
            Some(moment) => session.go_on_from(moment),
            None => session.begin_anew(),
        }
        session.tell(Event::Tick);
        session.resuming = false;
        match session.exit {
            Some(_) => {
                let reason = session.supervisor.reason().unwrap_or("the session did not start");
                Err(SessionError::Start(reason.to_owned()))
            }
            None => Ok(session),
        }
    }

    /// Simulates everything due before `until` and returns whether the session continues: `false` once its goal is
    /// reached, its time is up, or the supervisor gave up.
    pub fn step_until(&mut self, until: SimTime) -> bool {
        while self.exit.is_none() {
            let until = until.min(self.until);
            let at = self.next_instant();
            if at >= until {
                self.now = self.now.max(until);
                self.publish();
                break;
            }
            self.instant(at);
        }
        self.is_running()
    }

    /// Whether the session is still running.
    pub fn is_running(&self) -> bool {
        self.exit.is_none() && self.now < self.until
    }

    /// Session time at the start; of a branch, at the start of the session from which it stems.
    pub fn begin(&self) -> SimTime {
        self.begin
    }

    /// Current session time.
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// The current scene, by reference.
    pub fn view(&self) -> &Snapshot {
        self.core.view()
    }

    /// A snapshot of the current scene.
    pub fn snapshot(&mut self) -> Arc<Snapshot> {
        self.publish();
        self.remember();
        self.core.published().clone()
    }

    /// The state hash so far.
    pub fn hash(&self) -> StateHash {
        self.core.hash()
    }

    /// The Model.
    pub fn model(&self) -> &ModelCore {
        &self.core
    }

    /// The supervisor.
    pub fn supervisor(&self) -> &Supervisor {
        &self.supervisor
    }

    /// HandleParts the session: forces to zero, controllers down, recording closed.
    pub fn finish(mut self) -> SessionOutcome {
        if self.exit.is_none() {
            self.tell(Event::ShutdownRequested { code: 0 });
        }
        // The devices' last step, which finds that no force may be rendered.
        for slot in &mut self.peers {
            slot.peer.step(slot.next);
            slot.peer.finish(slot.next);
        }
        // A controller stuck in a step is abandoned after its limit.
        while self.exit.is_none() {
            let Some(at) = self.supervisor.next_deadline(self.now) else { break };
            self.now = at;
            self.tell(Event::Tick);
        }
        self.close();
        self.forget_zombies();
        let snapshot = self.core.published().clone();
        let refused = self.slots.iter().filter_map(|slot| {
            let report = slot.report(self.elapsed());
            all_refused(&report, slot.stats.refusal()?, &snapshot)
        });
        SessionOutcome {
            refused: refused.collect(),
            mode: Mode::Lockstep,
            code: self.exit.unwrap_or(0),
            reason: self.supervisor.reason().map(str::to_owned),
            begin: self.begin,
            sim: self.now,
            wall: SimTime::from(self.begun.elapsed()),
            hash: self.core.hash(),
            snapshot,
            controllers: self.reports(),
            model: self.model_stats.report(self.elapsed()),
            faults: self.fault_log.rows().to_vec(),
            incidents: self.supervisor.incidents().to_vec(),
            held: self.supervisor.given_up(),
            zombies: self.supervisor.zombies(),
            recording_complete: self.recording_complete,
            // Lock-step needs no thread priority.
            permission: Permission { fifo: false, refused: String::new() },
        }
    }

    /// One row per controller, in the order of the session, as it is now. Lateness is zero by construction; step times
    /// are measured on the machine.
    pub fn reports(&self) -> Vec<ControllerReport> {
        self.slots.iter().map(|slot| slot.report(self.elapsed())).collect()
    }

    /// Time since the session began.
    fn elapsed(&self) -> SimTime {
        self.now.since(self.begin)
    }

    /// Statistics of every controller so far, in the order of the session.
    pub fn statistics(&self) -> impl Iterator<Item = &TickStats> {
        self.slots.iter().map(|slot| &slot.stats)
    }

    /// The next instant at which anything is due.
    fn next_instant(&self) -> SimTime {
        let mut at = self.deadline.min(self.next_publish).min(self.model_wakes_at());
        if self.stop_when.is_some() {
            at = at.min(self.next_stop_check);
        }
        for slot in &self.slots {
            at = at.min(slot.wakes_at());
        }
        for peer in &self.peers {
            at = at.min(peer.next);
        }
        for zombie in &self.zombies {
            at = at.min(zombie.pending.at);
        }
        if let Some(fault) = self.faults.next_at() {
            at = at.min(fault);
        }
        at.max(self.now)
    }

    /// Runs everything due at `at`, in order.
    fn instant(&mut self, at: SimTime) {
        self.now = at;
        self.inject_due_faults();
        if self.deadline <= at {
            self.tell(Event::Tick);
        }
        self.check_model();
        if self.queued && self.model_up {
            self.drain_queues();
        }
        self.zombies_finish();
        for index in 0..self.slots.len() {
            self.deliver(index);
            self.finish_slow_step(index);
        }
        for slot in &mut self.peers {
            if slot.next <= at {
                slot.peer.step(at);
                slot.next += SimTime(slot.peer.period_ns());
            }
        }
        for index in 0..self.slots.len() {
            if self.slots[index].next <= at {
                self.run_tick(index);
            }
        }
        if at >= self.next_publish {
            self.publish();
        }
        if self.fault_log.is_open() {
            self.check_sinks();
        }
        if let Some(stop) = &self.stop_when
            && at >= self.next_stop_check
        {
            self.next_stop_check = at + stop.every;
            if (stop.check)(self.core.view()) {
                // This instant is complete; the next one is beyond the end.
                self.until = at;
            }
        }
    }

    fn run_tick(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        let number = slot.advance();
        if !slot.is_free() {
            self.missed_tick(index);
            return;
        }
        // A life that starts at once repeats the tick in which its predecessor died, as in live mode.
        let lived =
            self.attempt(index, number) || (self.slots[index].is_free() && self.attempt(index, number));
        if !lived {
            self.slots[index].stats.missed(1);
        }
    }

    /// Runs one step of slot `index`; returns whether it survived.
    fn attempt(&mut self, index: usize, number: u64) -> bool {
        let slot = &mut self.slots[index];
        let begun = Instant::now();
        let ticked = slot.tick(number, self.now, self.core.view(), &self.registry);
        let lived = !matches!(ticked, Ticked::Died(_));
        if lived {
            let took = begun.elapsed().saturating_sub(std::mem::take(&mut slot.beside));
            slot.stats.ran(self.now, SimTime::ZERO, SimTime::from(took));
            slot.stats.found(match &ticked {
                Ticked::Ready(batch) => batch.commands.listed(),
                _ => None,
            });
        }
        if slot.late && !matches!(ticked, Ticked::Busy) {
            slot.late = false;
            let child = slot.child;
            self.tell(Event::Late { child, late: false });
        }
        self.finish_tick(index, ticked);
        lived
    }

    fn missed_tick(&mut self, index: usize) {
        let slot = &mut self.slots[index];
        slot.stats.missed(1);
        if slot.is_alive() && !slot.late {
            slot.late = true;
            let child = slot.child;
            self.tell(Event::Late { child, late: true });
            self.notice(index, FaultKind::Slow);
        }
    }

    pub(super) fn finish_tick(&mut self, index: usize, ticked: Ticked) {
        match ticked {
            Ticked::Busy => {}
            Ticked::Died(cause) => self.died(index, cause),
            Ticked::Idle => {
                if self.slots[index].active_faults.queue_full {
                    self.notice(index, FaultKind::QueueFull);
                } else {
                    self.did_good_work(index);
                }
            }
            Ticked::Ready(batch) => self.send(index, batch),
        }
    }

    /// Submits a batch of slot `index` to the Model.
    pub(super) fn commit(&mut self, index: usize, mut batch: Box<Batch>) {
        let outcome = self.decide(&mut batch);
        let slot = &mut self.slots[index];
        match outcome {
            Ok(Outcome::Applied { .. }) => {
                slot.applied += 1;
                slot.unpublished += 1;
                slot.give_back(batch);
                self.did_good_work(index);
            }
            Ok(Outcome::Conflict(_)) => {
                slot.stats.conflict();
                slot.give_back(batch);
                self.did_good_work(index);
            }
            Ok(Outcome::Rejected(why)) => {
                slot.stats.rejected(&why);
                slot.give_back(batch);
                self.notice(index, FaultKind::Nan);
                self.step_is_over(index);
            }
            // The batch is discarded.
            Err(text) => {
                slot.stats.quarantined();
                let writer = slot.writer;
                self.model_died(Some(writer), text);
            }
        }
    }

    pub(super) fn decide(&mut self, batch: &mut Batch) -> Result<Outcome, String> {
        let (core, now) = (&mut self.core, self.now);
        guarded(|| core.apply(batch, now))
    }

    /// Submits a batch of an ended life, which the Model refuses by its epoch.
    pub(super) fn apply_stale(&mut self, index: usize, mut batch: Box<Batch>) {
        if batch.commands.is_empty() {
            return;
        }
        batch.commands.seal();
        self.slots[index].sent += 1;
        if let Ok(Outcome::Rejected(why)) = self.decide(&mut batch) {
            self.slots[index].stats.rejected(&why);
        }
    }

    /// Sends an event to the supervisor, and executes its actions until none is left.
    pub(super) fn tell(&mut self, event: Event) {
        let mut actions = std::mem::take(&mut self.actions);
        self.supervisor.apply(event, self.now, &mut actions);
        let mut done = 0;
        while done < actions.len() {
            let action = actions[done].clone();
            done += 1;
            if let Some(answer) = self.act(action) {
                self.supervisor.apply(answer, self.now, &mut actions);
            }
        }
        actions.clear();
        self.actions = actions;
        self.deadline = self.supervisor.next_deadline(self.now).unwrap_or(NEVER);
    }

    fn publish(&mut self) {
        self.next_publish = self.now + PUBLISH_EVERY;
        self.core.publish();
        self.slots.iter_mut().for_each(|slot| slot.unpublished = 0);
        if let Some(sink) = &mut self.commit_sink {
            let commits = self.core.swap_commits(std::mem::take(&mut self.spare_commits));
            self.spare_commits = sink.committed(self.core.published(), commits);
            self.spare_commits.clear();
        }
    }

    pub(super) fn close(&mut self) {
        self.publish();
        if let Some(mut sink) = self.commit_sink.take() {
            self.recording_complete = Some(sink.close(CLOSE_MAX));
        }
        self.core.keep_commits(false);
    }
}
