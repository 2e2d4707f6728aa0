//! Writes a recording, on whatever thread calls it.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapResult, WriteOptions, Writer};
use serde_json::Value;
use thiserror::Error;
use trocar_scene::{RecordPolicy, Revision, SimTime, Snapshot};

use super::format::{
    COMMITS, COMPONENT, EVENTS, GAPS, Gap, KEYFRAMES, META, META_DEVICES, META_END, PROFILE, SCENARIO,
    SCHEMA, TF, encode_group, encode_keyframe_header,
};
use super::side::{self, EVENT_SCHEMA, Frames, TF_SCHEMA};
use super::spool::{Spool, SpoolEnd};
use crate::chain::StateHash;
use crate::commit::CommitBuffer;

/// What stands at the head of a recording.
#[derive(Clone, Debug, Default)]
pub struct RecordingHead {
    /// Name of the scenario.
    pub scenario: String,
    /// Its text, as it was run.
    pub scenario_text: String,
    /// The session's seed.
    pub seed: u64,
    /// This station's number.
    pub station: u16,
    /// How it was run: `live` or `lockstep`.
    pub mode: String,
    /// Capabilities of each device by name.
    pub devices: BTreeMap<String, Value>,
    /// Whatever else a reader may want to know.
    pub extra: BTreeMap<String, String>,
}

/// How a recording is written.
#[derive(Clone, Copy, Debug)]
pub struct RecorderOptions {
    /// Time from one keyframe to the next.
    pub keyframe_period: SimTime,
    /// Time from one set of poses on `/tf` to the next.
    pub tf_period: SimTime,
    /// Longest time for which something stays in memory only.
    pub flush_period: SimTime,
    /// Most bytes that may wait for the disk; what comes on top is a gap.
    pub backlog_max: usize,
    /// Most publications that may wait for the recorder's thread; what comes on top is a gap.
    pub queue_max: usize,
}

impl Default for RecorderOptions {
    fn default() -> Self {
        Self {
            keyframe_period: SimTime::from_millis(5_000),
            tf_period: SimTime(33_333_333),
            flush_period: SimTime::from_millis(500),
            backlog_max: 64 << 20,
            queue_max: 4_096,
        }
    }
}

/// A recording that cannot begin.
#[derive(Debug, Error)]
pub enum RecorderError {
    /// The file cannot be created.
    #[error("recording '{}': {source}", file.display())]
    Create {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The head cannot be written.
    #[error("recording '{}': {message}", file.display())]
    Head {
        /// The file.
        file: PathBuf,
        /// Why.
        message: String,
    },
}

struct Channels {
    commits: u16,
    keyframes: u16,
    gaps: u16,
    tf: u16,
    events: u16,
}

/// A recording in the making.
pub(super) struct RecordWriter {
    mcap: Writer<SpoolEnd>,
    spool: SpoolEnd,
    channels: Channels,
    sequence: u32,
    options: RecorderOptions,
    scratch: Vec<u8>,
    frames: Frames,
    revision: Revision,
    hash: StateHash,
    time: SimTime,
    event_cursor: u64,
    tf_revision: Revision,
    next_keyframe: SimTime,
    next_tf: SimTime,
    next_flush: SimTime,
    /// Since which revision nothing could be written, and why.
    gap: Option<String>,
    complete: bool,
}

impl RecordWriter {
    /// Writes the head and the first keyframe.
    pub(super) fn begin(
        spool: Spool,
        head: &RecordingHead,
        scene: &Snapshot,
        hash: StateHash,
        options: RecorderOptions,
    ) -> Result<Self, String> {
        let text = |error: mcap::McapError| error.to_string();
        let spool = SpoolEnd::new(spool);
        let mut mcap = WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("trocar ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(1 << 20))
            // Whole chunks are appended at once, so that a crash leaves only whole chunks behind.
            .disable_seeking(true)
            .create(spool.clone())
            .map_err(text)?;
        write_head(&mut mcap, head, scene).map_err(text)?;
        let channels = add_channels(&mut mcap).map_err(text)?;
        let mut writer = Self {
            mcap,
            spool,
            channels,
            sequence: 0,
            options,
            scratch: Vec::new(),
            frames: Frames::default(),
            revision: scene.revision(),
            hash,
            time: SimTime::ZERO,
            event_cursor: scene.events().next(),
            tf_revision: Revision::ZERO,
            next_keyframe: SimTime::ZERO,
            next_tf: SimTime::ZERO,
            next_flush: options.flush_period,
            gap: None,
            complete: true,
        };
        writer.keyframe(scene).map_err(text)?;
        writer.flush();
        let refusal = writer.spool.lock().refusal.take();
        refusal.map_or(Ok(writer), |error| Err(error.to_string()))
    }

    /// One publication. What cannot be taken becomes part of a gap.
    pub(super) fn committed(&mut self, snapshot: &Arc<Snapshot>, commits: &CommitBuffer, hash: StateHash) {
        self.time = self.time.max(snapshot.time());
        if self.gap.is_none() && self.backlog() > self.options.backlog_max {
            let reason = self.spool.lock().refusal.as_ref().map(ToString::to_string);
            self.begin_gap(reason.unwrap_or_else(|| "the disk is too slow".to_owned()));
        }
        if self.gap.is_some() {
            self.drain();
            if self.backlog() > self.options.backlog_max / 2 {
                return;
            }
            self.end_gap(snapshot, hash);
        } else if !commits.is_empty() {
            self.hash = hash;
            self.write_commits(snapshot, commits);
        }
        if self.time >= self.next_flush {
            self.next_flush = self.time + self.options.flush_period;
            self.flush();
        } else if self.backlog() > 0 {
            self.drain();
        }
    }

    fn write_commits(&mut self, snapshot: &Snapshot, commits: &CommitBuffer) {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        encode_group(commits, self.hash, &mut scratch);
        let written = self.message(self.channels.commits, &scratch);
        self.scratch = scratch;
        self.revision = snapshot.revision();
        let written = written.and_then(|()| self.side_channels(snapshot));
        let written = written
            .and_then(|()| if self.time >= self.next_keyframe { self.keyframe(snapshot) } else { Ok(()) });
        if let Err(error) = written {
            // The spool takes everything, so this is a value that cannot be encoded.
            self.begin_gap(error.to_string());
        }
    }

    /// From here on commits are missing, until [`Self::end_gap`].
    pub(super) fn begin_gap(&mut self, reason: String) {
        self.complete = false;
        self.gap.get_or_insert(reason);
    }

    fn end_gap(&mut self, snapshot: &Snapshot, hash: StateHash) {
        let Some(reason) = self.gap.take() else { return };
        let gap = Gap { after: self.revision, until: snapshot.revision(), time: self.time, reason };
        let (revision, json) = (gap.until, serde_json::to_vec(&gap).unwrap_or_default());
        self.revision = revision;
        self.hash = hash;
        self.event_cursor = snapshot.events().next();
        let written = self.message(self.channels.gaps, &json).and_then(|()| self.keyframe(snapshot));
        if let Err(error) = written {
            self.begin_gap(error.to_string());
        }
    }

    fn keyframe(&mut self, scene: &Snapshot) -> McapResult<()> {
        let mut scratch = std::mem::take(&mut self.scratch);
        scratch.clear();
        encode_keyframe_header(self.hash, &mut scratch);
        let encoded = scene.encode(&mut scratch);
        let written = match encoded {
            Ok(()) => self.message(self.channels.keyframes, &scratch),
            Err(error) => Err(mcap::McapError::Io(std::io::Error::other(error.to_string()))),
        };
        self.scratch = scratch;
        self.next_keyframe = self.time + self.options.keyframe_period;
        // A viewer that begins here gets all frames.
        self.tf_revision = Revision::ZERO;
        written
    }

    fn side_channels(&mut self, scene: &Snapshot) -> McapResult<()> {
        let events: Vec<Value> =
            scene.events().since(self.event_cursor).map(|(_, event)| side::event(scene, event)).collect();
        self.event_cursor = scene.events().next();
        for event in events {
            self.message(self.channels.events, event.to_string().as_bytes())?;
        }
        if self.time >= self.next_tf {
            // From the due time, so that publications between two of them do not slow the rate down.
            let next = self.next_tf + self.options.tf_period;
            self.next_tf = if next < self.time { self.time + self.options.tf_period } else { next };
            if let Some(transforms) = self.frames.transforms(scene, self.tf_revision, self.time) {
                self.message(self.channels.tf, transforms.to_string().as_bytes())?;
            }
            self.tf_revision = scene.revision();
        }
        Ok(())
    }

    fn message(&mut self, channel_id: u16, data: &[u8]) -> McapResult<()> {
        self.sequence = self.sequence.wrapping_add(1);
        let time = self.time.as_nanos();
        let header =
            MessageHeader { channel_id, sequence: self.sequence, log_time: time, publish_time: time };
        self.mcap.write_to_known_channel(&header, data)
    }

    /// Ends the chunk and gives the disk what it takes.
    pub(super) fn flush(&mut self) {
        if let Err(error) = self.mcap.flush() {
            self.begin_gap(error.to_string());
        }
        self.drain();
    }

    fn drain(&mut self) {
        self.spool.lock().drain();
    }

    fn backlog(&self) -> usize {
        self.spool.lock().backlog()
    }

    /// Fault hook: the disk takes nothing while `full`.
    pub(super) fn set_disk_full(&mut self, full: bool) {
        self.spool.lock().full = full;
    }

    /// Whether the disk takes what it is given.
    pub(super) fn is_sound(&self) -> bool {
        self.gap.is_none() && self.spool.lock().refusal.is_none()
    }

    /// Writes the end; `true` when nothing is missing in the file.
    pub(super) fn close(mut self) -> bool {
        let complete = self.complete && self.gap.is_none();
        let end = BTreeMap::from([
            ("revision".to_owned(), self.revision.0.to_string()),
            ("hash".to_owned(), self.hash.to_string()),
            ("time_ns".to_owned(), self.time.as_nanos().to_string()),
            ("complete".to_owned(), complete.to_string()),
        ]);
        let written = self
            .mcap
            .write_metadata(&Metadata { name: META_END.to_owned(), metadata: end })
            .and_then(|()| self.mcap.finish().map(|_| ()));
        let mut spool = self.spool.lock();
        let drained = spool.drain();
        written.is_ok() && drained && spool.sync().is_ok() && complete
    }
}

fn write_head(mcap: &mut Writer<SpoolEnd>, head: &RecordingHead, scene: &Snapshot) -> McapResult<()> {
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
    mcap.write_metadata(&Metadata { name: META.to_owned(), metadata: meta })?;
    let devices = head.devices.iter().map(|(name, device)| (name.clone(), device.to_string())).collect();
    mcap.write_metadata(&Metadata { name: META_DEVICES.to_owned(), metadata: devices })?;
    mcap.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: SCENARIO.to_owned(),
        media_type: "application/toml".to_owned(),
        data: head.scenario_text.as_bytes().into(),
    })
}

fn add_channels(mcap: &mut Writer<SpoolEnd>) -> McapResult<Channels> {
    let none = BTreeMap::new();
    let tf = mcap.add_schema(TF_SCHEMA, "jsonschema", side::tf_schema().to_string().as_bytes())?;
    let event = mcap.add_schema(EVENT_SCHEMA, "jsonschema", side::event_schema().to_string().as_bytes())?;
    Ok(Channels {
        commits: mcap.add_channel(0, COMMITS, "trocar-postcard", &none)?,
        keyframes: mcap.add_channel(0, KEYFRAMES, "trocar-postcard", &none)?,
        gaps: mcap.add_channel(0, GAPS, "json", &none)?,
        tf: mcap.add_channel(tf, TF, "json", &none)?,
        events: mcap.add_channel(event, EVENTS, "json", &none)?,
    })
}
