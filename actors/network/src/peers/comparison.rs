//! Comparison: a peer's own bodies beside the sketches of their owner.

use std::collections::{BTreeMap, VecDeque};

use trocar_scene::{Entity, SimTime, Snapshot};

use super::sketch::{self, Apart, BodySketch};
use crate::replication::ReplicationError;

/// Time between two sketches of an owner.
pub const SKETCH_EVERY: SimTime = SimTime::from_millis(500);
/// Time between two scenes that a peer remembers, and how many: those of two seconds, as long as a sketch may be on its way.
const REMEMBER_EVERY: SimTime = SimTime::from_millis(8);
const REMEMBERED_MAX: usize = 256;
/// How far bodies may be apart \[m\], \[rad\].
pub const TOLERANCE: (f64, f64) = (1e-3, 0.05);
/// After so many sketches in a row a body that differs is asked for: what one of both has done a little later is over by then.
const SKETCHES_IN_A_ROW: u32 = 2;
/// Least time between two repairs of a body.
const REPAIR_EVERY: SimTime = SimTime::from_millis(2_000);
/// Most bodies that are asked for at once.
const ASKED_MAX: usize = 4;

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ComparisonCounts {
    /// Bodies, or parts of them, that were compared.
    pub compared: u64,
    /// Of them, those that were further apart than allowed.
    pub differing: u64,
    /// Bodies that were asked for.
    pub asked: u64,
    /// Farthest distance of what has one, over all comparisons \[m\].
    pub distance_max: f64,
    /// The same of the last comparison \[m\].
    pub distance: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct Differing {
    /// Number of the last sketch in which it differed, and in how many in a row.
    number: u64,
    in_a_row: u32,
    asked_at: Option<SimTime>,
}

/// A peer's own bodies of the last seconds, and which of them differ from their owner's.
#[derive(Default)]
pub struct Comparison {
    remembered: VecDeque<(SimTime, Snapshot)>,
    differing: BTreeMap<Entity, Differing>,
    counts: ComparisonCounts,
}

impl Comparison {
    /// The scene at `now`, for a sketch of now that comes later.
    pub fn remember(&mut self, now: SimTime, scene: &Snapshot) {
        if self.remembered.back().is_some_and(|(before, _)| now.since(*before) < REMEMBER_EVERY) {
            return;
        }
        if self.remembered.len() == REMEMBERED_MAX {
            self.remembered.pop_front();
        }
        self.remembered.push_back((now, scene.clone()));
    }

    /// What was found so far.
    pub fn counts(&self) -> &ComparisonCounts {
        &self.counts
    }

    /// Compares with a payload of sketches of the scene as it was at `at`, by this peer's clock. One of a time that is not
    /// remembered has no effect.
    ///
    /// # Errors
    /// When the payload is malformed.
    pub fn compare(&mut self, at: SimTime, payload: &[u8]) -> Result<(), ReplicationError> {
        let (number, sketches) = sketch::read(payload)?;
        let from = |then: SimTime| then.since(at).max(at.since(then));
        let nearest = self.remembered.iter().min_by_key(|(then, _)| from(*then));
        let nearest = nearest.filter(|(then, _)| from(*then) <= REMEMBER_EVERY);
        let Some(scene) = nearest.map(|(_, scene)| scene.clone()) else { return Ok(()) };
        let mut own: Option<(Entity, Vec<BodySketch>)> = None;
        self.counts.distance = 0.0;
        for theirs in &sketches {
            if own.as_ref().is_none_or(|(entity, _)| *entity != theirs.entity) {
                own = Some((theirs.entity, sketch::of(&scene, theirs.entity, number)));
            }
            let Some((_, parts)) = &own else { continue };
            let apart = parts
                .iter()
                .find(|part| part.first == theirs.first)
                .map_or(Apart::Otherwise, |part| part.apart(theirs));
            self.counts.compared += 1;
            let differs = match apart {
                Apart::Otherwise => true,
                Apart::By { distance, angle } => {
                    self.counts.distance = self.counts.distance.max(distance);
                    self.counts.distance_max = self.counts.distance_max.max(distance);
                    !(distance <= TOLERANCE.0 && angle <= TOLERANCE.1)
                }
            };
            if differs {
                self.counts.differing += 1;
                self.differs(theirs.entity, number);
            }
        }
        Ok(())
    }

    fn differs(&mut self, entity: Entity, number: u64) {
        let of = self.differing.entry(entity).or_default();
        if of.number == number && of.in_a_row > 0 {
            return;
        }
        of.in_a_row = if of.number + 1 == number { of.in_a_row + 1 } else { 1 };
        of.number = number;
    }

    /// The bodies that are to be asked for now.
    pub fn take_asked(&mut self, now: SimTime) -> Vec<Entity> {
        let is_due = |of: &Differing| {
            of.in_a_row >= SKETCHES_IN_A_ROW && of.asked_at.is_none_or(|at| now.since(at) >= REPAIR_EVERY)
        };
        let mut asked = Vec::new();
        for (entity, of) in self.differing.iter_mut().filter(|(_, of)| is_due(of)).take(ASKED_MAX) {
            (of.in_a_row, of.asked_at) = (0, Some(now));
            asked.push(*entity);
        }
        self.differing
            .retain(|_, of| of.in_a_row > 0 || of.asked_at.is_some_and(|at| now.since(at) < REPAIR_EVERY));
        self.counts.asked += asked.len() as u64;
        asked
    }
}
