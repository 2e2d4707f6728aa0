//! A host's end of a replicated scene, for one station: deltas for the control channel, datagrams of rows.

use std::collections::VecDeque;
use std::sync::Arc;

use trocar_scene::{ComponentError, ComponentId, Entity, Revision, SimTime, Snapshot};

use super::ReplicationError;
use super::choice::ReplicatedColumns;
use super::delta::{self, DeltaChoice, ExcludedRows, RowSet, Scope, chunk_of};
use super::quantised_row::RowQuantiser;
use super::row_sender::RowSender;
use super::state_digest::StateDigest;

/// Most deltas that a station has not confirmed. Further changes wait, and go in one.
pub const DELTAS_MAX: usize = 8;
/// Most rows that a station writes itself.
pub const EXCLUDED_MAX: usize = 1_024;

/// Limits of a feed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedLimits {
    /// Most bytes of datagrams a second, headers included.
    pub bytes_per_sec: f64,
    /// Least time between two deltas.
    pub delta_period: SimTime,
}

impl Default for FeedLimits {
    /// A megabyte a second, and 20 deltas a second.
    fn default() -> Self {
        Self { bytes_per_sec: 1e6, delta_period: SimTime::from_millis(50) }
    }
}

/// How a station that comes back goes on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Resumed {
    /// The host knows what the station has: the next delta holds what it missed.
    Known,
    /// It does not: the station has to send its digest, for [`SceneFeed::reconcile`].
    Unknown,
}

/// The sending end for one station.
pub struct SceneFeed {
    columns: Arc<ReplicatedColumns>,
    limits: FeedLimits,
    entities: EntityFilter,
    quantiser: RowQuantiser,
    excluded: ExcludedRows,
    forced: RowSet,
    rows: RowSender,
    /// What the station has confirmed, if anything, then what was sent since.
    sent: VecDeque<SentDelta>,
    is_confirmed: bool,
    /// What the next delta covers, if not the changes since the last one.
    next: Option<Start>,
    delta_at: Option<SimTime>,
}

struct SentDelta {
    /// Its name.
    revision: Revision,
    /// A scene that holds the same for the station: not the oldest such one, so that old snapshots are not kept.
    scene: Arc<Snapshot>,
    /// Rows that it put although they had not changed since the one before.
    forced: RowSet,
}

/// Which entities a station is told of.
type EntityFilter = Box<dyn Fn(Entity) -> bool + Send + Sync>;

enum Start {
    Everything,
    Chunks(Vec<u64>),
}

impl SceneFeed {
    /// A feed for a station that has nothing: its first delta holds everything.
    pub fn new(columns: Arc<ReplicatedColumns>, limits: FeedLimits) -> Self {
        Self {
            rows: RowSender::new(columns.clone(), limits.bytes_per_sec),
            quantiser: RowQuantiser::new(columns.registry()),
            columns,
            limits,
            entities: Box::new(|_| true),
            excluded: ExcludedRows::default(),
            forced: RowSet::new(),
            sent: VecDeque::new(),
            is_confirmed: false,
            next: Some(Start::Everything),
            delta_at: None,
        }
    }

    /// Tells of these entities only, for instance of those that the station has not created itself. The answer for an
    /// entity must not change.
    #[must_use]
    pub fn of(mut self, entities: impl Fn(Entity) -> bool + Send + Sync + 'static) -> Self {
        self.entities = Box::new(entities);
        self
    }

    /// Another limit on the bytes of datagrams a second, because the link turned out to carry less or more.
    pub fn limit(&mut self, bytes_per_sec: f64) {
        self.limits.bytes_per_sec = bytes_per_sec;
        self.rows.limit(bytes_per_sec);
    }

    /// The sender of datagrams, for its figures.
    pub fn rows(&self) -> &RowSender {
        &self.rows
    }
    /// The revision of the newest delta.
    pub fn sent_revision(&self) -> Option<Revision> {
        self.sent.back().map(|sent| sent.revision)
    }
    /// Whether the station has confirmed all deltas and acknowledged all rows, up to `scene`.
    pub fn is_settled(&self, scene: &Snapshot) -> bool {
        let is_told = self.sent.back().is_some_and(|sent| sent.scene.revision() >= scene.revision());
        let is_confirmed = self.is_confirmed && self.sent.len() == 1 && is_told;
        let is_seen = scene.revision() <= self.rows.observed();
        is_confirmed && self.next.is_none() && self.forced.is_empty() && is_seen && self.rows.is_settled()
    }

    /// The rows that the station itself writes, such as those of its hands, are never sent to it; at most
    /// [`EXCLUDED_MAX`]. A row that is no longer among them is sent with the next delta. False, and nothing changes, when
    /// there are too many.
    pub fn exclude(&mut self, excluded: impl Into<ExcludedRows>) -> bool {
        let excluded = excluded.into();
        if excluded.rows().len() > EXCLUDED_MAX {
            return false;
        }
        self.forced.extend(self.excluded.rows().difference(excluded.rows()));
        for (id, entity) in excluded.rows().difference(self.excluded.rows()) {
            self.rows.forget(*id, *entity);
        }
        excluded.columns().iter().for_each(|id| self.rows.forget_column(*id));
        self.forced.retain(|(id, entity)| !excluded.contains(*id, *entity));
        self.excluded = excluded;
        true
    }

    /// The next delta, as one message; `Ok(None)` while there is nothing to tell, [`DELTAS_MAX`] are unconfirmed, or the
    /// last one was sent less than the period ago. To be called only when the control channel has room.
    ///
    /// # Errors
    /// When a value cannot be encoded or the scene is too large; the station cannot follow then.
    pub fn delta(&mut self, now: SimTime, scene: &Arc<Snapshot>) -> Result<Option<Vec<u8>>, ComponentError> {
        let is_early = self.delta_at.is_some_and(|at| now.since(at) < self.limits.delta_period);
        if self.sent.len() > DELTAS_MAX || (self.next.is_none() && is_early) {
            return Ok(None);
        }
        self.forced.extend(self.rows.take_unfit());
        self.forced.retain(|(id, entity)| scene.erased_column(*id).revision(*entity).is_some());
        let scope = match (&self.next, self.sent.back()) {
            (Some(Start::Chunks(chunks)), _) => Scope::Chunks(chunks.clone()),
            (None, Some(SentDelta { revision, scene: before, .. })) => {
                if before.revision() >= scene.revision() && self.forced.is_empty() {
                    return Ok(None);
                }
                Scope::Since { revision: *revision, before }
            }
            _ => Scope::Everything,
        };
        let mut out = Vec::new();
        let rows = &self.rows;
        let goes_reliably = |id: ComponentId, entity: Entity| rows.goes_reliably(scene, id, entity);
        let choice = DeltaChoice {
            columns: &self.columns,
            entities: &self.entities,
            excluded: &self.excluded,
            forced: &self.forced,
            goes_reliably: &goes_reliably,
        };
        let written = delta::write(&scope, scene, &choice, &mut self.quantiser, &mut out)?;
        self.delta_at = Some(now);
        let Some(written) = written else {
            if let Some(sent) = self.sent.back_mut() {
                sent.scene = scene.clone();
            }
            return Ok(None);
        };
        let revision = scene.revision();
        written.despawned.iter().for_each(|entity| self.rows.forget_entity(*entity));
        written.removed.iter().for_each(|(id, entity)| self.rows.forget(*id, *entity));
        for (id, entity) in &written.put_unreliable {
            self.rows.introduce(scene, *id, *entity, revision);
        }
        self.next = None;
        let forced = std::mem::take(&mut self.forced);
        self.sent.push_back(SentDelta { revision, scene: scene.clone(), forced });
        Ok(Some(out))
    }

    /// The next datagram's payload; false when there is none now. Call it until then, at least at each new snapshot and
    /// at [`RowSender::next_due`].
    pub fn datagram(&mut self, now: SimTime, scene: &Snapshot, out: &mut Vec<u8>) -> bool {
        self.rows.datagram(now, scene, out)
    }

    /// Takes an acknowledgement of the station.
    ///
    /// # Errors
    /// When it is malformed or acknowledges what was never sent.
    pub fn acknowledge(&mut self, now: SimTime, bytes: &[u8]) -> Result<(), ReplicationError> {
        let applied = self.rows.acknowledge(now, bytes)?;
        if let Some(at) = self.sent.iter().rposition(|sent| sent.revision == applied) {
            self.sent.drain(..at);
            self.is_confirmed = true;
            self.rows.confirm(applied);
        }
        Ok(())
    }

    /// The station has come back after a break, with all deltas up to `applied`.
    pub fn resume(&mut self, applied: Revision) -> Resumed {
        self.rows.lose_all();
        self.delta_at = None;
        let known = self.sent.iter().rposition(|sent| sent.revision == applied);
        match known {
            Some(at) => {
                self.sent.drain(at + 1..).for_each(|mut lost| self.forced.append(&mut lost.forced));
                self.sent.drain(..at);
                self.is_confirmed = true;
                self.rows.forget_after(applied);
                self.forced.retain(|(id, entity)| !self.excluded.contains(*id, *entity));
                self.rows.confirm(applied);
                self.next = None;
                Resumed::Known
            }
            None => {
                self.sent.clear();
                self.is_confirmed = false;
                self.rows.forget_after(Revision::ZERO);
                self.next = Some(Start::Everything);
                Resumed::Unknown
            }
        }
    }

    /// Compares with the digest of a station, and returns a delta with all there is in the chunks that differ from
    /// `scene`, and nothing else. Also between two stations that are connected, as a repair of what differs although both
    /// think that it does not; `Ok(None)` when deltas are on their way, so that the digest is out of date.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn reconcile(
        &mut self,
        now: SimTime,
        digest: &StateDigest,
        scene: &Arc<Snapshot>,
    ) -> Result<Option<Vec<u8>>, ComponentError> {
        if self.sent.back().is_some_and(|sent| sent.revision != digest.revision) {
            return Ok(None);
        }
        let chunks = self.digest(scene)?.differing(digest);
        // What does not differ is what the station has now.
        for id in self.columns.clone().unreliable() {
            let mut same = Vec::new();
            scene.erased_column(id).for_each_entity(&mut |entity| {
                let differs = chunks.binary_search(&chunk_of(entity)).is_ok();
                if !differs && (self.entities)(entity) && !self.excluded.contains(id, entity) {
                    same.push(entity);
                }
            });
            same.into_iter().for_each(|entity| self.rows.introduce(scene, id, entity, scene.revision()));
        }
        self.next = Some(Start::Chunks(chunks));
        self.sent.clear();
        self.is_confirmed = false;
        self.delta(now, scene)
    }

    /// How many entities, and rows of each column, the station should have of `scene`.
    pub fn row_counts(&self, scene: &Snapshot) -> (usize, Vec<(ComponentId, usize)>) {
        let entities = scene.entities().filter(|entity| (self.entities)(*entity)).count();
        let columns = self.columns.replicated().map(|id| {
            let mut rows = 0;
            scene.erased_column(id).for_each_entity(&mut |entity| {
                rows += usize::from((self.entities)(entity) && !self.excluded.contains(id, entity));
            });
            (id, rows)
        });
        (entities, columns.collect())
    }

    /// Digest of what the station should have of `scene`.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn digest(&self, scene: &Snapshot) -> Result<StateDigest, ComponentError> {
        let mut quantiser = RowQuantiser::new(self.columns.registry());
        let rows = |id, entity| (self.entities)(entity) && !self.excluded.contains(id, entity);
        StateDigest::of(scene, scene.revision(), &self.columns, &mut quantiser, &self.entities, &rows)
    }
}
