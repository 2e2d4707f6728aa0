//! Handover between lives of the recorder: the journal and the queue of publications, used by one life after another.
//! No real-time thread ever waits for it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use rtrb::{Consumer, Producer};
use trocar_scene::{ControllerError, SimTime, Snapshot};

use super::gate::{Gate, WritePermit};
use super::journal::Journal;
use super::life_buffers::LifeBuffers;
use crate::commit::CommitBuffer;
use crate::spec::{FaultKind, FaultOrder, FaultSink, Fence};
use crate::state_hash::StateHash;

/// Pause between two attempts to lock the journal when closing.
const CLOSING_PAUSE: Duration = Duration::from_millis(2);
/// Epoch of closing a recording: the last one.
const LAST_EPOCH: u32 = u32::MAX;

/// A publication of the Model, queued for the recorder.
pub(super) struct Publication {
    pub(super) snapshot: Arc<Snapshot>,
    pub(super) commits: CommitBuffer,
    /// The state hash after the last commit.
    pub(super) hash: StateHash,
    /// Reason for a loss directly before this publication.
    pub(super) lost: Option<&'static str>,
}

/// The last publication, when it did not reach the queue, with the reason.
pub(super) struct LostPublication {
    pub(super) reason: &'static str,
    pub(super) snapshot: Arc<Snapshot>,
    pub(super) hash: StateHash,
}

struct HandoverState {
    queue: Consumer<Publication>,
    /// Return queue for emptied buffers.
    emptied: Producer<CommitBuffer>,
    /// `None` once it is closed.
    journal: Option<Journal>,
    /// The last publication taken, for a gap that is still open at the end.
    last: Option<(Arc<Snapshot>, StateHash)>,
}

/// See the module.
pub(super) struct Handover {
    gate: Gate,
    state: Mutex<HandoverState>,
}

impl Handover {
    pub(super) fn new(
        gate: Gate,
        journal: Journal,
        queue: Consumer<Publication>,
        emptied: Producer<CommitBuffer>,
    ) -> Self {
        let state = HandoverState { queue, emptied, journal: Some(journal), last: None };
        Self { gate, state: Mutex::new(state) }
    }

    /// Locks the state without waiting. A panic leaves a journal that [`Journal::resume`] accepts.
    fn state(&self) -> Option<MutexGuard<'_, HandoverState>> {
        match self.state.try_lock() {
            Ok(state) => Some(state),
            Err(TryLockError::Poisoned(poisoned)) => {
                self.state.clear_poison();
                Some(PoisonError::into_inner(poisoned))
            }
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Begins a life: from now on only it may write. Returns its buffers.
    ///
    /// # Errors
    /// When an earlier life hangs in a write to the disk, or the file cannot be truncated to its known state.
    pub(super) fn take_over(&self, epoch: u32) -> Result<LifeBuffers, ControllerError> {
        self.gate.raise(epoch);
        let Some(mut state) = self.state() else {
            let reason = "an earlier life of the recorder still waits for the disk to take a write";
            return Err(ControllerError::Device(reason.to_owned()));
        };
        let Some(journal) = &mut state.journal else {
            return Err(ControllerError::Failed("the recording is closed".to_owned()));
        };
        match journal.resume() {
            Ok(()) => Ok(journal.buffers()),
            Err(error) => Err(ControllerError::Device(format!("the recording: {error}"))),
        }
    }

    /// One tick of a life: records the queued publications, and writes what is due at `now`.
    ///
    /// # Errors
    /// When that life was fenced.
    pub(super) fn work(
        &self,
        epoch: u32,
        now: SimTime,
        buffers: &mut LifeBuffers,
    ) -> Result<(), ControllerError> {
        let permit = self.gate.permit(epoch);
        if !permit.is_valid() {
            return Err(ControllerError::Failed("this life of the recorder was fenced".to_owned()));
        }
        // A fenced life still holds the lock and is about to release it: the queue can wait for the next tick.
        let Some(mut state) = self.state() else { return Ok(()) };
        if let Some(journal) = &mut state.journal {
            journal.resumed_at(now, permit);
        }
        state.take_publications(buffers, permit);
        if let Some(journal) = &mut state.journal {
            journal.passed(buffers, now, permit);
            self.gate.set_sound(journal.is_sound());
        }
        Ok(())
    }

    /// Records the queued publications and closes the file; nothing is written after that. Gives up after `limit` if a
    /// life still holds the lock. `true` when the recording is complete.
    pub(super) fn close(&self, lost: Option<LostPublication>, limit: Duration) -> bool {
        self.gate.raise(LAST_EPOCH);
        let permit = self.gate.permit(LAST_EPOCH);
        let begun = Instant::now();
        let mut state = loop {
            match self.state() {
                Some(state) => break state,
                None if begun.elapsed() < limit => std::thread::sleep(CLOSING_PAUSE),
                None => return false,
            }
        };
        let buffers = state.journal.as_mut().and_then(|journal| {
            journal.resume().ok()?;
            Some(journal.buffers())
        });
        let Some(mut buffers) = buffers else { return false };
        state.take_publications(&mut buffers, permit);
        let Some(mut journal) = state.journal.take() else { return false };
        journal.wait(SimTime::from(limit), permit);
        let mut last = state.last.take();
        if let Some(LostPublication { reason, snapshot, hash }) = lost {
            journal.begin_gap(reason.to_owned());
            last = Some((snapshot, hash));
        }
        journal.close(&mut buffers, last.as_ref().map(|(snapshot, hash)| (&**snapshot, *hash)), permit)
    }
}

impl HandoverState {
    /// Takes the publications queued now; later ones wait for the next call.
    fn take_publications(&mut self, buffers: &mut LifeBuffers, permit: WritePermit<'_>) {
        let Some(journal) = &mut self.journal else { return };
        for _ in 0..self.queue.slots() {
            if !permit.is_valid() {
                return;
            }
            let Ok(Publication { snapshot, mut commits, hash, lost }) = self.queue.pop() else { return };
            if let Some(reason) = lost {
                journal.begin_gap(reason.to_owned());
            }
            let (scene, _) = self.last.insert((snapshot, hash));
            journal.committed(buffers, scene, &commits, hash, permit);
            commits.clear();
            // The return queue is full when fewer buffers are in use than before.
            let _ = self.emptied.push(commits);
        }
    }
}

impl Fence for Handover {
    fn raise(&self, epoch: u32) {
        self.gate.raise(epoch);
    }
}

impl FaultSink for Handover {
    fn fault(&self, order: &FaultOrder) {
        match order.kind {
            FaultKind::DiskFull => self.gate.set_disk_full(order.begins),
            FaultKind::DiskSlow => self.gate.set_disk_slow(order.begins.then_some(order.bytes_per_sec)),
            // Other kinds affect the recorder itself.
            _ => {}
        }
    }
    fn is_sound(&self) -> Option<bool> {
        Some(self.gate.is_sound())
    }
}
