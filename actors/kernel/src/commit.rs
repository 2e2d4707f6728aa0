//! Commit log: applied batches and fences, encoded once, in the order of application.

use std::sync::Arc;

use trocar_scene::{Provenance, PutSection, Revision, SectionMap};

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

/// Where the sections of a commit's payload lie; see [`SectionMap`].
#[derive(Clone, Copy, Debug)]
pub struct Sections<'a> {
    /// Whether the commit creates entities.
    pub spawns: bool,
    /// Where the puts begin, with their count.
    pub puts_at: usize,
    /// The byte after the puts.
    pub puts_end: usize,
    /// The puts of each component.
    pub puts: &'a [PutSection],
}

#[derive(Clone, Debug)]
struct Entry {
    kind: CommitKind,
    revision: Revision,
    writer: Arc<str>,
    provenance: Provenance,
    hash: StateHash,
    end: usize,
    spawns: bool,
    puts_at: u32,
    puts_end: u32,
    sections_end: usize,
}

/// Consecutive commits, in reused buffers.
#[derive(Debug, Default)]
pub struct CommitBuffer {
    entries: Vec<Entry>,
    bytes: Vec<u8>,
    sections: Vec<PutSection>,
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

    /// The commits with the sections of their payloads, oldest first.
    pub(crate) fn with_sections(&self) -> impl Iterator<Item = (Commit<'_>, Sections<'_>)> {
        let mut start = 0;
        self.iter().zip(&self.entries).map(move |(commit, entry)| {
            let puts = &self.sections[start..entry.sections_end];
            start = entry.sections_end;
            let Entry { spawns, puts_at, puts_end, .. } = *entry;
            (commit, Sections { spawns, puts_at: puts_at as usize, puts_end: puts_end as usize, puts })
        })
    }

    pub(crate) fn push(&mut self, commit: &Commit<'_>, writer: &Arc<str>, map: &SectionMap) {
        let Commit { kind, revision, provenance, hash, payload, .. } = *commit;
        self.bytes.extend_from_slice(payload);
        self.sections.extend_from_slice(&map.puts);
        self.entries.push(Entry {
            kind,
            revision,
            writer: writer.clone(),
            provenance,
            hash,
            end: self.bytes.len(),
            spawns: map.spawns,
            puts_at: map.puts_at,
            puts_end: map.puts_end,
            sections_end: self.sections.len(),
        });
    }

    /// Keeps only the first `len` commits.
    pub(crate) fn truncate(&mut self, len: usize) {
        self.entries.truncate(len);
        self.bytes.truncate(self.entries.last().map_or(0, |entry| entry.end));
        self.sections.truncate(self.entries.last().map_or(0, |entry| entry.sections_end));
    }
}
