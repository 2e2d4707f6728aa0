//! Open block: the commits that the next message of a recording will hold. Plain data that survives the recorder's
//! restarts.

use trocar_scene::{Provenance, Revision, SimTime};

use super::block::CommitHead;
use crate::state_hash::CommitKind;

/// One commit, with the place of its payload.
#[derive(Clone, Copy)]
struct Pending {
    kind: CommitKind,
    revision: Revision,
    writer: usize,
    provenance: Provenance,
    end: usize,
    /// Where its puts lie in its payload.
    puts: (usize, usize),
}

/// See the module.
#[derive(Default)]
pub(super) struct OpenBlock {
    commits: Vec<Pending>,
    bytes: Vec<u8>,
    /// Names of writers; as many as a session has.
    writers: Vec<String>,
    /// The time of its first commit.
    begun: Option<SimTime>,
}

/// A position in an open block for a roll-back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BlockMark {
    commits: usize,
    bytes: usize,
}

impl OpenBlock {
    pub(super) fn push(&mut self, head: &CommitHead<'_>, payload: &[u8], puts: (usize, usize)) {
        let known = self.writers.iter().position(|name| name == head.writer);
        let writer = known.unwrap_or_else(|| {
            self.writers.push(head.writer.to_owned());
            self.writers.len() - 1
        });
        self.begun.get_or_insert(head.provenance.time);
        self.bytes.extend_from_slice(payload);
        let CommitHead { kind, revision, provenance, .. } = *head;
        self.commits.push(Pending { kind, revision, writer, provenance, end: self.bytes.len(), puts });
    }
    pub(super) fn is_empty(&self) -> bool {
        self.commits.is_empty()
    }
    /// Bytes of all payloads.
    pub(super) fn len(&self) -> usize {
        self.bytes.len()
    }
    /// The time of its first commit.
    pub(super) fn begun(&self) -> Option<SimTime> {
        self.begun
    }
    /// The commits with their payloads and the places of their puts.
    pub(super) fn commits(&self) -> impl Iterator<Item = (CommitHead<'_>, &[u8], (usize, usize))> {
        let mut start = 0;
        self.commits.iter().map(move |commit| {
            let payload = &self.bytes[std::mem::replace(&mut start, commit.end)..commit.end];
            let Pending { kind, revision, provenance, .. } = *commit;
            let head = CommitHead { kind, revision, writer: &self.writers[commit.writer], provenance };
            (head, payload, commit.puts)
        })
    }
    pub(super) fn clear(&mut self) {
        self.roll_back(BlockMark { commits: 0, bytes: 0 });
    }
    pub(super) fn mark(&self) -> BlockMark {
        BlockMark { commits: self.commits.len(), bytes: self.bytes.len() }
    }
    /// Removes everything since `mark`.
    pub(super) fn roll_back(&mut self, mark: BlockMark) {
        self.commits.truncate(mark.commits);
        self.bytes.truncate(mark.bytes);
        if self.commits.is_empty() {
            self.begun = None;
        }
    }
}
