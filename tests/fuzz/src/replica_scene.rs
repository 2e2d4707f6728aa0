//! A host's scene, small, before and after a change of everything that moves; and what a station gets of it.

use std::sync::{Arc, LazyLock};

use nalgebra::{Point3, Vector3};
use trocar_network::replication::{ColumnRates, FeedLimits, Replica, ReplicatedColumns, SceneFeed};
use trocar_scene::{
    CollisionList, Commands, EntityAllocator, Name, Parent, Particles, Pose, Registry, RegistryBuilder,
    RegistryError, SimTime, Snapshot, Store, SurfaceMesh, TaskState, Velocity, VertexPositions,
};

/// The default choice of columns, of a few components: each codec, reliable ones, and one that does not travel.
pub static COLUMNS: LazyLock<Arc<ReplicatedColumns>> = LazyLock::new(|| {
    let registry = registry().expect("their names are distinct");
    let columns = ReplicatedColumns::new(&registry, &ColumnRates::default());
    Arc::new(columns.expect("the defaults hold"))
});

fn registry() -> Result<Arc<Registry>, RegistryError> {
    let mut builder = RegistryBuilder::new();
    builder.register::<CollisionList>()?.register::<Name>()?.register::<Parent>()?.register::<Particles>()?;
    builder.register::<Pose>()?.register::<SurfaceMesh>()?.register::<TaskState>()?;
    builder.register::<Velocity>()?.register::<VertexPositions>()?;
    Ok(builder.build())
}

/// The scene, and the scene a moment later.
pub static SCENES: LazyLock<[Arc<Snapshot>; 2]> = LazyLock::new(|| {
    let registry = COLUMNS.registry().clone();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(1, 4));
    let [organ, peg, smoke] = std::array::from_fn(|_| commands.spawn());
    commands.put(organ, Name("organ".into()));
    commands.put(organ, Pose::at(0.1, -0.05, 0.02));
    commands.put(organ, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [3, 4, 5]]) });
    commands.put(organ, body(0.0));
    commands.put(peg, Pose::at(0.2, 0.0, 0.02));
    commands.put(peg, Velocity::default());
    commands.put(peg, Parent(organ));
    commands.put(smoke, particles(0.0));
    let me = commands.me();
    commands.put(me, TaskState::default());
    commands.event("begin", organ, None, 1.0);
    let mut take = |commands: &mut Commands, ms: u64| {
        commands.seal();
        store.apply(commands, SimTime::from_millis(ms));
        commands.clear();
        Arc::new(store.snapshot())
    };
    let before = take(&mut commands, 1);
    commands.put(organ, Pose::at(0.1, -0.04, 0.02));
    commands.put(organ, body(0.001));
    commands.put(peg, Name("peg".into()));
    commands.put(peg, Velocity { linear: Vector3::new(0.3, 0.0, -0.1), angular: Vector3::zeros() });
    commands.remove::<Parent>(peg);
    commands.despawn(smoke);
    let drop = commands.spawn();
    commands.put(drop, Pose::at(0.5, 0.5, 0.5));
    commands.put(drop, particles(0.002));
    commands.event("moved", organ, Some(peg), 2.0);
    [before, take(&mut commands, 20)]
});

/// Vertices, some of them moved.
fn body(moved: f64) -> VertexPositions {
    let vertex = |k: i32| {
        let x = 0.003 * f64::from(k);
        Point3::new(x, if k % 5 == 0 { moved } else { 0.0 }, 0.1)
    };
    VertexPositions { positions: Arc::new((0..6).map(vertex).collect()) }
}

fn particles(up: f64) -> Particles {
    let positions = (0..3).map(|k| Point3::new(0.01 * f64::from(k), 0.0, up)).collect();
    Particles { positions: Arc::new(positions), radius: 0.0078125, ..Particles::default() }
}

/// The host's end for a station that has nothing.
pub fn feed() -> SceneFeed {
    SceneFeed::new(COLUMNS.clone(), FeedLimits::default())
}

/// The first delta that a station gets.
pub static FIRST_DELTA: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let delta = feed().delta(SimTime::ZERO, &SCENES[0]);
    delta.expect("it encodes").expect("there is much to tell")
});

/// The scene of a station that has got it.
pub static STATION_SCENE: LazyLock<Snapshot> = LazyLock::new(|| {
    let registry = COLUMNS.registry().clone();
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(2, 9));
    Replica::new(COLUMNS.clone()).apply(&FIRST_DELTA, &mut commands).expect("the host wrote it");
    commands.seal();
    let mut store = Store::new(registry);
    store.apply(&mut commands, SimTime::ZERO);
    store.snapshot()
});
