//! Commit log: applied batches and fences, encoded once, in the order of application.

use std::sync::Arc;

use trocar_scene::{Provenance, Revision};

use crate::state_hash::{CommitKind, StateHash};

/// One applied batch or fence.
#[derive(Clone, Copy, Debug)]
pub struct Commit<'a> {
    /// A batch or a fence.
    pub kind: CommitKind,
    /// The revision that it made.
    pub revision: Revision,
    /// The writer's name.
    pub writer: &'a str,
    /// Its provenance.
    pub provenance: Provenance,
    /// The state hash after it.
    pub hash: StateHash,
    /// The encoded commands; for a fence, the equivalent removals.
    pub payload: &'a [u8],
}

#[derive(Clone, Debug)]
struct Entry {
    kind: CommitKind,
    revision: Revision,
    writer: Arc<str>,
    provenance: Provenance,
    hash: StateHash,
    end: usize,
}

/// Consecutive commits, in reused buffers.
#[derive(Debug, Default)]
pub struct CommitBuffer {
    entries: Vec<Entry>,
    bytes: Vec<u8>,
}

impl CommitBuffer {
    /// Empty.
    pub fn new() -> Self {
        Self::default()
    }
    /// How many commits.
    pub fn len(&self) -> usize {
        self.entries.len()
    }
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
    /// Bytes of all payloads.
    pub fn payload_len(&self) -> usize {
        self.bytes.len()
    }
    /// The state hash after the last commit.
    pub fn last_hash(&self) -> Option<StateHash> {
        self.entries.last().map(|entry| entry.hash)
    }
    /// Clears the commits and keeps the capacity.
    pub fn clear(&mut self) {
        self.truncate(0);
    }
    /// The commits, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = Commit<'_>> {
        let mut start = 0;
        self.entries.iter().map(move |entry| {
            let payload = &self.bytes[start..entry.end];
            start = entry.end;
            Commit {
                kind: entry.kind,
                revision: entry.revision,
                writer: &entry.writer,
                provenance: entry.provenance,
                hash: entry.hash,
                payload,
            }
        })
    }

    pub(crate) fn push(
        &mut self,
        kind: CommitKind,
        revision: Revision,
        writer: &Arc<str>,
        provenance: Provenance,
        hash: StateHash,
        payload: &[u8],
    ) {
        self.bytes.extend_from_slice(payload);
        let (writer, end) = (writer.clone(), self.bytes.len());
        self.entries.push(Entry { kind, revision, writer, provenance, hash, end });
    }

    /// Keeps only the first `len` commits.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.entries.truncate(len);
        self.bytes.truncate(self.entries.last().map_or(0, |entry| entry.end));
    }
}
