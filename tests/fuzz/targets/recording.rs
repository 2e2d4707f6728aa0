//! A recording in MCAP: opened, replayed, its keyframes loaded.
#![no_main]

use std::path::PathBuf;
use std::sync::{Arc, LazyLock};

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::Bound;
use trocar_kernel::recorder::{Item, Recording, Replay};
use trocar_scene::{DeviceState, Entity, Registry};

/// A byte unpacks to at most 1,032 by deflate, or 255 by LZ4; what is unpacked is held as bytes, as the pieces cut out of
/// it, and as the scene that they make. Inputs are short.
const RECORDING: Bound = Bound { per_byte: 1_032 * 96, always: 1 << 20 };

static REGISTRY: LazyLock<Arc<Registry>> = LazyLock::new(Registry::standard);
/// The reader takes files; one per process, in memory where the system offers that.
static FILE: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() { memory } else { std::env::temp_dir() };
    folder.join(format!("trocar-fuzz-{}.mcap", std::process::id()))
});

fuzz_target!(|bytes: &[u8]| {
    let (file, registry) = (&*FILE, &*REGISTRY);
    std::fs::write(file, bytes).expect("a file for the input");
    let opened = RECORDING.holds(bytes.len(), || Recording::open(file));
    // Opened or refused, the file is no longer needed under its name.
    let recording = match opened {
        Ok(recording) => recording,
        Err(error) => {
            std::fs::remove_file(file).expect("it was just written");
            assert!(error.to_string().contains("trocar-fuzz"), "{error}");
            return;
        }
    };
    let replayed = RECORDING
        .holds(bytes.len(), || Replay::new(&recording, registry).and_then(|mut replay| replay.run_to_end()));
    if let Err(error) = replayed {
        assert!(error.to_string().contains("trocar-fuzz"), "{error}");
    }
    RECORDING.holds(bytes.len(), || {
        drop(recording.statistics());
        drop(recording.recover(&mut std::io::sink()));
        for item in recording.items() {
            match item {
                Ok(Item::Keyframe(keyframe)) => drop(keyframe.load(registry)),
                Ok(_) => {}
                Err(_) => break,
            }
        }
        drop(recording.series::<DeviceState>(registry, Entity::new(0, 0, 3)));
    });
    std::fs::remove_file(file).expect("it was just written");
});
