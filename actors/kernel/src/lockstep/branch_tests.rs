//! Tests of the guarantees of branches, one per guarantee.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use trocar_scene::{
    Access, Commands, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Registry, SimTime,
    Snapshot, Store, Tick, WriterId,
};

use super::{BranchError, LockstepSession};
use crate::faults::{FaultPlan, secs};
use crate::spec::{ControllerSpec, Peer, SessionSpec, StopWhen};
use crate::state_hash::Chain;
use crate::supervision::RuntimeClass;
use crate::testing::{self, Count, Level, Pairs};

const RING: Entity = Entity::new(0, 0, 1);
const PEG: Entity = Entity::new(0, 0, 2);

/// The registry of this test program.
fn registry() -> Arc<Registry> {
    static REGISTRY: OnceLock<Arc<Registry>> = OnceLock::new();
    REGISTRY.get_or_init(testing::registry).clone()
}

/// A controller whose whole state is in the scene; it records the events it gets and its ticks, and spawns now and
/// then.
struct Counter {
    on: Entity,
    /// Session time at which it was built.
    built: SimTime,
}
impl Controller for Counter {
    fn access(&self) -> Access {
        let on = || EntitySet::Of(vec![self.on]);
        Access::new().writes::<Count>(on()).writes::<Level>(on()).contributes::<Pairs>().spawns()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let count = scene.get::<Count>(self.on).map_or(0, |count| count.0);
        let heard = tick.events.iter().filter(|event| event.name == "told").map(|event| event.value as u32);
        let mut heard: Vec<u32> = heard.collect();
        heard.push(tick.number as u32);
        out.contribute(Pairs(heard));
        out.put(self.on, Count(count + 1));
        out.put(self.on, Level(tick.time.as_secs_f64() - self.built.as_secs_f64()));
        if tick.number % 10 == 3 {
            out.spawn();
        }
        Ok(())
    }
}

fn counter(name: &str, writer: u16, rate_hz: f64, on: Entity) -> ControllerSpec {
    ControllerSpec::new(name, writer, RuntimeClass::Simulation, rate_hz, move |context| {
        Ok(Box::new(Counter { on, built: context.time }))
    })
}

fn spec() -> SessionSpec {
    let registry = registry();
    let mut scene = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    commands.spawn();
    commands.spawn();
    scene.apply(&mut commands, SimTime::ZERO);
    let mut late = counter("late", 2, 333.0, PEG);
    late.phase = SimTime::from_micros(700);
    SessionSpec::new("toy", 42, scene, vec![counter("fast", 1, 1_000.0, RING), late])
}

fn start() -> LockstepSession {
    LockstepSession::new(spec()).expect("starts")
}

fn at(seconds: f64) -> LockstepSession {
    let mut session = start();
    session.step_until(secs(seconds));
    session
}

fn branch(session: &LockstepSession) -> LockstepSession {
    LockstepSession::resume(spec(), session.present()).expect("resumes")
}

fn pairs(session: &LockstepSession, writer: u16) -> Vec<u32> {
    session.view().get::<Pairs>(Entity::of_writer(0, writer)).expect("told").0.clone()
}

fn rows(session: &LockstepSession) -> Vec<u8> {
    let mut bytes = Vec::new();
    session.view().encode(&mut bytes).expect("encodes");
    bytes
}

#[test]
fn a_branch_of_resumable_controllers_ends_where_its_parent_does_to_the_bit() {
    for seconds in [0.0, 0.0004, 0.1, 0.123_456, 0.5] {
        let mut parent = at(seconds);
        let mut branch = branch(&parent);
        assert_eq!((branch.now(), branch.hash()), (parent.now(), parent.hash()));
        for session in [&mut parent, &mut branch] {
            session.step_until(secs(1.0));
        }
        // Only the counter's record of its own age is not in the scene.
        assert_eq!(pairs(&branch, 1), pairs(&parent, 1), "from {seconds} s");
        assert_eq!(pairs(&branch, 2), pairs(&parent, 2), "from {seconds} s");
        assert_eq!(branch.view().revision(), parent.view().revision());
        assert!(branch.view().entities().eq(parent.view().entities()), "no name is given out twice");
        let age = |session: &LockstepSession| session.view().get::<Level>(RING).expect("told").0;
        let last_tick = (seconds * 1e3).ceil() / 1e3 - if seconds > 0.0 { 1e-3 } else { 0.0 };
        assert!(
            (age(&branch) - (0.999 - last_tick)).abs() < 1e-9,
            "built for its last tick: {}",
            age(&branch)
        );
    }
}

#[test]
fn branches_are_alike_and_leave_their_parent_alone() {
    let unbranched = {
        let mut session = at(0.3);
        session.step_until(secs(1.0));
        session.finish().hash
    };
    let mut parent = at(0.3);
    let (mut one, mut other) = (branch(&parent), branch(&parent));
    one.step_until(secs(0.7));
    let mut grandchild = branch(&one);
    for session in [&mut one, &mut other, &mut grandchild] {
        session.step_until(secs(1.0));
    }
    assert_eq!(one.hash(), other.hash());
    assert_eq!(pairs(&grandchild, 2), pairs(&one, 2));
    one.apply(|out| out.put(RING, Count(7))).expect("applied");
    assert_ne!(one.hash(), other.hash());
    parent.step_until(secs(1.0));
    assert_eq!(parent.finish().hash, unbranched);
}

#[test]
fn what_was_told_is_heard_once_on_either_side_of_a_branch() {
    let mut parent = at(0.3);
    parent.apply(|out| out.event("told", RING, None, 77.0)).expect("applied");
    let mut branched = branch(&parent);
    branched.step_until(secs(0.301));
    assert_eq!(pairs(&branched, 1), [77, 300], "nobody had heard it");
    let mut again = branch(&branched);
    again.step_until(secs(0.302));
    assert_eq!(pairs(&again, 1), [301], "it was heard");
    again.step_until(secs(0.305));
    let mut by_late = branch(&parent);
    by_late.step_until(secs(0.304));
    assert_eq!(pairs(&by_late, 2)[0], 77);
}

#[test]
fn the_past_can_be_branched_and_a_snapshot_that_was_given_out_keeps_its_time_and_hash() {
    let mut parent = at(0.3004);
    let (snapshot, hash) = (parent.snapshot(), parent.hash());
    parent.step_until(secs(0.6));
    let moment = parent.moment_of(&snapshot).expect("known");
    assert!(!moment.is_present());
    let mut past = LockstepSession::resume(spec(), moment).expect("resumes");
    assert_eq!((past.now(), past.hash()), (secs(0.3004), hash));
    past.step_until(secs(0.6));
    assert_eq!(pairs(&past, 1).last(), pairs(&parent, 1).last());
    assert_eq!(past.view().get::<Count>(RING), parent.view().get::<Count>(RING));
    assert_eq!(past.view().get::<Count>(PEG), parent.view().get::<Count>(PEG));
    assert!(past.view().entities().eq(parent.view().entities()));
    // An unpublished snapshot: complete at the time of its last batch, hashed by its content.
    let stranger = at(0.25).view().clone();
    let moment = parent.moment_of(&stranger).expect("fits");
    assert_eq!(moment.at(), SimTime(stranger.time().0 + 1));
    let mut past = LockstepSession::resume(spec(), moment).expect("resumes");
    assert_eq!(past.hash(), Chain::begin(&stranger).expect("encodes").head());
    past.step_until(secs(0.6));
    assert_eq!(past.view().get::<Count>(RING), parent.view().get::<Count>(RING));
    assert_eq!(rows(&branch(&parent)), rows(&parent));
    let foreign = Store::new(testing::registry()).snapshot();
    assert!(matches!(parent.moment_of(&foreign), Err(BranchError::OtherComponents)));
}

#[test]
fn faults_that_are_planned_or_under_way_come_to_the_branch_as_well() {
    let plan = FaultPlan::new(1)
        .at(secs(0.2))
        .lasting(secs(0.4))
        .queue_full("fast")
        .at(secs(0.8))
        .kill("late")
        .at(secs(0.1))
        .kill("late");
    let faulty = || {
        let mut spec = spec();
        spec.faults = plan.clone();
        spec
    };
    let mut parent = LockstepSession::new(faulty()).expect("starts");
    parent.step_until(secs(0.4));
    let snapshot = parent.snapshot();
    let mut present = LockstepSession::resume(faulty(), parent.present()).expect("resumes");
    parent.step_until(secs(0.5));
    let past = LockstepSession::resume(faulty(), parent.moment_of(&snapshot).expect("known"));
    let mut past = past.expect("resumes");
    for session in [&mut parent, &mut present, &mut past] {
        session.step_until(secs(1.0));
    }
    let outcomes = [parent, present, past].map(LockstepSession::finish);
    let counts = outcomes.each_ref().map(|end| end.snapshot.get::<Count>(RING).copied());
    assert_eq!(counts[0], Some(Count(600)), "400 of 1,000 batches found their ring full");
    assert_eq!([counts[1], counts[2]], [counts[0]; 2]);
    let restarts = outcomes.each_ref().map(|end| end.controllers[1].restarts);
    assert_eq!(restarts, [2, 1, 1], "the first kill was over");
}

#[test]
fn what_is_on_its_way_over_a_bad_link_arrives_in_the_branch_as_well() {
    let faulty = || {
        let mut spec = spec();
        // The one that was killed sends from its second life; in a branch that is its first.
        let plan = FaultPlan::new(1).at(secs(0.1)).kill("late");
        let plan = plan.at(secs(0.2)).lasting(secs(0.4)).jitter("late", secs(0.05), secs(0.02));
        spec.faults = plan.at(secs(0.2)).lasting(secs(0.4)).delay("fast", secs(0.03));
        spec
    };
    let mut parent = LockstepSession::new(faulty()).expect("starts");
    parent.step_until(secs(0.45));
    let mut branch = LockstepSession::resume(faulty(), parent.present()).expect("resumes");
    for session in [&mut parent, &mut branch] {
        session.step_until(secs(1.0));
    }
    for writer in [1, 2] {
        assert_eq!(pairs(&branch, writer), pairs(&parent, writer));
    }
    assert_eq!(branch.view().revision(), parent.view().revision(), "every batch has arrived");
    let counts = |session: &LockstepSession| [RING, PEG].map(|on| session.view().get::<Count>(on).copied());
    assert_eq!(counts(&branch), counts(&parent));
    assert!(branch.finish().controllers.iter().all(|row| row.rejected == 0 && row.lost == 0));
}

#[test]
fn a_batch_that_came_twice_does_not_lead_to_names_that_are_given_out_twice() {
    let mut spec = spec();
    spec.faults = FaultPlan::new(1).at(secs(0.1)).lasting(secs(0.4)).duplicate("fast", 1.0);
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(secs(1.0));
    let outcome = session.finish();
    // Duplicates of batches that spawn are refused, because their entities exist; every tenth batch spawns.
    assert_eq!(outcome.controllers[0].rejected, 40);
    let spawned = outcome.snapshot.entities().filter(|entity| entity.spawner() == 1).count();
    assert_eq!(spawned, 100);
}

#[test]
fn rows_that_were_handed_over_stay_where_they_are() {
    let mut parent = at(0.1);
    parent.apply(|out| out.transfer::<Count>(RING, WriterId(2))).expect("applied");
    parent.step_until(secs(0.2));
    let rejected = |session: LockstepSession| session.finish().controllers[0].rejected;
    let mut branched = branch(&parent);
    branched.step_until(secs(0.3));
    parent.step_until(secs(0.3));
    assert_eq!((rejected(parent), rejected(branched)), (200, 100), "the first writer has lost it for good");
}

struct Metronome(Arc<AtomicU64>);
impl Peer for Metronome {
    fn name(&self) -> &str {
        "metronome"
    }
    fn period_ns(&self) -> u64 {
        3_000_000
    }
    fn step(&mut self, now: SimTime) {
        assert_eq!(now.0 % 3_000_000, 0);
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn peers_keep_their_beat_and_a_goal_and_an_end_stay_what_they_are() {
    let with_peer = |steps: &Arc<AtomicU64>| {
        let mut spec = spec();
        spec.peers.push(Box::new(Metronome(steps.clone())));
        spec.until = Some(secs(5.0));
        let reached = |scene: &Snapshot| scene.get::<Count>(RING).is_some_and(|count| count.0 >= 1_000);
        spec.stop_when = Some(StopWhen { every: SimTime::from_millis(20), check: Arc::new(reached) });
        spec
    };
    let (mine, its) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    let mut parent = LockstepSession::new(with_peer(&mine)).expect("starts");
    parent.step_until(secs(0.5));
    let before = mine.load(Ordering::Relaxed);
    assert_eq!(before, 167);
    let mut branched = LockstepSession::resume(with_peer(&its), parent.present()).expect("resumes");
    assert!(!parent.step_until(secs(9.0)) && !branched.step_until(secs(9.0)));
    assert_eq!(its.load(Ordering::Relaxed), mine.load(Ordering::Relaxed) - before);
    let ended = branched.now();
    assert!(ended == parent.now() && ended >= secs(0.999) && ended <= secs(1.02), "{ended}");
    let over = LockstepSession::resume(with_peer(&its), parent.present()).expect("resumes");
    assert!(!over.is_running(), "what is over is over in its branches");
}
