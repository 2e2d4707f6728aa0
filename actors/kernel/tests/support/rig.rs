//! A driver of the supervisor without threads.

use trocar_kernel::supervision::{
    Action, Backoff, Cause, ChildId, ChildSpec, Event, GroupSpec, Health, RuntimeClass, Strategy, Supervisor,
};
use trocar_scene::SimTime;

pub fn ms(millis: u64) -> SimTime {
    SimTime::from_millis(millis)
}

/// A supervisor whose driver starts and stops children at once, and that remembers what it was ordered.
pub struct Rig {
    pub tree: Supervisor,
    pub log: Vec<Action>,
    pub now: SimTime,
    /// Children that never answer an order to stop.
    pub deaf: Vec<ChildId>,
    /// Children whose construction is not answered.
    pub slow_starters: Vec<ChildId>,
}

impl Rig {
    pub fn new(root: GroupSpec) -> Self {
        Self::with(root, 2, &[], &[])
    }
    pub fn with(root: GroupSpec, zombies_max: u32, deaf: &[ChildId], slow_starters: &[ChildId]) -> Self {
        let tree = Supervisor::new(root, 7, zombies_max).expect("a valid tree");
        let mut rig = Self {
            tree,
            log: Vec::new(),
            now: SimTime::ZERO,
            deaf: deaf.to_vec(),
            slow_starters: slow_starters.to_vec(),
        };
        rig.at(0, Event::Tick);
        rig
    }
    pub fn at(&mut self, millis: u64, event: Event) {
        self.at_time(ms(millis), event);
    }
    pub fn at_time(&mut self, now: SimTime, event: Event) {
        self.now = now;
        let mut queue = vec![event];
        while let Some(event) = queue.pop() {
            let mut out = Vec::new();
            self.tree.apply(event, self.now, &mut out);
            for action in &out {
                match *action {
                    Action::Start { child, incarnation, .. } if !self.slow_starters.contains(&child) => {
                        queue.push(Event::Started { child, incarnation });
                    }
                    Action::Stop { child } if !self.deaf.contains(&child) => {
                        let incarnation = self.tree.incarnation(child);
                        queue.push(Event::Died { child, incarnation, cause: Cause::Stop });
                    }
                    _ => {}
                }
            }
            self.log.extend(out);
        }
    }
}

pub const A: ChildId = ChildId(0);
pub const B: ChildId = ChildId(1);
pub const C: ChildId = ChildId(2);

pub fn spec(id: &str) -> ChildSpec {
    ChildSpec::new(id, RuntimeClass::Haptics, 1000.0)
}

/// No pauses, so that a test's times are exact.
pub fn prompt() -> Backoff {
    Backoff { base: SimTime::ZERO, factor: 1.0, max: SimTime::ZERO, jitter: 0.0, reset_after: ms(1_000) }
}

pub fn three(strategy: Strategy) -> GroupSpec {
    GroupSpec::new("root", strategy).with_backoff(prompt()).child(spec("a")).child(spec("b")).child(spec("c"))
}

impl Rig {
    pub fn died(&mut self, millis: u64, child: ChildId, cause: Cause) {
        let incarnation = self.tree.incarnation(child);
        self.at(millis, Event::Died { child, incarnation, cause });
    }
    pub fn panics(&mut self, millis: u64, child: ChildId) {
        self.died(millis, child, Cause::Panic("boom".to_owned()));
    }
    pub fn stalls(&mut self, millis: u64, child: ChildId) {
        let incarnation = self.tree.incarnation(child);
        self.at(millis, Event::Stalled { child, incarnation });
    }
    pub fn take(&mut self) -> Vec<Action> {
        std::mem::take(&mut self.log)
    }
    pub fn lives(&self) -> [u32; 3] {
        [self.tree.incarnation(A), self.tree.incarnation(B), self.tree.incarnation(C)]
    }
    pub fn health(&self, child: ChildId) -> Health {
        self.tree.health(child).expect("a child")
    }
}

pub fn starts(log: &[Action]) -> Vec<u16> {
    log.iter()
        .filter_map(|a| if let Action::Start { child, .. } = a { Some(child.0) } else { None })
        .collect()
}
pub fn stops(log: &[Action]) -> Vec<u16> {
    log.iter().filter_map(|a| if let Action::Stop { child } = a { Some(child.0) } else { None }).collect()
}
pub fn position(log: &[Action], wanted: impl Fn(&Action) -> bool) -> usize {
    log.iter().position(wanted).unwrap_or_else(|| panic!("not ordered: {log:?}"))
}
