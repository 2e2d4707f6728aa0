//! A scenario file and a fault plan: TOML with every component.
#![no_main]

use std::path::Path;
use std::sync::{Arc, LazyLock};

use libfuzzer_sys::{Corpus, fuzz_target};
use trocar_fuzz::Bound;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::Registry;
use trocar_scene::scenario::Scenario;

/// A value of one character ("a=0\n" is four) becomes a table entry with the places of key and value, twice.
const TOML: Bound = Bound { per_byte: 1_024, always: 256 << 10 };

static REGISTRY: LazyLock<Arc<Registry>> = LazyLock::new(Registry::standard);

fuzz_target!(|bytes: &[u8]| -> Corpus {
    let Ok(text) = std::str::from_utf8(bytes) else { return Corpus::Reject };
    let registry = &*REGISTRY;
    match TOML.holds(text.len(), || Scenario::parse(Path::new("hostile.toml"), text, registry)) {
        Ok(scenario) => {
            let spawned = TOML.holds(text.len(), || scenario.spawn(registry));
            assert!(spawned.is_ok(), "what was accepted can be spawned");
        }
        Err(error) => assert!(error.to_string().contains("hostile.toml"), "{error}"),
    }
    if let Err(error) = TOML.holds(text.len(), || FaultPlan::parse(text, "hostile.toml")) {
        assert!(error.to_string().starts_with("hostile.toml: "), "{error}");
    }
    Corpus::Keep
});
