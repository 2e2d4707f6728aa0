//! Tests of the operator's rights and limits, one per guarantee.

use trocar_scene::{
    Access, CommandError, Commands, Controller, ControllerError, Entity, EntityAllocator, EntitySet, Refusal,
    Revision, SimTime, Snapshot, Store, Tick, WriterId,
};

use crate::faults::secs;
use crate::lockstep::LockstepSession;
use crate::model_core::{DeclareError, ModelCore, Rejection};
use crate::operator::{OPERATOR, OPERATOR_NAME, OPERATOR_WRITES_MAX, OperatorError};
use crate::recorder::tests::{Folder, head};
use crate::recorder::{Recorder, RecorderOptions, Recording, Replay};
use crate::spec::{ControllerSpec, SessionSpec};
use crate::supervision::RuntimeClass;
use crate::testing::{Bomb, Count, Level, Pairs, registry};

const RING: Entity = Entity::new(0, 0, 1);
const PEG: Entity = Entity::new(0, 0, 2);

/// Increments the ring's count, and copies the level of the peg to the ring.
struct Engine;
impl Controller for Engine {
    fn access(&self) -> Access {
        let ring = || EntitySet::Of(vec![RING]);
        Access::new().writes::<Count>(ring()).writes::<Level>(ring()).contributes::<Pairs>()
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let count = scene.get::<Count>(RING).map_or(0, |count| count.0);
        out.put(RING, Count(count + 1));
        if let Some(level) = scene.get::<Level>(PEG) {
            out.put(RING, *level);
        }
        out.contribute(Pairs(tick.events.iter().map(|event| event.value as u32).collect()));
        Ok(())
    }
}

fn scene() -> Store {
    let registry = registry();
    let mut scene = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    commands.spawn();
    commands.spawn();
    scene.apply(&mut commands, SimTime::ZERO);
    scene
}

fn spec() -> SessionSpec {
    let engine =
        ControllerSpec::new("engine", 1, RuntimeClass::Simulation, 1_000.0, |_| Ok(Box::new(Engine)));
    SessionSpec::new("toy", 1, scene(), vec![engine])
}

fn session() -> LockstepSession {
    LockstepSession::new(spec()).expect("starts")
}

fn count(session: &LockstepSession) -> u64 {
    session.view().get::<Count>(RING).expect("counts").0
}

#[test]
fn an_operator_writes_rows_of_others_and_they_go_on_from_there() {
    let mut session = session();
    session.step_until(secs(0.01));
    assert_eq!(count(&session), 10);
    let before = session.view().revision();
    let revision = session.apply(|out| {
        out.put(RING, Count(1_000));
        out.put(PEG, Level(2.5));
        out.event("told", RING, None, 7.0);
    });
    assert_eq!(revision, Ok(Revision(before.0 + 1)));
    assert_eq!((count(&session), session.now()), (1_000, secs(0.01)));
    session.step_until(secs(0.011));
    let engine = Entity::of_writer(0, 1);
    assert_eq!(session.view().get::<Pairs>(engine), Some(&Pairs(vec![7])), "its events are heard");
    session.step_until(secs(0.02));
    assert_eq!(count(&session), 1_010);
    assert_eq!(session.view().get::<Level>(RING), Some(&Level(2.5)));
    let row = session.finish().controllers.remove(0);
    assert_eq!((row.rejected, row.conflicts, row.missed), (0, 0, 0), "nobody is disturbed");
}

#[test]
fn entities_of_its_own_can_be_made_and_removed_and_others_stay() {
    let mut session = session();
    let mut made = RING;
    let spawn = |out: &mut Commands| {
        let entity = out.spawn();
        out.put(entity, Count(5));
        entity
    };
    session.apply(|out| made = spawn(out)).expect("applied");
    assert_eq!((made.spawner(), made.counter()), (OPERATOR.0, 1));
    assert_eq!(session.view().get::<Count>(made), Some(&Count(5)));
    session.apply(|out| out.despawn(made)).expect("applied");
    assert!(!session.view().contains(made));
    let refused = session.apply(|out| out.despawn(RING));
    assert_eq!(refused, Err(Rejection::Refused(Refusal::NotOwner(RING)).into()));
    let mut again = RING;
    session.apply(|out| again = spawn(out)).expect("applied");
    assert_eq!(again.counter(), 2, "no name returns");
}

#[test]
fn what_is_wrong_is_refused_as_a_whole_and_named() {
    let mut session = session();
    session.step_until(secs(0.005));
    let before = (session.hash(), session.view().revision());
    let ghost = Entity::new(0, 0, 99);
    let unknown = session.apply(|out| {
        out.put(RING, Count(0));
        out.put(ghost, Count(1));
    });
    assert_eq!(unknown, Err(Rejection::Refused(Refusal::UnknownEntity(ghost)).into()));
    let nan = session.apply(|out| out.put(RING, Level(f64::NAN)));
    let text = nan.as_ref().expect_err("refused").to_string();
    assert!(text.contains("test_level of 0:0:1") && text.contains("not finite"), "{text}");
    let many = session.apply(|out| {
        (0..=OPERATOR_WRITES_MAX).for_each(|_| out.event("flood", RING, None, 0.0));
    });
    assert_eq!(many, Err(Rejection::TooManyWrites(OPERATOR_WRITES_MAX + 1).into()));
    #[derive(Clone, serde::Serialize, serde::Deserialize, trocar_scene::Component)]
    #[component(name = "stranger")]
    struct Stranger;
    let stranger = session.apply(|out| out.put(RING, Stranger));
    let expected = Rejection::Refused(CommandError::Unregistered("stranger").into());
    assert_eq!(stranger, Err(expected.into()));
    let changed = session.view().changed::<Count>(RING).expect("counts");
    let conflict = session.apply(|out| {
        out.require_unchanged::<Count>(RING, Revision(changed.0 - 1));
        out.put(RING, Count(0));
    });
    assert!(matches!(conflict, Err(OperatorError::Conflict(_))), "{conflict:?}");
    assert_eq!(session.apply(|_| {}), Ok(before.1), "nothing commanded, nothing changed");
    assert_eq!((session.hash(), session.view().revision()), before);
    assert_eq!(session.model().counts(OPERATOR).expect("known").rejected, 4);
}

#[test]
fn a_row_given_to_somebody_is_taken_from_whoever_had_it() {
    let mut core = ModelCore::new(scene(), 0).expect("encodes");
    let access = |on| Access::new().writes::<Count>(EntitySet::Of(vec![on]));
    core.declare("a", WriterId(1), &access(RING)).expect("new");
    core.declare("b", WriterId(2), &access(PEG)).expect("new");
    let mut send = |writer: WriterId, fill: &dyn Fn(&mut Commands)| {
        let commands = Commands::new(core.view().registry().clone(), EntityAllocator::new(0, writer.0));
        let provenance = trocar_scene::Provenance {
            writer,
            epoch: 1,
            tick: 0,
            time: SimTime::ZERO,
            based_on: Revision::ZERO,
        };
        let mut batch = trocar_scene::Batch { provenance, commands };
        fill(&mut batch.commands);
        batch.commands.seal();
        crate::operator::answer(core.apply(&mut batch, SimTime::ZERO)).is_ok()
    };
    assert!(send(OPERATOR, &|out| out.transfer::<Count>(RING, WriterId(2))));
    assert!(!send(WriterId(1), &|out| out.put(RING, Count(1))), "it was taken away");
    assert!(send(WriterId(2), &|out| out.put(RING, Count(2))));
    assert!(send(OPERATOR, &|out| out.put(RING, Count(3))), "the operator still may");
    // An operator can write a component on a writer's own entity, but not one of an entity that does not exist.
    assert!(send(OPERATOR, &|out| out.put(Entity::of_writer(0, 1), Count(4))));
    assert!(!send(OPERATOR, &|out| out.put(Entity::of_writer(0, 9), Count(4))));
}

#[test]
fn its_name_and_number_are_nobody_elses_and_it_stays_out_of_sight() {
    let mut core = ModelCore::new(scene(), 0).expect("encodes");
    assert_eq!(core.writers().count(), 0);
    for (name, id) in [(OPERATOR_NAME, 7), ("panel", OPERATOR.0)] {
        let error = core.declare(name, WriterId(id), &Access::new()).expect_err("reserved");
        assert!(matches!(error, DeclareError::Reserved { .. }), "{error}");
        assert!(error.to_string().contains("'operator', writer 65534"), "{error}");
    }
}

#[test]
fn what_it_writes_is_recorded_and_a_replay_and_a_rerun_end_in_the_same_hash() {
    let folder = Folder::new();
    let run = |file: Option<&std::path::Path>, value: f64| {
        let mut spec = spec();
        if let Some(file) = file {
            let recorder = Recorder::create(file, &head(), spec.scene.view(), RecorderOptions::exact());
            recorder.expect("begins").install(&mut spec);
        }
        let mut session = LockstepSession::new(spec).expect("starts");
        for at in [0.5, 1.0, 2.25] {
            session.step_until(secs(at));
            session
                .apply(|out| {
                    let entity = out.spawn();
                    out.put(entity, Count(3));
                    out.put(PEG, Level(value * at));
                })
                .expect("applied");
        }
        session.step_until(secs(3.0));
        session.finish()
    };
    let file = folder.file("operated.mcap");
    let recorded = run(Some(&file), 1.0);
    assert_eq!(recorded.recording_complete, Some(true));
    assert_eq!(recorded.hash, run(None, 1.0).hash);
    assert_ne!(recorded.hash, run(None, 1.5).hash);
    let recording = Recording::open(&file).expect("opens");
    let mut replay = Replay::new(&recording, recorded.snapshot.registry()).expect("has a keyframe");
    assert_eq!(replay.run_to_end().expect("agrees"), recorded.hash);
    assert_eq!(replay.view().get::<Level>(RING), Some(&Level(2.25)));
}

#[test]
fn a_batch_that_makes_the_model_panic_is_quarantined_and_the_session_goes_on() {
    let mut session = session();
    session.step_until(secs(0.1));
    let mut bomb = || session.apply(|out| out.put(PEG, Bomb::new(13)));
    // The first restart is immediate, the next one has to wait.
    assert_eq!(
        [bomb(), bomb(), bomb()],
        [Err(OperatorError::Quarantined), Err(OperatorError::Quarantined), Err(OperatorError::ModelDown)]
    );
    assert_eq!(session.model().counts(OPERATOR).expect("known").quarantined, 2);
    session.step_until(secs(0.3));
    session.apply(|out| out.put(PEG, Level(1.0))).expect("it is back");
    session.step_until(secs(0.31));
    assert_eq!(session.view().get::<Level>(RING), Some(&Level(1.0)));
    let outcome = session.finish();
    assert_eq!((outcome.code, outcome.model.restarts), (0, 2));
}

#[test]
fn a_session_that_has_given_up_takes_nothing() {
    let mut session = session();
    for step in 1..=60_000 {
        // An operator that kills the Model again and again ends the session, like any other writer.
        let _ = session.apply(|out| out.put(PEG, Bomb::new(13)));
        if !session.step_until(SimTime::from_millis(step)) {
            break;
        }
    }
    assert!(!session.is_running());
    assert_eq!(session.apply(|out| out.put(PEG, Level(1.0))), Err(OperatorError::Ended));
    assert_eq!(session.finish().code, 70);
}
