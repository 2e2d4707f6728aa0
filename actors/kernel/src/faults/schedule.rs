//! When each fault of a plan begins and ends: `due(now) → orders`.

use std::collections::BTreeMap;

use trocar_scene::SimTime;

use super::plan::{FaultPlan, FaultPlanError, FaultSpec};
use crate::spec::{FaultKind, FaultOrder, MODEL, RECORDER};

/// What a target is, and so how it can fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetClass {
    /// A controller and its handle.
    Controller,
    /// A device and its driver.
    Device,
    /// The Model.
    Model,
    /// The recorder and its disk.
    Recorder,
    /// A network link.
    Link,
}

impl TargetClass {
    /// How messages call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Device => "device",
            Self::Model => "model",
            Self::Recorder => "recorder",
            Self::Link => "network link",
        }
    }

    /// What a target that takes faults itself is, by its name: `recorder`, `network.…`, or else a device.
    pub fn of_sink(name: &str) -> Self {
        match name {
            RECORDER => Self::Recorder,
            name if name.starts_with("network.") => Self::Link,
            _ => Self::Device,
        }
    }

    /// The faults that can befall it.
    pub const fn kinds(self) -> &'static [FaultKind] {
        use FaultKind as K;
        match self {
            Self::Controller => &[K::Kill, K::Stall, K::Slow, K::QueueFull, K::Nan],
            Self::Device => &[K::Kill, K::Stall, K::Unplug, K::Nan],
            Self::Model => &[K::Kill],
            Self::Recorder => &[K::Kill, K::Stall, K::Slow, K::DiskFull],
            Self::Link => &[K::Drop, K::Delay, K::Duplicate, K::Reorder, K::Corrupt, K::Partition],
        }
    }
}

/// Everything in a session that faults can be aimed at.
#[derive(Clone, Debug, Default)]
pub struct Targets(BTreeMap<String, TargetClass>);

impl Targets {
    /// The Model, and nothing else yet.
    pub fn new() -> Self {
        Self::default().with(MODEL, TargetClass::Model)
    }
    /// Adds a target.
    #[must_use]
    pub fn with(mut self, name: &str, class: TargetClass) -> Self {
        self.0.insert(name.to_owned(), class);
        self
    }
    /// What a name stands for.
    pub fn class(&self, name: &str) -> Option<TargetClass> {
        self.0.get(name).copied()
    }
}

/// The orders of a plan in the order of their time.
#[derive(Clone, Debug, Default)]
pub struct FaultSchedule {
    orders: Vec<(SimTime, FaultOrder)>,
    next: usize,
}

impl FaultSchedule {
    /// Checks that every fault fits its target.
    ///
    /// # Errors
    /// [`FaultPlanError::UnknownTarget`] and [`FaultPlanError::KindNotApplicable`], with what is valid.
    pub fn new(plan: &FaultPlan, targets: &Targets) -> Result<Self, FaultPlanError> {
        let mut orders = Vec::with_capacity(plan.faults.len() * 2);
        for (index, fault) in plan.faults.iter().enumerate() {
            let Some(class) = targets.class(&fault.target) else {
                let names: Vec<&str> = targets.0.keys().map(String::as_str).collect();
                return Err(FaultPlanError::UnknownTarget {
                    id: fault.id.clone(),
                    target: fault.target.clone(),
                    valid: names.join(", "),
                });
            };
            if !class.kinds().contains(&fault.kind) {
                let kinds: Vec<&str> = class.kinds().iter().map(|kind| kind.name()).collect();
                return Err(FaultPlanError::KindNotApplicable {
                    id: fault.id.clone(),
                    target: fault.target.clone(),
                    class: class.name(),
                    kind: fault.kind,
                    valid: kinds.join(", "),
                });
            }
            let begin = order(plan.seed, index, fault);
            // A stall carries its length with it, a kill has none: neither needs an order to end.
            if let Some(span) = fault.lasting.filter(|_| !fault.kind.is_instant()) {
                orders.push((fault.at + span, FaultOrder { begins: false, ..begin.clone() }));
            }
            orders.push((fault.at, begin));
        }
        // Ends first, so that of two faults back to back the later one stays.
        orders.sort_by_key(|(at, order)| (*at, order.begins, order.index));
        Ok(Self { orders, next: 0 })
    }

    /// When the next order is due; `None` when all are given.
    pub fn next_at(&self) -> Option<SimTime> {
        self.orders.get(self.next).map(|(at, _)| *at)
    }

    /// The next order that is due at `now`; call it until it gives `None`.
    pub fn due(&mut self, now: SimTime) -> Option<&FaultOrder> {
        let (_, order) = self.orders.get(self.next).filter(|(at, _)| *at <= now)?;
        self.next += 1;
        Some(order)
    }
}

fn order(seed: u64, index: usize, fault: &FaultSpec) -> FaultOrder {
    let span = match fault.kind {
        FaultKind::Slow => fault.step,
        FaultKind::Delay => fault.delay,
        // A stall that nobody ends lasts for ever; the supervisor replaces the thread.
        FaultKind::Stall => fault.lasting.unwrap_or(SimTime(u64::MAX)),
        _ => SimTime::ZERO,
    };
    FaultOrder {
        index: index as u32,
        target: fault.target.clone(),
        kind: fault.kind,
        begins: true,
        span,
        probability: fault.probability,
        // Any odd multiplier keeps the seeds of one plan's faults apart.
        seed: seed ^ (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::secs;

    fn targets() -> Targets {
        Targets::new()
            .with("engine", TargetClass::Controller)
            .with("device.left", TargetClass::Device)
            .with("recorder", TargetClass::Recorder)
    }

    #[test]
    fn orders_come_in_time_and_each_once() {
        let plan = FaultPlan::new(1)
            .at(secs(2.0))
            .lasting(secs(1.0))
            .queue_full("engine")
            .at(secs(1.0))
            .kill("engine")
            .at(secs(3.0))
            .nan("engine");
        let mut schedule = FaultSchedule::new(&plan, &targets()).expect("fits");
        assert!(schedule.due(secs(0.5)).is_none());
        let mut seen = Vec::new();
        for tenth in 0..50 {
            let now = f64::from(tenth) * 0.1;
            while let Some(order) = schedule.due(secs(now)) {
                seen.push((tenth, order.begins, order.kind));
            }
        }
        assert_eq!(
            seen,
            [
                (10, true, FaultKind::Kill),
                (20, true, FaultKind::QueueFull),
                (30, false, FaultKind::QueueFull),
                (30, true, FaultKind::Nan),
            ]
        );
        assert_eq!(schedule.next_at(), None);
    }

    #[test]
    fn a_wrong_target_or_kind_lists_the_valid_ones() {
        let error = |plan: FaultPlan| FaultSchedule::new(&plan, &targets()).expect_err("wrong").to_string();
        let message = error(FaultPlan::new(1).at(secs(1.0)).kill("motor"));
        assert!(message.contains("motor") && message.contains("device.left, engine, model"), "{message}");
        let message = error(FaultPlan::new(1).at(secs(1.0)).unplug("engine"));
        assert!(message.contains("controller") && message.contains("queue_full"), "{message}");
        let message = error(FaultPlan::new(1).at(secs(1.0)).fault(FaultKind::Drop, "device.left"));
        assert!(message.contains("unplug"), "{message}");
        let message = error(FaultPlan::new(1).at(secs(1.0)).nan("recorder"));
        assert!(message.contains("kill, stall, slow, disk_full"), "{message}");
    }
}
