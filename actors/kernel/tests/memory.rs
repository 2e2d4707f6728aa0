//! An hour of a session in lock-step, with everything that a controller can do: what the session holds afterwards is
//! what it held before. `trocar bench memory` does the same with the exercises.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::spec::{CommitSink, ControllerSpec, SessionSpec};
use trocar_kernel::supervision::RuntimeClass;
use trocar_kernel::{CommitBuffer, LockstepSession};
use trocar_scene::{
    Access, BuildContext, Commands, Component, Controller, ControllerError, Entity, EntityAllocator,
    EntitySet, Registry, RegistryBuilder, SimTime, Snapshot, Store, Tick, WriterId,
};
use trocar_test_support::allocations::{held, peak_of};

const BODIES: u32 = 40;
const HOUR_SECS: u64 = 3_600;
const PHYSICS: WriterId = WriterId(1);

#[derive(Clone, Serialize, Deserialize, Component)]
#[component(name = "place")]
struct BodyPose([f64; 7]);
#[derive(Clone, Serialize, Deserialize, Component)]
#[component(name = "contacts")]
struct Contacts(Vec<u32>);
#[derive(Clone, Serialize, Deserialize, Component)]
#[component(name = "memo")]
struct Memo(u64);

fn body(n: u32) -> Entity {
    Entity::new(0, 0, n + 1)
}

fn scene() -> Store {
    let mut builder = RegistryBuilder::new();
    builder
        .register::<BodyPose>()
        .and_then(|b| b.register::<Contacts>())
        .and_then(|b| b.register::<Memo>())
        .expect("new");
    let registry: Arc<Registry> = builder.build();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    for n in 0..BODIES {
        assert_eq!(commands.spawn(), body(n));
        commands.put(body(n), BodyPose([0.0; 7]));
    }
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    store
}

/// Writes everything at every tick, and a list whose length changes.
struct Physics;
impl Controller for Physics {
    fn access(&self) -> Access {
        let bodies = (0..BODIES).map(body).collect();
        Access::new()
            .writes::<BodyPose>(EntitySet::Of(bodies))
            .contributes::<Contacts>()
            .contributes::<Memo>()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for n in 0..BODIES {
            out.put(body(n), BodyPose([tick.time.as_secs_f64(); 7]));
        }
        out.contribute(Contacts(vec![0; (tick.number % 17) as usize]));
        out.contribute(Memo(tick.number));
        Ok(())
    }
}

/// Creates things, hands them over, says so, and removes them two seconds later; now and then it fails.
struct Maker;
impl Controller for Maker {
    fn access(&self) -> Access {
        Access::new().writes::<Memo>(EntitySet::Own).writes::<Contacts>(EntitySet::Own).spawns()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let thing = out.spawn();
        out.put(thing, Memo(tick.number));
        out.put(thing, Contacts(vec![1, 2, 3]));
        out.transfer::<Memo>(thing, PHYSICS);
        out.event("made", thing, None, 1.0);
        let mine =
            scene.entities().filter(|entity| entity.spawner() == thing.spawner() && *entity != tick.me);
        let old = mine.take(scene.iter::<Contacts>().count().saturating_sub(40));
        old.for_each(|entity| out.despawn(entity));
        if tick.number % 6_000 == 599 {
            return Err(ControllerError::Failed("every now and then".to_owned()));
        }
        Ok(())
    }
}

/// Mostly too late: its preconditions do not hold, or its rows are not its own.
struct Late;
impl Controller for Late {
    fn access(&self) -> Access {
        Access::new().reads::<BodyPose>().contributes::<Memo>()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let changed = scene.changed::<BodyPose>(body(0)).unwrap_or_default();
        match tick.number % 3 {
            0 => out
                .require_unchanged::<BodyPose>(body(0), trocar_scene::Revision(changed.0.saturating_sub(1))),
            1 => out.put(body(1), BodyPose([1.0; 7])),
            _ => {}
        }
        out.contribute(Memo(tick.number));
        Ok(())
    }
}

/// Takes commits as a recorder does and keeps nothing.
struct Sink;
impl CommitSink for Sink {
    fn committed(&mut self, _: &Arc<Snapshot>, mut commits: CommitBuffer) -> CommitBuffer {
        commits.clear();
        commits
    }
    fn close(&mut self, _: Duration) -> bool {
        true
    }
}

fn controller<C: Controller>(
    name: &str,
    id: u16,
    rate_hz: f64,
    make: impl Fn() -> C + Send + Sync + 'static,
) -> ControllerSpec {
    let build = move |_: &BuildContext<'_>| Ok(Box::new(make()) as Box<dyn Controller>);
    ControllerSpec::new(name, id, RuntimeClass::Simulation, rate_hz, build)
}

fn session() -> LockstepSession {
    let controllers = vec![
        controller("physics", PHYSICS.0, 50.0, || Physics),
        controller("maker", 2, 20.0, || Maker),
        controller("late", 3, 60.0, || Late),
    ];
    let mut spec = SessionSpec::new("an hour", 42, scene(), controllers);
    spec.commit_sink = Some(Box::new(Sink));
    spec.faults = FaultPlan::new(1).at(SimTime::from_millis(70_000)).kill("physics");
    LockstepSession::new(spec).expect("starts")
}

fn run_to(session: &mut LockstepSession, secs: u64) -> f64 {
    assert!(session.step_until(SimTime::from_millis(secs * 1_000)), "it goes on");
    held() as f64
}

#[test]
fn live_bytes_are_flat_over_a_simulated_hour() {
    let mut session = session();
    // The log of events is full after 205 s; every minute on from there the same is held.
    let warm = run_to(&mut session, 300);
    let minutes: Vec<f64> = (6..=HOUR_SECS / 60).map(|minute| run_to(&mut session, minute * 60)).collect();
    let worst = minutes.iter().map(|bytes| (bytes / warm - 1.0).abs()).fold(0.0, f64::max);
    println!(
        "{warm} bytes after five minutes, {:?} after an hour, off by at most {worst:.5}",
        minutes.last()
    );
    assert!(worst <= 0.01, "{warm} bytes after five minutes, then {minutes:?}");
    // It was no session that did nothing.
    let outcome = session.finish();
    let row = |name: &str| outcome.controllers.iter().find(|row| row.name == name).expect("ran");
    assert!(row("physics").scheduled >= 50 * HOUR_SECS - 10 && row("physics").restarts == 1);
    assert!(row("maker").restarts >= 11, "{}", row("maker").restarts);
    assert!(row("late").rejected > 10 * HOUR_SECS, "{}", row("late").rejected);
}

#[test]
fn a_reader_that_stalls_holding_a_snapshot_costs_one_copy_of_the_scene_and_no_more() {
    let mut session = session();
    let before = run_to(&mut session, 300);
    let stalled = session.snapshot();
    let mut bytes = Vec::new();
    stalled.encode(&mut bytes).expect("encodes");
    let (copy, one_copy) = peak_of(|| Store::load(stalled.registry(), &bytes).map(|(store, _)| store));
    drop((copy, bytes));
    // By then everything that it shares has been replaced: rows at once, the log of events after 205 s.
    let held_up = run_to(&mut session, 540);
    assert!(held_up - before <= 1.5 * one_copy as f64, "{} bytes, a scene has {one_copy}", held_up - before);
    for minute in 10..=30 {
        let now = run_to(&mut session, minute * 60);
        assert!((now / held_up - 1.0).abs() <= 0.01, "{held_up} bytes, {now} after {minute} minutes");
    }
    drop(stalled);
    let after = run_to(&mut session, 1_860);
    assert!((after / before - 1.0).abs() <= 0.01, "{before} bytes before, {after} after the reader let go");
}
