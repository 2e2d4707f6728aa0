//! Tests of the Model's guarantees, one per guarantee. `tests/model_sequences.rs` runs random sessions.

use trocar_scene::{
    Access, Batch, CommandError, Commands, Entity, EntityAllocator, EntitySet, Provenance, Refusal, Revision,
    SimTime, Store, WriterId,
};

use crate::commit::CommitBuffer;
use crate::model_core::{DeclareError, ModelCore, Outcome, Rejection};
use crate::runtime::panics::guarded;
use crate::state_hash::CommitKind;
use crate::testing::{Bomb, Count, Level, Pairs, Shadow, registry};

const RING: Entity = Entity::new(0, 0, 1);
const PEG: Entity = Entity::new(0, 0, 2);
const ENGINE: WriterId = WriterId(1);
const PILOT: WriterId = WriterId(2);

fn scene() -> Store {
    let registry = registry();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    commands.spawn();
    commands.spawn();
    commands.put(RING, Count(0));
    store.apply(&mut commands, SimTime::ZERO);
    store
}

fn core() -> ModelCore {
    let mut core = ModelCore::new(scene(), 0).expect("encodes");
    let engine = Access::new()
        .writes::<Count>(EntitySet::Of(vec![RING]))
        .writes::<Level>(EntitySet::All)
        .writes::<Bomb>(EntitySet::All)
        .contributes::<Pairs>()
        .contributes::<Shadow>()
        .spawns();
    let pilot = Access::new().writes::<Count>(EntitySet::Of(vec![PEG])).contributes::<Pairs>();
    assert_eq!(core.declare("engine", ENGINE, &engine), Ok(1));
    assert_eq!(core.declare("pilot", PILOT, &pilot), Ok(1));
    core
}

fn batch(core: &ModelCore, writer: WriterId, epoch: u32, fill: impl FnOnce(&mut Commands)) -> Batch {
    let registry = core.view().registry().clone();
    let mut commands = Commands::new(registry, EntityAllocator::new(0, writer.0));
    fill(&mut commands);
    commands.seal();
    let time = SimTime::from_millis(1);
    Batch { provenance: Provenance { writer, epoch, tick: 1, time, based_on: Revision::ZERO }, commands }
}

fn submit(core: &mut ModelCore, writer: WriterId, epoch: u32, fill: impl FnOnce(&mut Commands)) -> Outcome {
    let mut batch = batch(core, writer, epoch, fill);
    core.apply(&mut batch, SimTime::from_millis(1))
}

fn rejection(outcome: Outcome) -> Rejection {
    match outcome {
        Outcome::Rejected(rejection) => rejection,
        other => panic!("not rejected: {other:?}"),
    }
}

#[test]
fn two_writers_of_one_row_are_refused_at_the_start() {
    let mut core = core();
    let rogue = Access::new().writes::<Count>(EntitySet::Of(vec![RING, PEG]));
    let error = core.declare("rogue", WriterId(3), &rogue).expect_err("overlaps");
    let text = error.to_string();
    assert!(text.contains("rogue") && text.contains("engine") && text.contains("test_count"), "{text}");
    let all = Access::new().writes::<Level>(EntitySet::Own).spawns();
    assert!(matches!(core.declare("rogue", WriterId(3), &all), Err(DeclareError::Overlap(_))));
    assert!(matches!(core.declare("engine", WriterId(3), &all), Err(DeclareError::NameTaken(_))));
    assert!(matches!(core.declare("rogue", ENGINE, &all), Err(DeclareError::IdTaken { .. })));
    let mut unknown = Access::new();
    unknown.reads.push("no_such_component");
    assert!(matches!(core.declare("rogue", WriterId(3), &unknown), Err(DeclareError::Component { .. })));
    assert_eq!(core.writers().count(), 2, "nobody else came in");
}

#[test]
fn a_pilot_that_writes_what_is_the_engines_is_rejected_as_a_whole() {
    let mut core = core();
    let before = (core.hash(), core.view().revision());
    let outcome = submit(&mut core, PILOT, 1, |out| {
        out.put(PEG, Count(5));
        out.put(RING, Count(6));
    });
    let expected = Refusal::NotDeclared { component: "test_count", entity: RING };
    assert_eq!(rejection(outcome), Rejection::Refused(expected.clone()));
    assert_eq!(core.view().get::<Count>(PEG), None, "nothing of the batch is in the scene");
    assert_eq!((core.hash(), core.view().revision()), before);
    let counts = core.counts(PILOT).expect("declared");
    assert_eq!((counts.applied, counts.rejected), (0, 1));
    assert_eq!(core.last_rejection(PILOT), Some(&Rejection::Refused(expected)));
}

#[test]
fn bad_numbers_unknown_entities_and_strangers_are_rejected() {
    let mut core = core();
    let nan = rejection(submit(&mut core, ENGINE, 1, |out| out.put(RING, Level(f64::NAN))));
    assert!(matches!(nan, Rejection::Refused(Refusal::Command(CommandError::Value { .. }))), "{nan}");
    let ghost = Entity::new(0, 0, 99);
    let unknown = rejection(submit(&mut core, ENGINE, 1, |out| out.put(ghost, Level(1.0))));
    assert_eq!(unknown, Rejection::Refused(Refusal::UnknownEntity(ghost)));
    let stranger = rejection(submit(&mut core, WriterId(9), 1, |out| out.put(RING, Count(1))));
    assert_eq!(stranger, Rejection::UnknownWriter(9));
    let spawn = rejection(submit(&mut core, PILOT, 1, |out| {
        out.spawn();
    }));
    assert!(matches!(spawn, Rejection::Refused(Refusal::NotOwner(_))));
    assert!(matches!(
        submit(&mut core, ENGINE, 1, |out| out.put(RING, Level(1.0))),
        Outcome::Applied { revision: Revision(2) }
    ));
}

#[test]
fn a_stale_precondition_is_a_conflict_and_no_failure() {
    let mut core = core();
    let before = core.view().revision();
    submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(1)));
    let outcome = submit(&mut core, ENGINE, 1, |out| {
        out.require_unchanged::<Count>(RING, before);
        out.put(RING, Count(2));
    });
    assert!(matches!(outcome, Outcome::Conflict(Refusal::Conflict { entity: RING, .. })), "{outcome:?}");
    let counts = core.counts(ENGINE).expect("declared");
    assert_eq!((counts.applied, counts.rejected, counts.conflicts), (1, 0, 1));
    let now = core.view().revision();
    let outcome = submit(&mut core, ENGINE, 1, |out| {
        out.require_unchanged::<Count>(RING, now);
        out.put(RING, Count(2));
    });
    assert!(matches!(outcome, Outcome::Applied { .. }));
}

#[test]
fn a_fence_removes_contributions_and_refuses_the_old_life() {
    let mut core = core();
    let me = Entity::of_writer(0, ENGINE.0);
    submit(&mut core, ENGINE, 1, |out| {
        out.contribute(Pairs(vec![1, 2]));
        out.contribute(Shadow(1.0));
    });
    submit(&mut core, PILOT, 1, |out| out.contribute(Pairs(vec![3])));
    assert!(core.fence(ENGINE, 2, SimTime::from_millis(2)));
    assert!(!core.fence(ENGINE, 2, SimTime::from_millis(2)), "once is enough");
    assert_eq!(core.view().get::<Pairs>(me), None);
    assert_eq!(core.view().get::<Shadow>(me), None);
    assert_eq!(core.view().iter::<Pairs>().count(), 1, "the other's contribution stays");
    let stale = rejection(submit(&mut core, ENGINE, 1, |out| out.contribute(Pairs(vec![9]))));
    assert_eq!(stale, Rejection::StaleEpoch { found: 1, current: 2 });
    assert!(matches!(
        submit(&mut core, ENGINE, 2, |out| out.contribute(Pairs(vec![4]))),
        Outcome::Applied { .. }
    ));
    assert!(!core.fence(WriterId(9), 2, SimTime::ZERO));
}

#[test]
fn ownership_moves_explicitly_and_survives_a_restart_of_either_side() {
    let mut core = core();
    let put = |value| move |out: &mut Commands| out.put(RING, Count(value));
    submit(&mut core, ENGINE, 1, |out| out.transfer::<Count>(RING, PILOT));
    assert!(matches!(submit(&mut core, ENGINE, 1, put(1)), Outcome::Rejected(_)));
    assert!(matches!(submit(&mut core, PILOT, 1, put(2)), Outcome::Applied { .. }));
    // A new life with another declaration is compiled again; transferred rows stay transferred.
    let wider = Access::new().writes::<Count>(EntitySet::Of(vec![PEG])).contributes::<Shadow>();
    core.declare("pilot", PILOT, &wider).expect("no overlap");
    assert!(matches!(submit(&mut core, PILOT, 1, put(3)), Outcome::Applied { .. }));
    submit(&mut core, PILOT, 1, |out| out.transfer::<Count>(RING, ENGINE));
    assert!(matches!(submit(&mut core, PILOT, 1, put(4)), Outcome::Rejected(_)));
    assert!(matches!(submit(&mut core, ENGINE, 1, put(5)), Outcome::Applied { .. }));
    let heir = rejection(submit(&mut core, ENGINE, 1, |out| out.transfer::<Count>(RING, WriterId(9))));
    assert_eq!(heir, Rejection::UnknownHeir(9));
}

/// Applies a batch that panics and lets the core recover.
fn blow_up(core: &mut ModelCore, bomb: Bomb) -> bool {
    let mut bad = batch(core, ENGINE, 1, |out| out.put(RING, bomb));
    assert!(guarded(|| core.apply(&mut bad, SimTime::ZERO)).is_err());
    core.recover(Some(ENGINE))
}

#[test]
fn a_batch_that_panics_before_it_touches_the_scene_costs_nothing_else() {
    let mut core = core();
    submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(2)));
    let before = (core.hash(), core.view().revision());
    assert!(!blow_up(&mut core, Bomb::new(13)));
    assert_eq!((core.hash(), core.view().revision()), before);
    assert_eq!(core.counts(ENGINE).expect("declared").quarantined, 1);
    assert!(matches!(submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(3))), Outcome::Applied { .. }));
}

#[test]
fn a_batch_that_panics_half_applied_takes_the_model_back_to_what_was_published() {
    let mut core = core();
    core.keep_commits(true);
    submit(&mut core, ENGINE, 1, |out| {
        out.put(RING, Count(1));
        out.put(RING, Bomb::new(14));
    });
    let published = core.publish();
    let hash = core.hash();
    submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(2)));
    submit(&mut core, ENGINE, 1, |out| out.transfer::<Count>(RING, PILOT));
    assert!(blow_up(&mut core, Bomb::new(0)), "replacing the armed bomb panics");
    assert_eq!(core.view().revision(), published.revision());
    assert_eq!(core.view().get::<Count>(RING), Some(&Count(1)));
    assert_eq!(core.hash(), hash);
    assert_eq!(core.swap_commits(CommitBuffer::new()).len(), 1, "what nobody saw is not recorded");
    let again = submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(3)));
    assert!(matches!(again, Outcome::Applied { .. }), "the unseen transfer is undone: {again:?}");
}

#[test]
fn a_published_snapshot_never_changes() {
    let mut core = core();
    let first = core.publish();
    for value in 1..100 {
        submit(&mut core, ENGINE, 1, |out| out.put(RING, Count(value)));
    }
    assert_eq!(first.get::<Count>(RING), Some(&Count(0)));
    assert_eq!(core.published().get::<Count>(RING), Some(&Count(0)), "not before publication");
    assert_eq!(core.publish().get::<Count>(RING), Some(&Count(99)));
}

#[test]
fn derived_components_are_in_the_scene_but_not_in_the_hash() {
    let (mut one, mut other) = (core(), core());
    submit(&mut one, ENGINE, 1, |out| {
        out.put(RING, Count(1));
        out.contribute(Shadow(1.0));
    });
    submit(&mut other, ENGINE, 1, |out| {
        out.contribute(Shadow(2.0));
        out.put(RING, Count(1));
    });
    assert_eq!(one.hash(), other.hash());
    submit(&mut one, ENGINE, 1, |out| out.put(RING, Level(1.0)));
    submit(&mut other, ENGINE, 1, |out| out.put(RING, Level(f64::from_bits(1.0f64.to_bits() ^ 1))));
    assert_ne!(one.hash(), other.hash(), "one flipped bit");
}

#[test]
fn commits_replayed_into_a_fresh_core_give_the_same_scene_and_hash() {
    let mut core = core();
    core.keep_commits(true);
    let spawner = EntityAllocator::new(0, ENGINE.0);
    for tick in 0..20 {
        let mut batch = batch(&core, ENGINE, core.epoch(ENGINE).expect("declared"), |_| {});
        batch.commands = Commands::new(core.view().registry().clone(), spawner.clone());
        let entity = batch.commands.spawn();
        batch.commands.put(entity, Level(f64::from(tick)));
        batch.commands.contribute(Pairs(vec![tick]));
        batch.commands.event("tick", entity, None, 1.0);
        batch.commands.seal();
        assert!(matches!(core.apply(&mut batch, SimTime::ZERO), Outcome::Applied { .. }));
        if tick % 7 == 3 {
            let epoch = core.epoch(ENGINE).expect("declared") + 1;
            assert!(core.fence(ENGINE, epoch, SimTime::from_millis(u64::from(tick))));
        }
    }
    let commits = core.swap_commits(CommitBuffer::new());
    let mut again = ModelCore::new(scene(), 0).expect("encodes");
    for commit in commits.iter() {
        let mut commands = Commands::new(again.view().registry().clone(), EntityAllocator::new(0, 0));
        assert!(commands.decode(commit.payload).expect("own bytes").is_empty());
        let revision = again
            .replay(commit.kind, commit.revision, commit.writer, commit.provenance, &mut commands)
            .expect("encodes");
        assert_eq!((revision, again.hash()), (commit.revision, commit.hash));
    }
    assert_eq!(commits.iter().filter(|commit| commit.kind == CommitKind::Fence).count(), 3);
    let scene_of = |core: &ModelCore| {
        let mut bytes = Vec::new();
        core.view().encode(&mut bytes).expect("encodes");
        bytes
    };
    assert_eq!(scene_of(&again), scene_of(&core));
}

#[test]
fn of_two_heirs_of_one_row_in_a_batch_the_later_one_has_it() {
    let mut core = core();
    let (guest, none) = (WriterId(3), Access::new().contributes::<Shadow>());
    core.declare("guest", guest, &Access::new()).expect("fits");
    assert!(
        core.declare("shadow", WriterId(4), &none).is_ok(),
        "everybody contributes on an entity of its own"
    );
    submit(&mut core, ENGINE, 1, |out| {
        out.transfer::<Count>(RING, PILOT);
        out.transfer::<Count>(RING, guest);
    });
    let put = |out: &mut Commands| out.put(RING, Count(1));
    assert!(matches!(submit(&mut core, PILOT, 1, put), Outcome::Rejected(_)));
    assert!(matches!(submit(&mut core, guest, 1, put), Outcome::Applied { .. }));
}

#[test]
fn a_fence_outlives_the_fall_back_of_a_panic() {
    let mut core = core();
    core.keep_commits(true);
    let me = Entity::of_writer(0, PILOT.0);
    submit(&mut core, PILOT, 1, |out| out.contribute(Pairs(vec![1])));
    submit(&mut core, ENGINE, 1, |out| out.put(RING, Bomb::new(14)));
    core.publish();
    assert!(core.fence(PILOT, 2, SimTime::from_millis(3)));
    submit(&mut core, ENGINE, 1, |out| out.put(PEG, Level(1.0)));
    assert!(blow_up(&mut core, Bomb::new(0)));
    assert_eq!(core.view().get::<Pairs>(me), None, "a dead writer's contact does not come back");
    assert_eq!(core.view().get::<Level>(PEG), None);
    assert_eq!(core.counts(ENGINE).expect("declared").undone, 1);
    let last = core.swap_commits(CommitBuffer::new());
    assert_eq!(last.iter().last().map(|commit| commit.kind), Some(CommitKind::Fence), "and is in the log");
}

#[test]
fn what_stands_on_a_writers_own_entity_is_nobody_elses() {
    let mut core = core();
    let me = Entity::of_writer(0, PILOT.0);
    let all = Access::new().writes::<Pairs>(EntitySet::All);
    assert!(matches!(core.declare("rogue", WriterId(3), &all), Err(DeclareError::Overlap(_))));
    let heir = rejection(submit(&mut core, PILOT, 1, |out| out.transfer::<Pairs>(me, ENGINE)));
    assert_eq!(heir, Rejection::OwnEntity { component: "test_pairs", entity: me });
}

/// A station 1 with the copy of a scene of station 0, of whose entities it moves one itself.
fn replica() -> ModelCore {
    let mut core = ModelCore::new(scene(), 1).expect("encodes");
    assert_eq!(core.declare("link", ENGINE, &Access::new().replicates()), Ok(1));
    let hand =
        Access::new().writes::<Count>(EntitySet::Of(vec![PEG])).writes::<Level>(EntitySet::Own).spawns();
    assert_eq!(core.declare("hand", PILOT, &hand), Ok(1), "it claims nothing that is another's");
    core
}

#[test]
fn a_replica_creates_changes_and_removes_what_other_stations_own() {
    let mut core = replica();
    let theirs = Entity::new(0, 7, 12);
    let outcome = submit(&mut core, ENGINE, 1, |out| {
        out.adopt(theirs);
        out.put(theirs, Count(3));
        out.put(RING, Level(0.5));
        out.put(Entity::of_writer(0, 7), Pairs(vec![4]));
    });
    assert!(matches!(outcome, Outcome::Applied { .. }), "{outcome:?}");
    assert_eq!(core.view().get::<Count>(theirs), Some(&Count(3)));
    assert_eq!(core.view().get::<Pairs>(Entity::of_writer(0, 7)), Some(&Pairs(vec![4])));
    let outcome = submit(&mut core, ENGINE, 1, |out| {
        out.remove::<Level>(RING);
        out.despawn(theirs);
    });
    assert!(matches!(outcome, Outcome::Applied { .. }), "{outcome:?}");
    assert!(!core.view().contains(theirs) && core.view().get::<Level>(RING).is_none());
    assert_eq!(core.view().first_free(0, 7), 13, "its number is never given again");
}

#[test]
fn a_replica_leaves_the_rows_of_this_stations_writers_alone() {
    let mut core = replica();
    let refused =
        |core: &mut ModelCore, fill: &dyn Fn(&mut Commands)| rejection(submit(core, ENGINE, 1, fill));
    let peg = Refusal::NotDeclared { component: "test_count", entity: PEG };
    assert_eq!(refused(&mut core, &|out| out.put(PEG, Count(1))), Rejection::Refused(peg.clone()));
    let ours = Entity::new(1, 7, 1);
    assert_eq!(refused(&mut core, &|out| out.adopt(ours)), Rejection::Refused(Refusal::NotOwner(ours)));
    let of_hand = Entity::of_writer(1, PILOT.0);
    let level = Refusal::NotDeclared { component: "test_level", entity: of_hand };
    assert_eq!(refused(&mut core, &|out| out.put(of_hand, Level(1.0))), Rejection::Refused(level));
    // The others may not touch the copy.
    let theirs = rejection(submit(&mut core, PILOT, 1, |out| out.despawn(RING)));
    assert_eq!(theirs, Rejection::Refused(Refusal::NotOwner(RING)));
    // A new writer's rows are left alone as well, and a roll-back does not forget them.
    assert_eq!(
        core.declare("late", WriterId(5), &Access::new().writes::<Count>(EntitySet::Of(vec![RING]))),
        Ok(1)
    );
    submit(&mut core, ENGINE, 1, |out| out.put(RING, Bomb::new(14)));
    core.publish();
    assert!(blow_up(&mut core, Bomb::new(0)), "it rolled back");
    let ring = Refusal::NotDeclared { component: "test_count", entity: RING };
    assert_eq!(refused(&mut core, &|out| out.put(RING, Count(1))), Rejection::Refused(ring));
    assert_eq!(refused(&mut core, &|out| out.put(PEG, Count(1))), Rejection::Refused(peg));
}
