//! Sender of rows in datagrams, to one station.
//!
//! A row waits in no queue of values: what waits is the row, and when its turn comes its newest value goes. Its turn
//! comes when it has changed, or when the datagram with its last value was lost, and when its column's rate allows; of
//! those whose turn it is, the one that has waited longest goes first. So a slow link gets fewer values, never older
//! ones, and memory is bounded by the number of rows.
//!
//! A datagram states which delta must have been applied for its rows to be those that the station knows under their
//! names: a row may have been removed and put again meanwhile. A station that has not got there drops the datagram and
//! does not acknowledge it. Rows of deltas that the station has not confirmed yet therefore go in datagrams of their own.
//!
//! Payload, numbers of variable length:
//!
//! ```text
//! sequence, revision of the scene, how many revisions before it the delta is that must have been applied
//! for each row: component, entity (difference to the one before), revision of the scene − that of the row,
//!               length, that many bytes: a quantised row or a chunk of vertices
//! ```

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

use trocar_scene::{ComponentId, Entity, Revision, SimTime, Snapshot, VertexPositions, varint};

use super::acknowledgement::RowWindow;
use super::choice::{ReplicatedColumns, RowCodec};
use super::positions::CHUNK_BYTES_MAX;
use super::quantised_row::RowQuantiser;
use super::round_trip::RoundTrip;
use super::row_places::RowPlaces;
use super::send_budget::SendBudget;
use super::sent_datagrams::{Part, SentDatagrams};
use super::vertex_chunks::VertexChunks;
use super::wire_reader::write_entity;
use super::{ROWS_PAYLOAD_MAX, ReplicationError};

/// Most bytes of a row's quantised form; a larger row travels reliably.
pub const ROW_BYTES_MAX: usize = BODY_MAX - ROW_HEAD_MAX;
const PAYLOAD_HEAD_MAX: usize = 30;
/// Most bytes of a payload's rows.
const BODY_MAX: usize = ROWS_PAYLOAD_MAX - PAYLOAD_HEAD_MAX;
const ROW_HEAD_MAX: usize = 3 + 10 + 10 + 2;
const _: () = assert!(CHUNK_BYTES_MAX <= ROW_BYTES_MAX);
/// What a sender has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RowSenderCounts {
    /// Datagrams sent.
    pub datagrams: u64,
    /// Bytes of their payloads.
    pub bytes: u64,
    /// Rows and chunks in them.
    pub rows: u64,
    /// Rows whose turn it was, but whose quantised value had not changed.
    pub unchanged: u64,
    /// Datagrams acknowledged.
    pub acknowledged: u64,
    /// Datagrams given up for lost.
    pub lost: u64,
}

type Queue = BinaryHeap<Reverse<(SimTime, u32, u32)>>;

/// Sends rows of unreliable columns to one station.
pub struct RowSender {
    columns: Arc<ReplicatedColumns>,
    quantiser: RowQuantiser,
    budget: SendBudget,
    rows: RowPlaces,
    /// Rows that the station has, by the time of their turn, and those that it may not have yet.
    known: Queue,
    fresh: Queue,
    waiting: usize,
    confirmed: Revision,
    /// By component: changes up to this revision have been queued.
    scanned: Vec<Revision>,
    observed: Revision,
    sent: SentDatagrams,
    unfit: Vec<(ComponentId, Entity)>,
    value: Vec<u8>,
    body: Vec<u8>,
    trip: RoundTrip,
    doubled_at: SimTime,
    counts: RowSenderCounts,
}

impl RowSender {
    /// Sends at most so many bytes a second, headers included.
    pub fn new(columns: Arc<ReplicatedColumns>, bytes_per_sec: f64) -> Self {
        let registry = columns.registry().clone();
        Self {
            quantiser: RowQuantiser::new(&registry),
            budget: SendBudget::new(bytes_per_sec),
            rows: RowPlaces::default(),
            known: Queue::new(),
            fresh: Queue::new(),
            waiting: 0,
            confirmed: Revision::ZERO,
            scanned: vec![Revision::ZERO; registry.len()],
            observed: Revision::ZERO,
            sent: SentDatagrams::default(),
            unfit: Vec::new(),
            value: Vec::new(),
            body: Vec::new(),
            trip: RoundTrip::default(),
            doubled_at: SimTime::ZERO,
            counts: RowSenderCounts::default(),
            columns,
        }
    }

    /// Another limit on bytes a second.
    pub fn limit(&mut self, bytes_per_sec: f64) {
        self.budget.limit(bytes_per_sec);
    }
    /// What has been done so far.
    pub fn counts(&self) -> &RowSenderCounts {
        &self.counts
    }
    /// Round trip of the station's acknowledgements, once one has come.
    pub fn round_trip(&self) -> Option<SimTime> {
        self.trip.mean()
    }
    /// The revision of the newest scene that was seen.
    pub fn observed(&self) -> Revision {
        self.observed
    }
    /// Rows whose turn will come.
    pub fn waiting(&self) -> usize {
        self.waiting
    }
    /// Places for rows, in use or free.
    pub fn places(&self) -> usize {
        self.rows.len()
    }
    /// Whether the station has acknowledged the newest value of every row.
    pub fn is_settled(&self) -> bool {
        self.waiting == 0 && self.unfit.is_empty() && self.sent.is_empty()
    }

    /// A delta of revision `delta` takes a row to the station as it is in `scene`; from then on datagrams move it.
    pub fn introduce(&mut self, scene: &Snapshot, id: ComponentId, entity: Entity, delta: Revision) {
        let slot = self.rows.find_or_place(id, entity);
        let is_unfit = self.rows.at(slot).is_unfit && {
            self.value.clear();
            let written = self.quantiser.write(scene, &self.columns, id, entity, &mut self.value);
            written != Ok(true) || self.value.len() > ROW_BYTES_MAX
        };
        let row = self.rows.at_mut(slot);
        row.introduced = delta;
        (row.sequence, row.is_lost, row.hash, row.is_unfit) = (None, false, None, is_unfit);
        if self.columns.codec(id) == RowCodec::Vertices {
            let revision = scene.changed::<VertexPositions>(entity).unwrap_or(Revision::ZERO);
            let vertices = scene.get::<VertexPositions>(entity);
            row.vertices = vertices.and_then(|vertices| VertexChunks::new(&vertices.positions, revision));
            row.is_unfit = row.vertices.is_none();
        }
        if self.scanned.get(usize::from(id.0)).is_some_and(|scanned| *scanned > delta) {
            self.enqueue(slot);
        }
    }

    /// A row is gone, or is no longer sent to the station.
    pub fn forget(&mut self, id: ComponentId, entity: Entity) {
        self.waiting -= usize::from(self.rows.forget(id, entity));
    }

    /// No row of a component is sent to the station any more.
    pub fn forget_column(&mut self, id: ComponentId) {
        let rows: Vec<Entity> = self.rows.iter().filter(|row| row.id == id).map(|row| row.entity).collect();
        rows.into_iter().for_each(|entity| self.forget(id, entity));
    }

    /// An entity is gone with all its rows.
    pub fn forget_entity(&mut self, entity: Entity) {
        let columns = self.columns.clone();
        columns.unreliable().for_each(|id| self.forget(id, entity));
    }

    /// Forgets the rows that deltas after `revision` brought, which never arrived. The next delta brings them again.
    pub fn forget_after(&mut self, revision: Revision) {
        let late = self.rows.iter().filter(|row| row.introduced > revision);
        let late: Vec<_> = late.map(|row| (row.id, row.entity)).collect();
        late.iter().for_each(|(id, entity)| self.forget(*id, *entity));
        self.confirmed = self.confirmed.min(revision);
    }

    /// Whether a row must go reliably, since datagrams cannot carry it.
    pub fn goes_reliably(&self, scene: &Snapshot, id: ComponentId, entity: Entity) -> bool {
        let Some(slot) = self.rows.find(id, entity) else { return true };
        let row = self.rows.at(slot);
        let had = row.vertices.as_ref().map(VertexChunks::len);
        let has =
            had.and_then(|_| scene.get::<VertexPositions>(entity)).map(|vertices| vertices.positions.len());
        row.is_unfit || had != has
    }

    /// Rows that turned out not to fit into datagrams since the last call; they must go reliably.
    pub fn take_unfit(&mut self) -> Vec<(ComponentId, Entity)> {
        std::mem::take(&mut self.unfit)
    }

    /// The station has applied all deltas up to this revision.
    pub fn confirm(&mut self, revision: Revision) {
        self.confirmed = self.confirmed.max(revision);
    }

    fn enqueue(&mut self, slot: u32) {
        let row = self.rows.at_mut(slot);
        if row.is_queued || row.is_unfit {
            return;
        }
        row.is_queued = true;
        self.waiting += 1;
        let period = self.columns.period(row.id).unwrap_or_default();
        let due = row.sent_at.map_or(SimTime::ZERO, |sent_at| sent_at + period);
        let entry = Reverse((due, slot, row.generation));
        if row.introduced <= self.confirmed { self.known.push(entry) } else { self.fresh.push(entry) }
    }

    /// Queues the rows that have changed since the last call.
    pub fn observe(&mut self, scene: &Snapshot) {
        if scene.revision() <= self.observed {
            return;
        }
        self.observed = scene.revision();
        let columns = self.columns.clone();
        for id in columns.unreliable() {
            let column = scene.erased_column(id);
            let since = self.scanned[usize::from(id.0)];
            self.scanned[usize::from(id.0)] = scene.revision();
            if column.latest() <= since {
                continue;
            }
            column.for_each_changed(since, &mut |entity| {
                let Some(slot) = self.rows.find(id, entity) else { return };
                // The delta that brought the row brought this value as well.
                if column.revision(entity) > Some(self.rows.at(slot).introduced) {
                    self.enqueue(slot);
                }
            });
        }
    }

    /// The next datagram's payload, with the newest values of `scene`; false when nothing is to be sent now. Call it until
    /// then.
    pub fn datagram(&mut self, now: SimTime, scene: &Snapshot, out: &mut Vec<u8>) -> bool {
        self.give_up(now);
        self.observe(scene);
        out.clear();
        if self.sent.is_full() || !self.budget.may_send(now) {
            return false;
        }
        let (mut parts, mut body) = (self.sent.spare(), std::mem::take(&mut self.body));
        body.clear();
        for is_fresh in [false, true] {
            if parts.is_empty() {
                self.fill(is_fresh, now, scene, &mut parts, &mut body);
            }
        }
        if parts.is_empty() {
            self.sent.give_back(parts);
            self.body = body;
            return false;
        }
        let needed = parts.iter().map(|part| self.rows.at(part.slot).introduced).max().unwrap_or_default();
        varint::write(self.sent.next_sequence(), out);
        varint::write(scene.revision().0, out);
        varint::write(scene.revision().0.saturating_sub(needed.0), out);
        out.extend_from_slice(&body);
        self.body = body;
        self.counts.datagrams += 1;
        self.counts.bytes += out.len() as u64;
        self.counts.rows += parts.len() as u64;
        self.budget.sent(now, out.len());
        self.sent.push(now, parts);
        true
    }

    fn fill(
        &mut self,
        is_fresh: bool,
        now: SimTime,
        scene: &Snapshot,
        parts: &mut Vec<Part>,
        out: &mut Vec<u8>,
    ) {
        let mut queue = std::mem::take(if is_fresh { &mut self.fresh } else { &mut self.known });
        let mut before = 0;
        while let Some(Reverse((due, slot, generation))) = queue.peek().copied() {
            if due > now {
                break;
            }
            let row = self.rows.at_mut(slot);
            if row.generation != generation {
                queue.pop();
                continue;
            }
            if is_fresh != (row.introduced > self.confirmed) {
                queue.pop();
                let other = if is_fresh { &mut self.known } else { &mut self.fresh };
                other.push(Reverse((due, slot, generation)));
                continue;
            }
            if !self.put(slot, now, scene, &mut before, parts, out) {
                // It keeps its place, which is the first one.
                break;
            }
            queue.pop();
            self.rows.at_mut(slot).is_queued = false;
            self.waiting -= 1;
        }
        let place = if is_fresh { &mut self.fresh } else { &mut self.known };
        *place = queue;
    }

    /// Appends a row; false when the datagram has no room for all of it.
    fn put(
        &mut self,
        slot: u32,
        now: SimTime,
        scene: &Snapshot,
        before: &mut u64,
        parts: &mut Vec<Part>,
        out: &mut Vec<u8>,
    ) -> bool {
        let (sequence, row) = (self.sent.next_sequence(), self.rows.at_mut(slot));
        let (id, entity, generation) = (row.id, row.entity, row.generation);
        let Some(revision) = scene.erased_column(id).revision(entity) else { return true };
        let head = |revision: Revision, value: &[u8], before: &mut u64, out: &mut Vec<u8>| {
            varint::write(u64::from(id.0), out);
            write_entity(entity, before, out);
            varint::write(scene.revision().0.saturating_sub(revision.0), out);
            varint::write(value.len() as u64, out);
            out.extend_from_slice(value);
        };
        let Some(vertices) = &mut row.vertices else {
            self.value.clear();
            let written = self.quantiser.write(scene, &self.columns, id, entity, &mut self.value);
            if written != Ok(true) || self.value.len() > ROW_BYTES_MAX {
                row.is_unfit = true;
                self.unfit.push((id, entity));
                return true;
            }
            let hash = hash(&self.value);
            if row.hash == Some(hash) && !row.is_lost {
                self.counts.unchanged += 1;
                return true;
            }
            if out.len() + ROW_HEAD_MAX + self.value.len() > BODY_MAX {
                return false;
            }
            head(revision, &self.value, before, out);
            parts.push(Part { slot, generation, chunk: 0, revision });
            (row.hash, row.sequence, row.is_lost) = (Some(hash), Some(sequence), false);
            row.sent_at = Some(now);
            return true;
        };
        let positions = scene.get::<VertexPositions>(entity);
        if !positions.is_some_and(|positions| vertices.scan(&positions.positions, revision)) {
            row.is_unfit = true;
            self.unfit.push((id, entity));
            return true;
        }
        let mut is_any = false;
        while let Some(chunk) = vertices.next() {
            self.value.clear();
            vertices.write(chunk, &mut self.value);
            if out.len() + ROW_HEAD_MAX + self.value.len() > BODY_MAX {
                return false;
            }
            let revision = vertices.sent(chunk, sequence);
            head(revision, &self.value, before, out);
            parts.push(Part { slot, generation, chunk: chunk as u32, revision });
            row.sent_at = Some(now);
            is_any = true;
        }
        self.counts.unchanged += u64::from(!is_any && row.sent_at != Some(now));
        true
    }

    /// Takes the acknowledgement of a station, which also says up to which revision it has applied deltas.
    ///
    /// # Errors
    /// When it is malformed, or acknowledges what was never sent.
    pub fn acknowledge(&mut self, now: SimTime, bytes: &[u8]) -> Result<Revision, ReplicationError> {
        let (window, applied) = RowWindow::read(bytes)?;
        let Some(newest) = window.newest() else { return Ok(applied) };
        if newest >= self.sent.next_sequence() {
            return Err(ReplicationError::Number {
                what: "an acknowledgement",
                at: 0,
                found: newest,
                valid: "the number of a datagram that was sent",
            });
        }
        let mut from = 0;
        while let Some((sequence, sent_at, parts)) = self.sent.take_acknowledged(from, &window) {
            from = sequence + 1;
            if sequence == newest {
                self.trip.acknowledged(now.since(sent_at));
            }
            self.budget.answered();
            self.counts.acknowledged += 1;
            for part in &parts {
                if let Some(row) = self.rows.of(part)
                    && let Some(vertices) = &mut row.vertices
                {
                    vertices.acknowledged(part.chunk as usize, part.revision);
                }
            }
            self.sent.give_back(parts);
        }
        self.sent.drop_done();
        Ok(applied)
    }

    /// Gives up datagrams that were not acknowledged in time, and queues what they carried.
    fn give_up(&mut self, now: SimTime) {
        while self.sent.oldest().is_some_and(|sent_at| sent_at + self.trip.lost_after() <= now) {
            let Some((sequence, sent_at, parts)) = self.sent.take_sent_until(now) else { break };
            // Nothing has come back since it was sent: the link may have become slower than it was.
            if self.budget.is_unanswered_since(sent_at) && self.doubled_at <= sent_at {
                self.trip.nothing_came();
                self.doubled_at = now;
            }
            self.lose(sequence, parts);
        }
    }

    /// The channel broke: nothing on its way counts.
    pub fn lose_all(&mut self) {
        while let Some((sequence, _, parts)) = self.sent.take_sent_until(SimTime(u64::MAX)) {
            self.lose(sequence, parts);
        }
        self.budget.answered();
    }

    fn lose(&mut self, sequence: u64, parts: Vec<Part>) {
        self.counts.lost += 1;
        for part in &parts {
            let Some(row) = self.rows.of(part) else { continue };
            let is_lost = match &mut row.vertices {
                Some(vertices) => vertices.lost(part.chunk as usize, sequence),
                None => {
                    row.is_lost |= row.sequence == Some(sequence);
                    row.sequence == Some(sequence)
                }
            };
            if is_lost {
                self.enqueue(part.slot);
            }
        }
        self.sent.give_back(parts);
    }

    /// When [`Self::datagram`] should be asked again, if not because the scene changes: a row's turn or a loss.
    pub fn next_due(&self) -> Option<SimTime> {
        let turn = [&self.known, &self.fresh].into_iter().filter_map(|queue| queue.peek());
        let turn = turn.map(|Reverse((due, ..))| (*due).max(self.budget.free_at())).min();
        let lost = self.sent.oldest().map(|sent_at| sent_at + self.trip.lost_after());
        turn.into_iter().chain(lost).min()
    }
}

/// 64 bits of BLAKE3.
fn hash(bytes: &[u8]) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&blake3::hash(bytes).as_bytes()[..8]);
    u64::from_le_bytes(word)
}
