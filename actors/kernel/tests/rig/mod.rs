//! A driver of the supervisor without threads.

// Each test binary uses a part of it.
#![allow(dead_code)]

use trocar_kernel::supervision::{Action, Cause, ChildId, Event, GroupSpec, Supervisor};
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
