//! Core of the Model without its actor: admits batches, applies them and publishes snapshots.
//!
//! Sans-IO: no clock, no thread, no channel. The live Model and lock-step drive the same core, so that the
//! same batches in the same order give the same revisions and the same hash.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::{
    Access, AccessOverlap, Batch, Commands, ComponentError, ComponentId, Entity, Provenance, RecordPolicy,
    Registry, Revision, SectionMap, SimTime, Snapshot, Store, WriterId, WriterRules, varint,
};

use crate::admission::TRANSFERS_MAX;
pub use crate::admission::{DeclareError, Outcome, Rejection, WriterCounts};
use crate::commit::{Commit, CommitBuffer};
use crate::operator::{OPERATOR, OPERATOR_EPOCH, OPERATOR_NAME, OPERATOR_WRITES_MAX};
use crate::publish::{PublishClock, PublishRule};
use crate::state_hash::{Chain, CommitKind, StateHash};

struct Writer {
    name: Arc<str>,
    id: WriterId,
    access: Access,
    rules: WriterRules,
    epoch: u32,
    counts: WriterCounts,
    /// Batches applied and not published.
    unpublished: u64,
    last_rejection: Option<Rejection>,
}

pub(crate) type Transfers = BTreeMap<(ComponentId, Entity), WriterId>;

/// The published state, which the Model also rolls back to.
#[derive(Clone)]
struct Committed {
    snapshot: Arc<Snapshot>,
    chain: Chain,
    transfers: Arc<Transfers>,
    commits: usize,
}

/// An unpublished fence. It must survive a roll-back, or the dead writer's contributions would reappear.
struct UnseenFence {
    writer: WriterId,
    epoch: u32,
    now: SimTime,
    rules: WriterRules,
}

/// The Model's state machine.
pub struct ModelCore {
    station: u16,
    store: Store,
    chain: Chain,
    /// Sorted by id.
    writers: Vec<Writer>,
    transfers: Arc<Transfers>,
    clock: PublishClock,
    commits: CommitBuffer,
    keep_commits: bool,
    scratch: Vec<u8>,
    /// Where the sections of `scratch` lie.
    sections: SectionMap,
    committed: Committed,
    unseen_fences: Vec<UnseenFence>,
    /// Whether a batch is being moved into the scene; still set after a panic during the move.
    half_applied: bool,
}

impl ModelCore {
    /// A core that owns a scene; `station` is this station's number, part of every writer's entity.
    ///
    /// # Errors
    /// When the scene cannot be encoded.
    pub fn new(store: Store, station: u16) -> Result<Self, ComponentError> {
        let chain = Chain::begin(store.view())?;
        Ok(Self::going_on(store, station, chain, Arc::default()))
    }

    /// A core that continues from another core's scene, with its hash chain and transferred rows.
    pub(crate) fn resume(store: Store, station: u16, head: StateHash, transfers: Arc<Transfers>) -> Self {
        Self::going_on(store, station, Chain::resume(head), transfers)
    }

    fn going_on(store: Store, station: u16, chain: Chain, transfers: Arc<Transfers>) -> Self {
        let committed = Committed {
            snapshot: Arc::new(store.snapshot()),
            chain,
            transfers: transfers.clone(),
            commits: 0,
        };
        let operator = Writer {
            name: OPERATOR_NAME.into(),
            id: OPERATOR,
            access: Access::new(),
            rules: WriterRules::unrestricted(Entity::of_writer(station, OPERATOR.0)),
            epoch: OPERATOR_EPOCH,
            counts: WriterCounts::default(),
            unpublished: 0,
            last_rejection: None,
        };
        Self {
            station,
            store,
            chain,
            writers: vec![operator],
            transfers,
            clock: PublishClock::new(PublishRule::default()),
            commits: CommitBuffer::new(),
            keep_commits: false,
            scratch: Vec::new(),
            sections: SectionMap::default(),
            committed,
            unseen_fences: Vec::new(),
            half_applied: false,
        }
    }

    /// The same with other limits between publications.
    #[must_use]
    pub fn with_publish_rule(mut self, rule: PublishRule) -> Self {
        self.clock = PublishClock::new(rule);
        self
    }

    /// Continues a hash chain instead of starting one from the scene, for a replay from a keyframe.
    #[must_use]
    pub fn with_chain(mut self, head: StateHash) -> Self {
        self.continue_chain(head);
        self
    }
    /// Continues another hash chain, for a replay behind a part of a recording that cannot be read.
    pub(crate) fn continue_chain(&mut self, head: StateHash) {
        self.chain = Chain::resume(head);
        self.committed.chain = self.chain;
    }

    /// Whether commits are kept for [`Self::swap_commits`]; off, commits do not pile up unread.
    pub fn keep_commits(&mut self, keep: bool) {
        self.keep_commits = keep;
    }

    /// Declares a writer, or a new life of one: its write access must not overlap with that of others. Transferred rows
    /// keep their owner. Returns its epoch, which is 1 in its first life.
    ///
    /// A writer must be fenced before it declares other access than in its previous life: a later fence removes only
    /// its current contributions.
    ///
    /// # Errors
    /// [`DeclareError`]; writers declared before are not affected.
    pub fn declare(&mut self, name: &str, id: WriterId, access: &Access) -> Result<u32, DeclareError> {
        if name == OPERATOR_NAME || id == OPERATOR {
            return Err(DeclareError::Reserved { name: name.to_owned(), id: id.0 });
        }
        for other in &self.writers {
            if *other.name == *name && other.id != id {
                return Err(DeclareError::NameTaken(name.to_owned()));
            }
            if *other.name != *name && other.id == id {
                let (name, other) = (name.to_owned(), other.name.to_string());
                return Err(DeclareError::IdTaken { name, other, id: id.0 });
            }
        }
        let known = self.writers.binary_search_by_key(&id, |writer| writer.id);
        if let Ok(at) = known
            && self.writers[at].access == *access
        {
            return Ok(self.writers[at].epoch);
        }
        let me = Entity::of_writer(self.station, id.0);
        let mut rules = WriterRules::compile(access, self.store.view().registry(), me)
            .map_err(|error| DeclareError::Component { name: name.to_owned(), error })?;
        for other in self.writers.iter().filter(|other| other.id != id) {
            if let Some((component, entities)) = rules.overlap(&other.rules) {
                let component = self.store.view().registry().entry(component).name;
                let (first, second) = (name.to_owned(), other.name.to_string());
                return Err(AccessOverlap { first, second, component, entities }.into());
            }
        }
        restore_transfers(&self.transfers, id, &mut rules);
        let epoch = match known {
            Ok(at) => {
                self.writers[at].access = access.clone();
                self.writers[at].rules = rules;
                self.writers[at].epoch
            }
            Err(at) => {
                let writer = Writer {
                    name: name.into(),
                    id,
                    access: access.clone(),
                    rules,
                    epoch: 1,
                    counts: WriterCounts::default(),
                    unpublished: 0,
                    last_rejection: None,
                };
                self.writers.insert(at, writer);
                if let Some(operator) = self.position(OPERATOR) {
                    self.writers[operator].rules.acquaint(me);
                }
                1
            }
        };
        self.reserve_rows();
        Ok(epoch)
    }

    /// Keeps a replica's writer away from the rows that other writers of this station claim.
    fn reserve_rows(&mut self) {
        for at in 0..self.writers.len() {
            let (before, rest) = self.writers.split_at_mut(at);
            let Some((writer, after)) = rest.split_first_mut() else { continue };
            if writer.rules.replicates() {
                writer.rules.clear_reserved();
                let others = before.iter().chain(&*after).filter(|other| !other.rules.is_unrestricted());
                others.for_each(|other| writer.rules.reserve(&other.rules));
            }
        }
    }

    /// Applies a sealed batch atomically. `now` affects only when to publish: the scene and the hash take the batch's
    /// own time.
    ///
    /// A batch that panics in here (a component's own code) leaves the core unusable until
    /// [`Self::recover`] is called.
    pub fn apply(&mut self, batch: &mut Batch, now: SimTime) -> Outcome {
        let Provenance { writer: id, epoch, tick, time, .. } = batch.provenance;
        let Ok(at) = self.writers.binary_search_by_key(&id, |writer| writer.id) else {
            return Outcome::Rejected(Rejection::UnknownWriter(id.0));
        };
        if let Err(rejection) = self.admit(at, epoch, batch) {
            let writer = &mut self.writers[at];
            return match rejection {
                Rejection::Refused(refusal) if refusal.is_conflict() => {
                    writer.counts.conflicts += 1;
                    Outcome::Conflict(refusal)
                }
                rejection => {
                    writer.counts.rejected += 1;
                    writer.last_rejection = Some(rejection.clone());
                    Outcome::Rejected(rejection)
                }
            };
        }
        self.half_applied = true;
        self.move_ownership(batch);
        let revision = self.store.apply(&mut batch.commands, time);
        self.half_applied = false;
        let writer = &mut self.writers[at];
        writer.counts.applied += 1;
        writer.unpublished += 1;
        self.chain.append(CommitKind::Batch, &writer.name, tick, time, &self.scratch);
        if self.keep_commits {
            let head = self.chain.head();
            let commit = Commit {
                kind: CommitKind::Batch,
                revision,
                writer: &writer.name,
                provenance: batch.provenance,
                hash: head,
                payload: &self.scratch,
            };
            self.commits.push(&commit, &writer.name, &self.sections);
        }
        self.clock.applied(now);
        Outcome::Applied { revision }
    }

    /// Runs all checks on a batch; leaves its encoding in `scratch`.
    fn admit(&mut self, at: usize, epoch: u32, batch: &Batch) -> Result<(), Rejection> {
        let writer = &self.writers[at];
        if epoch != writer.epoch {
            return Err(Rejection::StaleEpoch { found: epoch, current: writer.epoch });
        }
        if writer.rules.is_unrestricted() && batch.commands.len() > OPERATOR_WRITES_MAX {
            return Err(Rejection::TooManyWrites(batch.commands.len()));
        }
        self.store.validate(&batch.commands, &writer.rules).map_err(Rejection::Refused)?;
        for transfer in batch.commands.transfers() {
            if self.position(transfer.to).is_none() {
                return Err(Rejection::UnknownHeir(transfer.to.0));
            }
            let entity = transfer.entity;
            if entity == Entity::of_writer(entity.station(), entity.spawner()) {
                let component = self.store.view().registry().entry(transfer.component).name;
                return Err(Rejection::OwnEntity { component, entity });
            }
        }
        if self.transfers.len() + batch.commands.transfers().len() > TRANSFERS_MAX {
            return Err(Rejection::TooManyTransfers);
        }
        self.scratch.clear();
        batch.commands.encode_mapped(&mut self.scratch, &mut self.sections).map_err(Rejection::Unencodable)
    }

    fn move_ownership(&mut self, batch: &Batch) {
        for transfer in batch.commands.transfers() {
            let row = (transfer.component, transfer.entity);
            // Removed from all other writers, not only the sender: if a batch transfers one row twice, the later
            // recipient owns it.
            for writer in &mut self.writers {
                if writer.id == transfer.to {
                    writer.rules.grant(row.0, row.1);
                } else {
                    writer.rules.revoke(row.0, row.1);
                }
            }
            Arc::make_mut(&mut self.transfers).insert(row, transfer.to);
        }
        // Entities are never reused, so rights to a removed one can be dropped.
        if !self.transfers.is_empty() && !batch.commands.despawns().is_empty() {
            Arc::make_mut(&mut self.transfers)
                .retain(|(_, entity), _| !batch.commands.despawns().contains(entity));
            for writer in &mut self.writers {
                batch.commands.despawns().iter().for_each(|entity| writer.rules.forget(*entity));
            }
        }
    }

    /// Fences the lives of a writer before `epoch`: their batches are refused and their contributions leave the scene.
    /// Returns `false`, without effect, when the writer is unknown or already in that epoch.
    ///
    /// The fence of a writer that declared nothing is no commit, so that the hash chain does not depend on read-only
    /// participants (a recorder).
    pub fn fence(&mut self, id: WriterId, epoch: u32, now: SimTime) -> bool {
        let Some(at) = self.position(id).filter(|at| self.writers[*at].epoch < epoch) else { return false };
        let writer = &mut self.writers[at];
        writer.epoch = epoch;
        let Access { reads: _, writes, contributes, spawns, replicates, repairs: _ } = &writer.access;
        if writes.is_empty() && contributes.is_empty() && !spawns && !replicates {
            return true;
        }
        let fence = UnseenFence { writer: id, epoch, now, rules: writer.rules.clone() };
        self.end_lives(&fence);
        self.unseen_fences.push(fence);
        true
    }

    /// Removes a fenced writer's contributions from the scene, as a commit.
    fn end_lives(&mut self, fence: &UnseenFence) {
        let UnseenFence { writer, epoch, now, ref rules } = *fence;
        let Some(at) = self.position(writer) else { return };
        let writer = &self.writers[at];
        let revision = self.store.remove_contributions(rules);
        // The epoch takes the place of a batch's tick.
        let provenance =
            Provenance { writer: writer.id, epoch, tick: u64::from(epoch), time: now, based_on: revision };
        self.scratch.clear();
        encode_fence(self.store.view().registry(), rules, &mut self.scratch, &mut self.sections);
        self.chain.append(CommitKind::Fence, &writer.name, provenance.tick, now, &self.scratch);
        if self.keep_commits {
            let head = self.chain.head();
            let commit = Commit {
                kind: CommitKind::Fence,
                revision,
                writer: &writer.name,
                provenance,
                hash: head,
                payload: &self.scratch,
            };
            self.commits.push(&commit, &writer.name, &self.sections);
        }
        self.clock.applied(now);
    }

    /// Applies a recorded commit again, without access checks, which passed when it was recorded. The resulting hash is
    /// computed from the commands as encoded now. `revision` is that of the recorded commit; a recording leaves some out.
    ///
    /// # Errors
    /// When the commands cannot be encoded, or the scene has no room for their rows; nothing is applied then.
    pub fn replay(
        &mut self,
        kind: CommitKind,
        revision: Revision,
        writer: &str,
        provenance: Provenance,
        commands: &mut Commands,
    ) -> Result<Revision, ComponentError> {
        self.store.check_room(commands)?;
        self.scratch.clear();
        commands.encode(&mut self.scratch)?;
        self.chain.append(kind, writer, provenance.tick, provenance.time, &self.scratch);
        // A fence does not advance the scene's time.
        let time = if kind == CommitKind::Fence { SimTime::ZERO } else { provenance.time };
        self.clock.applied(provenance.time);
        Ok(self.store.apply_as(commands, time, revision))
    }

    /// Whether it is time to [`Self::publish`]; `drained` says that no batch waits.
    pub fn is_publish_due(&self, now: SimTime, drained: bool) -> bool {
        self.clock.is_due(now, drained)
    }

    /// Commits everything applied so far and returns the snapshot for readers.
    pub fn publish(&mut self) -> Arc<Snapshot> {
        let snapshot = Arc::new(self.store.snapshot());
        self.committed = Committed {
            snapshot: snapshot.clone(),
            chain: self.chain,
            transfers: self.transfers.clone(),
            commits: self.commits.len(),
        };
        self.unseen_fences.clear();
        self.writers.iter_mut().for_each(|writer| writer.unpublished = 0);
        self.clock.published();
        snapshot
    }

    /// After a panic in [`Self::apply`]: counts it against `culprit`, and if its batch was being moved into the scene,
    /// rolls back to the last published state. Batches applied since then are lost; returns whether it rolled back.
    pub fn recover(&mut self, culprit: Option<WriterId>) -> bool {
        if let Some(at) = culprit.and_then(|id| self.position(id)) {
            self.writers[at].counts.quarantined += 1;
        }
        if self.half_applied {
            self.fall_back();
        }
        std::mem::take(&mut self.half_applied)
    }

    /// Rolls back to the last publication, but keeps fences.
    fn fall_back(&mut self) {
        let committed = self.committed.clone();
        self.store = Store::from_snapshot(&committed.snapshot);
        self.chain = committed.chain;
        self.transfers = committed.transfers;
        self.commits.truncate(committed.commits);
        self.clock.published();
        for at in 0..self.writers.len() {
            let writer = &mut self.writers[at];
            writer.counts.undone += std::mem::take(&mut writer.unpublished);
            if writer.rules.is_unrestricted() {
                continue;
            }
            // It compiled before, so it compiles again.
            if let Ok(mut rules) =
                WriterRules::compile(&writer.access, self.store.view().registry(), writer.rules.me())
            {
                restore_transfers(&self.transfers, writer.id, &mut rules);
                writer.rules = rules;
            }
        }
        self.reserve_rows();
        let fences = std::mem::take(&mut self.unseen_fences);
        fences.iter().for_each(|fence| self.end_lives(fence));
        self.unseen_fences = fences;
    }

    /// Takes the commits since the last call, published or not, and leaves `empty` for the next ones.
    /// Call it right after [`Self::publish`]: publish is commit.
    pub fn swap_commits(&mut self, empty: CommitBuffer) -> CommitBuffer {
        self.committed.commits = 0;
        std::mem::replace(&mut self.commits, empty)
    }

    /// The scene with everything applied so far, published or not, without sharing it.
    pub fn view(&self) -> &Snapshot {
        self.store.view()
    }
    /// The last published snapshot.
    pub fn published(&self) -> &Arc<Snapshot> {
        &self.committed.snapshot
    }
    /// The state hash over everything applied so far.
    pub fn hash(&self) -> StateHash {
        self.chain.head()
    }
    /// This station's number.
    pub fn station(&self) -> u16 {
        self.station
    }
    /// The transferred rows and their new owners.
    pub(crate) fn transfers(&self) -> &Arc<Transfers> {
        &self.transfers
    }
    /// The epoch in which a writer's batches are accepted.
    pub fn epoch(&self, id: WriterId) -> Option<u32> {
        self.position(id).map(|at| self.writers[at].epoch)
    }
    /// Outcome counts of a writer.
    pub fn counts(&self, id: WriterId) -> Option<WriterCounts> {
        self.position(id).map(|at| self.writers[at].counts)
    }
    /// Why a writer's batch was rejected last.
    pub fn last_rejection(&self, id: WriterId) -> Option<&Rejection> {
        self.writers[self.position(id)?].last_rejection.as_ref()
    }
    /// A writer's name.
    pub fn name(&self, id: WriterId) -> Option<&Arc<str>> {
        self.position(id).map(|at| &self.writers[at].name)
    }
    /// What every writer declared, ordered by id. The operator declares nothing.
    pub fn writers(&self) -> impl Iterator<Item = (WriterId, &str, &Access)> {
        let declared = self.writers.iter().filter(|writer| !writer.rules.is_unrestricted());
        declared.map(|writer| (writer.id, &*writer.name, &writer.access))
    }

    fn position(&self, id: WriterId) -> Option<usize> {
        self.writers.binary_search_by_key(&id, |writer| writer.id).ok()
    }
}

/// Applies the transfers to a writer's new rules: adds rows transferred to it and removes rows transferred away.
fn restore_transfers(transfers: &Transfers, id: WriterId, rules: &mut WriterRules) {
    for ((component, entity), heir) in transfers {
        if *heir == id {
            rules.grant(*component, *entity);
        } else {
            rules.revoke(*component, *entity);
        }
    }
}

/// Encodes a fence as commands, in the format of [`Commands::encode`]: the removal of the writer's contributions. A
/// replay then needs no knowledge of the writer.
fn encode_fence(registry: &Registry, rules: &WriterRules, out: &mut Vec<u8>, map: &mut SectionMap) {
    let kept = || {
        let keys = rules.contributes().iter().map(|id| registry.entry(*id));
        keys.filter(|entry| entry.record != RecordPolicy::Derived)
    };
    let mut put = |value: u64| varint::write(value, out);
    // Spawns, despawns.
    put(0);
    put(0);
    put(kept().count() as u64);
    for entry in kept() {
        put(u64::from(entry.key));
        put(rules.me().to_bits());
    }
    // No puts, transfers or events.
    map.spawns = false;
    map.puts.clear();
    map.puts_at = out.len() as u32;
    out.push(0);
    map.puts_end = out.len() as u32;
    out.extend([0, 0]);
}
