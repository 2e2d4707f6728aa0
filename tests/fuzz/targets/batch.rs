//! The encodings of a batch of commands, of a keyframe, and of the body of a block of a recording, as they come out of recordings
//! and networks.
#![no_main]

use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Bound;
use trocar_kernel::recorder::rows_of_body;
use trocar_scene::{Commands, EntityAllocator, Registry, SimTime, Store};

/// The dearest bytes are those of a lone row: one byte of an entity that has a page to itself.
const ROWS: Bound = Bound { per_byte: 384, always: 64 << 10 };
/// A number of one byte is held as a word among the planes, the rows, the history and the values that are made of it.
const BLOCK: Bound = Bound { per_byte: 384, always: 64 << 10 };

static REGISTRY: LazyLock<Arc<Registry>> = LazyLock::new(Registry::standard);

fn keyframe(bytes: &[u8]) {
    let registry = &*REGISTRY;
    if let Ok((store, rest)) = ROWS.holds(bytes.len(), || Store::load(registry, bytes)) {
        assert!(rest.len() < bytes.len());
        // What was read is canonical: it comes back as the same bytes.
        let (mut again, mut third) = (Vec::new(), Vec::new());
        store.view().encode(&mut again).expect("it was read");
        let (twice, _) = Store::load(registry, &again).expect("its own bytes");
        twice.view().encode(&mut third).expect("it was read");
        assert_eq!(again, third);
    }
}

fn batch(bytes: &[u8]) {
    let registry = &*REGISTRY;
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(3, 7));
    let decoded = ROWS.holds(bytes.len(), || commands.decode(bytes).is_ok());
    if !decoded {
        return;
    }
    commands.seal();
    assert!(commands.puts().all(|(_, puts)| puts.check().is_ok()));
    assert!(commands.events().iter().all(|event| event.value.is_finite()));
    let mut store = Store::new(registry.clone());
    if store.check_room(&commands).is_ok() {
        ROWS.holds(bytes.len(), || store.apply(&mut commands, SimTime::ZERO));
    }
}

/// The body of a block, unpacked: rows in columns. Twice: the second time with the first as its history.
fn block(bytes: &[u8]) {
    let (first, second) = bytes.split_at(bytes.len() / 2);
    for bodies in [&[bytes][..], &[first, second]] {
        // Read or refused, it must not panic.
        let _ = BLOCK.holds(bytes.len(), || rows_of_body(bodies));
    }
}

// The first byte says which of the three it is.
fuzz_target!(|bytes: &[u8]| {
    match bytes.split_first() {
        Some((0, rest)) => batch(rest),
        Some((2, rest)) => block(rest),
        Some((_, rest)) => keyframe(rest),
        None => {}
    }
});
