//! Repair: the rows of one body, from its owner to a peer whose own differ.
//!
//! The peer names the body with a hash of each row that it has, and the owner sends those that differ, exactly: an elastic body
//! is one state, which its simulator cannot take by parts, but most of its rows (how its mesh hangs together, what it is made
//! of) are the same. What haptics and detectors find anew in every tick is left out.

use std::collections::BTreeMap;

use trocar_scene::{Commands, ComponentId, Entity, Snapshot, varint};

use crate::replication::ReplicationError;
use crate::replication::choice::ReplicatedColumns;
use crate::replication::wire_reader::WireReader;

/// Most rows of a body: as many as columns are simulated.
pub const ROWS_MAX: usize = 64;
/// Most bytes of a repair: what one message of the control channel carries.
pub const REPAIR_BYTES_MAX: usize = (512 << 10) - 64;

/// What is found anew in every tick, or belongs to the hand that is felt here.
const LEFT_OUT: [&str; 9] = [
    "device_force",
    "device_state",
    "haptic_status",
    "instrument_force",
    "instrument_target",
    "instrument_yields",
    "local_contact_model",
    "measured",
    "station_contact_model",
];

/// A peer asks for a body: the hash of each row that it has.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct RepairRequest {
    /// The body.
    pub entity: Entity,
    /// Component, and the first eight bytes of the hash of its row.
    pub rows: Vec<(u16, u64)>,
}

/// The columns of a body that are repaired.
fn columns(columns: &ReplicatedColumns) -> impl Iterator<Item = ComponentId> + '_ {
    let registry = columns.registry();
    columns.simulated().filter(|id| !LEFT_OUT.contains(&registry.entry(*id).name)).take(ROWS_MAX)
}

/// The rows of a body, encoded; those that cannot be are left out.
fn rows(scene: &Snapshot, of: &ReplicatedColumns, entity: Entity) -> BTreeMap<u16, Vec<u8>> {
    let row = |id: ComponentId| {
        let mut bytes = Vec::new();
        let has = scene.erased_column(id).encode_row(entity, &mut bytes).unwrap_or(false);
        has.then_some((id.0, bytes))
    };
    columns(of).filter_map(row).collect()
}

fn hash(bytes: &[u8]) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&blake3::hash(bytes).as_bytes()[..8]);
    u64::from_le_bytes(word)
}

/// What a peer asks.
pub fn request(scene: &Snapshot, columns: &ReplicatedColumns, entity: Entity) -> RepairRequest {
    let rows = rows(scene, columns, entity).into_iter().map(|(id, bytes)| (id, hash(&bytes))).collect();
    RepairRequest { entity, rows }
}

/// What its owner answers: entity, rows that differ (component + 1, length, bytes), 0, then the components whose rows are to go.
/// `None` when they are more than [`REPAIR_BYTES_MAX`] bytes, or nothing differs.
pub fn answer(scene: &Snapshot, columns: &ReplicatedColumns, asked: &RepairRequest) -> Option<Vec<u8>> {
    let own = rows(scene, columns, asked.entity);
    let theirs: BTreeMap<u16, u64> = asked.rows.iter().copied().collect();
    let mut out = asked.entity.to_bits().to_le_bytes().to_vec();
    let head = out.len();
    for (id, bytes) in &own {
        if theirs.get(id) != Some(&hash(bytes)) {
            varint::write(u64::from(*id) + 1, &mut out);
            varint::write(bytes.len() as u64, &mut out);
            out.extend_from_slice(bytes);
        }
    }
    let put = out.len() - head;
    varint::write(0, &mut out);
    let gone: Vec<u16> = theirs.keys().copied().filter(|id| !own.contains_key(id)).collect();
    for id in &gone {
        varint::write(u64::from(*id), &mut out);
    }
    (out.len() <= REPAIR_BYTES_MAX && (put > 0 || !gone.is_empty())).then_some(out)
}

/// Writes an owner's answer; the body that it is of.
///
/// # Errors
/// When it is malformed; nothing is to be applied then.
pub fn write(
    bytes: &[u8],
    of: &ReplicatedColumns,
    scene: &Snapshot,
    out: &mut Commands,
) -> Result<Entity, ReplicationError> {
    let mut reader = WireReader::new("a repair", bytes);
    let entity = Entity::from_bits(reader.word()?);
    if !scene.contains(entity) {
        return Err(reader.refuse(entity.to_bits(), "a body of the scene"));
    }
    let known: Vec<ComponentId> = columns(of).collect();
    let column = |reader: &WireReader<'_>, number: u64| {
        let id = u16::try_from(number).ok().map(ComponentId).filter(|id| known.contains(id));
        id.ok_or_else(|| reader.refuse(number, "a column that peers compute"))
    };
    loop {
        let number = reader.number()?;
        let Some(number) = number.checked_sub(1) else { break };
        let id = column(&reader, number)?;
        let length = reader.count()?;
        let row = reader.take(length)?;
        let registry = of.registry();
        let component = registry.entry(id).name;
        registry
            .put_postcard(id, out, entity, row)
            .map_err(|error| ReplicationError::Value { component, error })?;
    }
    while !reader.is_empty() {
        let number = reader.number()?;
        let id = column(&reader, number)?;
        if scene.erased_column(id).revision(entity).is_some() {
            out.remove_component(id, entity);
        }
    }
    Ok(entity)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Point3;
    use proptest::prelude::*;
    use trocar_scene::{
        EntityAllocator, Grasp, Name, Pose, Registry, SimTime, Store, SurfaceMesh, Velocity, VertexPositions,
    };

    use super::*;
    use crate::replication::choice::ColumnRates;

    struct Scene {
        store: Store,
        commands: Commands,
    }

    impl Scene {
        fn apply(&mut self) {
            self.commands.seal();
            self.store.apply(&mut self.commands, SimTime::ZERO);
            self.commands.clear();
            self.commands.begin(SimTime::ZERO);
        }
    }

    /// A body with a mesh of 500 triangles at a height; it has a velocity or a grasp.
    fn scene(z: f64, moves: bool) -> (Scene, Entity) {
        let registry = Registry::standard();
        let store = Store::new(registry.clone());
        let mut commands = Commands::new(registry, EntityAllocator::new(0, 0));
        commands.begin(SimTime::ZERO);
        let body = commands.spawn();
        let positions = (0..300).map(|at| Point3::new(f64::from(at) * 1e-3, 0.0, z)).collect();
        commands.put(body, Name("organ".to_owned()));
        commands.put(body, VertexPositions { positions: Arc::new(positions) });
        commands.put(body, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]; 500]) });
        if moves {
            commands.put(body, Velocity::default());
        } else {
            let (anchor, since) = (Pose::default(), SimTime::ZERO);
            commands.put(body, Grasp { held: body, anchor, since, assisted: false });
        }
        let mut scene = Scene { store, commands };
        scene.apply();
        (scene, body)
    }

    fn columns() -> ReplicatedColumns {
        let columns = ReplicatedColumns::new(&Registry::standard(), &ColumnRates::default());
        columns.expect("the defaults hold").among_peers()
    }

    #[test]
    fn a_repair_has_the_rows_that_differ_and_makes_both_bodies_the_same() {
        let columns = columns();
        let ((owner, body), (mut peer, _)) = (scene(0.02, true), scene(0.01, false));
        let asked = request(&peer.store.snapshot(), &columns, body);
        let answer = answer(&owner.store.snapshot(), &columns, &asked).expect("they differ");
        assert!(answer.len() < 300 * 24 + 200, "{} bytes: the mesh is the same at both", answer.len());
        let before = peer.store.snapshot();
        assert_eq!(write(&answer, &columns, &before, &mut peer.commands), Ok(body));
        peer.apply();
        let (ours, theirs) = (peer.store.snapshot(), owner.store.snapshot());
        assert_eq!(ours.get::<VertexPositions>(body), theirs.get::<VertexPositions>(body));
        assert_eq!(ours.get::<Velocity>(body), theirs.get::<Velocity>(body));
        assert_eq!(ours.get::<Grasp>(body), None);
        let asked = request(&ours, &columns, body);
        assert_eq!(super::answer(&theirs, &columns, &asked), None, "nothing differs any more");
    }

    #[test]
    fn a_repair_of_what_peers_do_not_compute_is_refused() {
        let columns = columns();
        let (mut peer, body) = scene(0.01, true);
        let name = columns.registry().id::<Name>().expect("it is standard");
        let mut bytes = body.to_bits().to_le_bytes().to_vec();
        varint::write(u64::from(name.0) + 1, &mut bytes);
        bytes.extend_from_slice(&[2, 1, b'x', 0]);
        let before = peer.store.snapshot();
        let refused = write(&bytes, &columns, &before, &mut peer.commands).expect_err("it is refused");
        assert!(refused.to_string().contains("a column that peers compute"), "{refused}");
        let nobody = [u64::MAX.to_le_bytes().to_vec(), vec![0]].concat();
        assert!(write(&nobody, &columns, &before, &mut peer.commands).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_a_repair_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let columns = columns();
            let (mut peer, body) = scene(0.01, true);
            let before = peer.store.snapshot();
            let _ = write(&[&body.to_bits().to_le_bytes()[..], &bytes].concat(), &columns, &before, &mut peer.commands);
        }
    }
}
