//! Faults in virtual time: what a live session does to threads, devices and rings is done here to slots.

use std::sync::Arc;

use trocar_scene::SimTime;

use super::session::LockstepSession;
use crate::faults::{FaultLog, TargetClass, Targets};
use crate::spec::{FaultKind, FaultOrder, MODEL};

impl LockstepSession {
    /// Everything that faults can be aimed at in this session.
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

    /// What has become of the faults so far.
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
            if order.begins {
                self.model_died(None, "killed by a fault".into());
            }
            return;
        }
        if let Some(index) = self.slots.iter().position(|slot| slot.spec.name == order.target) {
            let ailments = &mut self.slots[index].ailments;
            match order.kind {
                FaultKind::Kill => ailments.kill = order.begins,
                FaultKind::Stall => ailments.stall = order.span,
                FaultKind::Slow => ailments.slow = if order.begins { order.span } else { SimTime::ZERO },
                FaultKind::QueueFull => ailments.queue_full = order.begins,
                FaultKind::Nan => ailments.nan = order.begins,
                // Refused for controllers when the plan was read, or of the recorder's disk.
                _ => {}
            }
        }
        let sinks = self.fault_sinks.iter().filter(|(name, _)| *name == order.target);
        let sinks: Vec<_> = sinks.map(|(_, sink)| Arc::clone(sink)).collect();
        for sink in sinks {
            sink.fault(order);
        }
    }

    /// Asks the targets that take faults themselves how they are.
    pub(super) fn look_at_sinks(&mut self) {
        for (name, sink) in &self.fault_sinks {
            if let Some(sound) = sink.is_sound() {
                self.fault_log.looked_at(name, sound, self.now);
            }
        }
    }

    /// Somebody noticed what a fault of `kind` does to slot `index`.
    pub(super) fn notice(&mut self, index: usize, kind: FaultKind) {
        if !self.fault_log.is_open() {
            return;
        }
        let ailments = self.slots[index].ailments;
        let ails = match kind {
            FaultKind::Slow => ailments.slow > SimTime::ZERO,
            FaultKind::QueueFull => ailments.queue_full,
            FaultKind::Nan => ailments.nan,
            _ => false,
        };
        if ails {
            self.fault_log.detected(&self.slots[index].spec.name, self.now);
        }
    }
}
