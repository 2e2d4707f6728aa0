//! A delta at the station that receives it: from bytes to commands.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{
    Commands, ComponentError, ComponentId, Entity, Event, Puts, Revision, SimTime, VertexPositions, varint,
};

use super::ReplicationError;
use super::choice::{ReplicatedColumns, RowCodec};
use super::delta::{CHUNKS, EVERYTHING, ExcludedRows, SINCE, chunk_of, is_quantised};
use super::known_rows::{KnownRows, KnownVertices};
use super::quantised_row::RowQuantiser;
use super::wire_reader::WireReader;

/// What a delta did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DeltaSummary {
    /// The revision of the host that the replica is at now.
    pub revision: Revision,
    /// Its time.
    pub time: SimTime,
    /// Whether it told changes only, and not all that there is in a part of the scene.
    pub is_since: bool,
    /// New entities.
    pub spawned: usize,
    /// Entities that are gone.
    pub despawned: usize,
    /// Rows that are gone, of entities that are not.
    pub removed: usize,
    /// Rows put.
    pub put: usize,
    /// Rows that were at hand in a newer value.
    pub older: usize,
    /// Number of the first event in the host's log.
    pub first_event: u64,
    /// Events emitted.
    pub events: usize,
}

/// What is told of the scope.
enum ReadScope {
    Since,
    Chunks(BTreeSet<u64>),
    Everything,
}

/// A put that waits until the whole delta has been read.
struct Staged {
    id: ComponentId,
    entity: Entity,
    revision: Revision,
    vertices: Option<Arc<Vec<Point3<f64>>>>,
}

/// What a delta is read with.
pub(super) struct DeltaReader<'a> {
    pub(super) columns: &'a ReplicatedColumns,
    /// Where the replica is.
    pub(super) applied: Revision,
    pub(super) excluded: &'a ExcludedRows,
    pub(super) known: &'a mut KnownRows,
    pub(super) quantiser: &'a mut RowQuantiser,
    /// Empty.
    pub(super) commands: &'a mut Commands,
    /// For rows that are read and not wanted; empty.
    pub(super) scratch: &'a mut Commands,
}

impl DeltaReader<'_> {
    /// Puts a delta into the commands, and notes it in what is known. After an error neither has changed.
    ///
    /// # Errors
    /// When it is malformed, or begins elsewhere.
    pub(super) fn read(mut self, bytes: &[u8]) -> Result<DeltaSummary, ReplicationError> {
        let outcome = self.read_all(bytes);
        self.scratch.clear();
        if outcome.is_err() {
            self.commands.clear();
        }
        outcome
    }

    fn read_all(&mut self, bytes: &[u8]) -> Result<DeltaSummary, ReplicationError> {
        let mut reader = WireReader::new("a delta", bytes);
        let scope = read_scope(&mut reader, self.applied)?;
        let target = Revision(reader.number()?);
        let time = SimTime(reader.number()?);
        let living = read_entities(&mut reader)?;
        let mut despawned = read_entities(&mut reader)?;
        let mut removed = self.read_removed(&mut reader)?;
        let is_since = matches!(scope, ReadScope::Since);
        let (staged, older) = self.read_puts(&mut reader, target, is_since)?;
        let first_event = reader.number()?;
        let events = read_events(&mut reader)?;
        if !reader.is_empty() {
            return Err(reader.refuse(0, "the end of the delta"));
        }
        let is_covered = |entity: Entity| match &scope {
            ReadScope::Since => false,
            ReadScope::Chunks(chunks) => chunks.contains(&chunk_of(entity)),
            ReadScope::Everything => true,
        };
        let listed: BTreeSet<Entity> = living.iter().copied().collect();
        let told: BTreeSet<_> = staged.iter().map(|staged| (staged.id, staged.entity)).collect();
        // The scene removes rows after it has put others.
        if let Some((_, entity)) = removed.iter().find(|row| told.contains(row)) {
            return Err(reader.refuse(entity.to_bits(), "an entity whose row is either removed or put"));
        }
        if !is_since {
            let gone = self.known.entities().iter().copied().filter(|entity| is_covered(*entity));
            despawned.extend(gone.filter(|entity| !listed.contains(entity)));
            despawned.sort_unstable();
            despawned.dedup();
            for id in self.columns.replicated() {
                let rows = self.known.column(id).filter(|entity| is_covered(*entity));
                removed.extend(rows.map(|entity| (id, entity)).filter(|row| !told.contains(row)));
            }
        }
        // The rows of a writer itself need no entity that lives, but go with one.
        let lives = |entity: &Entity| {
            let was = self.known.contains(*entity) || entity.counter() == 0;
            listed.contains(entity) || (was && despawned.binary_search(entity).is_err())
        };
        if let Some(staged) = staged.iter().find(|staged| !lives(&staged.entity)) {
            return Err(reader.refuse(staged.entity.to_bits(), "an entity that lives"));
        }
        // The scene drops the rows of what it despawns.
        despawned.retain(|entity| self.known.contains(*entity) && !listed.contains(entity));
        removed
            .retain(|(id, entity)| self.known.has(*id, *entity) && despawned.binary_search(entity).is_err());
        let spawned: Vec<Entity> =
            living.into_iter().filter(|entity| !self.known.contains(*entity)).collect();
        let summary = DeltaSummary {
            revision: target,
            time,
            is_since,
            spawned: spawned.len(),
            despawned: despawned.len(),
            removed: removed.len(),
            put: staged.len(),
            older,
            first_event,
            events: events.len(),
        };
        self.command(&spawned, &despawned, &removed, events)?;
        // From here on nothing fails.
        despawned.iter().for_each(|entity| _ = self.known.despawn(*entity));
        removed.iter().for_each(|(id, entity)| _ = self.known.remove(*id, *entity));
        spawned.iter().for_each(|entity| _ = self.known.spawn(*entity));
        for staged in staged {
            if !is_since {
                self.known.remove(staged.id, staged.entity);
            }
            self.note(staged);
        }
        if !is_since {
            self.known.is_as_in(target, is_covered);
        }
        Ok(summary)
    }

    fn read_removed(
        &self,
        reader: &mut WireReader<'_>,
    ) -> Result<Vec<(ComponentId, Entity)>, ReplicationError> {
        let mut removed = Vec::new();
        for _ in 0..reader.count()? {
            let id = reader.component(self.columns)?;
            removed.extend(read_entities(reader)?.into_iter().map(|entity| (id, entity)));
        }
        Ok(removed)
    }

    /// Rows that are newer than what is at hand, already among the commands, and how many are not.
    fn read_puts(
        &mut self,
        reader: &mut WireReader<'_>,
        target: Revision,
        is_since: bool,
    ) -> Result<(Vec<Staged>, usize), ReplicationError> {
        let (mut staged, mut older) = (Vec::new(), 0);
        for _ in 0..reader.count()? {
            let id = reader.component(self.columns)?;
            let registry = self.columns.registry().clone();
            let mut before = 0;
            for _ in 0..reader.count()? {
                let entity = reader.entity(&mut before)?;
                let revision = Revision(target.0.saturating_sub(reader.number()?));
                let at_hand = self.known.row_mut(id, entity).map(|row| row.revision);
                let is_excluded = self.excluded.contains(id, entity);
                // After a reconciliation the host's revisions count, which may be lower than those at hand.
                let is_newer =
                    !is_excluded && (!is_since || at_hand.is_none_or(|at_hand| at_hand <= revision));
                let commands = if is_newer { &mut *self.commands } else { &mut *self.scratch };
                if is_quantised(self.columns, id) {
                    let length = reader.count()?;
                    self.quantiser.read(reader.take(length)?, self.columns, id, entity, commands)?;
                } else {
                    let put = registry.put_postcard(id, commands, entity, reader.rest());
                    let component = registry.entry(id).name;
                    reader.continue_at(put.map_err(|error| ReplicationError::Value { component, error })?);
                }
                if is_newer {
                    let vertices = match self.columns.codec(id) {
                        RowCodec::Vertices => last_vertices(self.commands, id),
                        _ => None,
                    };
                    staged.push(Staged { id, entity, revision, vertices });
                } else {
                    older += 1;
                }
            }
        }
        Ok((staged, older))
    }

    /// Notes a row that has been put.
    fn note(&mut self, staged: Staged) {
        let Staged { id, entity, revision, vertices } = staged;
        let Some(row) = self.known.row_or_new(id, entity) else { return };
        row.revision = revision;
        let Some(positions) = vertices else { return };
        match &mut row.vertices {
            Some(at_hand) => {
                if at_hand.replace(&positions, revision) {
                    at_hand.is_changed = false;
                    self.commands.put(entity, VertexPositions { positions: at_hand.positions.clone() });
                }
            }
            none => *none = Some(KnownVertices::new(positions, revision)),
        }
    }

    /// What has no method of its own for entities and components that are not known by type goes in as the encoding of
    /// commands.
    fn command(
        &mut self,
        spawned: &[Entity],
        despawned: &[Entity],
        removed: &[(ComponentId, Entity)],
        events: Vec<Event>,
    ) -> Result<(), ReplicationError> {
        let mut bytes = Vec::new();
        for entities in [spawned, despawned] {
            varint::write(entities.len() as u64, &mut bytes);
            entities.iter().for_each(|entity| varint::write(entity.to_bits(), &mut bytes));
        }
        varint::write(removed.len() as u64, &mut bytes);
        for (id, entity) in removed {
            varint::write(u64::from(self.columns.registry().entry(*id).key), &mut bytes);
            varint::write(entity.to_bits(), &mut bytes);
        }
        // No puts and no transfers; the events follow.
        bytes.extend([0, 0]);
        let in_postcard = postcard::to_io(&events, &mut bytes).map(drop).map_err(|error| error.to_string());
        let decoded =
            in_postcard.and_then(|()| self.commands.decode(&bytes).map_err(|error| error.to_string()));
        match decoded {
            Ok(_) => Ok(()),
            Err(error) => Err(ReplicationError::Value {
                component: "the entities and events of a delta",
                error: ComponentError::Malformed(error),
            }),
        }
    }
}

fn last_vertices(commands: &Commands, id: ComponentId) -> Option<Arc<Vec<Point3<f64>>>> {
    let (_, puts) = commands.puts().find(|(of, _)| *of == id)?;
    let puts: &Puts<VertexPositions> = puts.as_any().downcast_ref()?;
    puts.rows().last().map(|(_, vertices)| vertices.positions.clone())
}

fn read_scope(reader: &mut WireReader<'_>, applied: Revision) -> Result<ReadScope, ReplicationError> {
    match reader.byte()? {
        SINCE => {
            let from = reader.number()?;
            if from != applied.0 {
                return Err(ReplicationError::OtherBase { from, at: applied.0 });
            }
            Ok(ReadScope::Since)
        }
        CHUNKS => {
            let mut before = 0;
            let chunks = (0..reader.count()?).map(|_| reader.entity(&mut before).map(Entity::to_bits));
            chunks.collect::<Result<_, _>>().map(ReadScope::Chunks)
        }
        EVERYTHING => Ok(ReadScope::Everything),
        other => Err(reader.refuse(u64::from(other), "0, 1 or 2 for what the delta covers")),
    }
}

/// Entities in ascending order.
fn read_entities(reader: &mut WireReader<'_>) -> Result<Vec<Entity>, ReplicationError> {
    let count = reader.count()?;
    let (mut entities, mut before) = (Vec::with_capacity(count.min(1 << 16)), 0);
    for _ in 0..count {
        let entity = reader.entity(&mut before)?;
        if entities.last().is_some_and(|last| *last >= entity) {
            return Err(reader.refuse(entity.to_bits(), "an entity above the one before"));
        }
        entities.push(entity);
    }
    Ok(entities)
}

fn read_events(reader: &mut WireReader<'_>) -> Result<Vec<Event>, ReplicationError> {
    let malformed = |reader: &WireReader<'_>| reader.refuse(0, "a list of events with finite values");
    let (events, rest) =
        postcard::take_from_bytes::<Vec<Event>>(reader.rest()).map_err(|_| malformed(reader))?;
    if events.iter().any(|event| !event.value.is_finite()) {
        return Err(malformed(reader));
    }
    reader.continue_at(rest);
    Ok(events)
}
