//! Receiver of rows in datagrams: what is newer than what is at hand goes into commands.

use trocar_scene::{Commands, ComponentId, Entity, Revision, VertexPositions};

use super::ROWS_PAYLOAD_MAX;
use super::ReplicationError;
use super::acknowledgement::RowWindow;
use super::choice::{ReplicatedColumns, RowCodec};
use super::delta::ExcludedRows;
use super::known_rows::KnownRows;
use super::positions::{ChunkHead, vertex_from_grid};
use super::quantised_row::RowQuantiser;
use super::replica::ReplicaCounts;
use super::wire_reader::WireReader;

/// Highest revision that counts: counters cannot overflow.
const REVISION_MAX: u64 = 1 << 62;

/// What became of a row.
enum Fate {
    Applied,
    Older,
    Unknown,
}

/// What a datagram is read with.
pub(super) struct RowReceiver<'a> {
    pub(super) columns: &'a ReplicatedColumns,
    pub(super) applied: Revision,
    pub(super) excluded: &'a ExcludedRows,
    pub(super) known: &'a mut KnownRows,
    pub(super) quantiser: &'a mut RowQuantiser,
    pub(super) window: &'a mut RowWindow,
    pub(super) counts: &'a mut ReplicaCounts,
    pub(super) commands: &'a mut Commands,
}

impl RowReceiver<'_> {
    /// Takes a datagram's payload. It is acknowledged unless it holds a row that is not known yet, or is malformed.
    ///
    /// # Errors
    /// When it is malformed; the rows before that place have been taken all the same, for each stands for itself.
    pub(super) fn receive(mut self, payload: &[u8]) -> Result<(), ReplicationError> {
        self.counts.datagrams += 1;
        let outcome = self.rows(payload);
        self.counts.malformed += u64::from(outcome.is_err());
        outcome
    }

    fn rows(&mut self, payload: &[u8]) -> Result<(), ReplicationError> {
        let mut reader = WireReader::new("a datagram of rows", payload);
        if payload.len() > ROWS_PAYLOAD_MAX {
            return Err(reader.refuse(payload.len() as u64, "at most 1,160 bytes"));
        }
        let sequence = reader.number()?;
        let newest = reader.number()?;
        if sequence == u64::MAX || newest > REVISION_MAX {
            return Err(reader.refuse(newest, "a sequence number and a revision up to 2^62"));
        }
        if self.window.has(sequence) {
            self.counts.duplicates += 1;
            return Ok(());
        }
        let needed = Revision(newest.saturating_sub(reader.number()?));
        if needed > self.applied {
            self.counts.early += 1;
            return Ok(());
        }
        let (mut before, mut is_all_known) = (0, true);
        while !reader.is_empty() {
            let id = reader.component(self.columns)?;
            if !self.columns.is_unreliable(id) {
                return Err(reader.refuse(u64::from(id.0), "the number of an unreliable component"));
            }
            let entity = reader.entity(&mut before)?;
            let revision = Revision(newest.saturating_sub(reader.number()?));
            let length = reader.count()?;
            match self.row(id, entity, revision, reader.take(length)?)? {
                Fate::Applied => self.counts.applied += 1,
                Fate::Older => self.counts.older += 1,
                Fate::Unknown => {
                    self.counts.unknown += 1;
                    is_all_known = false;
                }
            }
        }
        if is_all_known {
            self.window.take(sequence);
        }
        Ok(())
    }

    fn row(
        &mut self,
        id: ComponentId,
        entity: Entity,
        revision: Revision,
        value: &[u8],
    ) -> Result<Fate, ReplicationError> {
        if self.excluded.contains(id, entity) {
            return Ok(Fate::Older);
        }
        let Some(row) = self.known.row_mut(id, entity) else { return Ok(Fate::Unknown) };
        if self.columns.codec(id) != RowCodec::Vertices {
            if revision <= row.revision {
                return Ok(Fate::Older);
            }
            self.quantiser.read(value, self.columns, id, entity, self.commands)?;
            row.revision = revision;
            return Ok(Fate::Applied);
        }
        let mut reader = WireReader::new("a chunk of vertices", value);
        let head = ChunkHead::read(&mut reader)?;
        let Some(vertices) = &mut row.vertices else { return Ok(Fate::Unknown) };
        if head.vertices != vertices.positions.len() {
            // Of the mesh before the one at hand, or of one that has not come yet.
            return Ok(if revision <= row.revision { Fate::Older } else { Fate::Unknown });
        }
        let Some(at_hand) = vertices.revision_of(head.chunk) else { return Ok(Fate::Unknown) };
        if revision <= *at_hand {
            return Ok(Fate::Older);
        }
        if at_hand.0 < revision.0.saturating_sub(head.over) {
            // It builds on a value that has not come yet.
            return Ok(Fate::Unknown);
        }
        // Read to the end before anything moves.
        head.read_points(&mut reader.clone(), |_, _| {})?;
        *at_hand = revision;
        head.read_points(&mut reader, |vertex, point| vertices.place(vertex, vertex_from_grid(point)))?;
        Ok(Fate::Applied)
    }
}

/// Puts bodies of which chunks have come, each once.
pub(super) fn put_vertices(id: ComponentId, known: &mut KnownRows, commands: &mut Commands) {
    for (entity, row) in known.column_mut(id) {
        if let Some(vertices) = row.vertices.as_mut().filter(|vertices| vertices.is_changed) {
            vertices.is_changed = false;
            commands.put(entity, VertexPositions { positions: vertices.positions.clone() });
        }
    }
}
