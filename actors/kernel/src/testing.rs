//! Toy components for the tests of this crate.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, RecordPolicy, Registry, RegistryBuilder};

/// A number that any entity may carry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Component)]
#[component(name = "test_count")]
pub struct Count(pub u64);

/// A number that must be finite and can be set to panic when it is checked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "test_level")]
pub struct Level(pub f64);

/// A list that several writers fill.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "test_pairs")]
pub struct Pairs(pub Vec<u32>);

/// A derived component.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "test_shadow", record = RecordPolicy::Derived)]
pub struct Shadow(pub f64);

/// A component whose own code panics in the Model: 13 when it is looked at for the second time (past the
/// sender), 14 when it is replaced.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fuse(pub u32);

/// See [`Fuse`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bomb(pub Fuse, #[serde(skip)] pub Trap);

impl Bomb {
    /// Goes off at 13 or 14.
    pub fn new(kind: u32) -> Self {
        Self(Fuse(kind), Trap(kind == 14))
    }
}

/// Panics when dropped while it is set, once per thread.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trap(bool);

impl Drop for Trap {
    fn drop(&mut self) {
        thread_local!(static SPRUNG: std::cell::Cell<bool> = const { std::cell::Cell::new(false) });
        if self.0 && !std::thread::panicking() && !SPRUNG.replace(true) {
            panic!("the trap is sprung");
        }
    }
}

impl Component for Bomb {
    const NAME: &'static str = "test_bomb";
    fn check(&self) -> Result<(), ComponentError> {
        thread_local!(static LOOKS: std::cell::Cell<u32> = const { std::cell::Cell::new(0) });
        if self.0.0 == 13 {
            LOOKS.set(LOOKS.get() + 1);
            assert!(LOOKS.get() % 2 == 1, "the bomb goes off");
        }
        Ok(())
    }
}

/// All of them.
pub fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::register_all!(&mut builder; Count, Level, Pairs, Shadow, Bomb).expect("new");
    builder.build()
}
