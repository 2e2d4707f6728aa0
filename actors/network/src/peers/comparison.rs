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
/// Most bodies that differ and are remembered; others are when there is room.
const DIFFERING_MAX: usize = 1_024;

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
    /// Number of the last sketch.
    number: u64,
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
        let mut own: BTreeMap<Entity, Vec<BodySketch>> = BTreeMap::new();
        self.counts.distance = 0.0;
        self.number = number;
        for theirs in &sketches {
            let entity = theirs.entity;
            let parts = own.entry(entity).or_insert_with(|| sketch::of(&scene, entity, number));
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
        if self.differing.len() >= DIFFERING_MAX && !self.differing.contains_key(&entity) {
            return;
        }
        let of = self.differing.entry(entity).or_default();
        if of.number == number && of.in_a_row > 0 {
            return;
        }
        let is_next = of.number.checked_add(1) == Some(number);
        of.in_a_row = if is_next { of.in_a_row.saturating_add(1) } else { 1 };
        of.number = number;
    }

    /// How many bodies have differed lately.
    pub fn differing(&self) -> usize {
        self.differing.len()
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
        // One that has not differed in the last sketches begins anew.
        let newest = self.number;
        self.differing.retain(|_, of| {
            let is_recent = of.in_a_row > 0 && of.number.abs_diff(newest) <= u64::from(SKETCHES_IN_A_ROW);
            is_recent || of.asked_at.is_some_and(|at| now.since(at) < REPAIR_EVERY)
        });
        self.counts.asked += asked.len() as u64;
        asked
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Commands, EntityAllocator, Motion, Pose, Registry, RigidBody, Store};

    use super::*;

    const MS: fn(u64) -> SimTime = SimTime::from_millis;

    /// A scene with as many rings at a place.
    fn rings(count: usize, x: f64) -> Snapshot {
        let registry = Registry::standard();
        let (mut store, mut out) =
            (Store::new(registry.clone()), Commands::new(registry, EntityAllocator::new(0, 0)));
        for _ in 0..count {
            let ring = out.spawn();
            out.put(ring, RigidBody { motion: Motion::Dynamic, ..RigidBody::default() });
            out.put(ring, Pose::at(x, 0.0, 0.1));
        }
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        store.snapshot()
    }

    fn payloads(scene: &Snapshot, number: u64) -> Vec<Vec<u8>> {
        let sketches: Vec<BodySketch> =
            sketch::bodies(scene).into_iter().flat_map(|body| sketch::of(scene, body, number)).collect();
        sketch::write(number, &sketches)
    }

    fn compare(comparison: &mut Comparison, at: SimTime, theirs: &Snapshot, number: u64) {
        for payload in payloads(theirs, number) {
            comparison.compare(at, &payload).expect("it is the owner's");
        }
    }

    #[test]
    fn a_body_is_asked_for_once_it_has_differed_in_two_sketches_in_a_row() {
        let (own, theirs) = (rings(2, 0.3), rings(2, 0.31));
        let mut comparison = Comparison::default();
        comparison.remember(MS(0), &own);
        compare(&mut comparison, MS(0), &theirs, 7);
        assert!(comparison.take_asked(MS(100)).is_empty());
        // Of a time that is not remembered.
        compare(&mut comparison, MS(500), &theirs, 8);
        assert!(comparison.take_asked(MS(600)).is_empty());
        compare(&mut comparison, MS(0), &theirs, 8);
        assert_eq!(comparison.take_asked(MS(600)).len(), 2);
        assert_eq!((comparison.counts().differing, comparison.counts().asked), (4, 2));
        for number in 9..12 {
            compare(&mut comparison, MS(0), &theirs, number);
        }
        assert!(comparison.take_asked(MS(2_000)).is_empty(), "the answer may be on its way");
        assert_eq!(comparison.take_asked(MS(2_600)).len(), 2);
    }

    #[test]
    fn one_that_differed_once_is_forgotten_and_no_number_is_beyond_counting() {
        let (own, theirs) = (rings(2, 0.3), rings(2, 0.31));
        let mut comparison = Comparison::default();
        comparison.remember(MS(0), &own);
        for number in [1, u64::MAX - 1, u64::MAX, 0, u64::MAX] {
            compare(&mut comparison, MS(0), &theirs, number);
        }
        assert_eq!(comparison.differing(), 2);
        compare(&mut comparison, MS(0), &own, 5);
        assert!(comparison.take_asked(MS(10_000)).is_empty());
        assert_eq!(comparison.differing(), 0);
    }

    #[test]
    fn what_is_remembered_of_bodies_is_bounded() {
        let (own, theirs) = (rings(0, 0.0), rings(2 * DIFFERING_MAX, 0.3));
        let mut comparison = Comparison::default();
        for ms in 0..10_000 {
            comparison.remember(MS(ms), &own);
        }
        assert_eq!(comparison.remembered.len(), REMEMBERED_MAX);
        // None of them is here.
        for number in 1..3 {
            compare(&mut comparison, MS(9_992), &theirs, number);
        }
        assert_eq!(comparison.differing(), DIFFERING_MAX);
        assert_eq!(comparison.take_asked(MS(10_000)).len(), ASKED_MAX, "the others follow");
    }
}
