//! What the Model promises, one test per promise, and a property test against a naive model.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use trocar_scene::{
    Access, Batch, CommandError, Commands, Entity, EntityAllocator, EntitySet, Provenance, Refusal, Revision,
    SimTime, Store, WriterId,
};

use crate::chain::CommitKind;
use crate::commit::CommitBuffer;
use crate::model_core::{DeclareError, ModelCore, Outcome, Rejection};
use crate::runtime::panics::guarded;
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
    // A new life that declares something else is compiled anew; what was handed over stays.
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
        let revision =
            again.replay(commit.kind, commit.writer, commit.provenance, &mut commands).expect("encodes");
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

/// One step of a random session.
#[derive(Clone, Debug)]
enum Step {
    Batch { writer: u16, stale: bool, writes: Vec<Write> },
    Fence { writer: u16 },
    Publish,
    Recover,
}

#[derive(Clone, Debug)]
enum Write {
    Put { entity: Entity, value: u64 },
    Remove { entity: Entity },
    Spawn { counter: u32 },
    Despawn { entity: Entity },
    Contribute { value: u32 },
    Nan { entity: Entity },
    Require { entity: Entity, since: u64 },
}

fn entity() -> impl Strategy<Value = Entity> {
    (0u16..3, 0u32..4).prop_map(|(spawner, counter)| Entity::new(0, spawner, counter))
}

fn write() -> impl Strategy<Value = Write> {
    prop_oneof![
        6 => (entity(), any::<u64>()).prop_map(|(entity, value)| Write::Put { entity, value }),
        2 => entity().prop_map(|entity| Write::Remove { entity }),
        3 => (1u32..4).prop_map(|counter| Write::Spawn { counter }),
        2 => entity().prop_map(|entity| Write::Despawn { entity }),
        2 => any::<u32>().prop_map(|value| Write::Contribute { value }),
        1 => entity().prop_map(|entity| Write::Nan { entity }),
        1 => (entity(), 0u64..30).prop_map(|(entity, since)| Write::Require { entity, since }),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        12 => (1u16..4, prop::bool::weighted(0.1), prop::collection::vec(write(), 0..5))
            .prop_map(|(writer, stale, writes)| Step::Batch { writer, stale, writes }),
        1 => (1u16..4).prop_map(|writer| Step::Fence { writer }),
        2 => Just(Step::Publish),
        1 => Just(Step::Recover),
    ]
}

/// The same rules over plain maps, in the most obvious way.
#[derive(Clone, Default)]
struct Naive {
    revision: u64,
    alive: BTreeSet<Entity>,
    counts: BTreeMap<Entity, (u64, u64)>,
    pairs: BTreeMap<Entity, u32>,
}

impl Naive {
    fn may_write(writer: u16, entity: Entity) -> bool {
        match writer {
            1 => entity == RING || entity.spawner() == 1,
            2 => entity == PEG,
            _ => false,
        }
    }

    fn batch(&mut self, writer: u16, writes: &[Write]) -> bool {
        let spawned: Vec<Entity> = writes
            .iter()
            .filter_map(|write| match write {
                Write::Spawn { counter } => Some(Entity::new(0, writer, *counter)),
                _ => None,
            })
            .collect();
        let me = Entity::new(0, writer, 0);
        let mine = |entity: Entity| writer == 1 && entity.spawner() == 1 && entity != me;
        let exists = |alive: &BTreeSet<Entity>, entity| {
            entity == me || alive.contains(&entity) || spawned.contains(&entity)
        };
        let fine = |write: &Write| match write {
            Write::Put { entity, .. } | Write::Remove { entity } => {
                Self::may_write(writer, *entity) && exists(&self.alive, *entity)
            }
            Write::Spawn { counter } => {
                let entity = Entity::new(0, writer, *counter);
                mine(entity) && !self.alive.contains(&entity)
            }
            Write::Despawn { entity } => mine(*entity) && self.alive.contains(entity),
            Write::Contribute { .. } => writer < 3,
            Write::Nan { .. } => false,
            Write::Require { entity, since } => {
                self.counts.get(entity).is_none_or(|(_, revision)| revision <= since)
            }
        };
        if writer > 2 || !writes.iter().all(fine) {
            return false;
        }
        self.revision += 1;
        let each = |wanted: fn(&Write) -> bool| writes.iter().filter(move |write| wanted(write));
        self.alive.extend(spawned);
        for write in each(|write| matches!(write, Write::Put { .. } | Write::Contribute { .. })) {
            match write {
                Write::Put { entity, value } => {
                    self.counts.insert(*entity, (*value, self.revision));
                }
                Write::Contribute { value } => {
                    self.pairs.insert(me, *value);
                }
                _ => {}
            }
        }
        for write in each(|write| matches!(write, Write::Remove { .. })) {
            if let Write::Remove { entity } = write {
                self.counts.remove(entity);
            }
        }
        for write in each(|write| matches!(write, Write::Despawn { .. })) {
            if let Write::Despawn { entity } = write {
                self.alive.remove(entity);
                self.counts.remove(entity);
                self.pairs.remove(entity);
            }
        }
        true
    }
}

fn random_batch(core: &ModelCore, writer: u16, epoch: u32, writes: &[Write]) -> Batch {
    batch(core, WriterId(writer), epoch, |out| {
        for write in writes {
            match write {
                Write::Put { entity, value } => out.put(*entity, Count(*value)),
                Write::Remove { entity } => out.remove::<Count>(*entity),
                Write::Spawn { counter } => {
                    spawn_from(out, Entity::new(0, writer, *counter));
                }
                Write::Despawn { entity } => out.despawn(*entity),
                Write::Contribute { value } => out.contribute(Pairs(vec![*value])),
                Write::Nan { entity } => out.put(*entity, Level(f64::NAN)),
                Write::Require { entity, since } => {
                    out.require_unchanged::<Count>(*entity, Revision(*since));
                }
            }
        }
    })
}

/// Spawns an entity of a given number, also one that exists already, as only bytes from outside can.
fn spawn_from(out: &mut Commands, entity: Entity) {
    let mut bytes = postcard::to_allocvec(&vec![entity]).expect("encodes");
    bytes.extend([0; 5]);
    assert!(out.decode(&bytes).expect("well-formed").is_empty());
}

fn compare(core: &ModelCore, naive: &Naive) -> Result<(), TestCaseError> {
    prop_assert_eq!(core.view().revision(), Revision(naive.revision));
    let alive: BTreeSet<Entity> = core.view().entities().collect();
    prop_assert_eq!(&alive, &naive.alive);
    let counts: BTreeMap<Entity, (u64, u64)> = core
        .view()
        .iter::<Count>()
        .map(|(entity, count)| {
            (entity, (count.0, core.view().changed::<Count>(entity).unwrap_or_default().0))
        })
        .collect();
    prop_assert_eq!(&counts, &naive.counts);
    let pairs: BTreeMap<Entity, u32> =
        core.view().iter::<Pairs>().map(|(entity, pairs)| (entity, pairs.0[0])).collect();
    prop_assert_eq!(&pairs, &naive.pairs);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]
    #[test]
    fn any_sequence_agrees_with_a_naive_model(steps in prop::collection::vec(step(), 1..40)) {
        let mut core = ModelCore::new(scene(), 0).expect("encodes");
        let engine = Access::new()
            .writes::<Count>(EntitySet::Of(vec![RING]))
            .writes::<Count>(EntitySet::Own)
            .contributes::<Pairs>()
            .spawns();
        let pilot = Access::new().writes::<Count>(EntitySet::Of(vec![PEG])).contributes::<Pairs>();
        core.declare("engine", ENGINE, &engine).expect("fits");
        core.declare("pilot", PILOT, &pilot).expect("fits");
        let mut naive = Naive {
            revision: 1,
            alive: BTreeSet::from([RING, PEG]),
            counts: BTreeMap::from([(RING, (0, 1))]),
            pairs: BTreeMap::new(),
        };
        for step in &steps {
            match step {
                Step::Batch { writer, stale, writes } => {
                    let epoch = core.epoch(WriterId(*writer)).unwrap_or(1) - u32::from(*stale);
                    let mut batch = random_batch(&core, *writer, epoch, writes);
                    let applied = matches!(core.apply(&mut batch, SimTime::ZERO), Outcome::Applied { .. });
                    prop_assert_eq!(applied, !stale && naive.batch(*writer, writes), "{:?}", step);
                }
                Step::Fence { writer } => {
                    let epoch = core.epoch(WriterId(*writer)).unwrap_or(1) + 1;
                    if core.fence(WriterId(*writer), epoch, SimTime::ZERO) {
                        naive.revision += 1;
                        naive.pairs.remove(&Entity::new(0, *writer, 0));
                    }
                }
                Step::Publish => {
                    core.publish();
                }
                Step::Recover => {
                    prop_assert!(!core.recover(None), "nothing was half applied");
                }
            }
            compare(&core, &naive)?;
        }
    }
}
