//! Five kinds of components that cover what the Model tells apart: recorded and derived, checked and unchecked,
//! contributed, and one whose own code misbehaves on command.

use std::cell::Cell;
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use trocar_scene::{
    Access, Commands, Component, ComponentError, Entity, RecordPolicy, Registry, RegistryBuilder, Revision,
    Snapshot, WriterId,
};

/// Which component a row is of; the order is that of their names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Bomb,
    Count,
    Level,
    Pairs,
    Shadow,
}

pub const KINDS: [Kind; 5] = [Kind::Bomb, Kind::Count, Kind::Level, Kind::Pairs, Kind::Shadow];

/// Where a [`Bomb`] goes off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fuse {
    /// In the Model's check, before anything is touched.
    Check,
    /// When it is encoded, before anything is touched.
    Encode,
    /// When it is encoded, as an error instead of a panic.
    EncodeFails,
    /// When it is replaced or taken away: in the middle of the batch.
    Replace,
}

thread_local!(static LIT: Cell<Option<Fuse>> = const { Cell::new(None) });

/// Runs `work` with the bombs of this thread live.
pub fn with_fuse<R>(fuse: Option<Fuse>, work: impl FnOnce() -> R) -> R {
    struct Out;
    impl Drop for Out {
        fn drop(&mut self) {
            LIT.set(None);
        }
    }
    let _out = Out;
    LIT.set(fuse);
    work()
}

fn goes_off(at: Fuse) -> bool {
    LIT.get() == Some(at)
}

#[derive(Clone, Debug)]
pub struct Bomb(pub u8);

impl Drop for Bomb {
    fn drop(&mut self) {
        if goes_off(Fuse::Replace) {
            LIT.set(None);
            panic!("a component's destructor");
        }
    }
}

impl Serialize for Bomb {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        assert!(!goes_off(Fuse::Encode), "a component's encoder");
        if goes_off(Fuse::EncodeFails) {
            return Err(serde::ser::Error::custom("a component that cannot be encoded"));
        }
        serializer.serialize_u8(self.0)
    }
}

impl<'de> Deserialize<'de> for Bomb {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        u8::deserialize(deserializer).map(Self)
    }
}

impl Component for Bomb {
    const NAME: &'static str = "seq_bomb";
    fn check(&self) -> Result<(), ComponentError> {
        assert!(!goes_off(Fuse::Check), "a component's check");
        Ok(())
    }
}

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "seq_count")]
pub struct Count(pub u8);

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "seq_level")]
pub struct Level(pub f64);

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "seq_pairs")]
pub struct Pairs(pub Vec<u8>);

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "seq_shadow", record = RecordPolicy::Derived)]
pub struct Shadow(pub u8);

/// Known to nobody.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "seq_stranger")]
pub struct Stranger(pub u8);

pub fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::register_all!(&mut builder; Shadow, Bomb, Pairs, Level, Count).expect("new");
    builder.build()
}

/// Calls a generic method with the component type of a kind.
macro_rules! of_kind {
    ($kind:expr, $call:ident ! ( $($argument:tt)* )) => {
        match $kind {
            Kind::Bomb => $call!(Bomb, $($argument)*),
            Kind::Count => $call!(Count, $($argument)*),
            Kind::Level => $call!(Level, $($argument)*),
            Kind::Pairs => $call!(Pairs, $($argument)*),
            Kind::Shadow => $call!(Shadow, $($argument)*),
        }
    };
}

impl Kind {
    pub fn name(self) -> &'static str {
        macro_rules! name {
            ($type:ty,) => {
                <$type>::NAME
            };
        }
        of_kind!(self, name!())
    }
    /// Whether commits leave it out.
    pub fn is_derived(self) -> bool {
        self == Kind::Shadow
    }
    pub fn put(self, out: &mut Commands, entity: Entity, value: u8) {
        match self {
            Kind::Bomb => out.put(entity, Bomb(value)),
            Kind::Count => out.put(entity, Count(value)),
            Kind::Level => out.put(entity, Level(f64::from(value))),
            Kind::Pairs => out.put(entity, Pairs(vec![value; usize::from(value % 4)])),
            Kind::Shadow => out.put(entity, Shadow(value)),
        }
    }
    pub fn remove(self, out: &mut Commands, entity: Entity) {
        macro_rules! remove {
            ($type:ty,) => {
                out.remove::<$type>(entity)
            };
        }
        of_kind!(self, remove!());
    }
    pub fn transfer(self, out: &mut Commands, entity: Entity, to: u16) {
        macro_rules! transfer {
            ($type:ty,) => {
                out.transfer::<$type>(entity, WriterId(to))
            };
        }
        of_kind!(self, transfer!());
    }
    pub fn require(self, out: &mut Commands, entity: Entity, since: u64) {
        macro_rules! require {
            ($type:ty,) => {
                out.require_unchanged::<$type>(entity, Revision(since))
            };
        }
        of_kind!(self, require!());
    }
    pub fn writes(self, access: Access, set: trocar_scene::EntitySet) -> Access {
        macro_rules! writes {
            ($type:ty,) => {
                access.writes::<$type>(set)
            };
        }
        of_kind!(self, writes!())
    }
    pub fn contributes(self, access: Access) -> Access {
        macro_rules! contributes {
            ($type:ty,) => {
                access.contributes::<$type>()
            };
        }
        of_kind!(self, contributes!())
    }
    /// Visits (entity, value, revision of the change) of every row that changed after `since`, in order.
    pub fn visit(self, scene: &Snapshot, since: Option<u64>, visit: &mut dyn FnMut(Entity, Row)) {
        macro_rules! rows {
            ($type:ty, $value:expr) => {{
                let mut each = |(entity, row): (Entity, &$type)| {
                    let revision = scene.changed::<$type>(entity).unwrap_or_default().0;
                    visit(entity, Row { value: $value(row), revision });
                };
                match since {
                    None => scene.iter::<$type>().for_each(&mut each),
                    Some(since) => scene.iter_changed::<$type>(Revision(since)).for_each(&mut each),
                }
            }};
        }
        match self {
            Kind::Bomb => rows!(Bomb, |row: &Bomb| row.0),
            Kind::Count => rows!(Count, |row: &Count| row.0),
            Kind::Level => rows!(Level, |row: &Level| row.0 as u8),
            // Its length and its content both come from one number.
            Kind::Pairs => rows!(Pairs, |row: &Pairs| row.0.first().copied().unwrap_or_default()),
            Kind::Shadow => rows!(Shadow, |row: &Shadow| row.0),
        }
    }
    /// What [`Self::visit`] shows of a value that was put.
    pub fn shown(self, value: u8) -> u8 {
        if self == Kind::Pairs && value.is_multiple_of(4) { 0 } else { value }
    }
}

/// A row as the reference keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    pub value: u8,
    pub revision: u64,
}
