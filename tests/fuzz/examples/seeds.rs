//! Writes the binary part of the corpus: `cargo fuzz run` needs something valid to begin with.
//!
//! `cargo run --release --example seeds` in this folder; what it writes is committed.

#[path = "../../../scene/tests/support/mod.rs"]
mod common;

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use common::ply::write_ply;
use common::vtk_xml::{styles, write_vtu};
use common::{Order, tet_box};
use trocar_kernel::LockstepSession;
use trocar_kernel::recorder::{Recorder, RecorderOptions, Recording, RecordingHead};
use trocar_kernel::spec::{ControllerSpec, SessionSpec};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::shapes;
use trocar_scene::*;

const RING: Entity = Entity::new(0, 0, 1);

fn commands(registry: &Arc<Registry>) -> Commands {
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
    for n in 0..3 {
        let entity = commands.spawn();
        commands.put(entity, Name(format!("thing {n}")));
        commands.put(entity, Pose::at(f64::from(n), 0.5, -0.25));
        commands.put(entity, Velocity::default());
    }
    commands.put(RING, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
    commands.contribute(CollisionList { collisions: Vec::new(), penetration_max: 0.0 });
    commands.event("drop", RING, None, 1.5);
    commands.remove::<Velocity>(RING);
    commands.transfer::<Pose>(RING, WriterId(2));
    commands.seal();
    commands
}

/// Moves a ring and says something now and then.
struct Mover;
impl Controller for Mover {
    fn access(&self) -> Access {
        Access::new().writes::<Pose>(EntitySet::Of(vec![RING])).contributes::<CollisionList>().spawns()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        out.put(RING, Pose::at(tick.time.as_secs_f64(), 0.0, 0.1));
        out.contribute(CollisionList { collisions: Vec::new(), penetration_max: 0.0 });
        if tick.number % 8 == 4 {
            let entity = out.spawn();
            out.event("dropped", RING, Some(entity), 1.5);
        }
        Ok(())
    }
}

fn recording(registry: &Arc<Registry>, file: &Path) {
    let mut scene = Store::new(registry.clone());
    scene.apply(&mut commands(registry), SimTime::ZERO);
    let head = RecordingHead {
        scenario: "toy".into(),
        scenario_text: "schema = 1\nname = \"toy\"\n".into(),
        seed: 42,
        station: 0,
        begin: SimTime::ZERO,
        mode: "lockstep".into(),
        devices: BTreeMap::new(),
        extra: BTreeMap::new(),
    };
    let recorder = Recorder::create(file, &head, scene.view(), RecorderOptions::default())
        .expect("the folder can be written to");
    let mover = ControllerSpec::new("mover", 1, RuntimeClass::Simulation, 1_000.0, |_| Ok(Box::new(Mover)));
    let mut spec = SessionSpec::new("toy", 42, scene, vec![mover]);
    recorder.install(&mut spec);
    let mut session = LockstepSession::new(spec).expect("starts");
    session.step_until(SimTime::from_millis(20));
    session.finish();
}

/// Sets the checksum of every chunk of an MCAP file to "none", so that damage reaches the decoders behind it.
fn clear_checksums(bytes: &mut [u8]) {
    const CHUNK: u8 = 0x06;
    let mut at = 8;
    while let Some(length) = bytes.get(at + 1..at + 9).and_then(|length| length.try_into().ok()) {
        if bytes[at] == CHUNK {
            bytes[at + 33..at + 37].fill(0);
        }
        at = at.saturating_add(9).saturating_add(u64::from_le_bytes(length) as usize);
    }
}

fn main() {
    let registry = Registry::standard();
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let save = |target: &str, name: &str, bytes: &[u8]| {
        let folder = corpus.join(target);
        std::fs::create_dir_all(&folder).expect("the corpus can be written to");
        std::fs::write(folder.join(name), bytes).expect("the corpus can be written to");
    };

    let surface = shapes::torus(0.75, 0.25, 3, 3).expect("a torus");
    let volume = tet_box(1);
    save("mesh", "torus.obj", &common::write_obj(&surface));
    save("mesh", "torus.ascii.stl", &common::write_stl(&surface, false));
    save("mesh", "torus.stl", &common::write_stl(&surface, true));
    save("mesh", "torus.gltf", &common::write_gltf_embedded(&surface));
    save("mesh", "torus.glb", &common::write_glb(&surface));
    for (name, order) in [("ascii", None), ("little", Some(Order::Little)), ("big", Some(Order::Big))] {
        save("mesh", &format!("box.{name}.2.msh"), &common::write_gmsh_2(&volume, order));
        save("mesh", &format!("box.{name}.4.msh"), &common::write_gmsh_4(&volume, order));
    }
    for (name, order) in [("ascii", None), ("little", Some(Order::Little)), ("big", Some(Order::Big))] {
        save("mesh", &format!("torus.{name}.ply"), &write_ply(&surface, order));
    }
    for (number, style) in styles().into_iter().enumerate().step_by(5) {
        save("mesh", &format!("box.{number}.vtu"), &write_vtu(&volume, style));
    }
    save("mesh", "square.vtk", common::POLY_DATA.as_bytes());
    save("mesh", "square.vtp", common::POLY_DATA_XML.as_bytes());
    for (name, binary) in [("ascii", false), ("binary", true)] {
        for version in [3, 5] {
            save("mesh", &format!("box.{name}.{version}.vtk"), &common::write_vtk(&volume, binary, version));
        }
    }

    let mut bytes = vec![0];
    commands(&registry).encode(&mut bytes).expect("encodes");
    save("batch", "batch", &bytes);
    let mut store = Store::new(registry.clone());
    store.apply(&mut commands(&registry), SimTime::from_millis(5));
    let mut bytes = vec![1];
    store.view().encode(&mut bytes).expect("encodes");
    save("batch", "keyframe", &bytes);

    let file = corpus.join("recording/whole.mcap");
    std::fs::create_dir_all(corpus.join("recording")).expect("the corpus can be written to");
    recording(&registry, &file);
    let bodies = Recording::open(&file).and_then(|recording| recording.bodies()).expect("just written");
    for (number, body) in bodies.iter().enumerate() {
        save("batch", &format!("block.{number}"), &[&[2], &body[..]].concat());
    }
    let mut bytes = std::fs::read(&file).expect("just written");
    clear_checksums(&mut bytes);
    save("recording", "unchecked.mcap", &bytes);
    save("recording", "torn.mcap", &bytes[..bytes.len() * 2 / 3]);
}
