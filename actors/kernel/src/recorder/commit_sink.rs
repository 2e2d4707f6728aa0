//! Commit sink on the Model's side of the recorder: takes publications without blocking.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;

use rtrb::{Consumer, Producer, PushError};
use trocar_scene::Snapshot;

use super::handover::{Handover, LostPublication, Publication};
use crate::commit::CommitBuffer;
use crate::runtime::guarded;
use crate::spec::CommitSink;
use crate::state_hash::StateHash;

/// Reason for a gap after a queue overflow.
const QUEUE_FULL: &str = "the recorder's queue was full";

/// The Model's end of the queue. A full queue causes a gap, which is declared when there is room again.
pub(super) struct RecorderSink {
    queue: Producer<Publication>,
    emptied: Consumer<CommitBuffer>,
    handover: Arc<Handover>,
    hash: StateHash,
    lost: Option<LostPublication>,
}

impl RecorderSink {
    pub(super) fn new(
        queue: Producer<Publication>,
        emptied: Consumer<CommitBuffer>,
        handover: Arc<Handover>,
        hash: StateHash,
    ) -> Self {
        Self { queue, emptied, handover, hash, lost: None }
    }
}

impl CommitSink for RecorderSink {
    fn committed(&mut self, snapshot: &Arc<Snapshot>, commits: CommitBuffer) -> CommitBuffer {
        if let Some(last) = commits.last_hash() {
            self.hash = last;
        }
        if commits.is_empty() && self.lost.is_none() {
            return commits;
        }
        let publication = Publication {
            snapshot: snapshot.clone(),
            commits,
            hash: self.hash,
            lost: self.lost.as_ref().map(|lost| lost.reason),
        };
        match self.queue.push(publication) {
            Ok(()) => {
                self.lost = None;
                self.emptied.pop().unwrap_or_default()
            }
            Err(PushError::Full(Publication { snapshot, mut commits, hash, .. })) => {
                self.lost = Some(LostPublication { reason: QUEUE_FULL, snapshot, hash });
                commits.clear();
                commits
            }
        }
    }

    fn close(&mut self, limit: Duration) -> bool {
        let (handover, lost) = (self.handover.clone(), self.lost.take());
        let (done, answer) = sync_channel(1);
        // On its own thread, so that a hanging disk cannot delay the end of the session.
        let closing = std::thread::Builder::new().name("trocar-closing".into()).spawn(move || {
            let complete = guarded(|| handover.close(lost, limit)).unwrap_or(false);
            let _ = done.try_send(complete);
        });
        closing.is_ok() && answer.recv_timeout(limit).unwrap_or(false)
    }
}
