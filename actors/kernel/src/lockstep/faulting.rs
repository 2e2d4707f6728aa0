//! Fault injection in virtual time: the live session's faults of threads, devices and rings, applied to slots.

use std::sync::Arc;

use trocar_scene::{Batch, SimTime};

use super::session::LockstepSession;
use super::slot::NEVER;
use crate::faults::{BatchInFlight, FaultLog, TargetClass, Targets, soundness};
use crate::spec::{FaultKind, FaultOrder, MODEL, takes};
use crate::supervision::Event;

/// A Model that hangs in a step.
#[derive(Clone, Copy)]
pub(super) struct ModelHang {
    until: SimTime,
    /// Time at which the watchdog abandons it.
    given_up_at: SimTime,
}

impl LockstepSession {
    /// All fault targets of this session.
    pub fn fault_targets(&self) -> Targets {
        let mut targets = Targets::new();
        for slot in &self.slots {
            targets = targets.with(&slot.spec.name, TargetClass::Controller);
        }
        for (name, _) in &self.fault_sinks {
            targets = targets.with(name, TargetClass::of_sink(name));
        }
        targets
    }

    /// Outcomes of the faults so far.
    pub fn fault_log(&self) -> &FaultLog {
        &self.fault_log
    }

    pub(super) fn inject_due_faults(&mut self) {
        while let Some(order) = self.faults.due(self.now, self.core.view()) {
            if order.begins {
                self.fault_log.injected(order.index as usize, self.now);
            } else {
                self.fault_log.healed(order.index as usize, self.now);
            }
            self.inject(&order);
        }
    }

    fn inject(&mut self, order: &FaultOrder) {
        if order.target == MODEL {
            match order.kind {
                FaultKind::Kill if order.begins => self.model_kill = true,
                FaultKind::Stall if order.begins => self.model_stall = order.span,
                // Refused when the plan was read.
                _ => {}
            }
            self.inject_model_fault();
            return;
        }
        if let Some(index) = self.slots.iter().position(|slot| slot.spec.name == order.target) {
            let active_faults = &mut self.slots[index].active_faults;
            match order.kind {
                FaultKind::Kill => active_faults.kill = order.begins,
                FaultKind::Stall => active_faults.stall = order.span,
                FaultKind::Slow => active_faults.slow = if order.begins { order.span } else { SimTime::ZERO },
                FaultKind::QueueFull => active_faults.queue_full = order.begins,
                FaultKind::Nan => active_faults.nan = order.begins,
                kind if kind.is_of_link() => {
                    self.slots[index].link.apply(order);
                    self.deliver(index);
                }
                // Refused for controllers when the plan was read, or of the recorder's disk.
                _ => {}
            }
        }
        let sinks = self.fault_sinks.iter().filter(|(name, _)| takes(name, &order.target));
        let sinks: Vec<_> = sinks.map(|(_, sink)| Arc::clone(sink)).collect();
        for sink in sinks {
            sink.fault(order);
        }
    }

    /// Applies the ordered fault to the Model, as soon as a Model is running.
    pub(super) fn inject_model_fault(&mut self) {
        if !self.model_up {
            return;
        }
        if std::mem::take(&mut self.model_kill) {
            self.model_died(None, "killed by a fault".into());
        } else if self.model_stall > SimTime::ZERO {
            let until = self.now + std::mem::take(&mut self.model_stall);
            let limit = self.supervisor.spec(self.model).map_or(NEVER, |spec| spec.heartbeat_limit);
            self.model_up = false;
            self.model_hangs = Some(ModelHang { until, given_up_at: self.now + limit });
        }
    }

    /// Resumes or abandons a hanging Model, and ends abandoned ones.
    pub(super) fn check_model(&mut self) {
        let before = self.model_zombies.len();
        self.model_zombies.retain(|until| *until > self.now);
        for _ in self.model_zombies.len()..before {
            self.tell(Event::ZombieEnded);
        }
        if let Some(ModelHang { until, given_up_at }) = self.model_hangs {
            if until <= self.now {
                self.model_hangs = None;
                self.model_up = true;
                self.queued = true;
                self.fault_log.stall_ended(MODEL, self.now);
            } else if given_up_at <= self.now {
                self.model_hangs = None;
                self.model_resumed = false;
                self.model_zombies.push(until);
                self.fault_log.detected(MODEL, self.now);
                let (child, incarnation) = (self.model, self.supervisor.incarnation(self.model));
                self.tell(Event::Stalled { child, incarnation });
            }
        }
        self.inject_model_fault();
    }

    /// Time at which [`Self::check_model`] is next needed.
    pub(super) fn model_wakes_at(&self) -> SimTime {
        let harmed = self.model_up && (self.model_kill || self.model_stall > SimTime::ZERO);
        let at = if harmed { self.now } else { NEVER };
        let hangs = self.model_hangs.map_or(NEVER, |hang| hang.until.min(hang.given_up_at));
        self.model_zombies.iter().fold(at.min(hangs), |at, until| at.min(*until))
    }

    /// Sends a batch of slot `index` over its link.
    pub(super) fn send(&mut self, index: usize, batch: Box<Batch>) {
        let slot = &mut self.slots[index];
        slot.sent += 1;
        if slot.link.is_idle() {
            self.arrive(index, batch);
            return;
        }
        let before = slot.link.counts().sum();
        slot.link.send(self.now, BatchInFlight { sealed_at: self.now, batch });
        if slot.link.counts().sum() > before && self.fault_log.is_open() {
            self.fault_log.detected(&slot.spec.name, self.now);
        }
        self.step_is_over(index);
        self.deliver(index);
    }

    /// Delivers the batches that have arrived over the link of slot `index`.
    pub(super) fn deliver(&mut self, index: usize) {
        while let Some(batch_in_flight) = self.slots[index].link.due(self.now) {
            self.arrive(index, batch_in_flight.batch);
        }
    }

    fn arrive(&mut self, index: usize, batch: Box<Batch>) {
        if self.model_up {
            self.commit(index, batch);
        } else {
            self.queued = true;
            self.slots[index].enqueue(batch);
        }
    }

    /// Polls the state of the fault sinks.
    pub(super) fn check_sinks(&mut self) {
        for (name, sink) in &self.fault_sinks {
            if let Some(sound) = sink.is_sound() {
                self.fault_log.looked_at(name, sound, self.now);
            }
            for (target, sound) in soundness(&self.fault_log, name, sink.as_ref()) {
                self.fault_log.looked_at(&target, sound, self.now);
            }
        }
    }

    /// Records that the effect of a fault of `kind` on slot `index` was detected.
    pub(super) fn notice(&mut self, index: usize, kind: FaultKind) {
        if !self.fault_log.is_open() {
            return;
        }
        let active_faults = self.slots[index].active_faults;
        let ails = match kind {
            FaultKind::Slow => active_faults.slow > SimTime::ZERO,
            FaultKind::QueueFull => active_faults.queue_full,
            FaultKind::Nan => active_faults.nan,
            _ => false,
        };
        if ails {
            self.fault_log.detected(&self.slots[index].spec.name, self.now);
        }
    }
}
