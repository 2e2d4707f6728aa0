//! A supervisor tree flattened into start order: every group covers a contiguous range of children.

use std::collections::{BTreeSet, VecDeque};
use std::ops::Range;

use thiserror::Error;
use trocar_scene::SimTime;
use trocar_scene::random::{SplitMix64, seed_of};

use super::child::{Backoff, ChildSpec, Exhausted, GroupSpec, Intensity, Node, Strategy};

/// Most children and groups of one tree.
pub const NODES_MAX: usize = 4_096;

/// Why a tree was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TreeError {
    /// Two nodes have the same name.
    #[error("supervisor tree: '{0}' stands in it twice; names are unique")]
    Duplicate(String),
    /// The tree has no children.
    #[error("supervisor tree: no child in it")]
    Empty,
    /// The tree has too many nodes.
    #[error("supervisor tree: more than {NODES_MAX} nodes")]
    TooMany,
    /// A back-off value is out of range.
    #[error("supervisor tree: back-off of '{group}': {field} is {value}; valid: {valid}")]
    Backoff {
        /// The group.
        group: String,
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A child that always fails at once would be restarted for ever, because the pauses grow so long that the
    /// group never counts too many restarts in its period.
    #[error(
        "supervisor tree: '{group}' would restart a child that always fails for ever: {restarts} restarts take \
         {span}, its period is {period}; lengthen the period, allow fewer restarts, or shorten the back-off"
    )]
    NeverGivesUp {
        /// The group.
        group: String,
        /// How many restarts it tolerates.
        restarts: u32,
        /// Longest time that this many restarts in a row can take.
        span: SimTime,
        /// The window in which it counts them.
        period: SimTime,
    },
}

/// Most failures that [`Flat::new`] simulates to check that a tree gives up.
const FAILURES_MAX: u32 = 100_000;

/// Failures in a row, for the back-off.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Streak {
    count: u32,
    last: Option<SimTime>,
}

impl Streak {
    /// Counts one more failure at `now` and returns the pause before the restart; `unit` in [0, 1) is its jitter.
    pub(super) fn pause(&mut self, backoff: &Backoff, now: SimTime, unit: f64) -> SimTime {
        if self.last.is_none_or(|last| now.since(last) > backoff.reset_after) {
            self.count = 0;
        }
        self.last = Some(now);
        let nth = self.count;
        self.count = self.count.saturating_add(1);
        if nth == 0 {
            return SimTime::ZERO;
        }
        let growth = backoff.factor.powi(i32::try_from(nth - 1).unwrap_or(i32::MAX));
        let plain = (backoff.base.as_secs_f64() * growth).min(backoff.max.as_secs_f64());
        SimTime::from_secs_f64(plain * (1.0 + backoff.jitter * (2.0 * unit - 1.0)))
    }
}

/// Jitter of the pauses of node `id`. Each node has its own stream, so that a failure of one does not change the pauses
/// of another.
pub(super) fn jitter(seed: u64, id: &str) -> SplitMix64 {
    SplitMix64::new(seed ^ seed_of(id))
}

/// Restarts within the sliding window of a group.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    times: VecDeque<SimTime>,
}

impl Window {
    /// Counts one more restart; `false` when it exceeds the intensity.
    pub(super) fn admit(&mut self, intensity: Intensity, now: SimTime) -> bool {
        while self.times.front().is_some_and(|&first| now.since(first) > intensity.period) {
            self.times.pop_front();
        }
        self.times.push_back(now);
        self.times.len() <= intensity.restarts as usize
    }
    /// Clears the window, as for a restarted supervisor.
    pub(super) fn clear(&mut self) {
        self.times.clear();
    }
}

/// One supervisor.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub(super) id: String,
    pub(super) parent: Option<usize>,
    pub(super) strategy: Strategy,
    pub(super) intensity: Intensity,
    pub(super) backoff: Backoff,
    pub(super) exhausted: Exhausted,
    /// The children below it.
    pub(super) leaves: Range<usize>,
    pub(super) window: Window,
    pub(super) streak: Streak,
    pub(super) jitter: SplitMix64,
}

impl Group {
    /// The children that restart together with `member`.
    pub(super) fn affected(&self, member: &Range<usize>) -> Range<usize> {
        match self.strategy {
            Strategy::OneForOne => member.clone(),
            Strategy::RestForOne => member.start..self.leaves.end,
            Strategy::OneForAll => self.leaves.clone(),
        }
    }
}

/// The flattened tree: group 0 is the root; `owner[i]` is the group of child `i`.
pub(super) struct Flat {
    pub(super) groups: Vec<Group>,
    pub(super) children: Vec<ChildSpec>,
    pub(super) owner: Vec<usize>,
}

impl Flat {
    pub(super) fn new(root: GroupSpec, seed: u64) -> Result<Self, TreeError> {
        let mut flat = Self { groups: Vec::new(), children: Vec::new(), owner: Vec::new() };
        let mut names = BTreeSet::new();
        flat.add(root, None, seed, &mut names)?;
        if flat.children.is_empty() {
            return Err(TreeError::Empty);
        }
        let mut groups: Vec<usize> = flat.owner.clone();
        groups.dedup();
        groups.into_iter().try_for_each(|group| flat.check_gives_up(group))?;
        Ok(flat)
    }

    /// Simulates a child of `group` that fails whenever it is started, with the longest pauses that jitter allows,
    /// until it is held or the root gives up. Pauses never shrink, so a window that once loses a restart always will.
    fn check_gives_up(&self, group: usize) -> Result<(), TreeError> {
        let mut chain: Vec<Group> = Vec::new();
        let mut at = Some(group);
        while let Some(index) = at {
            chain.push(self.groups[index].clone());
            at = self.groups[index].parent;
        }
        let failures = chain.iter().try_fold(1_u32, |product, group| {
            product.checked_mul(group.intensity.restarts.saturating_add(1)).filter(|n| *n <= FAILURES_MAX)
        });
        // An intensity this large means no limit.
        let Some(failures) = failures else { return Ok(()) };
        let (mut now, mut streak) = (SimTime::ZERO, Streak::default());
        for _ in 0..failures {
            let mut pause = streak.pause(&chain[0].backoff, now, 1.0);
            for level in 0..chain.len() {
                let group = &mut chain[level];
                let first = group.window.times.front().copied().unwrap_or(now);
                if now.since(first) > group.intensity.period {
                    return Err(TreeError::NeverGivesUp {
                        group: group.id.clone(),
                        restarts: group.intensity.restarts,
                        span: now.since(first),
                        period: group.intensity.period,
                    });
                }
                if group.window.admit(group.intensity, now) {
                    break;
                }
                if level == 0 && group.exhausted == Exhausted::Hold {
                    return Ok(());
                }
                group.window.clear();
                let Some(parent) = chain.get(level + 1).map(|parent| parent.backoff) else { return Ok(()) };
                pause = pause.max(chain[level].streak.pause(&parent, now, 1.0));
            }
            now += pause;
        }
        Ok(())
    }

    fn add(
        &mut self,
        spec: GroupSpec,
        parent: Option<usize>,
        seed: u64,
        names: &mut BTreeSet<String>,
    ) -> Result<(), TreeError> {
        let GroupSpec { id, strategy, intensity, backoff, exhausted, children } = spec;
        check_backoff(&id, &backoff)?;
        self.claim(&id, names)?;
        let me = self.groups.len();
        let first = self.children.len();
        self.groups.push(Group {
            jitter: jitter(seed, &id),
            id,
            parent,
            strategy,
            intensity,
            backoff,
            exhausted,
            leaves: first..first,
            window: Window::default(),
            streak: Streak::default(),
        });
        for node in children {
            match node {
                Node::Child(child) => {
                    self.claim(&child.id, names)?;
                    self.children.push(child);
                    self.owner.push(me);
                }
                Node::Group(group) => self.add(group, Some(me), seed, names)?,
            }
        }
        self.groups[me].leaves.end = self.children.len();
        Ok(())
    }

    fn claim(&self, id: &str, names: &mut BTreeSet<String>) -> Result<(), TreeError> {
        if names.len() >= NODES_MAX {
            return Err(TreeError::TooMany);
        }
        if names.insert(id.to_owned()) { Ok(()) } else { Err(TreeError::Duplicate(id.to_owned())) }
    }
}

fn check_backoff(group: &str, backoff: &Backoff) -> Result<(), TreeError> {
    let wrong = |field, value, valid| TreeError::Backoff { group: group.to_owned(), field, value, valid };
    if !(backoff.factor.is_finite() && backoff.factor >= 1.0) {
        return Err(wrong("factor", backoff.factor, "1 or more"));
    }
    if !(0.0..=1.0).contains(&backoff.jitter) {
        return Err(wrong("jitter", backoff.jitter, "0 to 1"));
    }
    Ok(())
}
