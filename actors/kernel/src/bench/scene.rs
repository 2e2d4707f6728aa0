//! Scenes of a given size for measurements: at least three populated columns, fifty registered types.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_scene::{
    Commands, Component, Entity, EntityAllocator, Name, Pose, Registry, RegistryBuilder, RegistryError,
    SCENARIO_SPAWNER, SimTime, Store,
};

/// A type that only fills the registry.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Component)]
#[component(name = NAMES[N])]
struct Filler<const N: usize>(f64);

const NAMES: [&str; 50] = {
    let mut names = [""; 50];
    let mut n = 0;
    while n < 50 {
        names[n] = NAME_TEXT.split_at(n * 9).1.split_at(9).0;
        n += 1;
    }
    names
};
const NAME_TEXT: &str = "filler_00filler_01filler_02filler_03filler_04filler_05filler_06filler_07filler_08filler_09\
filler_10filler_11filler_12filler_13filler_14filler_15filler_16filler_17filler_18filler_19\
filler_20filler_21filler_22filler_23filler_24filler_25filler_26filler_27filler_28filler_29\
filler_30filler_31filler_32filler_33filler_34filler_35filler_36filler_37filler_38filler_39\
filler_40filler_41filler_42filler_43filler_44filler_45filler_46filler_47filler_48filler_49";

/// Number of writes of a writer, used to measure latency.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Component)]
#[component(name = "bench_mark")]
pub(super) struct Mark(pub(super) u64);

macro_rules! fillers {
    ($builder:expr, $($n:literal)*) => { $( $builder.register::<Filler<$n>>()?; )* };
}

fn registry() -> Result<Arc<Registry>, RegistryError> {
    let mut builder = RegistryBuilder::new();
    builder.register::<Name>()?.register::<Pose>()?.register::<Mark>()?;
    fillers!(builder, 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31
        32 33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49);
    Ok(builder.build())
}

/// `entities` entities with a name, a pose and two numbers each.
pub(super) fn populated(entities: u32) -> (Store, Vec<Entity>) {
    let registry = registry().unwrap_or_else(|_| RegistryBuilder::new().build());
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, SCENARIO_SPAWNER));
    let mut all = Vec::with_capacity(entities as usize);
    for n in 0..entities {
        let entity = commands.spawn();
        commands.put(entity, Name(format!("entity {n}")));
        commands.put(entity, Pose::at(f64::from(n), 0.0, 0.0));
        commands.put(entity, Filler::<0>(f64::from(n)));
        commands.put(entity, Filler::<49>(f64::from(n)));
        all.push(entity);
    }
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    (store, all)
}
