//! One writer's batches through the store: what is accepted, what is refused, what readers see.

use trocar_scene::*;

fn scene() -> (std::sync::Arc<Registry>, Store, Commands, WriterRules) {
    let registry = Registry::standard();
    let allocator = EntityAllocator::new(0, 3);
    let commands = Commands::new(registry.clone(), allocator.clone());
    let access = Access::new().spawns().writes::<Pose>(EntitySet::Own).contributes::<CollisionList>();
    let rules = WriterRules::compile(&access, &registry, allocator.me()).unwrap();
    (registry.clone(), Store::new(registry), commands, rules)
}

fn apply(store: &mut Store, commands: &mut Commands, rules: &WriterRules) -> Result<Revision, Refusal> {
    commands.seal();
    let result = store.validate(commands, rules).map(|()| store.apply(commands, SimTime::ZERO));
    commands.clear();
    result
}

#[test]
fn a_snapshot_never_changes_and_shows_what_changed_since() {
    let (_, mut store, mut commands, rules) = scene();
    let entities: Vec<Entity> = (0..200).map(|_| commands.spawn()).collect();
    for (i, entity) in entities.iter().enumerate() {
        commands.put(*entity, Pose::at(i as f64, 0.0, 0.0));
    }
    apply(&mut store, &mut commands, &rules).unwrap();
    let before = store.snapshot();
    commands.put(entities[150], Pose::at(-1.0, 0.0, 0.0));
    apply(&mut store, &mut commands, &rules).unwrap();
    let after = store.snapshot();
    assert_eq!(before.get::<Pose>(entities[150]).unwrap().translation.x, 150.0);
    assert_eq!(after.get::<Pose>(entities[150]).unwrap().translation.x, -1.0);
    let changed: Vec<Entity> = after.iter_changed::<Pose>(before.revision()).map(|(e, _)| e).collect();
    assert_eq!(changed, [entities[150]]);
    assert_eq!(after.iter::<Pose>().count(), 200);
}

#[test]
fn a_retouched_copy_shows_other_values_as_changed_and_leaves_the_scene_alone() {
    let (_, mut store, mut commands, rules) = scene();
    let entities: Vec<Entity> = (0..100).map(|_| commands.spawn()).collect();
    for entity in &entities {
        commands.put(*entity, Pose::at(1.0, 0.0, 0.0));
    }
    apply(&mut store, &mut commands, &rules).unwrap();
    let published = store.snapshot();
    let mut shown = published.clone();
    let gone = Entity::new(9, 9, 9);
    shown.retouch(7, [(entities[3], Pose::at(2.0, 0.0, 0.0)), (gone, Pose::default())]);
    assert_eq!((shown.retouches(), published.retouches()), (7, 0));
    assert_eq!(shown.revision(), published.revision());
    assert_eq!(shown.get::<Pose>(entities[3]).unwrap().translation.x, 2.0);
    assert_eq!(published.get::<Pose>(entities[3]).unwrap().translation.x, 1.0);
    assert!(shown.get::<Pose>(gone).is_none());
    let changed: Vec<Entity> = shown.iter_changed::<Pose>(published.revision()).map(|(e, _)| e).collect();
    assert_eq!(changed, [entities[3]]);
    // Whoever sees the Model's next state is told of what it changed, not of what was retouched.
    commands.put(entities[5], Pose::at(3.0, 0.0, 0.0));
    apply(&mut store, &mut commands, &rules).unwrap();
    let next = store.snapshot();
    let changed: Vec<Entity> = next.iter_changed::<Pose>(shown.revision()).map(|(e, _)| e).collect();
    assert_eq!(changed, [entities[5]]);
}

#[test]
fn bad_writes_are_refused_and_named() {
    let (_, mut store, mut commands, rules) = scene();
    let mine = commands.spawn();
    commands.put(mine, Pose::at(f64::NAN, 0.0, 0.0));
    let refusal = apply(&mut store, &mut commands, &rules).unwrap_err();
    assert!(refusal.to_string().contains("pose"), "{refusal}");
    assert!(!store.view().contains(mine), "nothing of a refused batch is applied");

    commands.put(Entity::new(0, 0, 7), Pose::at(0.0, 0.0, 0.0));
    assert!(matches!(apply(&mut store, &mut commands, &rules), Err(Refusal::NotDeclared { .. })));
    commands.put(Entity::new(0, 3, 77), Pose::at(0.0, 0.0, 0.0));
    assert!(matches!(apply(&mut store, &mut commands, &rules), Err(Refusal::UnknownEntity(_))));
}

#[test]
fn the_encoding_of_a_batch_and_of_a_scene_round_trips() {
    let (registry, mut store, mut commands, rules) = scene();
    let mine = commands.spawn();
    commands.put(mine, Pose::at(1.0, 2.0, 3.0));
    commands.event("born", mine, None, 1.0);
    commands.contribute(CollisionList { collisions: vec![], penetration_max: 0.5 });
    commands.seal();
    let mut bytes = Vec::new();
    commands.encode(&mut bytes).unwrap();
    let mut again = Commands::new(registry.clone(), EntityAllocator::new(0, 3));
    assert!(again.decode(&bytes).unwrap().is_empty());
    again.seal();
    let mut twice = Vec::new();
    again.encode(&mut twice).unwrap();
    assert_eq!(bytes, twice);

    apply(&mut store, &mut commands, &rules).unwrap();
    let mut whole = Vec::new();
    store.view().encode(&mut whole).unwrap();
    let (loaded, rest) = Store::load(&registry, &whole).unwrap();
    assert!(rest.is_empty());
    assert_eq!(loaded.view().get::<Pose>(mine).unwrap().translation.z, 3.0);
    let mut again = Vec::new();
    loaded.view().encode(&mut again).unwrap();
    assert_eq!(whole, again);
}

#[test]
fn the_number_of_an_entity_that_is_gone_is_never_given_again() {
    let (registry, mut store, mut commands, rules) = scene();
    let spawner = |entity: Entity| (entity.station(), entity.spawner());
    let first_free = |scene: &Snapshot, (station, spawner)| scene.first_free(station, spawner);
    let (first, last) = (commands.spawn(), commands.spawn());
    let of = spawner(last);
    commands.seal();
    assert_eq!(first_free(store.view(), of), 1);
    apply(&mut store, &mut commands, &rules).unwrap();
    commands.clear();
    commands.despawn(last);
    commands.despawn(first);
    commands.seal();
    apply(&mut store, &mut commands, &rules).unwrap();
    assert!(!store.view().contains(last));
    assert_eq!(first_free(store.view(), of), last.counter() + 1);
    // Also by a session that continues from a snapshot, or from a keyframe.
    assert_eq!(first_free(Store::from_snapshot(store.view()).view(), of), last.counter() + 1);
    let mut whole = Vec::new();
    store.view().encode(&mut whole).unwrap();
    let (loaded, _) = Store::load(&registry, &whole).unwrap();
    assert_eq!(first_free(loaded.view(), of), last.counter() + 1);
    assert_eq!(first_free(loaded.view(), (9, 9)), 1);
}
