//! The recorder's desk: what waits to be recorded and the journal, for one life of the recorder after the
//! other. Nobody who has to be on time ever waits for it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

use rtrb::{Consumer, Producer};
use trocar_scene::{ControllerError, SimTime, Snapshot};

use super::gate::{Gate, Pass};
use super::journal::{Journal, Pen};
use crate::commit::CommitBuffer;
use crate::spec::{FaultKind, FaultOrder, FaultSink, Fence};
use crate::state_hash::StateHash;

/// Pause between two looks at a desk that somebody sits at.
const CLOSING_PAUSE: Duration = Duration::from_millis(2);
/// The epoch of the closing of a recording: no life comes after it.
const LAST_EPOCH: u32 = u32::MAX;

/// What the Model published, on its way to the recorder.
pub(super) struct Publication {
    pub(super) snapshot: Arc<Snapshot>,
    pub(super) commits: CommitBuffer,
    /// The state hash after the last commit.
    pub(super) hash: StateHash,
    /// Something before this was lost, because of this.
    pub(super) lost: Option<&'static str>,
}

/// What was published last, when it did not reach the desk, and why.
pub(super) struct Lost {
    pub(super) reason: &'static str,
    pub(super) snapshot: Arc<Snapshot>,
    pub(super) hash: StateHash,
}

struct Papers {
    queue: Consumer<Publication>,
    /// The way back for emptied buffers.
    emptied: Producer<CommitBuffer>,
    /// `None` once it is closed.
    journal: Option<Journal>,
    /// What was taken last, for a gap that nothing ends.
    last: Option<(Arc<Snapshot>, StateHash)>,
}

/// See the module.
pub(super) struct Handover {
    gate: Gate,
    papers: Mutex<Papers>,
}

impl Handover {
    pub(super) fn new(
        gate: Gate,
        journal: Journal,
        queue: Consumer<Publication>,
        emptied: Producer<CommitBuffer>,
    ) -> Self {
        let papers = Papers { queue, emptied, journal: Some(journal), last: None };
        Self { gate, papers: Mutex::new(papers) }
    }

    /// The papers, unless somebody has them. A panic leaves them as [`Journal::resume`] expects.
    fn papers(&self) -> Option<MutexGuard<'_, Papers>> {
        match self.papers.try_lock() {
            Ok(papers) => Some(papers),
            Err(TryLockError::Poisoned(poisoned)) => {
                self.papers.clear_poison();
                Some(PoisonError::into_inner(poisoned))
            }
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// A life begins: from here on only it writes.
    ///
    /// # Errors
    /// When an earlier life hangs in a write to the disk, or the file cannot be brought back to what is known.
    pub(super) fn take_over(&self, epoch: u32) -> Result<(), ControllerError> {
        self.gate.raise(epoch);
        let Some(mut papers) = self.papers() else {
            let reason = "an earlier life of the recorder still waits for the disk to take a write";
            return Err(ControllerError::Device(reason.to_owned()));
        };
        match papers.journal.as_mut().map(Journal::resume) {
            Some(Ok(())) => Ok(()),
            Some(Err(error)) => Err(ControllerError::Device(format!("the recording: {error}"))),
            None => Err(ControllerError::Failed("the recording is closed".to_owned())),
        }
    }

    /// One tick of a life: records what has come, and gives the disk what is due at `now`.
    ///
    /// # Errors
    /// When that life was fenced.
    pub(super) fn work(&self, epoch: u32, now: SimTime, pen: &mut Pen) -> Result<(), ControllerError> {
        let pass = self.gate.pass(epoch);
        if !pass.is_valid() {
            return Err(ControllerError::Failed("this life of the recorder was fenced".to_owned()));
        }
        // Somebody who was fenced is just noticing it: what has come can wait for the next tick.
        let Some(mut papers) = self.papers() else { return Ok(()) };
        if let Some(journal) = &mut papers.journal {
            journal.resumed_at(now, pass);
        }
        papers.take_publications(pen, pass);
        if let Some(journal) = &mut papers.journal {
            journal.passed(now, pass);
            self.gate.set_sound(journal.is_sound());
        }
        Ok(())
    }

    /// Records what has come and closes the file; nobody writes after that. Gives up after `limit` when a
    /// life still has the papers. `true` when nothing is missing in the recording.
    pub(super) fn close(&self, lost: Option<Lost>, limit: Duration) -> bool {
        self.gate.raise(LAST_EPOCH);
        let pass = self.gate.pass(LAST_EPOCH);
        let begun = Instant::now();
        let mut papers = loop {
            match self.papers() {
                Some(papers) => break papers,
                None if begun.elapsed() < limit => std::thread::sleep(CLOSING_PAUSE),
                None => return false,
            }
        };
        let resumed = papers.journal.as_mut().is_some_and(|journal| journal.resume().is_ok());
        if !resumed {
            return false;
        }
        papers.take_publications(&mut Pen::default(), pass);
        let Some(mut journal) = papers.journal.take() else { return false };
        journal.wait(SimTime::from(limit), pass);
        let mut last = papers.last.take();
        if let Some(Lost { reason, snapshot, hash }) = lost {
            journal.begin_gap(reason.to_owned());
            last = Some((snapshot, hash));
        }
        journal.close(last.as_ref().map(|(snapshot, hash)| (&**snapshot, *hash)), pass)
    }
}

impl Papers {
    /// Whatever waits now; what comes meanwhile waits for the next time.
    fn take_publications(&mut self, pen: &mut Pen, pass: Pass<'_>) {
        let Some(journal) = &mut self.journal else { return };
        for _ in 0..self.queue.slots() {
            if !pass.is_valid() {
                return;
            }
            let Ok(Publication { snapshot, mut commits, hash, lost }) = self.queue.pop() else { return };
            if let Some(reason) = lost {
                journal.begin_gap(reason.to_owned());
            }
            let (scene, _) = self.last.insert((snapshot, hash));
            journal.committed(pen, scene, &commits, hash, pass);
            commits.clear();
            // Full: somebody uses fewer buffers than before.
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
            // The others befall the recorder itself.
            _ => {}
        }
    }
    fn is_sound(&self) -> Option<bool> {
        Some(self.gate.is_sound())
    }
}
