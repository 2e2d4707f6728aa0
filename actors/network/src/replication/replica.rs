//! A station's end of a replicated scene: takes what the host sends, and writes it into the station's own scene.

use std::sync::Arc;

use trocar_scene::{
    Commands, ComponentError, ComponentId, Entity, EntityAllocator, Revision, Snapshot, VertexPositions,
};

use super::ReplicationError;
use super::acknowledgement::RowWindow;
use super::choice::ReplicatedColumns;
use super::delta::ExcludedRows;
use super::delta_reader::{DeltaReader, DeltaSummary};
use super::known_rows::{KnownRow, KnownRows, KnownVertices};
use super::pieces::Pieces;
use super::quantised_row::RowQuantiser;
use super::row_receiver::{self, RowReceiver};
use super::state_digest::StateDigest;

/// What a replica has taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplicaCounts {
    /// Deltas applied.
    pub deltas: u64,
    /// Datagrams received.
    pub datagrams: u64,
    /// Datagrams that came again.
    pub duplicates: u64,
    /// Rows and chunks that were newer than what was at hand.
    pub applied: u64,
    /// Rows and chunks that were not.
    pub older: u64,
    /// Datagrams that came before the delta that they build on.
    pub early: u64,
    /// Rows that are not at hand.
    pub unknown: u64,
    /// Events that the host no longer had when a delta could be sent again.
    pub events_lost: u64,
    /// Datagrams and deltas that could not be read to their end.
    pub malformed: u64,
}

/// The receiving end of one host's scene.
pub struct Replica {
    columns: Arc<ReplicatedColumns>,
    known: KnownRows,
    excluded: ExcludedRows,
    applied: Revision,
    /// Whether datagrams wait for a delta that states anew what there is.
    is_comparing: bool,
    next_event: u64,
    pieces: Pieces,
    window: RowWindow,
    quantiser: RowQuantiser,
    scratch: Commands,
    counts: ReplicaCounts,
}

impl Replica {
    /// A replica of which nothing has come yet.
    pub fn new(columns: Arc<ReplicatedColumns>) -> Self {
        let registry = columns.registry().clone();
        Self {
            known: KnownRows::new(registry.len()),
            excluded: ExcludedRows::default(),
            applied: Revision::ZERO,
            is_comparing: false,
            next_event: 0,
            pieces: Pieces::default(),
            window: RowWindow::default(),
            quantiser: RowQuantiser::new(&registry),
            scratch: Commands::new(registry, EntityAllocator::new(0, 0)),
            counts: ReplicaCounts::default(),
            columns,
        }
    }

    /// A replica that finds its host's entities in the station's scene, after the controller that held it has died. Their
    /// revisions are unknown, so it takes no datagrams before it has been reconciled: [`Self::compare`].
    pub fn adopt(
        columns: Arc<ReplicatedColumns>,
        scene: &Snapshot,
        of_host: impl Fn(Entity) -> bool,
    ) -> Self {
        let mut replica = Self { is_comparing: true, ..Self::new(columns) };
        scene.entities().filter(|entity| of_host(*entity)).for_each(|entity| {
            replica.known.spawn(entity);
        });
        for id in replica.columns.replicated() {
            scene.erased_column(id).for_each_entity(&mut |entity| {
                if of_host(entity)
                    && let Some(row) = replica.known.row_or_new(id, entity)
                {
                    *row = KnownRow::default();
                }
            });
        }
        if let Some(id) = replica.columns.registry().id::<VertexPositions>() {
            for (entity, row) in replica.known.column_mut(id) {
                let vertices = scene.get::<VertexPositions>(entity);
                row.vertices =
                    vertices.map(|vertices| KnownVertices::new(vertices.positions.clone(), Revision::ZERO));
            }
        }
        replica
    }

    /// The revision up to which deltas have been applied; zero before the first. A station that comes back names it to
    /// its host.
    pub fn applied(&self) -> Revision {
        self.applied
    }
    /// What has been taken so far.
    pub fn counts(&self) -> &ReplicaCounts {
        &self.counts
    }
    /// Entities and rows at hand.
    pub fn known(&self) -> &KnownRows {
        &self.known
    }
    /// How many entities, and rows of each column, are at hand.
    pub fn row_counts(&self) -> (usize, Vec<(ComponentId, usize)>) {
        let columns = self.columns.replicated().map(|id| (id, self.known.column(id).count()));
        (self.known.entities().len(), columns.collect())
    }

    /// How much of a delta has come, and its length \[bytes\].
    pub fn progress(&self) -> (usize, usize) {
        self.pieces.progress()
    }

    /// The rows that this station writes itself: what the host still sends of them is dropped, and nothing takes them
    /// away.
    pub fn exclude(&mut self, excluded: impl Into<ExcludedRows>) {
        let excluded = excluded.into();
        for (id, entity) in excluded.rows() {
            self.known.remove(*id, *entity);
        }
        excluded.columns().iter().for_each(|id| self.known.remove_column(*id));
        self.excluded = excluded;
    }

    /// The connection is a new one: what was half received is gone, and datagrams are numbered anew.
    pub fn reconnect(&mut self) {
        self.pieces.clear();
        self.window = RowWindow::default();
    }

    /// Takes a piece of a delta from the control channel; returns the whole delta's bytes when it was the last one.
    ///
    /// # Errors
    /// When pieces are missing: the channel has to be opened again.
    pub fn receive_piece(&mut self, piece: &[u8]) -> Result<Option<Vec<u8>>, ReplicationError> {
        let taken = self.pieces.take(piece);
        self.counts.malformed += u64::from(taken.is_err());
        taken
    }

    /// Puts a delta into `commands`, which must be empty and be applied as one batch: of a batch with two deltas, what
    /// the second creates could be taken for what the first removes.
    ///
    /// # Errors
    /// When it is malformed or begins elsewhere; nothing of it has been taken then, and the station has to be
    /// reconciled.
    pub fn apply(&mut self, delta: &[u8], commands: &mut Commands) -> Result<DeltaSummary, ReplicationError> {
        let Self { columns, known, excluded, applied, quantiser, scratch, .. } = self;
        let reader =
            DeltaReader { columns, applied: *applied, excluded, known, quantiser, commands, scratch };
        let read = reader.read(delta);
        match &read {
            Ok(summary) => {
                self.applied = summary.revision;
                self.is_comparing &= summary.is_since;
                if summary.is_since {
                    let lost = summary.first_event.saturating_sub(self.next_event);
                    self.counts.events_lost = self.counts.events_lost.saturating_add(lost);
                }
                self.next_event = summary.first_event.saturating_add(summary.events as u64);
                self.counts.deltas += 1;
                self.counts.older += summary.older as u64;
            }
            Err(_) => self.counts.malformed += 1,
        }
        read
    }

    /// Puts the rows of a datagram's payload into `commands`, but for vertices: [`Self::put_vertices`].
    ///
    /// # Errors
    /// When it is malformed; rows before that place have been taken.
    pub fn receive_rows(&mut self, payload: &[u8], commands: &mut Commands) -> Result<(), ReplicationError> {
        if self.is_comparing {
            self.counts.early += 1;
            return Ok(());
        }
        let Self { columns, known, applied, excluded, quantiser, window, counts, .. } = self;
        let receiver =
            RowReceiver { columns, applied: *applied, excluded, known, quantiser, window, counts, commands };
        receiver.receive(payload)
    }

    /// Puts the bodies whose vertices have moved since the last call, once for all datagrams of a tick.
    pub fn put_vertices(&mut self, commands: &mut Commands) {
        if let Some(id) = self.columns.registry().id::<VertexPositions>() {
            row_receiver::put_vertices(id, &mut self.known, commands);
        }
    }

    /// Appends the acknowledgement of all that has come: 48 bytes, to be sent while datagrams come or deltas have been
    /// applied, about every 20 ms.
    pub fn write_acknowledgement(&self, out: &mut Vec<u8>) {
        self.window.write(self.applied, out);
    }

    /// Digest for [`super::SceneFeed::reconcile`]. Datagrams wait from now on for the host's answer: what it finds equal
    /// must not change under way.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn compare(&mut self, scene: &Snapshot) -> Result<StateDigest, ComponentError> {
        self.is_comparing = true;
        self.digest(scene)
    }

    /// Digest of what this replica holds in the station's scene, to see whether it differs from the host's.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn digest(&mut self, scene: &Snapshot) -> Result<StateDigest, ComponentError> {
        let (columns, known) = (self.columns.clone(), &self.known);
        let entities = |entity| known.contains(entity);
        let rows = |id, entity| known.has(id, entity);
        StateDigest::of(scene, self.applied, &columns, &mut self.quantiser, &entities, &rows)
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Pose, SimTime, varint};

    use super::super::positions::{ChunkHead, write_chunk};
    use super::super::scene_testing::{Pair, Station};
    use super::super::wire_reader::write_entity;
    use super::super::{FeedLimits, RowWindow};
    use super::*;

    fn acknowledged(station: &Station) -> Option<u64> {
        let mut bytes = Vec::new();
        station.replica.write_acknowledgement(&mut bytes);
        RowWindow::read(&bytes).expect("it reads").0.newest()
    }

    #[test]
    fn a_chunk_that_builds_on_a_value_that_never_came_is_dropped() {
        let mut pair = Pair::new(1, FeedLimits::default());
        let organ = pair.host.commands.spawn();
        let body = pair.host.body(3);
        pair.host.commands.put(organ, body.clone());
        let revision = pair.host.apply(SimTime::ZERO);
        pair.settle(SimTime::from_millis(1_000));
        let id = pair.columns.registry().id::<VertexPositions>().expect("it is standard");
        let mut receive = |sequence: u64, over: u64| {
            let (mut payload, mut chunk) = (Vec::new(), Vec::new());
            let head = ChunkHead { vertices: 3, chunk: 0, over, mask: 0b010 };
            write_chunk(&head, &[[0; 3]; 3], &mut chunk);
            for number in [sequence, revision.0 + 10, 10, u64::from(id.0)] {
                varint::write(number, &mut payload);
            }
            write_entity(organ, &mut 0, &mut payload);
            varint::write(0, &mut payload);
            varint::write(chunk.len() as u64, &mut payload);
            payload.extend(chunk);
            pair.station.replica.receive_rows(&payload, &mut pair.station.commands).expect("it reads");
            pair.station.apply(SimTime::ZERO);
            let shown = pair.station.store.view().get::<VertexPositions>(organ).expect("it is there");
            let is_moved = shown.positions[1].coords.norm() == 0.0;
            (is_moved, acknowledged(&pair.station) == Some(sequence), shown.positions[0] == body.positions[0])
        };
        // What changed within nine revisions is too little for who was left ten behind.
        assert_eq!(receive(7, 9), (false, false, true));
        assert_eq!(receive(8, 10), (true, true, true));
    }

    #[test]
    fn after_a_crash_nothing_late_is_taken_before_the_host_has_compared() {
        let mut pair = Pair::new(2, FeedLimits::default());
        let mover = pair.host.commands.spawn();
        pair.host.commands.put(mover, Pose::at(0.0, 0.0, 0.0));
        pair.host.apply(SimTime::ZERO);
        pair.settle(SimTime::from_millis(1_000));
        let mut late = Vec::new();
        for x in [1.0, 2.0] {
            pair.host.commands.put(mover, Pose::at(x, 0.0, 0.0));
            pair.now += SimTime::from_millis(100);
            pair.host.apply(pair.now);
            if late.is_empty() {
                assert!(pair.feed.datagram(pair.now, &pair.host.scene, &mut late));
            }
        }
        pair.settle(SimTime::from_millis(3_000));
        pair.cut();
        let view = pair.station.store.snapshot();
        pair.station.replica = Replica::adopt(pair.columns.clone(), &view, |entity| entity.station() == 1);
        // Under the delta that the new replica is at, which is none, so that nothing else drops it.
        let (head, mut payload) = (late.len(), Vec::new());
        varint::write(0, &mut payload);
        varint::write(2, &mut payload);
        varint::write(2, &mut payload);
        payload.extend_from_slice(&late[3..head]);
        for bytes in [&late, &payload] {
            pair.station.replica.receive_rows(bytes, &mut pair.station.commands).expect("it reads");
            pair.station.apply(pair.now);
            let shown = pair.station.store.view().get::<Pose>(mover).map(|pose| pose.translation.x);
            assert_eq!((shown, acknowledged(&pair.station)), (Some(2.0), None));
        }
        pair.come_back();
        pair.settle(SimTime::from_millis(3_000));
        pair.assert_equal();
    }
}
