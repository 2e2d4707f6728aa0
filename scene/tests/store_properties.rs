//! The store against a model that cannot be wrong: a sorted map. Snapshots, changes, events, preconditions.

use std::collections::BTreeMap;

use proptest::prelude::*;
use trocar_scene::*;

#[derive(Clone, Debug)]
enum Op {
    Put { block: u16, row: u32, x: i32 },
    Remove { block: u16, row: u32 },
    Snapshot,
}

fn op() -> impl Strategy<Value = Op> {
    // Rows beyond one chunk of 64, gaps, and several spawners.
    let row = prop_oneof![0..6u32, 60..70u32, 126..131u32, 0..2_000u32];
    let block = 0..3u16;
    prop_oneof![
        6 => (block.clone(), row.clone(), any::<i32>()).prop_map(|(block, row, x)| Op::Put { block, row, x }),
        3 => (block, row).prop_map(|(block, row)| Op::Remove { block, row }),
        1 => Just(Op::Snapshot),
    ]
}

type Naive = BTreeMap<Entity, (i32, Revision)>;

fn at(x: i32) -> Pose {
    Pose::at(f64::from(x), 0.0, 0.0)
}

fn agrees(column: &Column<Pose>, naive: &Naive) -> Result<(), TestCaseError> {
    prop_assert_eq!(column.len(), naive.len());
    prop_assert_eq!(column.is_empty(), naive.is_empty());
    let rows: Vec<(Entity, f64)> = column.iter().map(|(e, pose)| (e, pose.translation.x)).collect();
    let expected: Vec<(Entity, f64)> = naive.iter().map(|(e, (x, _))| (*e, f64::from(*x))).collect();
    prop_assert_eq!(rows, expected);
    for (entity, (x, revision)) in naive {
        prop_assert_eq!(column.get(*entity).map(|pose| pose.translation.x), Some(f64::from(*x)));
        prop_assert_eq!(column.revision(*entity), Some(*revision));
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_column_is_a_sorted_map(ops in prop::collection::vec(op(), 1..200), since in 0..200u64) {
        let mut column = Column::<Pose>::default();
        let mut naive = Naive::new();
        let mut shared: Vec<(Column<Pose>, Naive)> = Vec::new();
        for (k, op) in ops.iter().enumerate() {
            let revision = Revision(k as u64 + 1);
            match *op {
                Op::Put { block, row, x } => {
                    let entity = Entity::new(1, block, row);
                    column.put(entity, at(x), revision);
                    naive.insert(entity, (x, revision));
                }
                Op::Remove { block, row } => {
                    let entity = Entity::new(1, block, row);
                    prop_assert_eq!(column.remove(entity, revision), naive.remove(&entity).is_some());
                    prop_assert!(column.get(entity).is_none());
                }
                Op::Snapshot => shared.push((column.clone(), naive.clone())),
            }
        }
        agrees(&column, &naive)?;
        // What was shared has not moved.
        for (column, naive) in &shared {
            agrees(column, naive)?;
        }
        let changed: Vec<Entity> = column.iter_changed(Revision(since)).map(|(e, _)| e).collect();
        let expected: Vec<Entity> =
            naive.iter().filter(|(_, (_, revision))| revision.0 > since).map(|(e, _)| *e).collect();
        prop_assert_eq!(changed, expected);
    }

    #[test]
    fn a_reader_with_a_cursor_misses_no_event(bursts in prop::collection::vec(0..700usize, 1..20)) {
        let mut log = EventLog::default();
        let (mut cursor, mut pushed) = (0, 0u64);
        for burst in bursts {
            for _ in 0..burst {
                let (name, subject) = ("tick".into(), Entity::new(0, 0, 1));
                log.push(Event { name, subject, object: None, value: pushed as f64, at: SimTime(pushed) });
                pushed += 1;
            }
            let events = Events::new(&log, cursor);
            let seen: Vec<u64> = events.iter().map(|event| event.value as u64).collect();
            // Bursts are below the log's bound, so nothing is lost and nothing comes twice.
            prop_assert_eq!(events.lost(), 0);
            prop_assert_eq!(seen, (cursor..pushed).collect::<Vec<_>>());
            cursor = log.next();
            prop_assert_eq!(cursor, pushed);
        }
        // A reader that never came hears how much it missed, and gets the rest in order.
        let late = Events::new(&log, 0);
        prop_assert_eq!(late.lost(), log.first());
        let rest: Vec<u64> = late.iter().map(|event| event.value as u64).collect();
        prop_assert_eq!(rest, (log.first()..pushed).collect::<Vec<_>>());
        prop_assert!(pushed - log.first() <= 4096);
        // Numbers survive a restart.
        let events: Vec<Event> = log.since(0).map(|(_, event)| event.clone()).collect();
        let restored = EventLog::restore(log.first(), events);
        prop_assert_eq!((restored.first(), restored.next()), (log.first(), log.next()));
    }
}

struct Writer {
    commands: Commands,
    rules: WriterRules,
}

fn writer(registry: &std::sync::Arc<Registry>, spawner: u16, access: Access) -> Writer {
    let allocator = EntityAllocator::new(0, spawner);
    let rules = WriterRules::compile(&access, registry, allocator.me()).expect("registered");
    Writer { commands: Commands::new(registry.clone(), allocator), rules }
}

impl Writer {
    fn send(&mut self, store: &mut Store) -> Result<Revision, Refusal> {
        self.commands.seal();
        let result = store
            .validate(&self.commands, &self.rules)
            .map(|()| store.apply(&mut self.commands, SimTime::ZERO));
        self.commands.clear();
        result
    }
}

#[test]
fn a_precondition_that_no_longer_holds_is_a_conflict_and_nothing_is_applied() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let mut surgeon = writer(
        &registry,
        1,
        Access::new().spawns().writes::<Pose>(EntitySet::All).writes::<Velocity>(EntitySet::All),
    );
    let ring = surgeon.commands.spawn();
    surgeon.commands.put(ring, at(1));
    surgeon.commands.put(ring, Velocity::default());
    surgeon.send(&mut store).expect("valid");
    let based_on = store.revision();

    surgeon.commands.put(ring, at(2));
    surgeon.send(&mut store).expect("valid");

    surgeon.commands.require_unchanged::<Pose>(ring, based_on);
    surgeon.commands.put(ring, at(3));
    let refusal = surgeon.send(&mut store).expect_err("conflict");
    assert!(refusal.is_conflict() && refusal.to_string().contains("pose"), "{refusal}");
    assert_eq!(store.view().get::<Pose>(ring), Some(&at(2)));

    // Another row of the same entity has not changed; nor has this one since the latest revision.
    surgeon.commands.require_unchanged::<Velocity>(ring, based_on);
    surgeon.commands.require_unchanged::<Pose>(ring, store.revision());
    surgeon.commands.put(ring, at(4));
    surgeon.send(&mut store).expect("holds");
    assert_eq!(store.view().get::<Pose>(ring), Some(&at(4)));
}

#[test]
fn a_batch_is_applied_as_a_whole_or_not_at_all() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let mut mine = writer(&registry, 1, Access::new().spawns().writes::<Pose>(EntitySet::Own));
    let first = mine.commands.spawn();
    mine.commands.put(first, at(1));
    mine.commands.put(Entity::new(0, 2, 1), at(2));
    assert!(matches!(mine.send(&mut store), Err(Refusal::NotDeclared { component: "pose", .. })));
    assert_eq!((store.revision(), store.view().contains(first)), (Revision::ZERO, false));

    let second = mine.commands.spawn();
    mine.commands.put(second, at(1));
    mine.commands.put(second, Velocity::default());
    assert!(matches!(mine.send(&mut store), Err(Refusal::NotDeclared { component: "velocity", .. })));

    let third = mine.commands.spawn();
    mine.commands.put(third, at(1));
    mine.commands.event("odd", third, None, f64::NAN);
    assert!(matches!(mine.send(&mut store), Err(Refusal::Command(CommandError::Event(_)))));
    assert_eq!(store.view().entities().count(), 0);
    assert_eq!(store.view().events().next(), 0);
}

#[test]
fn what_is_despawned_is_gone_with_all_its_rows_and_its_name_does_not_return() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let access = || Access::new().spawns().writes::<Pose>(EntitySet::Own).writes::<Name>(EntitySet::Own);
    let mut mine = writer(&registry, 1, access());
    let mut other = writer(&registry, 2, access());
    let ring = mine.commands.spawn();
    mine.commands.put(ring, at(1));
    mine.commands.put(ring, Name("ring".into()));
    mine.send(&mut store).expect("valid");
    let before = store.snapshot();
    assert_eq!(before.find("ring"), Some(ring));

    other.commands.despawn(ring);
    assert!(matches!(other.send(&mut store), Err(Refusal::NotOwner(e)) if e == ring));
    mine.commands.despawn(ring);
    mine.send(&mut store).expect("its owner may");
    assert!(!store.view().contains(ring) && store.view().get::<Pose>(ring).is_none());
    assert_eq!(store.view().find("ring"), None);
    assert_eq!(before.get::<Pose>(ring), Some(&at(1)), "an older snapshot still has it");
    assert_ne!(mine.commands.spawn(), ring);
    mine.commands.clear();
    mine.commands.put(ring, at(2));
    assert!(matches!(mine.send(&mut store), Err(Refusal::UnknownEntity(e)) if e == ring));
}

#[test]
fn contributions_of_several_writers_coexist_and_go_with_their_writer() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let list = |penetration_max| CollisionList { collisions: Vec::new(), penetration_max };
    let mut writers: Vec<Writer> =
        (1..4).map(|n| writer(&registry, n, Access::new().contributes::<CollisionList>())).collect();
    for (k, writer) in writers.iter_mut().enumerate() {
        writer.commands.contribute(list(k as f64));
        writer.send(&mut store).expect("valid");
    }
    assert_eq!(store.view().iter::<CollisionList>().count(), 3);
    store.remove_contributions(&writers[1].rules);
    let left: Vec<f64> = store.view().iter::<CollisionList>().map(|(_, list)| list.penetration_max).collect();
    assert_eq!(left, [0.0, 2.0]);
}

#[test]
fn a_transferred_row_has_one_writer_at_any_time() {
    let registry = Registry::standard();
    let id = registry.id::<Pose>().expect("registered");
    let ring = Entity::new(0, 1, 1);
    let mut left = writer(&registry, 1, Access::new().writes::<Pose>(EntitySet::Of(vec![ring])));
    let mut right = writer(&registry, 2, Access::new());
    assert!(left.rules.may_write(id, ring) && !right.rules.may_write(id, ring));
    left.rules.revoke(id, ring);
    right.rules.grant(id, ring);
    assert!(!left.rules.may_write(id, ring) && right.rules.may_write(id, ring));
    right.rules.revoke(id, ring);
    left.rules.grant(id, ring);
    assert!(left.rules.may_write(id, ring) && !right.rules.may_write(id, ring));
}

#[test]
fn a_chain_of_parents_composes_poses_and_a_cycle_ends() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
    let [a, b, c] = [commands.spawn(), commands.spawn(), commands.spawn()];
    let quarter =
        nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
    commands.put(a, Pose::new(nalgebra::Vector3::new(1.0, 0.0, 0.0), quarter));
    commands.put(b, Pose::at(1.0, 0.0, 0.0));
    commands.put(b, Parent(a));
    commands.put(c, Pose::at(0.0, 1.0, 0.0));
    commands.put(c, Parent(b));
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    let world = store.view().world_pose(c);
    assert!((world.translation.vector - nalgebra::Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-15, "{world}");

    commands.clear();
    commands.put(a, Parent(c));
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    assert!(store.view().world_pose(c).translation.vector.iter().all(|x| x.is_finite()));
}

#[test]
fn of_two_puts_of_one_row_the_later_counts_whatever_the_order_of_entities() {
    let registry = Registry::standard();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
    let entities: Vec<Entity> = (0..5).map(|_| commands.spawn()).collect();
    for round in 0..3 {
        for entity in entities.iter().rev() {
            commands.put(*entity, at(10 * round + entity.counter() as i32));
        }
    }
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    for entity in entities {
        assert_eq!(store.view().get::<Pose>(entity), Some(&at(20 + entity.counter() as i32)));
    }
}
