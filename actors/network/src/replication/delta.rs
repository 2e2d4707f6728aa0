//! A delta: what leads from one snapshot to another.
//!
//! Layout, all numbers of variable length unless stated, entities as differences to the one before, lists after their
//! count:
//!
//! ```text
//! scope       0 since a revision: revision │ 1 chunks of entities: their numbers, ascending │ 2 everything
//! target      revision, time [ns]
//! spawned     entities; of scopes 1 and 2 all that live
//! despawned   entities; of scope 0 only
//! removed     for each component: number, entities; of scope 0 only
//! put         for each component: number, rows (entity, target − revision of the row, value)
//! events      number of the first, events in postcard
//! ```
//!
//! The value of a row that datagrams move later is quantised as it is there, after its length; any other is exact, in
//! postcard. Vertices are exact, too.
//!
//! Scopes 1 and 2 state all that there is in a part of the scene, so that whatever else a station has there goes away:
//! what was despawned while it was absent is never missed. Children are despawned by name, like everybody.

use std::collections::BTreeSet;

use trocar_scene::{ComponentError, ComponentId, Entity, Event, Revision, Snapshot, varint};

use super::choice::{ReplicatedColumns, RowCodec};
use super::quantised_row::RowQuantiser;
use super::wire_reader::write_entity;

/// Most bytes of a delta: that of a join to a scene of a million rows. A longer one is refused.
pub const DELTA_BYTES_MAX: usize = 256 << 20;

/// Rows by component and entity.
pub type RowSet = BTreeSet<(ComponentId, Entity)>;

/// What a station computes itself, and so is neither sent to it nor taken there: single rows, and whole columns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExcludedRows {
    rows: RowSet,
    /// Ascending.
    columns: Vec<ComponentId>,
}

impl ExcludedRows {
    /// These rows, and all rows of these columns.
    pub fn new(rows: RowSet, columns: impl IntoIterator<Item = ComponentId>) -> Self {
        let mut columns: Vec<ComponentId> = columns.into_iter().collect();
        columns.sort_unstable();
        columns.dedup();
        Self { rows, columns }
    }

    /// Whether a row is among them.
    pub fn contains(&self, id: ComponentId, entity: Entity) -> bool {
        self.columns.binary_search(&id).is_ok() || self.rows.contains(&(id, entity))
    }

    /// The single rows.
    pub fn rows(&self) -> &RowSet {
        &self.rows
    }

    /// The whole columns.
    pub fn columns(&self) -> &[ComponentId] {
        &self.columns
    }
}

impl From<RowSet> for ExcludedRows {
    fn from(rows: RowSet) -> Self {
        Self { rows, columns: Vec::new() }
    }
}

/// Entities share a chunk when their numbers agree but for the last six bits.
pub fn chunk_of(entity: Entity) -> u64 {
    entity.to_bits() >> 6
}

/// What a delta covers.
#[derive(Clone)]
pub enum Scope<'a> {
    /// All changes since what the station has.
    Since {
        /// The revision of the delta that brought it there.
        revision: Revision,
        /// A scene that holds the same for it: as it was then, or later if nothing was to be told.
        before: &'a Snapshot,
    },
    /// All that there is in these chunks of entities, see [`chunk_of`]; ascending.
    Chunks(Vec<u64>),
    /// All that there is.
    Everything,
}

pub(super) const SINCE: u8 = 0;
pub(super) const CHUNKS: u8 = 1;
pub(super) const EVERYTHING: u8 = 2;

/// What a delta has written, for the sender's books.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeltaRows {
    /// Entities that are gone.
    pub despawned: Vec<Entity>,
    /// Rows that are gone, of entities that are not.
    pub removed: Vec<(ComponentId, Entity)>,
    /// Rows of unreliable columns that went this way.
    pub put_unreliable: Vec<(ComponentId, Entity)>,
    /// All rows that were put.
    pub put: usize,
    /// Events.
    pub events: usize,
}

impl DeltaRows {
    fn is_empty(&self, spawned: &[Entity]) -> bool {
        spawned.is_empty()
            && self.despawned.is_empty()
            && self.removed.is_empty()
            && self.put == 0
            && self.events == 0
    }
}

/// What goes into a delta besides the changes of reliable columns.
pub struct DeltaChoice<'a> {
    /// How columns travel.
    pub columns: &'a ReplicatedColumns,
    /// The entities that are told of.
    pub entities: &'a dyn Fn(Entity) -> bool,
    /// Rows that the station itself writes.
    pub excluded: &'a ExcludedRows,
    /// Rows to put although they did not change.
    pub forced: &'a RowSet,
    /// Whether a row of an unreliable column must go reliably, because datagrams cannot carry it.
    pub goes_reliably: &'a dyn Fn(ComponentId, Entity) -> bool,
}

impl DeltaChoice<'_> {
    fn tells(&self, id: ComponentId, entity: Entity) -> bool {
        (self.entities)(entity) && !self.excluded.contains(id, entity)
    }
}

/// Appends the delta to `now`; `Ok(None)`, with nothing appended, when there is nothing to tell.
///
/// # Errors
/// When a value cannot be encoded, or the delta would be longer than [`DELTA_BYTES_MAX`].
pub fn write(
    scope: &Scope<'_>,
    now: &Snapshot,
    choice: &DeltaChoice<'_>,
    quantiser: &mut RowQuantiser,
    out: &mut Vec<u8>,
) -> Result<Option<DeltaRows>, ComponentError> {
    let begin = out.len();
    let mut rows = DeltaRows::default();
    write_scope(scope, out);
    varint::write(now.revision().0, out);
    varint::write(now.time().0, out);
    let mut spawned = spawned(scope, now);
    spawned.retain(|entity| (choice.entities)(*entity));
    write_entities(&spawned, out);
    if let Scope::Since { before, .. } = scope {
        let is_gone = |entity: &Entity| !now.contains(*entity) && (choice.entities)(*entity);
        rows.despawned = before.entities().filter(is_gone).collect();
    }
    write_entities(&rows.despawned, out);
    write_removed(scope, now, choice, &mut rows, out);
    write_puts(scope, now, choice, quantiser, &mut rows, out)?;
    let cursor = match scope {
        Scope::Since { before, .. } => before.events().next(),
        _ => now.events().next(),
    };
    let events: Vec<&Event> = now.events().since(cursor).map(|(_, event)| event).collect();
    rows.events = events.len();
    varint::write(now.events().next() - events.len() as u64, out);
    encode(&events, out)?;
    if out.len() - begin > DELTA_BYTES_MAX {
        let bytes = out.len() - begin;
        out.truncate(begin);
        let what =
            format!("the scene takes {bytes} bytes, and at most {DELTA_BYTES_MAX} can be sent at once");
        return Err(ComponentError::Malformed(what));
    }
    if rows.is_empty(&spawned) && matches!(scope, Scope::Since { .. }) {
        out.truncate(begin);
        return Ok(None);
    }
    Ok(Some(rows))
}

/// Whether rows of a component are quantised in deltas as well.
pub(super) fn is_quantised(columns: &ReplicatedColumns, id: ComponentId) -> bool {
    columns.is_unreliable(id) && columns.codec(id) != RowCodec::Vertices
}

fn write_scope(scope: &Scope<'_>, out: &mut Vec<u8>) {
    match scope {
        Scope::Since { revision, .. } => {
            out.push(SINCE);
            varint::write(revision.0, out);
        }
        Scope::Chunks(chunks) => {
            out.push(CHUNKS);
            varint::write(chunks.len() as u64, out);
            let mut before = 0;
            chunks.iter().for_each(|chunk| write_entity(Entity::from_bits(*chunk), &mut before, out));
        }
        Scope::Everything => out.push(EVERYTHING),
    }
}

fn covers(scope: &Scope<'_>, entity: Entity) -> bool {
    match scope {
        Scope::Chunks(chunks) => chunks.binary_search(&chunk_of(entity)).is_ok(),
        _ => true,
    }
}

fn spawned(scope: &Scope<'_>, now: &Snapshot) -> Vec<Entity> {
    let is_told = |entity: &Entity| match scope {
        Scope::Since { before, .. } => !before.contains(*entity),
        _ => covers(scope, *entity),
    };
    now.entities().filter(is_told).collect()
}

fn write_entities(entities: &[Entity], out: &mut Vec<u8>) {
    varint::write(entities.len() as u64, out);
    let mut before = 0;
    entities.iter().for_each(|entity| write_entity(*entity, &mut before, out));
}

fn write_removed(
    scope: &Scope<'_>,
    now: &Snapshot,
    choice: &DeltaChoice<'_>,
    rows: &mut DeltaRows,
    out: &mut Vec<u8>,
) {
    let mut columns = Vec::new();
    if let Scope::Since { before, .. } = scope {
        for id in choice.columns.replicated() {
            let (had, has) = (before.erased_column(id), now.erased_column(id));
            if has.latest() <= before.revision() && has.len() == had.len() {
                continue;
            }
            let mut gone = Vec::new();
            had.for_each_entity(&mut |entity| {
                let is_gone = has.revision(entity).is_none() && choice.tells(id, entity);
                // A despawned entity takes its rows with it.
                if is_gone && (now.contains(entity) || !before.contains(entity)) {
                    gone.push(entity);
                }
            });
            if !gone.is_empty() {
                columns.push((id, gone));
            }
        }
    }
    varint::write(columns.len() as u64, out);
    for (id, gone) in columns {
        varint::write(u64::from(id.0), out);
        write_entities(&gone, out);
        rows.removed.extend(gone.into_iter().map(|entity| (id, entity)));
    }
}

fn write_puts(
    scope: &Scope<'_>,
    now: &Snapshot,
    choice: &DeltaChoice<'_>,
    quantiser: &mut RowQuantiser,
    rows: &mut DeltaRows,
    out: &mut Vec<u8>,
) -> Result<(), ComponentError> {
    let mut columns = Vec::new();
    for id in choice.columns.replicated() {
        let column = now.erased_column(id);
        let is_unreliable = choice.columns.is_unreliable(id);
        let mut put = Vec::new();
        let mut visit = |entity: Entity| {
            let goes = match scope {
                Scope::Since { .. } => !is_unreliable || (choice.goes_reliably)(id, entity),
                _ => covers(scope, entity),
            };
            if goes && choice.tells(id, entity) {
                put.push(entity);
            }
        };
        match scope {
            Scope::Since { before, .. } => column.for_each_changed(before.revision(), &mut visit),
            _ => column.for_each_entity(&mut visit),
        }
        let forced = choice.forced.range((id, Entity::from_bits(0))..=(id, Entity::from_bits(u64::MAX)));
        let forced = forced.map(|(_, entity)| *entity).filter(|entity| column.revision(*entity).is_some());
        let before = put.len();
        put.extend(forced);
        if put.len() > before {
            put.sort_unstable();
            put.dedup();
        }
        if !put.is_empty() {
            columns.push((id, put));
        }
    }
    varint::write(columns.len() as u64, out);
    for (id, put) in columns {
        varint::write(u64::from(id.0), out);
        varint::write(put.len() as u64, out);
        let column = now.erased_column(id);
        let (mut before, mut value) = (0, Vec::new());
        for entity in &put {
            write_entity(*entity, &mut before, out);
            let revision = column.revision(*entity).unwrap_or(Revision::ZERO);
            varint::write(now.revision().0 - revision.0.min(now.revision().0), out);
            if is_quantised(choice.columns, id) {
                value.clear();
                quantiser.write(now, choice.columns, id, *entity, &mut value)?;
                varint::write(value.len() as u64, out);
                out.extend_from_slice(&value);
            } else {
                column.encode_row(*entity, out)?;
            }
        }
        rows.put += put.len();
        if choice.columns.is_unreliable(id) {
            rows.put_unreliable.extend(put.into_iter().map(|entity| (id, entity)));
        }
    }
    Ok(())
}

/// Appends a value as postcard.
fn encode<T: serde::Serialize>(value: &T, out: &mut Vec<u8>) -> Result<(), ComponentError> {
    match postcard::to_io(value, &mut *out) {
        Ok(_) => Ok(()),
        Err(error) => Err(ComponentError::Malformed(error.to_string())),
    }
}
