//! The plan's mirror in Rust: `FaultPlan::new(42).at(secs(3.0)).kill("haptics.left")`.

use trocar_scene::SimTime;

use super::plan::{During, FaultPlan, FaultSpec, seed_of, unit_of};
use crate::spec::{FaultKind, RECORDER};

impl FaultPlan {
    /// Begins a fault at a time since the start of the session.
    pub fn at(self, at: SimTime) -> FaultAt {
        FaultAt { plan: self, at, lasting: None, during: None }
    }

    /// Begins a fault at a random time between two, chosen by the plan's seed.
    pub fn between(self, from: SimTime, to: SimTime) -> FaultAt {
        let unit = unit_of(seed_of(self.seed, self.faults.len()));
        let at = from + SimTime::from_secs_f64(to.since(from).as_secs_f64() * unit);
        self.at(at)
    }
}

/// Seconds as a time of the session; negative and non-finite values give zero.
pub fn secs(secs: f64) -> SimTime {
    SimTime::from_secs_f64(secs)
}

/// A fault whose time is said and whose kind is not yet.
#[must_use]
#[derive(Debug)]
pub struct FaultAt {
    plan: FaultPlan,
    at: SimTime,
    lasting: Option<SimTime>,
    during: Option<During>,
}

impl FaultAt {
    /// It waits until this goes on.
    pub fn during(mut self, what: During) -> Self {
        self.during = Some(what);
        self
    }
    /// How long the fault lasts before it heals.
    pub fn lasting(mut self, span: SimTime) -> Self {
        self.lasting = Some(span);
        self
    }
    /// The target panics.
    pub fn kill(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Kill, target)
    }
    /// The target's step does not return.
    pub fn stall(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Stall, target)
    }
    /// Each step of the target takes `step` longer.
    pub fn slow(self, target: &str, step: SimTime) -> FaultPlan {
        self.having(FaultKind::Slow, target, |fault| fault.step = step)
    }
    /// The device is gone.
    pub fn unplug(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Unplug, target)
    }
    /// The writer's handle takes no batch.
    pub fn queue_full(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::QueueFull, target)
    }
    /// Numbers that the target hands over are not finite.
    pub fn nan(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Nan, target)
    }
    /// The recorder's disk takes no byte.
    pub fn disk_full(self) -> FaultPlan {
        self.fault(FaultKind::DiskFull, RECORDER)
    }
    /// The recorder's disk takes `bytes_per_sec` and no more.
    pub fn disk_slow(self, bytes_per_sec: f64) -> FaultPlan {
        self.having(FaultKind::DiskSlow, RECORDER, |fault| fault.bytes_per_sec = bytes_per_sec)
    }
    /// The share `probability` (0 to 1) of the target's messages is lost.
    pub fn drop(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Drop, target, |fault| fault.probability = probability)
    }
    /// The target's messages arrive later by `delay`.
    pub fn delay(self, target: &str, delay: SimTime) -> FaultPlan {
        self.jitter(target, delay, SimTime::ZERO)
    }
    /// The target's messages arrive later by `delay`, give or take up to `jitter`, which is at most the delay.
    pub fn jitter(self, target: &str, delay: SimTime, jitter: SimTime) -> FaultPlan {
        self.having(FaultKind::Delay, target, |fault| {
            (fault.delay, fault.jitter) = (delay, jitter.min(delay))
        })
    }
    /// The share `probability` (0 to 1) of the target's messages arrives twice.
    pub fn duplicate(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Duplicate, target, |fault| fault.probability = probability)
    }
    /// The share `probability` (0 to 1) of the target's messages is overtaken by the next one.
    pub fn reorder(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Reorder, target, |fault| fault.probability = probability)
    }
    /// The share `probability` (0 to 1) of the target's messages is garbled, and so refused.
    pub fn corrupt(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Corrupt, target, |fault| fault.probability = probability)
    }
    /// No message of the target passes.
    pub fn partition(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Partition, target)
    }
    fn having(self, kind: FaultKind, target: &str, set: impl FnOnce(&mut FaultSpec)) -> FaultPlan {
        let mut plan = self.fault(kind, target);
        if let Some(fault) = plan.faults.last_mut() {
            set(fault);
        }
        plan
    }
    /// A fault of any kind.
    pub fn fault(self, kind: FaultKind, target: &str) -> FaultPlan {
        let mut plan = self.plan;
        plan.faults.push(FaultSpec {
            id: format!("{kind} {target} at {} s", self.at.as_secs_f64()),
            at: self.at,
            during: self.during,
            lasting: self.lasting,
            target: target.to_owned(),
            kind,
            step: SimTime::ZERO,
            probability: 1.0,
            delay: SimTime::ZERO,
            jitter: SimTime::ZERO,
            bytes_per_sec: 0.0,
        });
        plan
    }
}
