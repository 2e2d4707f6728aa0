//! Builder of fault plans in Rust: `FaultPlan::new(42).at(secs(3.0)).kill("haptics.left")`.

use trocar_scene::SimTime;

use super::plan::{During, FaultPlan, FaultSpec, seed_of, unit_of};
use crate::spec::{CLOCK, FaultKind, RECORDER};

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

/// A fault with its time set and its kind still open.
#[must_use]
#[derive(Debug)]
pub struct FaultAt {
    plan: FaultPlan,
    at: SimTime,
    lasting: Option<SimTime>,
    during: Option<During>,
}

impl FaultAt {
    /// Delays the fault until this condition holds.
    pub fn during(mut self, what: During) -> Self {
        self.during = Some(what);
        self
    }
    /// How long the fault lasts before it heals.
    pub fn lasting(mut self, span: SimTime) -> Self {
        self.lasting = Some(span);
        self
    }
    /// Makes the target panic.
    pub fn kill(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Kill, target)
    }
    /// Makes a step of the target hang.
    pub fn stall(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Stall, target)
    }
    /// Makes each step of the target `step` longer.
    pub fn slow(self, target: &str, step: SimTime) -> FaultPlan {
        self.having(FaultKind::Slow, target, |fault| fault.step = step)
    }
    /// Unplugs the device.
    pub fn unplug(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Unplug, target)
    }
    /// Makes the writer's ring refuse every batch.
    pub fn queue_full(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::QueueFull, target)
    }
    /// Makes the target's values NaN.
    pub fn nan(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Nan, target)
    }
    /// Makes the recorder's disk refuse every write.
    pub fn disk_full(self) -> FaultPlan {
        self.fault(FaultKind::DiskFull, RECORDER)
    }
    /// Limits the recorder's disk to `bytes_per_sec`.
    pub fn disk_slow(self, bytes_per_sec: f64) -> FaultPlan {
        self.having(FaultKind::DiskSlow, RECORDER, |fault| fault.bytes_per_sec = bytes_per_sec)
    }
    /// Loses the share `probability` (0 to 1) of the target's messages.
    pub fn drop(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Drop, target, |fault| fault.probability = probability)
    }
    /// Loses the share `probability` (0 to 1) of the target's messages, `messages` of them in a row on average.
    pub fn bursts(self, target: &str, probability: f64, messages: f64) -> FaultPlan {
        self.having(FaultKind::Drop, target, |fault| {
            (fault.probability, fault.burst) = (probability, messages);
        })
    }
    /// Delays each of the target's messages by itself, by `delay` ± `jitter`, so that they overtake each other.
    pub fn scatter(self, target: &str, delay: SimTime, jitter: SimTime) -> FaultPlan {
        self.having(FaultKind::Delay, target, |fault| {
            (fault.delay, fault.jitter, fault.independent) = (delay, jitter.min(delay), true);
        })
    }
    /// Delays the target's messages by these delays, one after the other, each for `every`, over and over again.
    pub fn delay_trace(self, target: &str, delays: Vec<SimTime>, every: SimTime) -> FaultPlan {
        self.having(FaultKind::Delay, target, |fault| (fault.delays, fault.every) = (delays, every))
    }
    /// Lets `bytes_per_sec` of the target's messages pass; the others wait, at most for `queue`.
    pub fn rate_limit(self, target: &str, bytes_per_sec: f64, queue: SimTime) -> FaultPlan {
        self.having(FaultKind::RateLimit, target, |fault| {
            (fault.bytes_per_sec, fault.queue) = (bytes_per_sec, queue);
        })
    }
    /// Delays the target's messages by `delay`.
    pub fn delay(self, target: &str, delay: SimTime) -> FaultPlan {
        self.jitter(target, delay, SimTime::ZERO)
    }
    /// Delays the target's messages by `delay` ± `jitter`, which is at most the delay.
    pub fn jitter(self, target: &str, delay: SimTime, jitter: SimTime) -> FaultPlan {
        self.having(FaultKind::Delay, target, |fault| {
            (fault.delay, fault.jitter) = (delay, jitter.min(delay))
        })
    }
    /// Duplicates the share `probability` (0 to 1) of the target's messages.
    pub fn duplicate(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Duplicate, target, |fault| fault.probability = probability)
    }
    /// Lets the next message overtake the share `probability` (0 to 1) of the target's messages.
    pub fn reorder(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Reorder, target, |fault| fault.probability = probability)
    }
    /// Corrupts the share `probability` (0 to 1) of the target's messages, which are then refused.
    pub fn corrupt(self, target: &str, probability: f64) -> FaultPlan {
        self.having(FaultKind::Corrupt, target, |fault| fault.probability = probability)
    }
    /// Blocks all messages of the target.
    pub fn partition(self, target: &str) -> FaultPlan {
        self.fault(FaultKind::Partition, target)
    }
    /// Steps the wall clock ahead.
    pub fn clock_ahead(self, step: SimTime) -> FaultPlan {
        self.having(FaultKind::ClockAhead, CLOCK, |fault| fault.step = step)
    }
    /// Steps the wall clock back.
    pub fn clock_back(self, step: SimTime) -> FaultPlan {
        self.having(FaultKind::ClockBack, CLOCK, |fault| fault.step = step)
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
            independent: false,
            delays: Vec::new(),
            every: SimTime::ZERO,
            burst: 0.0,
            queue: SimTime::ZERO,
            bytes_per_sec: 0.0,
        });
        plan
    }
}
