//! Branching: sessions that continue from the current or an earlier state of another session.
//!
//! The scene holds all that a controller needs to resume, so a branch starts every controller from a snapshot, like a
//! restart. A [`Moment`] adds the rest: due times of ticks, event cursors, allocated entities, transferred rows, active
//! faults, and batches in flight on faulty links. Devices are outside the kernel: the caller provides peers in the same
//! state as those of the other session.

use std::collections::VecDeque;
use std::sync::Arc;

use thiserror::Error;
use trocar_scene::{Batch, Commands, ComponentError, EntityAllocator, Revision, SimTime, Snapshot, Store};

use super::session::{LockstepSession, PUBLISH_EVERY};
use super::slot::{ActiveFaults, Slot};
use crate::faults::{BatchInFlight, FaultLog, FaultSchedule, LinkFaults, second_of};
use crate::model_core::{ModelCore, Transfers};
use crate::operator::OPERATOR;
use crate::spec::{Peer, SessionSpec};
use crate::state_hash::{Chain, StateHash};

use super::operating::OperatorWriter;
use super::session::SessionError;

/// Number of issued snapshots that a session remembers.
const GIVEN_MAX: usize = 256;

/// Why a branch is not possible.
#[derive(Debug, Error)]
pub enum BranchError {
    /// The snapshot is from a program with other components.
    #[error("the snapshot is of a session with other components than this one's")]
    OtherComponents,
    /// The scene cannot be encoded, so nothing can be hashed from there on.
    #[error("the snapshot: {0}")]
    Scene(#[from] ComponentError),
}

/// An issued snapshot: its time and state hash.
#[derive(Clone, Copy)]
pub(super) struct IssuedSnapshot {
    revision: Revision,
    at: SimTime,
    head: StateHash,
}

/// State of a session: its scene, and the state beside it. It costs a few references, whatever the size of the scene.
pub struct Moment {
    scene: Snapshot,
    at: SimTime,
    head: StateHash,
    transfers: Arc<Transfers>,
    slots: Vec<SlotMoment>,
    operator: (EntityAllocator, u64),
    given: Vec<IssuedSnapshot>,
    /// Only for the current state.
    present: Option<PresentState>,
}

struct SlotMoment {
    name: String,
    /// Its event cursor; for a past moment it follows from the time of its last tick.
    cursor: Option<u64>,
    allocator: EntityAllocator,
    active_faults: ActiveFaults,
    /// Batches in flight to the Model, or waiting for one that is down.
    link: LinkFaults<BatchInFlight>,
    queue: VecDeque<Box<Batch>>,
}

/// Epoch of the first life of a controller in a session.
const FIRST_EPOCH: u32 = 1;

/// Copies a batch of its writer's current life as if sent by the writer's first life in a branch. Batches of earlier
/// lives would be refused, and are not copied.
fn for_a_branch(batch: &Batch, epoch: u32, empty: impl FnOnce() -> Commands) -> Option<Box<Batch>> {
    let mut second = (batch.provenance.epoch == epoch).then(|| second_of(batch, empty()))??;
    second.provenance.epoch = FIRST_EPOCH;
    Some(second)
}

/// Number of the first event at `at` or later.
fn first_event_from(scene: &Snapshot, at: SimTime) -> u64 {
    let found = scene.events().since(0).find(|(_, event)| event.at >= at);
    found.map_or(scene.events().next(), |(number, _)| number)
}

struct PresentState {
    until: SimTime,
    next_publish: SimTime,
    next_stop_check: SimTime,
    faults: FaultSchedule,
    fault_log: FaultLog,
    /// Whether the faults of the specification are planned from here on, instead of the session's own.
    faults_anew: bool,
}

impl Moment {
    /// The scene.
    pub fn scene(&self) -> &Snapshot {
        &self.scene
    }
    /// Session time; everything due at that time is still pending.
    pub fn at(&self) -> SimTime {
        self.at
    }
    /// Whether it is the session's current state, rather than a past one.
    pub fn is_present(&self) -> bool {
        self.present.is_some()
    }

    /// The same moment, from which the faults of the specification that is given to [`LockstepSession::resume`] are
    /// planned, instead of those that the session still had before it. Faults in progress go on.
    #[must_use]
    pub fn with_faults_anew(mut self) -> Self {
        if let Some(present) = &mut self.present {
            present.faults_anew = true;
        }
        self
    }

    pub(super) fn core(&self, scene: Store, station: u16) -> ModelCore {
        ModelCore::resume(scene, station, self.head, self.transfers.clone())
    }
}

impl LockstepSession {
    /// The current state of the session.
    pub fn present(&self) -> Moment {
        let slot = |slot: &Slot| {
            let allocator = slot.allocator.fork();
            let empty = || Commands::new(self.registry.clone(), allocator.clone());
            let second = |batch: &Batch| for_a_branch(batch, slot.epoch, empty);
            SlotMoment {
                name: slot.spec.name.clone(),
                cursor: Some(slot.cursor),
                active_faults: slot.active_faults,
                link: slot.link.fork(|batch_in_flight| {
                    Some(BatchInFlight { batch: second(&batch_in_flight.batch)?, ..*batch_in_flight })
                }),
                queue: slot.queue.iter().filter_map(|batch| second(batch)).collect(),
                allocator,
            }
        };
        Moment {
            scene: self.core.view().clone(),
            at: self.now,
            head: self.core.hash(),
            transfers: self.core.transfers().clone(),
            slots: self.slots.iter().map(slot).collect(),
            operator: (self.operator.allocator.fork(), self.operator.tick),
            given: self.given.iter().copied().collect(),
            present: Some(PresentState {
                until: self.until,
                next_publish: self.next_publish,
                next_stop_check: self.next_stop_check,
                faults: self.faults.clone(),
                fault_log: self.fault_log.clone(),
                faults_anew: false,
            }),
        }
    }

    /// State of a session when its scene was `snapshot`: of this session, one that it was branched from or into, or a
    /// recorded one.
    ///
    /// The present is the [present](Self::present). The times of the last 256 snapshots issued by this session and its
    /// ancestors are known; any other is taken as complete at the time of its last batch, or at the session's begin if
    /// that is later. Event cursors follow from the time, so an event at the instant of the last tick may be delivered twice; planned faults that are over do not
    /// recur, lasting ones begin again.
    ///
    /// # Errors
    /// [`BranchError`].
    pub fn moment_of(&self, snapshot: &Snapshot) -> Result<Moment, BranchError> {
        if !Arc::ptr_eq(snapshot.registry(), &self.registry) {
            return Err(BranchError::OtherComponents);
        }
        let known = self.given.iter().find(|given| given.revision == snapshot.revision());
        if known.is_some_and(|given| given.at == self.now)
            && snapshot.revision() == self.core.view().revision()
        {
            return Ok(self.present());
        }
        let (at, head) = match known {
            Some(given) => (given.at, given.head),
            None => (SimTime(snapshot.time().0 + 1).max(self.begin), Chain::begin(snapshot)?.head()),
        };
        let station = self.core.station();
        let allocator = |writer: u16| {
            let allocator = EntityAllocator::new(station, writer);
            allocator.skip_to(snapshot.first_free(station, writer));
            allocator
        };
        let slot = |slot: &Slot| SlotMoment {
            name: slot.spec.name.clone(),
            cursor: None,
            allocator: allocator(slot.writer.0),
            active_faults: ActiveFaults::default(),
            link: LinkFaults::default(),
            queue: VecDeque::new(),
        };
        Ok(Moment {
            scene: snapshot.clone(),
            at,
            head,
            transfers: Arc::default(),
            slots: self.slots.iter().map(slot).collect(),
            // Its number only has to differ from earlier ones.
            operator: (allocator(OPERATOR.0), self.operator.tick),
            given: self.given.iter().filter(|given| given.at <= at).copied().collect(),
            present: None,
        })
    }

    /// Starts the controllers of `spec` in the scene of a moment, at its time. `spec` is as for a new session of the
    /// same controllers, also in its begin; the scene is the moment's, and its peers must be in the state of the moment.
    ///
    /// Shares only immutable data with the session of the moment.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn resume(spec: SessionSpec, moment: Moment) -> Result<Self, SessionError> {
        let scene = Store::from_snapshot(&moment.scene);
        Self::start_at(SessionSpec { scene, ..spec }, Some(moment))
    }

    /// The peers, in stepping order.
    pub fn peers(&self) -> impl Iterator<Item = &dyn Peer> {
        self.peers.iter().map(|slot| &*slot.peer)
    }

    /// Begins a new session, before controllers are built.
    pub(super) fn begin_anew(&mut self) {
        let begin = self.begin;
        self.stand_at(begin);
        if begin > SimTime::ZERO {
            // What the scene tells of the time before is not news.
            let heard = first_event_from(self.core.view(), begin);
            self.slots.iter_mut().for_each(|slot| slot.cursor = heard);
        }
    }

    /// Sets the clock, and what is due next by the grids of controllers, peers, publications, stop checks and faults.
    fn stand_at(&mut self, at: SimTime) {
        self.now = at;
        self.slots.iter_mut().for_each(|slot| slot.skip_to(at));
        for slot in &mut self.peers {
            slot.next = SimTime(at.0.next_multiple_of(slot.peer.period_ns()));
        }
        self.next_publish = SimTime((at.0 / PUBLISH_EVERY.0 + 1) * PUBLISH_EVERY.0);
        if let Some(stop) = &self.stop_when {
            self.next_stop_check = SimTime(at.0.next_multiple_of(stop.every.0.max(1)));
        }
        self.faults.skip_to(at);
    }

    /// Restores the state of a moment, before controllers are built.
    pub(super) fn go_on_from(&mut self, moment: Moment) {
        let Moment { scene, at, mut slots, operator, given, present, .. } = moment;
        self.resuming = true;
        self.stand_at(at);
        for slot in &mut self.slots {
            let Some(known) = slots.iter_mut().find(|known| known.name == slot.spec.name) else { continue };
            let heard = || first_event_from(&scene, slot.last_tick(self.begin));
            slot.cursor = known.cursor.unwrap_or_else(heard);
            slot.allocator = known.allocator.fork();
            slot.active_faults = known.active_faults;
            slot.link = std::mem::take(&mut known.link);
            slot.queue = std::mem::take(&mut known.queue);
            self.queued |= !slot.queue.is_empty();
        }
        self.operator = OperatorWriter::new(operator.0, operator.1);
        self.given = given.into();
        match present {
            Some(present) => {
                self.until = present.until;
                self.next_publish = present.next_publish;
                self.next_stop_check = present.next_stop_check;
                if !present.faults_anew {
                    self.faults = present.faults;
                    self.fault_log = present.fault_log;
                }
            }
            None => self.next_publish = at,
        }
    }

    /// Remembers the issued snapshot.
    pub(super) fn remember(&mut self) {
        let given =
            IssuedSnapshot { revision: self.core.view().revision(), at: self.now, head: self.core.hash() };
        if self.given.back().is_some_and(|last| (last.revision, last.at) == (given.revision, given.at)) {
            return;
        }
        if self.given.len() == GIVEN_MAX {
            self.given.pop_front();
        }
        self.given.push_back(given);
    }
}
