//! Keyframes, batches and components from bytes that may be anything: no panic, no value that the Model would
//! refuse, and never more memory than a fixed multiple of the input.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use proptest::sample::select;
use trocar_scene::*;
use trocar_test_support::allocations::peak_of;
use trocar_test_support::hostile::mutated;

/// What decoding may hold per byte of input. The dearest bytes are those of a lone row: one byte of an entity that
/// has a page to itself becomes a page, a chunk and their places in three lists.
const BYTES_PER_BYTE: usize = 384;
/// Columns, buffers for commands, messages.
const BYTES_ALWAYS: usize = 64 << 10;

fn allowed(bytes: &[u8]) -> usize {
    BYTES_PER_BYTE * bytes.len() + BYTES_ALWAYS
}

fn registry() -> Arc<Registry> {
    thread_local! {
        static REGISTRY: Arc<Registry> = Registry::standard();
    }
    REGISTRY.with(Clone::clone)
}

fn writer() -> Commands {
    Commands::new(registry(), EntityAllocator::new(3, 7))
}

/// A few rows of very different components, with an event and a removal.
fn commands() -> Commands {
    let mut commands = writer();
    for n in 0..5 {
        let entity = commands.spawn();
        commands.put(entity, Name(format!("thing {n}")));
        commands.put(entity, Pose::at(f64::from(n), 0.5, -0.25));
        commands.put(entity, Velocity::default());
    }
    let mesh = commands.spawn();
    let positions = vec![Point3::origin(), Point3::from(Vector3::x()), Point3::from(Vector3::y())];
    commands.put(mesh, VertexPositions { positions: Arc::new(positions) });
    commands.put(mesh, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
    commands.put(mesh, Parent(Entity::new(3, 7, 1)));
    commands.contribute(CollisionList { collisions: Vec::new(), penetration_max: 0.0 });
    commands.event("drop", mesh, Some(Entity::new(3, 7, 1)), 1.5);
    commands.remove::<Velocity>(Entity::new(3, 7, 2));
    commands.transfer::<Pose>(Entity::new(3, 7, 1), WriterId(2));
    commands.seal();
    commands
}

fn batch() -> Vec<u8> {
    let mut bytes = Vec::new();
    commands().encode(&mut bytes).expect("encodes");
    bytes
}

fn keyframe() -> Vec<u8> {
    let mut store = Store::new(registry());
    store.apply(&mut commands(), SimTime::from_millis(5));
    let mut bytes = Vec::new();
    store.view().encode(&mut bytes).expect("encodes");
    bytes
}

fn check_keyframe(bytes: &[u8]) -> Result<(), TestCaseError> {
    let registry = registry();
    let (loaded, peak) = peak_of(|| Store::load(&registry, bytes));
    prop_assert!(peak <= allowed(bytes), "{peak} bytes for an input of {}", bytes.len());
    match loaded {
        Ok((store, rest)) => {
            // What was read is canonical and complete: it comes back as the same bytes.
            let mut again = Vec::new();
            store.view().encode(&mut again).expect("encodes");
            let (twice, _) = Store::load(&registry, &again).expect("its own bytes");
            let mut third = Vec::new();
            twice.view().encode(&mut third).expect("encodes");
            prop_assert_eq!(again, third);
            prop_assert!(rest.len() < bytes.len());
        }
        Err(error) => prop_assert!(!error.to_string().is_empty()),
    }
    Ok(())
}

fn check_batch(bytes: &[u8]) -> Result<(), TestCaseError> {
    let ((mut commands, decoded), peak) = peak_of(|| {
        let mut commands = writer();
        let decoded = commands.decode(bytes).map(<[u8]>::len);
        (commands, decoded)
    });
    prop_assert!(peak <= allowed(bytes), "{peak} bytes for an input of {}", bytes.len());
    if decoded.is_ok() {
        commands.seal();
        for (_, puts) in commands.puts() {
            prop_assert!(puts.check().is_ok());
        }
        prop_assert!(commands.events().iter().all(|event| event.value.is_finite()));
        let mut store = Store::new(registry());
        if store.check_room(&commands).is_ok() {
            let (_, peak) = peak_of(|| store.apply(&mut commands, SimTime::ZERO));
            prop_assert!(peak <= allowed(bytes), "{peak} bytes to apply an input of {}", bytes.len());
        }
    }
    Ok(())
}

/// Entities of any station, spawner and number, also those that stand alone in their page.
fn entities(most: usize) -> impl Strategy<Value = Vec<Entity>> {
    let counter = prop_oneof![0..200u32, any::<u32>(), (0..1u32 << 20).prop_map(|page| page << 12)];
    let part = || prop_oneof![4 => Just(0u16), 1 => any::<u16>()];
    prop::collection::btree_set((part(), part(), counter), 0..most)
        .prop_map(|all| all.into_iter().map(|(a, b, c)| Entity::new(a, b, c)).collect())
}

/// Postcard's encoding of the pieces of a keyframe with rows of `velocity` (48 bytes) and `name` (1 byte or more).
fn scattered_keyframe(alive: &[Entity], named: &[Entity]) -> Vec<u8> {
    fn put(out: &mut Vec<u8>, value: &impl serde::Serialize) {
        out.extend(postcard::to_stdvec(value).expect("encodes"));
    }
    let registry = registry();
    let key = |name| registry.entry(registry.by_name(name).expect("registered")).key;
    let mut out = Vec::new();
    put(&mut out, &(1u64, 0u64, alive.len() as u32));
    alive.iter().for_each(|entity| put(&mut out, entity));
    // No spawners, one component.
    put(&mut out, &0u32);
    put(&mut out, &1u32);
    put(&mut out, &(key("name"), named.len() as u32));
    named.iter().for_each(|entity| put(&mut out, &(*entity, "")));
    put(&mut out, &(0u64, Vec::<Event>::new()));
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1500))]

    #[test]
    fn a_mutated_keyframe_never_harms(bytes in mutated(vec![keyframe()])) {
        check_keyframe(&bytes)?;
    }

    #[test]
    fn a_mutated_batch_never_harms(bytes in mutated(vec![batch()])) {
        check_batch(&bytes)?;
    }

    #[test]
    fn random_bytes_never_harm(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        check_keyframe(&bytes)?;
        check_batch(&bytes)?;
    }

    #[test]
    fn random_bytes_as_a_component_never_harm(
        name in select(registry().iter().map(|(_, entry)| entry.name).collect::<Vec<_>>()),
        bytes in prop_oneof![
            prop::collection::vec(any::<u8>(), 0..200),
            // Lengths that promise much, and short values.
            prop::collection::vec(select(vec![0u8, 1, 2, 0x7f, 0x80, 0xff]), 0..60),
        ],
    ) {
        let registry = registry();
        let id = registry.by_name(name).expect("registered");
        let mut commands = writer();
        let (decoded, peak) = peak_of(|| {
            registry.put_postcard(id, &mut commands, Entity::new(0, 0, 1), &bytes).map(<[u8]>::len)
        });
        prop_assert!(peak <= allowed(&bytes), "{name}: {peak} bytes for an input of {}", bytes.len());
        match decoded {
            Ok(_) => prop_assert!(commands.puts().all(|(_, puts)| puts.check().is_ok())),
            Err(_) => prop_assert!(commands.is_empty()),
        }
    }

    #[test]
    fn entity_numbers_cost_nothing(alive in entities(60), named in entities(60)) {
        let bytes = scattered_keyframe(&alive, &named);
        let registry = registry();
        let (loaded, peak) = peak_of(|| Store::load(&registry, &bytes));
        prop_assert!(peak <= allowed(&bytes), "{peak} bytes for an input of {}", bytes.len());
        let (store, rest) = loaded.expect("well-formed");
        prop_assert!(rest.is_empty());
        prop_assert_eq!(store.view().entities().collect::<Vec<_>>(), alive);
        prop_assert_eq!(store.view().iter::<Name>().map(|(entity, _)| entity).collect::<Vec<_>>(), named);
    }
}

#[test]
fn a_hundred_bytes_cannot_reserve_gigabytes() {
    let far = [Entity::new(0, 0, u32::MAX), Entity::new(u16::MAX, u16::MAX, u32::MAX)];
    let bytes = scattered_keyframe(&far, &far);
    assert!(bytes.len() < 100);
    let (loaded, peak) = peak_of(|| Store::load(&registry(), &bytes).map(|(store, _)| store));
    assert!(peak < 64 << 10, "{peak}");
    assert_eq!(loaded.expect("well-formed").view().iter::<Name>().count(), 2);
}

#[test]
fn a_scene_scattered_over_more_pages_than_a_column_takes_is_refused() {
    let pages = |count: u32| (0..count).map(|page| Entity::new(0, 1, page << 12)).collect::<Vec<_>>();
    let loads = |alive: &[Entity], named: &[Entity]| {
        Store::load(&registry(), &scattered_keyframe(alive, named)).map(|_| ()).map_err(|e| e.to_string())
    };
    assert_eq!(loads(&pages(16_384), &pages(16_384)), Ok(()));
    let refused = loads(&pages(16_385), &[]).expect_err("too many");
    assert!(refused.contains("the list of entities") && refused.contains("16384"), "{refused}");
    let refused = loads(&[], &pages(16_385)).expect_err("too many");
    assert!(refused.contains("name") && refused.contains("16384"), "{refused}");

    // Batches add up: what each of them could have alone is too much together.
    let mut store = Store::new(registry());
    for half in 0..2u32 {
        let mut commands = writer();
        for entity in pages(10_000) {
            commands.put(Entity::new(0, 2 + half as u16, entity.counter()), Name(String::new()));
        }
        assert_eq!(store.check_room(&commands).is_ok(), half == 0);
        store.apply(&mut commands, SimTime::ZERO);
        if half == 1 {
            break;
        }
        assert!(store.check_room(&commands).is_ok(), "nothing more is nothing too much");
    }
}

#[test]
fn what_is_out_of_order_or_beyond_counting_is_refused() {
    let [low, high] = [Entity::new(0, 0, 1), Entity::new(0, 0, 2)];
    for (alive, named) in [(vec![high, low], vec![]), (vec![low, low], vec![]), (vec![], vec![high, low])] {
        let error = Store::load(&registry(), &scattered_keyframe(&alive, &named)).err().expect("refused");
        assert!(error.to_string().contains("comes after"), "{error}");
    }
    let mut spawners = Vec::new();
    for number in [1, 0, 0, 2, 0, 7, 5, 0, 7, 6, 0, 0, 0] {
        spawners.extend(postcard::to_stdvec(&number).expect("encodes"));
    }
    let error = Store::load(&registry(), &spawners).err().expect("refused");
    assert!(error.to_string().contains("the list of spawners"), "{error}");
    let mut late = Vec::new();
    for number in [u64::MAX, 0, 0, 0, 0, 0, 0] {
        late.extend(postcard::to_stdvec(&number).expect("encodes"));
    }
    let error = Store::load(&registry(), &late).err().expect("refused");
    assert!(error.to_string().contains("revision"), "{error}");
    let mut events = Vec::new();
    for number in [1, 0, 0, 0, 0, u64::MAX, 0] {
        events.extend(postcard::to_stdvec(&number).expect("encodes"));
    }
    let error = Store::load(&registry(), &events).err().expect("refused");
    assert!(error.to_string().contains("event number"), "{error}");
}
