//! The supervisor as a state machine without threads or clocks: events in, actions out. Restart policies, strategies,
//! intensity and escalation follow Erlang/OTP's `supervisor` (Armstrong 2003, ch. 5); stalls, fences and zombies are
//! additions for a shared address space.

use std::ops::Range;
use std::sync::Arc;

use trocar_scene::SimTime;
use trocar_scene::random::SplitMix64;

use super::child::{ChildSpec, Exhausted, GroupSpec, Restart, RuntimeClass};
use super::event::{Action, Cause, ChildId, Event, Incident};
use super::tree::{Flat, Group, Streak, TreeError, jitter};

/// Exit code when the root gives up.
pub const EXIT_GAVE_UP: i32 = 70;
/// Longest wait for the controllers at the end of the session.
pub const SHUTDOWN_CONTROLLERS_MAX: SimTime = SimTime::from_millis(900);
/// Longest wait for the Model after them.
pub const SHUTDOWN_MODEL_MAX: SimTime = SimTime::from_millis(400);
/// Incidents kept for the report; later ones are only counted.
pub const INCIDENTS_MAX: usize = 4_096;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Starts no earlier than this time, and after the members ahead of it in its cohort.
    Waiting(SimTime),
    /// Under construction, with this deadline.
    Starting(SimTime),
    Running,
    /// Asked to end, with this deadline.
    Stopping {
        until: SimTime,
        again: bool,
    },
    Ended {
        failed: bool,
    },
}

#[derive(Clone, Debug)]
pub(super) struct Child {
    pub(super) spec: ChildSpec,
    group: usize,
    pub(super) phase: Phase,
    /// Children that (re)start together, in order, share a number.
    cohort: u32,
    pub(super) incarnation: u32,
    /// The lowest epoch still accepted.
    epoch: u32,
    /// The next life needs a new thread.
    fresh: bool,
    pub(super) late: bool,
    pub(super) held: bool,
    pub(super) stalled: bool,
    streak: Streak,
    jitter: SplitMix64,
    incident: Option<usize>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Up,
    /// The controllers end first, then the Model.
    Controllers(i32),
    Model(i32),
    Down(i32),
}

/// The supervisor tree.
pub struct Supervisor {
    pub(super) tree: Arc<GroupSpec>,
    pub(super) children: Vec<Child>,
    groups: Vec<Group>,
    pub(super) stage: Stage,
    cohorts: u32,
    pub(super) zombies: u32,
    zombies_max: u32,
    pub(super) incidents: Vec<Incident>,
    pub(super) incidents_lost: u64,
    pub(super) reason: Option<String>,
    /// Children held for failing too often, with the reason.
    pub(super) given_up: Vec<(ChildId, String)>,
}

impl Supervisor {
    /// A tree with no child started yet. `seed` feeds the jitter of the pauses; more than `zombies_max` abandoned
    /// threads end the session.
    ///
    /// # Errors
    /// Names that are not unique, an empty tree, a back-off out of range, or one with which a child that always fails
    /// would be restarted for ever.
    pub fn new(root: GroupSpec, seed: u64, zombies_max: u32) -> Result<Self, TreeError> {
        let tree = Arc::new(root.clone());
        let Flat { groups, children, owner } = Flat::new(root, seed)?;
        let children = children
            .into_iter()
            .zip(owner)
            .map(|(spec, group)| Child {
                jitter: jitter(seed, &spec.id),
                spec,
                group,
                phase: Phase::Waiting(SimTime::ZERO),
                cohort: 0,
                incarnation: 0,
                epoch: 0,
                fresh: true,
                late: false,
                held: false,
                stalled: false,
                streak: Streak::default(),
                incident: None,
            })
            .collect();
        Ok(Self {
            tree,
            children,
            groups,
            stage: Stage::Up,
            cohorts: 0,
            zombies: 0,
            zombies_max,
            incidents: Vec::new(),
            incidents_lost: 0,
            reason: None,
            given_up: Vec::new(),
        })
    }

    /// Takes one event and appends the actions, in order. Also handles everything due at `now`.
    pub fn apply(&mut self, event: Event, now: SimTime, out: &mut Vec<Action>) {
        match event {
            Event::Started { child, incarnation } => self.on_started(child, incarnation, now),
            Event::Resumed { child, incarnation } => {
                if let Some(i) = self.current(child, incarnation)
                    && let Some(at) = self.children[i].incident.take()
                {
                    self.incidents[at].resumed = Some(now);
                }
            }
            Event::Died { child, incarnation, cause } => self.on_died(child, incarnation, cause, now, out),
            Event::Stalled { child, incarnation } => {
                if let Some(i) = self.current(child, incarnation)
                    && self.children[i].phase == Phase::Running
                {
                    self.abandon(i, Cause::Stall, now, out);
                }
            }
            Event::Late { child, late } => self.with(child, |c| c.late = late),
            Event::Held { child, held } => {
                self.with(child, |c| c.held = held);
                if !held {
                    self.try_again(child, now);
                }
            }
            Event::ZombieEnded => self.zombies = self.zombies.saturating_sub(1),
            Event::Tick => {}
            Event::ShutdownRequested { code } => {
                if self.stage == Stage::Up {
                    self.shut_down(code, now, out);
                }
            }
        }
        self.check_limits(now, out);
        self.start_due(now, out);
        self.finish(now, out);
    }

    /// The earliest time after `now` at which [`Event::Tick`] can change something.
    pub fn next_deadline(&self, now: SimTime) -> Option<SimTime> {
        self.children
            .iter()
            .filter_map(|child| match child.phase {
                Phase::Waiting(at) | Phase::Starting(at) | Phase::Stopping { until: at, .. } => Some(at),
                Phase::Running | Phase::Ended { .. } => None,
            })
            .filter(|at| *at > now)
            .min()
    }

    fn with(&mut self, child: ChildId, change: impl FnOnce(&mut Child)) {
        if let Some(child) = self.children.get_mut(usize::from(child.0)) {
            change(child);
        }
    }

    /// Index of the child if `incarnation` is its current life.
    fn current(&self, child: ChildId, incarnation: u32) -> Option<usize> {
        let i = usize::from(child.0);
        self.children.get(i).filter(|child| child.incarnation == incarnation).map(|_| i)
    }

    fn on_started(&mut self, child: ChildId, incarnation: u32, now: SimTime) {
        let Some(i) = self.current(child, incarnation) else { return };
        if !matches!(self.children[i].phase, Phase::Starting(_)) {
            return;
        }
        self.children[i].phase = Phase::Running;
        self.children[i].stalled = false;
        if let Some(at) = self.children[i].incident {
            self.incidents[at].restarted = Some(now);
        }
    }

    fn on_died(
        &mut self,
        child: ChildId,
        incarnation: u32,
        cause: Cause,
        now: SimTime,
        out: &mut Vec<Action>,
    ) {
        let Some(i) = self.current(child, incarnation) else { return };
        match self.children[i].phase {
            Phase::Stopping { again, .. } => self.stopped(i, again, now),
            Phase::Starting(_) | Phase::Running => self.failed(i, cause, now, out),
            Phase::Waiting(_) | Phase::Ended { .. } => {}
        }
    }

    fn stopped(&mut self, i: usize, again: bool, now: SimTime) {
        self.children[i].phase = if again { Phase::Waiting(now) } else { Phase::Ended { failed: false } };
    }

    /// Handles an unresponsive thread: fences and abandons it, and continues without it.
    fn abandon(&mut self, i: usize, cause: Cause, now: SimTime, out: &mut Vec<Action>) {
        self.fence(i, out);
        let child = &mut self.children[i];
        out.push(Action::Abandon { child: ChildId(i as u16), incarnation: child.incarnation });
        child.fresh = true;
        child.stalled = true;
        self.zombies += 1;
        if self.stage == Stage::Up && self.zombies > self.zombies_max {
            let reason = format!(
                "{} threads had to be abandoned (at most {} may), the last one was {}",
                self.zombies, self.zombies_max, self.children[i].spec.id
            );
            self.note(i, cause, now);
            self.children[i].phase = Phase::Ended { failed: true };
            self.give_up(reason, now, out);
            return;
        }
        match self.children[i].phase {
            Phase::Stopping { again, .. } => self.stopped(i, again, now),
            _ => self.failed(i, cause, now, out),
        }
    }

    /// Handles the unrequested end of child `i`.
    fn failed(&mut self, i: usize, cause: Cause, now: SimTime, out: &mut Vec<Action>) {
        let was_starting = matches!(self.children[i].phase, Phase::Starting(_));
        let abnormal = cause.is_abnormal();
        self.fence(i, out);
        let text = match &cause {
            Cause::Panic(text) => format!("panicked: {text}"),
            Cause::Error(text) => text.clone(),
            Cause::Stop => "ended by itself".to_owned(),
            Cause::Stall => "stalled".to_owned(),
            Cause::StartTimeout => "was not built within its limit".to_owned(),
        };
        if abnormal {
            self.note(i, cause, now);
        }
        let child = &mut self.children[i];
        child.late = false;
        child.phase = Phase::Ended { failed: abnormal };
        if self.stage != Stage::Up {
            return;
        }
        if child.incarnation == 1 && was_starting && abnormal {
            // As in OTP, a failure during the first start fails the whole tree.
            let reason = format!("{} did not start: {text}", child.spec.id);
            self.give_up(reason, now, out);
            return;
        }
        let again = match child.spec.restart {
            Restart::Permanent => true,
            Restart::Transient => abnormal,
            Restart::Temporary => false,
        };
        if again {
            let cohort = was_starting.then_some(child.cohort);
            let reason = format!("{} {text}", child.spec.id);
            self.restart_member(i, cohort, &reason, now, out);
        }
    }

    /// Fences the current life: its later batches are refused.
    fn fence(&mut self, i: usize, out: &mut Vec<Action>) {
        let child = &mut self.children[i];
        if child.epoch <= child.incarnation {
            child.epoch = child.incarnation + 1;
            out.push(Action::Fence { child: ChildId(i as u16), epoch: child.epoch });
        }
    }

    fn note(&mut self, i: usize, cause: Cause, now: SimTime) {
        if self.incidents.len() >= INCIDENTS_MAX {
            self.incidents_lost += 1;
            return;
        }
        self.children[i].incident = Some(self.incidents.len());
        let child = self.children[i].spec.id.clone();
        self.incidents.push(Incident { child, cause, detected: now, restarted: None, resumed: None });
    }

    /// Restarts the children that the strategies select after child `i` died, escalating while groups give up.
    fn restart_member(
        &mut self,
        i: usize,
        cohort: Option<u32>,
        reason: &str,
        now: SimTime,
        out: &mut Vec<Action>,
    ) {
        let mut member: Range<usize> = i..i + 1;
        let mut at = self.children[i].group;
        let unit = self.children[i].jitter.unit();
        let mut pause = self.children[i].streak.pause(&self.groups[at].backoff, now, unit);
        loop {
            let group = &mut self.groups[at];
            if group.window.admit(group.intensity, now) {
                let affected = group.affected(&member);
                // Supervisors restarted from above start with empty restart counts. Preorder: a later group whose
                // children lie within ours is below us.
                for below in &mut self.groups[at + 1..] {
                    if affected.start <= below.leaves.start && below.leaves.end <= affected.end {
                        below.window.clear();
                    }
                }
                self.restart_range(affected, i, cohort, now, now + pause, out);
                return;
            }
            if member.len() == 1 && at == self.children[i].group && group.exhausted == Exhausted::Hold {
                let (restarts, period) = (group.intensity.restarts, group.intensity.period);
                // Its failures must not count against its siblings.
                group.window.clear();
                self.children[i].held = true;
                let why = format!("held after more than {restarts} restarts in {period}: {reason}");
                self.given_up.push((ChildId(i as u16), why));
                return;
            }
            let Some(parent) = group.parent else {
                let reason = format!(
                    "{} needed more than {} restarts in {}; the last one because {reason}",
                    group.id, group.intensity.restarts, group.intensity.period
                );
                self.give_up(reason, now, out);
                return;
            };
            member = group.leaves.clone();
            let mut streak = group.streak;
            let unit = self.groups[at].jitter.unit();
            pause = pause.max(streak.pause(&self.groups[parent].backoff, now, unit));
            self.groups[at].streak = streak;
            at = parent;
        }
    }

    /// Restarts, on request, a child held for failing too often.
    fn try_again(&mut self, child: ChildId, now: SimTime) {
        let Some(at) = self.given_up.iter().position(|(held, _)| *held == child) else { return };
        self.given_up.remove(at);
        self.cohorts += 1;
        let (cohort, child) = (self.cohorts, &mut self.children[usize::from(child.0)]);
        child.cohort = cohort;
        child.streak = Streak::default();
        child.phase = Phase::Waiting(now);
    }

    fn restart_range(
        &mut self,
        range: Range<usize>,
        dead: usize,
        cohort: Option<u32>,
        now: SimTime,
        not_before: SimTime,
        out: &mut Vec<Action>,
    ) {
        let cohort = cohort.unwrap_or_else(|| {
            self.cohorts += 1;
            self.cohorts
        });
        for i in range.rev() {
            let child = &mut self.children[i];
            child.cohort = cohort;
            if i == dead {
                child.phase = Phase::Waiting(not_before);
                continue;
            }
            match child.phase {
                Phase::Running | Phase::Starting(_) => {
                    out.push(Action::Stop { child: ChildId(i as u16) });
                    let again = child.spec.restart != Restart::Temporary;
                    child.phase = Phase::Stopping { until: now + child.spec.shutdown_limit, again };
                }
                Phase::Waiting(at) => child.phase = Phase::Waiting(at.max(not_before)),
                Phase::Stopping { .. } | Phase::Ended { .. } => {}
            }
        }
    }

    /// Handles children that exceeded their start or stop limits.
    fn check_limits(&mut self, now: SimTime, out: &mut Vec<Action>) {
        for i in 0..self.children.len() {
            match self.children[i].phase {
                Phase::Starting(until) if now >= until => self.abandon(i, Cause::StartTimeout, now, out),
                Phase::Stopping { until, .. } if now >= until => self.abandon(i, Cause::Stall, now, out),
                _ => {}
            }
        }
    }

    /// Starts all due children: in order within a cohort, each once its predecessor is up, and none before all stopping
    /// members have stopped.
    fn start_due(&mut self, now: SimTime, out: &mut Vec<Action>) {
        if self.stage != Stage::Up {
            return;
        }
        let mut blocked: Vec<u32> = Vec::new();
        for child in &self.children {
            if matches!(child.phase, Phase::Stopping { again: true, .. }) && !blocked.contains(&child.cohort)
            {
                blocked.push(child.cohort);
            }
        }
        for (i, child) in self.children.iter_mut().enumerate() {
            match child.phase {
                Phase::Waiting(at) => {
                    if now >= at && !blocked.contains(&child.cohort) {
                        child.incarnation += 1;
                        // A child that stopped in good order has not been fenced yet.
                        if child.incarnation > 1 && child.epoch < child.incarnation {
                            child.epoch = child.incarnation;
                            out.push(Action::Fence { child: ChildId(i as u16), epoch: child.epoch });
                        }
                        child.phase = Phase::Starting(now + child.spec.start_limit);
                        out.push(Action::Start {
                            child: ChildId(i as u16),
                            incarnation: child.incarnation,
                            fresh: child.fresh,
                        });
                        child.fresh = false;
                    }
                    blocked.push(child.cohort);
                }
                Phase::Starting(_) => blocked.push(child.cohort),
                Phase::Running | Phase::Stopping { .. } | Phase::Ended { .. } => {}
            }
        }
    }

    fn give_up(&mut self, reason: String, now: SimTime, out: &mut Vec<Action>) {
        self.reason.get_or_insert(reason);
        self.shut_down(EXIT_GAVE_UP, now, out);
    }

    fn shut_down(&mut self, code: i32, now: SimTime, out: &mut Vec<Action>) {
        self.stage = Stage::Controllers(code);
        out.push(Action::ZeroForces);
        self.stop_where(|class| class != RuntimeClass::Model, SHUTDOWN_CONTROLLERS_MAX, now, out);
    }

    fn stop_where(
        &mut self,
        wanted: impl Fn(RuntimeClass) -> bool,
        longest: SimTime,
        now: SimTime,
        out: &mut Vec<Action>,
    ) {
        for (i, child) in self.children.iter_mut().enumerate().rev() {
            if !wanted(child.spec.class) {
                continue;
            }
            let until = now + child.spec.shutdown_limit.min(longest);
            match child.phase {
                Phase::Running | Phase::Starting(_) => {
                    out.push(Action::Stop { child: ChildId(i as u16) });
                    child.phase = Phase::Stopping { until, again: false };
                }
                Phase::Stopping { until: at, .. } => {
                    child.phase = Phase::Stopping { until: at.min(until), again: false };
                }
                Phase::Waiting(_) => child.phase = Phase::Ended { failed: false },
                Phase::Ended { .. } => {}
            }
        }
    }

    /// Advances the shutdown: the controllers first, then the Model, then the recording.
    fn finish(&mut self, now: SimTime, out: &mut Vec<Action>) {
        let down = |child: &Child| matches!(child.phase, Phase::Ended { .. });
        if let Stage::Controllers(code) = self.stage
            && self.children.iter().all(|c| c.spec.class == RuntimeClass::Model || down(c))
        {
            self.stage = Stage::Model(code);
            self.stop_where(|class| class == RuntimeClass::Model, SHUTDOWN_MODEL_MAX, now, out);
        }
        if let Stage::Model(code) = self.stage
            && self.children.iter().all(down)
        {
            self.stage = Stage::Down(code);
            out.push(Action::CloseRecording);
            out.push(Action::Exit(code));
        }
    }
}
