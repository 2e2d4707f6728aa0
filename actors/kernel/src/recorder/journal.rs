//! Journal of a recording: the plain data that survives a restart of the recorder and from which its next life
//! continues.
//!
//! Messages wait in an open chunk, closed chunks wait in the write buffer, and written chunks are only counted. A life
//! that dies between two publications therefore loses nothing; one that dies during a publication loses that
//! publication, which becomes a declared gap.

use std::collections::BTreeMap;
use std::io;

use serde_json::Value;
use trocar_scene::{ComponentError, RecordPolicy, Revision, SimTime, Snapshot};

use super::container::{Container, Mark, OpenChunk};
use super::format::{
    COMMITS, COMPONENT, EVENTS, GAPS, Gap, KEYFRAMES, META, META_DEVICES, META_END, PROFILE, SCENARIO,
    SCHEMA, TF, encode_group, encode_keyframe_header,
};
use super::gate::WritePermit;
use super::json_channels::{self, EVENT_SCHEMA, Frames, TF_SCHEMA};
use super::mcap_records::{Channel, Schema};
use super::options::{RecorderOptions, RecordingHead};
use super::write_buffer::WriteBuffer;
use crate::commit::CommitBuffer;
use crate::state_hash::StateHash;

/// An open chunk of this size is closed.
const CHUNK_BYTES: usize = 1 << 20;
/// Reason for the gap after a life that ended during a publication.
const TORN: &str = "the recorder panicked while it took a publication";

mod channel {
    pub(super) const COMMITS: u16 = 1;
    pub(super) const KEYFRAMES: u16 = 2;
    pub(super) const GAPS: u16 = 3;
    pub(super) const TF: u16 = 4;
    pub(super) const EVENTS: u16 = 5;
}

/// State of one life: buffers and cached names. The next life does not reuse them.
#[derive(Default)]
pub(super) struct LifeBuffers {
    scratch: Vec<u8>,
    frames: Frames,
}

/// A recording in the making.
pub(super) struct Journal {
    container: Container,
    chunk: OpenChunk,
    write_buffer: WriteBuffer,
    /// Scratch buffer in which a chunk is assembled.
    sealed: Vec<u8>,
    sequence: u32,
    options: RecorderOptions,
    revision: Revision,
    hash: StateHash,
    time: SimTime,
    event_cursor: u64,
    tf_revision: Revision,
    next_keyframe: SimTime,
    next_tf: SimTime,
    next_flush: SimTime,
    /// Time of the last access by a life.
    seen: SimTime,
    /// An open gap: nothing was recorded since `revision`, with the reason.
    gap: Option<String>,
    complete: bool,
    /// Start of the publication being recorded; still set after a panic during it.
    taking: Option<Mark>,
}

impl Journal {
    /// Writes the header and the first keyframe.
    pub(super) fn begin(
        write_buffer: WriteBuffer,
        head: &RecordingHead,
        scene: &Snapshot,
        hash: StateHash,
        options: RecorderOptions,
        permit: WritePermit<'_>,
    ) -> Result<Self, String> {
        let (mut chunk, mut bytes) = (OpenChunk::default(), Vec::new());
        let library = concat!("trocar ", env!("CARGO_PKG_VERSION"));
        let mut container =
            Container::begin((PROFILE, library), schemas(), channels(), &mut chunk, &mut bytes);
        write_head(&mut container, head, scene, &mut bytes);
        let mut journal = Self {
            container,
            chunk,
            write_buffer,
            sealed: Vec::new(),
            sequence: 0,
            options,
            revision: scene.revision(),
            hash,
            time: SimTime::ZERO,
            event_cursor: scene.events().next(),
            tf_revision: Revision::ZERO,
            next_keyframe: SimTime::ZERO,
            next_tf: SimTime::ZERO,
            next_flush: options.flush_period,
            seen: SimTime::ZERO,
            gap: None,
            complete: true,
            taking: None,
        };
        journal.write_buffer.append(&bytes);
        journal.keyframe(&mut LifeBuffers::default(), scene, hash).map_err(|error| error.to_string())?;
        journal.flush(permit);
        journal.write_buffer.refusal.take().map_or(Ok(journal), |error| Err(error.to_string()))
    }

    /// Takes over from a failed life, at whatever point it failed.
    ///
    /// # Errors
    /// When the file cannot be truncated to its known state.
    pub(super) fn resume(&mut self) -> io::Result<()> {
        if let Some(mark) = self.taking.take() {
            self.chunk.roll_back(mark);
            self.begin_gap(TORN.to_owned());
        }
        self.write_buffer.resume()
    }

    /// Records one publication; one that cannot be recorded becomes part of a gap.
    pub(super) fn committed(
        &mut self,
        buffers: &mut LifeBuffers,
        snapshot: &Snapshot,
        commits: &CommitBuffer,
        hash: StateHash,
        permit: WritePermit<'_>,
    ) {
        self.time = self.time.max(snapshot.time());
        if self.gap.is_none() && self.write_buffer.backlog() > self.options.backlog_max {
            let reason = self.write_buffer.refusal.as_ref().map(ToString::to_string);
            self.begin_gap(reason.unwrap_or_else(|| "the disk is too slow".to_owned()));
        }
        if self.gap.is_some() {
            self.write_buffer.drain(permit);
            if self.write_buffer.backlog() <= self.options.backlog_max / 2 {
                self.end_gap(buffers, snapshot, hash);
            }
        } else if !commits.is_empty() {
            self.take(snapshot, hash, |journal| journal.write_commits(buffers, snapshot, commits, hash));
        }
        if self.chunk.len() >= CHUNK_BYTES {
            self.seal();
        }
    }

    /// Lets `write` write the records of one revision atomically: if it fails or panics, none of them stays.
    fn take(
        &mut self,
        snapshot: &Snapshot,
        hash: StateHash,
        write: impl FnOnce(&mut Self) -> Result<(), ComponentError>,
    ) {
        let mark = self.chunk.mark();
        self.taking = Some(mark);
        let written = write(self);
        self.taking = None;
        match written {
            Ok(()) => {
                self.revision = snapshot.revision();
                self.hash = hash;
            }
            Err(error) => {
                self.chunk.roll_back(mark);
                self.begin_gap(error.to_string());
            }
        }
    }

    fn write_commits(
        &mut self,
        buffers: &mut LifeBuffers,
        snapshot: &Snapshot,
        commits: &CommitBuffer,
        hash: StateHash,
    ) -> Result<(), ComponentError> {
        buffers.scratch.clear();
        encode_group(commits, hash, &mut buffers.scratch);
        self.message(channel::COMMITS, &buffers.scratch);
        self.side_channels(buffers, snapshot);
        if self.time >= self.next_keyframe { self.keyframe(buffers, snapshot, hash) } else { Ok(()) }
    }

    /// Begins a gap, in which commits are missing until [`Self::end_gap`].
    pub(super) fn begin_gap(&mut self, reason: String) {
        self.complete = false;
        self.gap.get_or_insert(reason);
    }

    fn end_gap(&mut self, buffers: &mut LifeBuffers, snapshot: &Snapshot, hash: StateHash) {
        let Some(reason) = self.gap.take() else { return };
        let gap = Gap { after: self.revision, until: snapshot.revision(), time: self.time, reason };
        self.take(snapshot, hash, |journal| {
            journal.message(channel::GAPS, &serde_json::to_vec(&gap).unwrap_or_default());
            journal.event_cursor = snapshot.events().next();
            journal.keyframe(buffers, snapshot, hash)
        });
    }

    fn keyframe(
        &mut self,
        buffers: &mut LifeBuffers,
        scene: &Snapshot,
        hash: StateHash,
    ) -> Result<(), ComponentError> {
        buffers.scratch.clear();
        encode_keyframe_header(hash, &mut buffers.scratch);
        scene.encode(&mut buffers.scratch)?;
        self.message(channel::KEYFRAMES, &buffers.scratch);
        self.next_keyframe = self.time + self.options.keyframe_period;
        // A viewer that starts here gets all frames.
        self.tf_revision = Revision::ZERO;
        Ok(())
    }

    fn side_channels(&mut self, buffers: &mut LifeBuffers, scene: &Snapshot) {
        let events: Vec<Value> = scene
            .events()
            .since(self.event_cursor)
            .map(|(_, event)| json_channels::event(scene, event))
            .collect();
        self.event_cursor = scene.events().next();
        for event in events {
            self.message(channel::EVENTS, event.to_string().as_bytes());
        }
        if self.time >= self.next_tf {
            // Counted from the due time, so that irregular publications do not lower the rate.
            let next = self.next_tf + self.options.tf_period;
            self.next_tf = if next < self.time { self.time + self.options.tf_period } else { next };
            if let Some(transforms) = buffers.frames.transforms(scene, self.tf_revision, self.time) {
                self.message(channel::TF, transforms.to_string().as_bytes());
            }
            self.tf_revision = scene.revision();
        }
    }

    fn message(&mut self, channel: u16, data: &[u8]) {
        self.sequence = self.sequence.wrapping_add(1);
        self.chunk.message(channel, self.sequence, self.time.as_nanos(), data);
    }

    /// Called when a life returns to the journal at `now`: a slow disk has progressed since.
    pub(super) fn resumed_at(&mut self, now: SimTime, permit: WritePermit<'_>) {
        let span = now.since(self.seen);
        self.seen = self.seen.max(now);
        self.wait(span, permit);
    }

    /// Lets a slow disk write for `span`.
    pub(super) fn wait(&mut self, span: SimTime, permit: WritePermit<'_>) {
        self.write_buffer.ration(permit.disk_rate().map(|rate| rate * span.as_secs_f64()));
    }

    /// Advances to `now`: closes the chunk when it is old enough, and writes as much as the disk takes.
    pub(super) fn passed(&mut self, now: SimTime, permit: WritePermit<'_>) {
        if now >= self.next_flush {
            let next = self.next_flush + self.options.flush_period;
            self.next_flush = if next <= now { now + self.options.flush_period } else { next };
            self.seal();
        }
        if self.write_buffer.backlog() > 0 {
            self.write_buffer.drain(permit);
        }
    }

    fn flush(&mut self, permit: WritePermit<'_>) {
        self.seal();
        self.write_buffer.drain(permit);
    }

    /// Moves the open chunk to the write buffer.
    fn seal(&mut self) {
        self.sealed.clear();
        self.container.seal(&mut self.chunk, &mut self.sealed);
        self.write_buffer.append(&self.sealed);
    }

    /// Whether everything due was written.
    pub(super) fn is_sound(&self) -> bool {
        self.gap.is_none() && self.write_buffer.refusal.is_none()
    }

    /// Writes the end of the file; `last` is the last publication, for a gap that is still open. `true` when the file
    /// is complete.
    pub(super) fn close(mut self, last: Option<(&Snapshot, StateHash)>, permit: WritePermit<'_>) -> bool {
        if self.gap.is_some()
            && let Some((snapshot, hash)) = last
        {
            self.committed(&mut LifeBuffers::default(), snapshot, &CommitBuffer::new(), hash, permit);
        }
        let complete = self.complete && self.gap.is_none();
        let end = BTreeMap::from([
            ("revision".to_owned(), self.revision.0.to_string()),
            ("hash".to_owned(), self.hash.to_string()),
            ("time_ns".to_owned(), self.time.as_nanos().to_string()),
            ("complete".to_owned(), complete.to_string()),
        ]);
        self.seal();
        self.sealed.clear();
        self.container.metadata(META_END, &end, &mut self.sealed);
        self.container.finish(&mut self.sealed);
        self.write_buffer.append(&self.sealed);
        self.write_buffer.drain(permit) && self.write_buffer.sync().is_ok() && complete
    }
}

fn write_head(container: &mut Container, head: &RecordingHead, scene: &Snapshot, out: &mut Vec<u8>) {
    let mut meta = head.extra.clone();
    meta.extend([
        ("schema".to_owned(), SCHEMA.to_owned()),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ("scenario".to_owned(), head.scenario.clone()),
        ("seed".to_owned(), head.seed.to_string()),
        ("station".to_owned(), head.station.to_string()),
        ("mode".to_owned(), head.mode.clone()),
    ]);
    for (_, entry) in scene.registry().iter() {
        let policy = match entry.record {
            RecordPolicy::Full => "full",
            RecordPolicy::Derived => "derived",
        };
        meta.insert(format!("{COMPONENT}{}", entry.name), format!("{:08x} {policy}", entry.key));
    }
    container.metadata(META, &meta, out);
    let devices = head.devices.iter().map(|(name, device)| (name.clone(), device.to_string())).collect();
    container.metadata(META_DEVICES, &devices, out);
    container.attachment(SCENARIO, "application/toml", head.scenario_text.as_bytes(), out);
}

fn schemas() -> Vec<Schema> {
    let schema = |id, name, text: Value| Schema {
        id,
        name,
        encoding: "jsonschema",
        data: text.to_string().into_bytes(),
    };
    vec![
        schema(1, TF_SCHEMA, json_channels::tf_schema()),
        schema(2, EVENT_SCHEMA, json_channels::event_schema()),
    ]
}

fn channels() -> Vec<Channel> {
    let channel = |id, schema, topic, encoding| Channel { id, schema, topic, encoding };
    vec![
        channel(channel::COMMITS, 0, COMMITS, "trocar-postcard"),
        channel(channel::KEYFRAMES, 0, KEYFRAMES, "trocar-postcard"),
        channel(channel::GAPS, 0, GAPS, "json"),
        channel(channel::TF, 1, TF, "json"),
        channel(channel::EVENTS, 2, EVENTS, "json"),
    ]
}
