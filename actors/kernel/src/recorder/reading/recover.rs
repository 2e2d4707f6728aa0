//! Recovery of a cut or damaged recording: everything that is whole in it, as a new and closed file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};

use trocar_scene::{Revision, SimTime};

use super::error::RecordingError;
use super::recording::Recording;
use crate::recorder::columns::History;
use crate::recorder::format::{Gap, META, META_END, PROFILE, SCENARIO, SCHEMA, channel};
use crate::recorder::head::{channels, schemas};
use crate::recorder::mcap::bytes::Bytes;
use crate::recorder::mcap::chunk_list::{ChunkPlace, contents};
use crate::recorder::mcap::container::{Container, OpenChunk};
use crate::recorder::mcap::records::{Compression, op};
use crate::recorder::reading::chunk_items::{self, Item, Message, parse_message};
use crate::state_hash::StateHash;

/// What a recovery found.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// Chunks that are whole.
    pub chunks: usize,
    /// Chunks of which something is lost.
    pub damaged_chunks: usize,
    /// What is wrong with the file, and where.
    pub damage: Vec<String>,
    /// The latest time in what is whole.
    pub until: SimTime,
    /// Bytes of the new file.
    pub bytes: u64,
}

/// The new file.
struct Recovery<'a> {
    out: &'a mut dyn Write,
    container: Container,
    bytes: Vec<u8>,
    sequence: u32,
    found: Recovered,
    /// Something was lost since the last whole block.
    lost: Option<String>,
    revision: Revision,
    hashes: Option<(StateHash, StateHash)>,
}

impl Recording {
    /// Writes everything that is whole in the file as a new recording; what is lost becomes a declared gap.
    ///
    /// # Errors
    /// When the file cannot be read, the new one cannot be written, or nothing is whole.
    pub fn recover(&self, out: &mut dyn Write) -> Result<Recovered, RecordingError> {
        let io_error = |source| RecordingError::Io { file: self.path().to_owned(), source };
        let mut file = File::open(self.path()).map_err(io_error)?;
        let contents = contents(&mut file, self.size()).map_err(io_error)?;
        let (mut first, mut bytes) = (OpenChunk::default(), Vec::new());
        let library = concat!("trocar ", env!("CARGO_PKG_VERSION"));
        let mut container =
            Container::begin((PROFILE, library), schemas(), channels(), &mut first, &mut bytes);
        let mut has_head = false;
        for (opcode, _, body) in &contents.records {
            // A record that cannot be read is lost; the reader of this file has told so.
            if *opcode == op::METADATA {
                has_head |= copy_metadata(&mut container, body, &mut bytes).is_ok_and(|name| name == META);
            } else {
                drop(copy_attachment(&mut container, body, &mut bytes));
            }
        }
        if !has_head {
            container.metadata(META, &unknown_head(), &mut bytes);
        }
        container.seal(&mut first, Compression::Lz4, &mut bytes);
        let damage: Vec<String> = self.damage().chain(self.truncation().map(str::to_owned)).collect();
        let mut recovery = Recovery {
            out,
            container,
            bytes,
            sequence: 0,
            found: Recovered { damage, ..Recovered::default() },
            lost: None,
            revision: Revision::ZERO,
            hashes: None,
        };
        let mut between = contents.damage.iter().peekable();
        for place in &contents.chunks {
            while let Some((_, what)) = between.next_if(|(offset, _)| *offset < place.offset) {
                recovery.lost.get_or_insert_with(|| what.clone());
            }
            let body = self.chunk_body(*place)?;
            let records = self.records(&body);
            recovery.chunk(place, records).map_err(RecordingError::Write)?;
        }
        if recovery.hashes.is_none() {
            return Err(RecordingError::NotARecording {
                file: self.path().to_owned(),
                what: "nothing in it is whole".to_owned(),
            });
        }
        recovery.close(self.is_complete()).map_err(RecordingError::Write)
    }
}

impl Recovery<'_> {
    /// Copies what is whole of a chunk.
    fn chunk(&mut self, place: &ChunkPlace, records: Result<Vec<u8>, String>) -> io::Result<()> {
        let records = match records {
            Ok(records) => records,
            Err(error) => {
                self.lose(place, &error);
                return Ok(());
            }
        };
        let (mut chunk, mut history) = (OpenChunk::default(), History::default());
        let mut whole = true;
        for message in chunk_items::messages(&records) {
            let copied = message.and_then(|message| self.message(&message, place, &mut history, &mut chunk));
            if let Err(error) = copied {
                self.lose(place, &error);
                whole = false;
                break;
            }
        }
        self.found.chunks += usize::from(whole);
        let compression = if place.is_log { Compression::None } else { Compression::Lz4 };
        self.container.seal(&mut chunk, compression, &mut self.bytes);
        self.flush()
    }

    fn message(
        &mut self,
        message: &Message<'_>,
        place: &ChunkPlace,
        history: &mut History,
        chunk: &mut OpenChunk,
    ) -> Result<(), String> {
        let item = parse_message(message, history, place.offset)?;
        let first = match &item {
            Some(Item::Commits(group)) => {
                group.commits().next().map(|commit| (commit.revision, commit.provenance.time))
            }
            Some(Item::Keyframe(keyframe)) => Some((keyframe.revision, keyframe.time)),
            _ => None,
        };
        if let Some((revision, time)) = first
            && let Some(reason) = self.lost.take()
        {
            let gap =
                Gap { after: self.revision, until: revision, time, reason: format!("damaged: {reason}") };
            let gap = serde_json::to_vec(&gap).map_err(|error| error.to_string())?;
            self.put(channel::GAPS, time, &gap, chunk);
        }
        match item {
            Some(Item::Commits(group)) => {
                self.revision = group.commits().last().map_or(self.revision, |commit| commit.revision);
                self.hashes = Some((group.hash(), group.state_hash()));
            }
            Some(Item::Keyframe(keyframe)) => {
                self.revision = keyframe.revision;
                self.hashes = Some((keyframe.hash, keyframe.state_hash));
            }
            _ => {}
        }
        self.put(message.channel, message.time, message.data, chunk);
        self.found.until = self.found.until.max(message.time);
        Ok(())
    }

    fn put(&mut self, channel: u16, time: SimTime, data: &[u8], chunk: &mut OpenChunk) {
        self.sequence = self.sequence.wrapping_add(1);
        chunk.message(channel, self.sequence, time.as_nanos(), data);
    }

    fn lose(&mut self, place: &ChunkPlace, what: &str) {
        self.found.damaged_chunks += 1;
        self.found.damage.push(format!("at byte {}: {what}", place.offset));
        if place.is_log {
            self.lost.get_or_insert_with(|| what.to_owned());
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.found.bytes += self.bytes.len() as u64;
        self.out.write_all(&self.bytes)?;
        self.bytes.clear();
        Ok(())
    }

    fn close(mut self, was_complete: bool) -> io::Result<Recovered> {
        let complete = was_complete && self.found.damage.is_empty();
        let (stored, state) = self.hashes.unwrap_or((StateHash([0; 32]), StateHash([0; 32])));
        let end = BTreeMap::from([
            ("revision".to_owned(), self.revision.0.to_string()),
            ("hash".to_owned(), stored.to_string()),
            ("state_hash".to_owned(), state.to_string()),
            ("time_ns".to_owned(), self.found.until.as_nanos().to_string()),
            ("complete".to_owned(), complete.to_string()),
        ]);
        self.container.metadata(META_END, &end, &mut self.bytes);
        let mut last = std::mem::take(&mut self.bytes);
        self.container.finish(&mut last);
        self.found.bytes += last.len() as u64;
        self.out.write_all(&last)?;
        Ok(self.found)
    }
}

/// Copies a metadata record, unless it is the one of a clean close.
fn copy_metadata(container: &mut Container, body: &[u8], out: &mut Vec<u8>) -> Result<String, String> {
    let (name, pairs) = super::metadata::metadata_record(body)?;
    if name != META_END {
        container.metadata(&name, &pairs, out);
    }
    Ok(name)
}

/// The head of a file whose own is lost.
fn unknown_head() -> BTreeMap<String, String> {
    let pairs =
        [("schema", SCHEMA), ("version", "unknown"), ("seed", "0"), ("station", "0"), ("mode", "unknown")];
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned())).collect()
}

fn copy_attachment(container: &mut Container, body: &[u8], out: &mut Vec<u8>) -> Result<(), String> {
    let mut body = Bytes(body);
    body.take(16)?;
    let (name, media_type) = (body.text()?, body.text()?);
    let length = body.u64()?;
    let data = body.take(length)?;
    if name == SCENARIO {
        container.attachment(&name, &media_type, data, out);
    }
    Ok(())
}
