//! Fault schedule: begin and end orders of a plan's faults, as `due(now) → orders`.

use std::collections::BTreeMap;

use trocar_scene::{SimTime, Snapshot};

use super::plan::{During, FaultPlan, FaultPlanError, FaultSpec, seed_of};
use crate::spec::{
    CLOCK, FaultKind, FaultOrder, LINK, LINK_OF_STATION, LINKS, MODEL, RECORDER, STATION_PROGRAM, VIEWER,
    takes,
};

/// Class of a fault target, which determines the applicable faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetClass {
    /// A controller with its handle and its link to the Model.
    Controller,
    /// A device and its driver.
    Device,
    /// The Model.
    Model,
    /// The recorder and its disk.
    Recorder,
    /// A network link.
    Link,
    /// All network links at once, with what serves them.
    Links,
    /// The wall clock.
    Clock,
    /// A program that is a station of the session.
    Station,
    /// The windows onto the session.
    Viewer,
}

impl TargetClass {
    /// Name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Controller => "controller",
            Self::Device => "device",
            Self::Model => "model",
            Self::Recorder => "recorder",
            Self::Link => "network link",
            Self::Links => "set of all network links",
            Self::Clock => "clock",
            Self::Station => "station",
            Self::Viewer => "viewer",
        }
    }

    /// Class of a fault sink by its name: `recorder`, `viewer`, `clock`, `links`, `link`, `link.*`, `network.…`, or else a
    /// device.
    pub fn of_sink(name: &str) -> Self {
        match name {
            RECORDER => Self::Recorder,
            VIEWER => Self::Viewer,
            CLOCK => Self::Clock,
            LINKS => Self::Links,
            LINK | LINK_OF_STATION => Self::Link,
            STATION_PROGRAM => Self::Station,
            name if name.starts_with("network.") => Self::Link,
            _ => Self::Device,
        }
    }

    /// The kinds of fault that apply to it.
    pub const fn kinds(self) -> &'static [FaultKind] {
        use FaultKind as K;
        match self {
            Self::Controller => &[
                K::Kill,
                K::Stall,
                K::Slow,
                K::QueueFull,
                K::Nan,
                K::Drop,
                K::Delay,
                K::Duplicate,
                K::Reorder,
                K::Corrupt,
                K::Partition,
                K::RateLimit,
            ],
            Self::Device => &[K::Kill, K::Stall, K::Unplug, K::Nan],
            Self::Model => &[K::Kill, K::Stall],
            Self::Recorder => &[K::Kill, K::Stall, K::Slow, K::DiskFull, K::DiskSlow],
            // For a viewer, `unplug` takes away the graphics device.
            Self::Viewer => &[K::Kill, K::Unplug],
            // A link that is killed is cut, and its ends may connect anew.
            Self::Link => &[
                K::Kill,
                K::Drop,
                K::Delay,
                K::Duplicate,
                K::Reorder,
                K::Corrupt,
                K::Partition,
                K::RateLimit,
            ],
            Self::Links | Self::Station => &[K::Kill],
            Self::Clock => &[K::ClockAhead, K::ClockBack],
        }
    }
}

/// All fault targets of a session.
#[derive(Clone, Debug, Default)]
pub struct Targets(BTreeMap<String, TargetClass>);

impl Targets {
    /// Targets with the Model only.
    pub fn new() -> Self {
        Self::default().with(MODEL, TargetClass::Model)
    }
    /// Adds a target.
    #[must_use]
    pub fn with(mut self, name: &str, class: TargetClass) -> Self {
        self.0.insert(name.to_owned(), class);
        self
    }
    /// Class of the target of this name.
    pub fn class(&self, name: &str) -> Option<TargetClass> {
        let one_of_many = || self.0.iter().find(|(sink, _)| takes(sink, name)).map(|(_, class)| *class);
        self.0.get(name).copied().or_else(one_of_many)
    }
}

/// A fault that waits for its condition.
#[derive(Clone, Debug)]
struct Waiting {
    from: SimTime,
    during: During,
    begin: FaultOrder,
    lasting: Option<SimTime>,
}

/// The orders of a plan, sorted by time.
#[derive(Clone, Debug, Default)]
pub struct FaultSchedule {
    /// Sorted by time; orders already given are at the front.
    orders: Vec<(SimTime, FaultOrder)>,
    next: usize,
    waiting: Vec<Waiting>,
}

impl FaultSchedule {
    /// Checks that every fault fits its target.
    ///
    /// # Errors
    /// [`FaultPlanError::UnknownTarget`] and [`FaultPlanError::KindNotApplicable`], with what is valid.
    pub fn new(plan: &FaultPlan, targets: &Targets) -> Result<Self, FaultPlanError> {
        let mut orders = Vec::with_capacity(plan.faults.len() * 2);
        let mut waiting = Vec::new();
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
            // A stall carries its length with it, a kill has none: neither needs an end order.
            let lasting = fault.lasting.filter(|_| !fault.kind.is_instant());
            if let Some(during) = fault.during {
                waiting.push(Waiting { from: fault.at, during, begin, lasting });
                continue;
            }
            if let Some(span) = lasting {
                orders.push((fault.at + span, FaultOrder { begins: false, ..begin.clone() }));
            }
            orders.push((fault.at, begin));
        }
        orders.sort_by_key(place);
        Ok(Self { orders, next: 0, waiting })
    }

    /// Starts the schedule at `now` in a running session: faults that are already over are skipped, lasting faults
    /// begin at once, and conditional faults keep waiting.
    pub fn skip_to(&mut self, now: SimTime) {
        let lasts: Vec<u32> = self
            .orders
            .iter()
            .filter(|(at, order)| !order.begins && *at > now)
            .map(|(_, order)| order.index)
            .collect();
        let ends: Vec<u32> =
            self.orders.iter().filter(|(_, order)| !order.begins).map(|(_, order)| order.index).collect();
        self.orders.retain(|(at, order)| {
            let endless = !order.kind.is_instant() && !ends.contains(&order.index);
            *at >= now || (order.begins && (lasts.contains(&order.index) || endless))
        });
        self.next = 0;
    }

    /// Time of the next order; `None` when all were given or wait for a condition.
    pub fn next_at(&self) -> Option<SimTime> {
        self.orders.get(self.next).map(|(at, _)| *at)
    }

    /// Whether a conditional fault may strike at any time from `now` on, so that the driver must poll often.
    pub fn is_waiting(&self, now: SimTime) -> bool {
        self.waiting.iter().any(|waiting| waiting.from <= now)
    }

    /// Time from which the first conditional fault waits.
    pub fn next_waiting(&self) -> Option<SimTime> {
        self.waiting.iter().map(|waiting| waiting.from).min()
    }

    /// The next order that is due at `now`, given the current scene; call it until it returns `None`.
    pub fn due(&mut self, now: SimTime, scene: &Snapshot) -> Option<FaultOrder> {
        let met = |waiting: &Waiting| waiting.from <= now && waiting.during.holds(scene);
        if let Some(at) = self.waiting.iter().position(met) {
            let Waiting { begin, lasting, .. } = self.waiting.remove(at);
            if let Some(span) = lasting {
                let end = (now + span, FaultOrder { begins: false, ..begin.clone() });
                let key = place(&end);
                let at = self.next + self.orders[self.next..].partition_point(|order| place(order) <= key);
                self.orders.insert(at, end);
            }
            return Some(begin);
        }
        let (_, order) = self.orders.get(self.next).filter(|(at, _)| *at <= now)?;
        self.next += 1;
        Some(order.clone())
    }
}

/// Sort key of an order: at equal times ends come first, so that of two adjacent faults the later one stays active.
fn place((at, order): &(SimTime, FaultOrder)) -> (SimTime, bool, u32) {
    (*at, order.begins, order.index)
}

fn order(seed: u64, index: usize, fault: &FaultSpec) -> FaultOrder {
    let span = match fault.kind {
        FaultKind::Slow | FaultKind::ClockAhead | FaultKind::ClockBack => fault.step,
        FaultKind::Delay => fault.delay,
        FaultKind::RateLimit => fault.queue,
        // A stall without a duration lasts for ever; the supervisor replaces the thread.
        FaultKind::Stall => fault.lasting.unwrap_or(SimTime(u64::MAX)),
        _ => SimTime::ZERO,
    };
    FaultOrder {
        index: index as u32,
        target: fault.target.clone(),
        kind: fault.kind,
        begins: true,
        span,
        jitter: fault.jitter,
        independent: fault.independent,
        delays: fault.delays.clone(),
        every: fault.every,
        burst: fault.burst,
        probability: fault.probability,
        bytes_per_sec: fault.bytes_per_sec,
        seed: seed_of(seed, index),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::secs;
    use trocar_scene::{Commands, EntityAllocator, Grasp, Pose, RegistryBuilder, SCENARIO_SPAWNER, Store};

    fn targets() -> Targets {
        Targets::new()
            .with("engine", TargetClass::Controller)
            .with("device.left", TargetClass::Device)
            .with("recorder", TargetClass::Recorder)
    }

    #[test]
    fn the_links_of_stations_that_come_later_are_targets_by_their_names() {
        let targets = targets().with("link.*", TargetClass::Link).with("clock", TargetClass::Clock);
        assert_eq!(targets.class("link.Ana"), Some(TargetClass::Link));
        assert_eq!((targets.class("link"), targets.class("linkage")), (None, None));
        let plan = FaultPlan::new(1).at(secs(1.0)).partition("link.Ana");
        let plan = plan.at(secs(2.0)).clock_ahead(secs(3_600.0));
        let mut schedule = FaultSchedule::new(&plan, &targets).expect("valid");
        let scene = Store::new(trocar_scene::Registry::standard()).snapshot();
        let orders: Vec<FaultOrder> = std::iter::from_fn(|| schedule.due(secs(9.0), &scene)).collect();
        assert_eq!(orders.len(), 2);
        assert_eq!((orders[0].target.as_str(), orders[1].span), ("link.Ana", secs(3_600.0)));
        let wrong = FaultPlan::new(1).at(secs(1.0)).stall("link.Ana");
        let error = FaultSchedule::new(&wrong, &targets).expect_err("a link has no steps").to_string();
        assert!(error.contains("network link") && error.contains("partition"), "{error}");
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
        let (scene, _) = scenes();
        assert!(schedule.due(secs(0.5), &scene).is_none());
        let mut seen = Vec::new();
        for tenth in 0..50 {
            let now = f64::from(tenth) * 0.1;
            while let Some(order) = schedule.due(secs(now), &scene) {
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

    /// A scene without a grasp, and one with a grasp.
    fn scenes() -> (Snapshot, Snapshot) {
        let mut registry = RegistryBuilder::new();
        trocar_scene::components::register(&mut registry).expect("distinct names");
        let registry = registry.build();
        let mut store = Store::new(registry.clone());
        let idle = store.snapshot();
        let mut commands = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
        let (tool, ring) = (commands.spawn(), commands.spawn());
        commands
            .put(tool, Grasp { held: ring, anchor: Pose::default(), since: SimTime::ZERO, assisted: false });
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        (idle, store.snapshot())
    }

    #[test]
    fn a_fault_during_a_grasp_waits_for_one_and_ends_after_its_span() {
        let plan = FaultPlan::new(1)
            .at(secs(1.0))
            .during(During::Grasp)
            .lasting(secs(0.5))
            .nan("engine")
            .at(secs(3.0))
            .kill("engine");
        let mut schedule = FaultSchedule::new(&plan, &targets()).expect("fits");
        let (idle, holding) = scenes();
        assert!(schedule.due(secs(0.5), &holding).is_none(), "not before its time");
        assert!(!schedule.is_waiting(secs(0.5)) && schedule.is_waiting(secs(1.0)));
        assert!(schedule.due(secs(1.5), &idle).is_none(), "nothing is held");
        let begin = schedule.due(secs(2.8), &holding).expect("strikes");
        assert!(begin.begins && begin.index == 0);
        assert!(schedule.due(secs(2.8), &holding).is_none(), "once");
        assert_eq!(schedule.next_at(), Some(secs(3.0)));
        assert_eq!(schedule.due(secs(3.0), &idle).expect("the kill").index, 1);
        let end = schedule.due(secs(3.3), &idle).expect("it heals");
        assert!(!end.begins && end.index == 0);
        assert_eq!(schedule.next_at(), None);
    }

    #[test]
    fn a_schedule_that_joins_late_leaves_out_what_is_over_and_begins_what_lasts() {
        let plan = FaultPlan::new(1)
            .at(secs(1.0))
            .kill("engine")
            .at(secs(1.0))
            .lasting(secs(0.5))
            .queue_full("engine")
            .at(secs(1.5))
            .lasting(secs(2.0))
            .nan("engine")
            .at(secs(1.7))
            .unplug("device.left")
            .at(secs(3.0))
            .kill("engine");
        let mut schedule = FaultSchedule::new(&plan, &targets()).expect("fits");
        schedule.skip_to(secs(2.0));
        let (scene, _) = scenes();
        let mut due = |at| {
            let orders = std::iter::from_fn(|| schedule.due(secs(at), &scene));
            orders.map(|order| (order.index, order.begins)).collect::<Vec<_>>()
        };
        assert_eq!(due(2.0), [(2, true), (3, true)]);
        assert_eq!(due(3.0), [(4, true)]);
        assert_eq!(due(9.0), [(2, false)]);
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
        assert!(message.contains("kill, stall, slow, disk_full, disk_slow"), "{message}");
    }
}
