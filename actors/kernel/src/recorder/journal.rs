//! Journal of a recording: the plain data that survives a restart of the recorder and from which its next life
//! continues.
//!
//! ```text
//! commits ─▶ open block ─▶ open chunk ─▶ write buffer ─▶ disk
//!            100 ms        500 ms
//! ```
//! What has been written is only counted. A life that dies between two publications therefore loses nothing; one that
//! dies during a publication loses that publication, and one that dies while a block is encoded loses the block; what is
//! lost becomes a declared gap.

use std::collections::BTreeMap;
use std::io;

use serde_json::Value;
use trocar_scene::{ComponentError, Provenance, Revision, SimTime, Snapshot, WriterId};

use super::block::CommitHead;
use super::byte_counts::ByteCounts;
use super::columns::History;
use super::format::{Gap, META_BYTES, META_END, PROFILE, channel};
use super::gate::WritePermit;
use super::head::{channels, schemas, write_head};
use super::life_buffers::LifeBuffers;
use super::mcap::container::{Container, Mark, OpenChunk};
use super::mcap::records::Compression;
use super::open_block::{BlockMark, OpenBlock};
use super::options::{RecorderOptions, RecordingHead};
use super::tool_channels::ToolChannels;
use super::write_buffer::WriteBuffer;
use crate::commit::CommitBuffer;
use crate::spec::RECORDER;
use crate::state_hash::{Chain, CommitKind, StateHash};

/// An open chunk or block of this size is closed.
const CHUNK_BYTES: usize = 1 << 20;
/// Payloads of this size close a block before its time.
const BLOCK_BYTES: usize = 8 << 20;
/// Reason for the gap after a life that ended during a publication.
const TORN: &str = "the recorder panicked while it took a publication";

/// What a life was doing, to be undone if it did not finish.
#[derive(Clone, Copy, Debug)]
struct Taking {
    log: Mark,
    tools: Mark,
    block: BlockMark,
    revision: Revision,
    hash: StateHash,
    stored: Chain,
}

/// A recording in the making.
pub(super) struct Journal {
    container: Container,
    /// Blocks, keyframes and gaps.
    log: OpenChunk,
    /// Messages for standard tools.
    tools: OpenChunk,
    block: OpenBlock,
    /// What the next block of the open chunk is predicted from.
    history: History,
    write_buffer: WriteBuffer,
    /// Scratch buffer in which a chunk is assembled.
    sealed: Vec<u8>,
    sequence: u32,
    samples: u64,
    options: RecorderOptions,
    revision: Revision,
    /// The revision up to which blocks are closed.
    closed: Revision,
    /// The Model's hash.
    hash: StateHash,
    /// The hash of what is stored.
    stored: Chain,
    /// The hash of what is stored in closed blocks.
    stored_closed: Chain,
    time: SimTime,
    /// What has been told to standard tools.
    told: ToolChannels,
    next_keyframe: SimTime,
    next_flush: SimTime,
    /// Time of the last access by a life.
    seen: SimTime,
    /// An open gap: nothing was recorded since `revision`, with the reason.
    gap: Option<String>,
    complete: bool,
    /// Where to go back to when a publication cannot be recorded; still set after a panic.
    taking: Option<Taking>,
    /// The open block is being encoded; still set after a panic, of which the block may be the cause.
    closing: bool,
    /// The revision of the last keyframe.
    keyframe: Revision,
    counts: ByteCounts,
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
        let (mut tools, mut bytes) = (OpenChunk::default(), Vec::new());
        let library = concat!("trocar ", env!("CARGO_PKG_VERSION"));
        let mut container =
            Container::begin((PROFILE, library), schemas(), channels(), &mut tools, &mut bytes);
        write_head(&mut container, head, scene, options.exact, &mut bytes);
        let mut journal = Self {
            container,
            log: OpenChunk::default(),
            tools,
            block: OpenBlock::default(),
            history: History::default(),
            write_buffer,
            sealed: Vec::new(),
            sequence: 0,
            samples: 0,
            options,
            revision: scene.revision(),
            closed: scene.revision(),
            hash,
            stored: Chain::resume(hash),
            stored_closed: Chain::resume(hash),
            time: head.begin,
            told: ToolChannels::new(scene, options.tf_period),
            next_keyframe: SimTime::ZERO,
            next_flush: head.begin + options.flush_period,
            seen: head.begin,
            gap: None,
            complete: true,
            taking: None,
            closing: false,
            keyframe: Revision::ZERO,
            counts: ByteCounts::new(scene.registry()),
        };
        journal.write_buffer.append(&bytes);
        // Schemas and channels stand before all messages.
        journal.seal_tools();
        let mut buffers = journal.buffers();
        journal.keyframe(&mut buffers, scene).map_err(|error| error.to_string())?;
        journal.messages_for_tools(&mut buffers, scene);
        journal.flush(permit);
        journal.write_buffer.refusal.take().map_or(Ok(journal), |error| Err(error.to_string()))
    }

    /// The buffers of a new life.
    pub(super) fn buffers(&self) -> LifeBuffers {
        // What has not changed since the last keyframe is stored in it.
        LifeBuffers::new(self.counts.registry(), self.options.exact, self.keyframe)
    }

    /// Takes over from a failed life, at whatever point it failed.
    ///
    /// # Errors
    /// When the file cannot be truncated to its known state.
    pub(super) fn resume(&mut self) -> io::Result<()> {
        if let Some(taking) = self.taking.take() {
            self.go_back(taking);
            self.begin_gap(TORN.to_owned());
        }
        if std::mem::take(&mut self.closing) {
            self.drop_block();
            self.begin_gap(TORN.to_owned());
        }
        self.write_buffer.resume()
    }

    fn go_back(&mut self, taking: Taking) {
        self.log.roll_back(taking.log);
        self.tools.roll_back(taking.tools);
        self.block.roll_back(taking.block);
        (self.revision, self.hash, self.stored) = (taking.revision, taking.hash, taking.stored);
    }

    fn place(&self) -> Taking {
        Taking {
            log: self.log.mark(),
            tools: self.tools.mark(),
            block: self.block.mark(),
            revision: self.revision,
            hash: self.hash,
            stored: self.stored,
        }
    }

    /// What has been recorded so far stays, whatever becomes of the rest of a publication.
    fn keep_so_far(&mut self) {
        if self.taking.is_some() {
            self.taking = Some(self.place());
        }
    }

    /// Gives up the open block, with the predictions that have been made from it.
    fn drop_block(&mut self) {
        self.block.clear();
        (self.revision, self.stored) = (self.closed, self.stored_closed);
        self.seal_log();
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
            self.take(|journal| journal.write_commits(buffers, snapshot, commits, hash));
            let begun = self.block.begun().unwrap_or(self.time);
            if self.time.since(begun) >= self.options.block_period || self.block.len() >= BLOCK_BYTES {
                self.close_block(buffers);
            }
        }
        // By the time of what was published, so that the file does not depend on when the recorder had time for it.
        if self.time >= self.next_flush {
            self.seal_both(self.time);
        }
        if self.log.len() >= CHUNK_BYTES {
            self.seal_log();
        }
        if self.tools.len() >= CHUNK_BYTES {
            self.seal_tools();
        }
    }

    fn seal_both(&mut self, now: SimTime) {
        let next = self.next_flush + self.options.flush_period;
        self.next_flush = if next <= now { now + self.options.flush_period } else { next };
        self.seal_log();
        self.seal_tools();
    }

    /// Lets `write` write atomically: if it fails or panics, nothing of it stays.
    fn take(&mut self, write: impl FnOnce(&mut Self) -> Result<(), ComponentError>) {
        self.taking = Some(self.place());
        let written = write(self);
        let taking = self.taking.take();
        if let (Err(error), Some(taking)) = (written, taking) {
            self.go_back(taking);
            self.begin_gap(error.to_string());
        }
    }

    fn write_commits(
        &mut self,
        buffers: &mut LifeBuffers,
        snapshot: &Snapshot,
        commits: &CommitBuffer,
        hash: StateHash,
    ) -> Result<(), ComponentError> {
        for (commit, sections) in commits.with_sections() {
            self.counts.add(&commit, &sections);
            self.told.met(commit.provenance.writer, commit.writer);
            let mut payload = std::mem::take(&mut buffers.payload);
            let kept = buffers.keeper.keep(&commit, &sections, &mut payload);
            if let Ok(Some(kept)) = &kept {
                if kept.removes {
                    buffers.sampler.forget();
                }
                let (kind, revision, provenance) = (commit.kind, commit.revision, commit.provenance);
                let head = CommitHead { kind, revision, writer: commit.writer, provenance };
                self.store(&head, &payload, kept.puts);
            }
            buffers.payload = payload;
            kept?;
        }
        let is_keyframe_due = self.time >= self.next_keyframe;
        self.sample(buffers, snapshot, is_keyframe_due)?;
        self.messages_for_tools(buffers, snapshot);
        (self.revision, self.hash) = (snapshot.revision(), hash);
        if is_keyframe_due { self.keyframe(buffers, snapshot) } else { Ok(()) }
    }

    /// Adds a commit to the open block, and to the hash of what is stored.
    fn store(&mut self, head: &CommitHead<'_>, payload: &[u8], puts: (usize, usize)) {
        let Provenance { tick, time, .. } = head.provenance;
        self.stored.append(head.kind, head.writer, tick, time, payload);
        self.block.push(head, payload, puts);
    }

    /// Stores the values of sampled components that are due, or all of them.
    fn sample(
        &mut self,
        buffers: &mut LifeBuffers,
        scene: &Snapshot,
        everything: bool,
    ) -> Result<(), ComponentError> {
        let mut payload = std::mem::take(&mut buffers.payload);
        let sampled = buffers.sampler.sample(scene, self.time, everything, &mut payload);
        if let Ok(true) = sampled {
            self.samples += 1;
            let provenance = Provenance {
                writer: WriterId(u16::MAX),
                epoch: 1,
                tick: self.samples,
                time: self.time,
                based_on: scene.revision(),
            };
            let revision = scene.revision();
            let head = CommitHead { kind: CommitKind::Sample, revision, writer: RECORDER, provenance };
            // Three counts of zero before the puts, two behind them.
            self.store(&head, &payload, (3, payload.len() - 2));
        }
        buffers.payload = payload;
        sampled.map(drop)
    }

    /// Encodes the open block into a message; a block that cannot be encoded becomes a gap.
    fn close_block(&mut self, buffers: &mut LifeBuffers) {
        if !self.block.is_empty() {
            let mark = self.log.mark();
            self.closing = true;
            let encoded = self.encode_block(buffers);
            self.closing = false;
            if let Err(error) = encoded {
                self.log.roll_back(mark);
                self.drop_block();
                buffers.forget();
                self.begin_gap(error.to_string());
                return;
            }
            self.block.clear();
        }
        (self.closed, self.stored_closed) = (self.revision, self.stored);
        self.keep_so_far();
    }

    fn encode_block(&mut self, buffers: &mut LifeBuffers) -> Result<(), ComponentError> {
        let base = self.closed;
        buffers.encoder.begin(base);
        for (head, payload, puts) in self.block.commits() {
            buffers.encoder.commit(&head, payload, puts)?;
        }
        buffers.message.clear();
        let hashes = (self.stored.head(), self.hash);
        buffers.encoder.finish(hashes, base, &mut self.history, &mut buffers.message);
        self.log_message(channel::COMMITS, &buffers.message);
        Ok(())
    }

    /// Begins a gap, in which commits are missing until [`Self::end_gap`].
    pub(super) fn begin_gap(&mut self, reason: String) {
        self.complete = false;
        self.gap.get_or_insert(reason);
    }

    fn end_gap(&mut self, buffers: &mut LifeBuffers, snapshot: &Snapshot, hash: StateHash) {
        let Some(reason) = self.gap.take() else { return };
        // What was taken before the gap is whole.
        self.close_block(buffers);
        let gap = Gap { after: self.revision, until: snapshot.revision(), time: self.time, reason };
        // What the keyframe holds is the first thing that is known again.
        self.seal_log();
        self.take(|journal| {
            journal.log_message(channel::GAPS, &serde_json::to_vec(&gap).unwrap_or_default());
            journal.told.skip_events(snapshot);
            (journal.revision, journal.closed, journal.hash) =
                (snapshot.revision(), snapshot.revision(), hash);
            journal.stored = Chain::resume(hash);
            journal.stored_closed = journal.stored;
            journal.keyframe(buffers, snapshot)
        });
    }

    /// Writes the scene as it is stored: every sampled value rounded, which is what the commits before lead to.
    fn keyframe(&mut self, buffers: &mut LifeBuffers, scene: &Snapshot) -> Result<(), ComponentError> {
        self.close_block(buffers);
        if self.gap.is_some() {
            return Ok(());
        }
        if !self.log.holds_only_a_gap() {
            self.seal_log();
        }
        buffers.keyframe(scene, (self.stored.head(), self.hash), &mut self.history)?;
        // From here on samples are what has changed since.
        let mut payload = std::mem::take(&mut buffers.payload);
        let sampled = buffers.sampler.sample(scene, self.time, true, &mut payload);
        buffers.payload = payload;
        sampled?;
        self.log_message(channel::KEYFRAMES, &buffers.message);
        self.keyframe = scene.revision();
        self.next_keyframe = self.time + self.options.keyframe_period;
        self.told.begin_anew();
        Ok(())
    }

    fn messages_for_tools(&mut self, buffers: &mut LifeBuffers, scene: &Snapshot) {
        let Self { told, tools, sequence, time, .. } = self;
        told.tell(&mut buffers.tools, scene, *time, &mut |channel, value| {
            tool_message(tools, sequence, *time, channel, value);
        });
    }

    /// How the session ended.
    fn last_messages_for_tools(&mut self, scene: &Snapshot) {
        let Self { told, tools, sequence, time, .. } = self;
        told.end(scene, &mut |channel, value| tool_message(tools, sequence, *time, channel, value));
    }

    fn log_message(&mut self, channel: u16, data: &[u8]) {
        self.sequence = self.sequence.wrapping_add(1);
        self.log.message(channel, self.sequence, self.time.as_nanos(), data);
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

    /// Advances to `now`: writes as much as the disk takes, also of what is old while nothing is published.
    pub(super) fn passed(&mut self, buffers: &mut LifeBuffers, now: SimTime, permit: WritePermit<'_>) {
        if now >= self.next_flush + self.options.block_period {
            self.close_block(buffers);
            self.seal_both(now);
        }
        if self.write_buffer.backlog() > 0 {
            self.write_buffer.drain(permit);
        }
    }

    fn flush(&mut self, permit: WritePermit<'_>) {
        self.seal_log();
        self.seal_tools();
        self.write_buffer.drain(permit);
    }

    /// Moves the open chunk of blocks to the write buffer. The next one is read without it.
    fn seal_log(&mut self) {
        self.history = History::default();
        self.sealed.clear();
        self.container.seal(&mut self.log, Compression::None, &mut self.sealed);
        self.write_buffer.append(&self.sealed);
        self.keep_so_far();
    }

    fn seal_tools(&mut self) {
        self.sealed.clear();
        self.container.seal(&mut self.tools, Compression::Lz4, &mut self.sealed);
        self.write_buffer.append(&self.sealed);
    }

    /// Whether everything due was written.
    pub(super) fn is_sound(&self) -> bool {
        self.gap.is_none() && self.write_buffer.refusal.is_none()
    }

    /// Writes the end of the file; `last` is the last publication. `true` when the file is complete.
    pub(super) fn close(
        mut self,
        buffers: &mut LifeBuffers,
        last: Option<(&Snapshot, StateHash)>,
        permit: WritePermit<'_>,
    ) -> bool {
        if let Some((snapshot, hash)) = last {
            if self.gap.is_some() {
                self.committed(buffers, snapshot, &CommitBuffer::new(), hash, permit);
            } else {
                // The last values of sampled components.
                self.take(|journal| {
                    journal.last_messages_for_tools(snapshot);
                    journal.sample(buffers, snapshot, true)
                });
            }
        }
        self.close_block(buffers);
        let complete = self.complete && self.gap.is_none();
        let end = BTreeMap::from([
            ("revision".to_owned(), self.revision.0.to_string()),
            ("hash".to_owned(), self.stored.head().to_string()),
            ("state_hash".to_owned(), self.hash.to_string()),
            ("time_ns".to_owned(), self.time.as_nanos().to_string()),
            ("complete".to_owned(), complete.to_string()),
        ]);
        self.seal_log();
        self.seal_tools();
        self.sealed.clear();
        self.container.metadata(META_BYTES, &self.counts.metadata(), &mut self.sealed);
        self.container.metadata(META_END, &end, &mut self.sealed);
        self.container.finish(&mut self.sealed);
        self.write_buffer.append(&self.sealed);
        self.write_buffer.drain(permit) && self.write_buffer.sync().is_ok() && complete
    }
}

fn tool_message(tools: &mut OpenChunk, sequence: &mut u32, time: SimTime, channel: u16, value: &Value) {
    *sequence = sequence.wrapping_add(1);
    tools.message(channel, *sequence, time.as_nanos(), value.to_string().as_bytes());
}
