//! A scene that two peers compute, as its owner has it and as a peer does whose own is a little different: a body of vertices, a
//! ring that moves, and an instrument that holds it or nothing.

use std::sync::{Arc, LazyLock};

use nalgebra::Point3;
use trocar_network::peers::sketch::{self, BodySketch};
use trocar_network::replication::{ColumnRates, ReplicatedColumns};
use trocar_scene::{
    Commands, Entity, EntityAllocator, Grasp, Instrument, Motion, Pose, Registry, RigidBody, SimTime,
    Snapshot, Store, VertexPositions,
};

/// Vertices of the body: two chunks.
const VERTICES: u32 = 70;

/// The columns of a session among peers.
pub static PEER_COLUMNS: LazyLock<ReplicatedColumns> = LazyLock::new(|| {
    let columns = ReplicatedColumns::new(&Registry::standard(), &ColumnRates::default());
    columns.expect("the defaults hold").among_peers()
});

/// The scene as its owner has it, and as the peer has it.
pub static PEER_SCENES: LazyLock<[Snapshot; 2]> = LazyLock::new(|| [scene(0.0, true), scene(0.004, false)]);

/// The bodies of both.
pub static BODIES: LazyLock<Vec<Entity>> = LazyLock::new(|| sketch::bodies(&PEER_SCENES[0]));

fn scene(apart: f64, holds: bool) -> Snapshot {
    let registry = PEER_COLUMNS.registry().clone();
    let mut store = Store::new(registry.clone());
    let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
    let [organ, ring, tool] = std::array::from_fn(|_| commands.spawn());
    let vertex = |at: u32| Point3::new(1e-3 * f64::from(at) + apart, 0.0, 0.1);
    commands.put(organ, VertexPositions { positions: Arc::new((0..VERTICES).map(vertex).collect()) });
    commands.put(ring, RigidBody { motion: Motion::Dynamic, ..RigidBody::default() });
    commands.put(ring, Pose::at(0.2 + apart, 0.0, 0.02));
    commands.put(tool, Instrument::default());
    if holds {
        commands
            .put(tool, Grasp { held: ring, anchor: Pose::default(), since: SimTime::ZERO, assisted: false });
    }
    commands.seal();
    store.apply(&mut commands, SimTime::ZERO);
    store.snapshot()
}

/// The sketch of this number of all bodies of a scene.
pub fn sketches(scene: &Snapshot, number: u64) -> Vec<BodySketch> {
    sketch::bodies(scene).into_iter().flat_map(|body| sketch::of(scene, body, number)).collect()
}
