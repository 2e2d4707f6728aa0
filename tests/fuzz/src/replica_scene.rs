//! A host's scene, small, before and after a change of everything that moves; and what a station gets of it.

use std::sync::{Arc, LazyLock};

use nalgebra::{Point3, Vector3};
use trocar_network::replication::{ColumnRates, FeedLimits, ReplicatedColumns, SceneFeed};
use trocar_scene::{
    Commands, Entity, EntityAllocator, InstrumentTarget, Name, Parent, Particles, Pose, Registry, SimTime,
    Snapshot, Store, SurfaceMesh, TaskState, Velocity, VertexPositions, VitalSigns,
};

/// The default choice of columns.
pub static COLUMNS: LazyLock<Arc<ReplicatedColumns>> = LazyLock::new(|| {
    let columns = ReplicatedColumns::new(&Registry::standard(), &ColumnRates::default());
    Arc::new(columns.expect("the defaults hold"))
});

/// The scene, and the scene a moment later.
pub static SCENES: LazyLock<[Arc<Snapshot>; 2]> = LazyLock::new(|| {
    let registry = COLUMNS.registry().clone();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(1, 4));
    let things: [Entity; 4] = std::array::from_fn(|_| commands.spawn());
    let [organ, tool, smoke, peg] = things;
    for (number, entity) in things.into_iter().enumerate() {
        commands.put(entity, Name(format!("thing {number}")));
        commands.put(entity, Pose::at(0.1 * number as f64, -0.05, 0.02));
        commands.put(entity, Velocity::default());
    }
    commands.put(peg, Parent(tool));
    commands.put(tool, InstrumentTarget::default());
    commands.put(organ, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [67, 68, 69]]) });
    commands.put(organ, body(0.0));
    commands.put(smoke, particles(0.0));
    commands.put(organ, VitalSigns::default());
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
    for (number, entity) in things.into_iter().enumerate() {
        commands.put(entity, Pose::at(0.1 * number as f64, 0.04, 0.02));
        let linear = Vector3::new(0.3, 0.0, -0.1 * number as f64);
        commands.put(entity, Velocity { linear, angular: Vector3::zeros() });
    }
    commands.put(organ, body(0.001));
    commands.put(smoke, particles(0.002));
    commands.put(peg, Name("peg".into()));
    commands.remove::<Parent>(peg);
    let drop = commands.spawn();
    commands.put(drop, Pose::at(0.5, 0.5, 0.5));
    commands.despawn(tool);
    commands.event("moved", organ, Some(tool), 2.0);
    [before, take(&mut commands, 20)]
});

/// Vertices of two chunks, some of them moved.
fn body(moved: f64) -> VertexPositions {
    let vertex = |k: i32| {
        let x = 0.003 * f64::from(k);
        Point3::new(x, if k % 5 == 0 { moved } else { 0.0 }, 0.1)
    };
    VertexPositions { positions: Arc::new((0..70).map(vertex).collect()) }
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
