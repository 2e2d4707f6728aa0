//! Reader of recordings, also of truncated and damaged ones: its parts are listed once, and each chunk is read when it
//! is needed. What is not whole is reported, and the rest is used.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use trocar_scene::{Component, ComponentError, Entity, EntityAllocator, Registry, SimTime, Snapshot};

use super::chunk_items::{self, Item, parse_chunk};
use super::error::RecordingError;
use super::metadata::{Metadata, RecordingEnd, RecordingMetadata};
use crate::recorder::format::SCHEMA;
use crate::recorder::mcap::chunk_list::{ChunkPlace, Contents, contents};
use crate::recorder::mcap::records::MAGIC;

/// An opened recording.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    size: u64,
    metadata: Metadata,
    /// Chunks with blocks, keyframes and gaps.
    chunks: Vec<ChunkPlace>,
    /// Chunks with messages for tools.
    tool_chunks: Vec<ChunkPlace>,
    truncation: Option<String>,
    /// The file has no checksums.
    unchecked: bool,
    /// Damaged places between the chunks.
    damage: Vec<(u64, String)>,
}

impl Recording {
    /// Opens a file and lists its parts; its chunks are read when they are needed.
    ///
    /// # Errors
    /// [`RecordingError`]; a truncated or damaged file still opens, see [`Self::truncation`] and [`Self::damage`].
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let io_error = |source| RecordingError::Io { file: path.to_owned(), source };
        let not_a_recording =
            |what: &str| RecordingError::NotARecording { file: path.to_owned(), what: what.to_owned() };
        let mut file = File::open(path).map_err(io_error)?;
        let size = file.metadata().map_err(io_error)?.len();
        let mut magic = [0; 8];
        file.read_exact(&mut magic).map_err(|_| not_a_recording("it is shorter than a header"))?;
        if magic != *MAGIC {
            return Err(not_a_recording("it is no MCAP file"));
        }
        let Contents { chunks, records, truncation, damage } = contents(&mut file, size).map_err(io_error)?;
        let (chunks, tool_chunks) = chunks.into_iter().partition(|chunk| chunk.is_log);
        let mut recording = Self {
            path: path.to_owned(),
            size,
            metadata: Metadata::default(),
            chunks,
            tool_chunks,
            truncation,
            unchecked: false,
            damage,
        };
        recording.unchecked = recording.has_no_checksums()?;
        for (opcode, offset, body) in records {
            if let Err(message) = recording.metadata.note(opcode, &body) {
                recording.damage.push((offset, message));
            }
        }
        match recording.metadata.schema.take() {
            Some(found) if found != SCHEMA => Err(RecordingError::Schema {
                file: path.to_owned(),
                found,
                version: recording.metadata.head.version,
            }),
            // Where the head is damaged, the chunks can be read all the same.
            None if recording.damage.is_empty() || recording.chunks.is_empty() => {
                Err(not_a_recording("it has no metadata 'trocar'"))
            }
            _ => Ok(recording),
        }
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }
    /// The metadata at its head.
    pub fn metadata(&self) -> &RecordingMetadata {
        &self.metadata.head
    }
    /// The final metadata, after a clean close.
    pub fn end(&self) -> Option<&RecordingEnd> {
        self.metadata.end.as_ref()
    }
    /// Bytes in the file.
    pub fn size(&self) -> u64 {
        self.size
    }
    /// After a clean close: bytes of all commits before anything was left out, as `component.NAME`, `writer.NAME` and
    /// `rest`, each with the number of puts or commits and their bytes.
    pub fn committed_bytes(&self) -> &BTreeMap<String, String> {
        &self.metadata.bytes
    }
    /// Damaged places outside the chunks; damage within them is found as they are read.
    pub fn damage(&self) -> impl Iterator<Item = String> + '_ {
        self.damage.iter().map(|(offset, what)| format!("at byte {offset}: {what}"))
    }
    /// Where and how the file was truncated, if it was; everything before that is usable.
    pub fn truncation(&self) -> Option<&str> {
        self.truncation.as_deref()
    }
    /// Whether it was closed cleanly with nothing missing.
    pub fn is_complete(&self) -> bool {
        self.truncation.is_none()
            && self.damage.is_empty()
            && self.metadata.end.as_ref().is_some_and(|end| end.complete)
    }
    /// The latest time in the recording.
    pub fn duration(&self) -> SimTime {
        let chunks = self.chunks.iter().chain(&self.tool_chunks);
        chunks.map(|chunk| chunk.end).max().unwrap_or_default()
    }

    /// The items in order, from the beginning.
    pub fn items(&self) -> impl Iterator<Item = Result<Item, RecordingError>> + '_ {
        self.items_from_chunk(0)
    }

    /// The items in order, from the start of the chunk that holds the last keyframe at or before `time`, so that the
    /// scene at `time` can be rebuilt.
    ///
    /// # Errors
    /// [`RecordingError`] while looking for that keyframe.
    pub fn seek(
        &self,
        time: SimTime,
    ) -> Result<impl Iterator<Item = Result<Item, RecordingError>> + '_, RecordingError> {
        let before = |chunk: &ChunkPlace| chunk.start <= time;
        // In file order, so that only chunks near the wanted one are looked into.
        let candidates = (0..self.chunks.len()).rev().filter(|index| before(&self.chunks[*index]));
        let mut from = 0;
        for index in candidates.filter(|index| self.chunks[*index].is_keyframe) {
            let items = self.read_chunk(index)?;
            if items.iter().any(|item| matches!(item, Item::Keyframe(keyframe) if keyframe.time <= time)) {
                from = index;
                break;
            }
        }
        Ok(self.items_from_chunk(from))
    }

    /// The scene at `time`: everything that was committed up to then. Derived components have their values of the last
    /// keyframe before.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn snapshot_at(&self, registry: &Arc<Registry>, time: SimTime) -> Result<Snapshot, RecordingError> {
        let mut replay = crate::recorder::Replay::seek(self, registry, time)?;
        replay.advance_to(time)?;
        Ok(replay.view().clone())
    }

    /// Every recorded value of a component of an entity, with the time of the batch that wrote it, for example the hand
    /// on a device. Values before the first commit are those of the first keyframe, at its time.
    ///
    /// # Errors
    /// [`RecordingError`].
    pub fn series<T: Component>(
        &self,
        registry: &Arc<Registry>,
        entity: Entity,
    ) -> Result<Vec<(SimTime, T)>, RecordingError> {
        let mut series: Vec<(SimTime, T)> = Vec::new();
        let mut commands = trocar_scene::Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut fresh = true;
        for item in self.items() {
            match item? {
                Item::Gap(_) | Item::Damage(_) => fresh = true,
                Item::Keyframe(keyframe) if fresh => {
                    fresh = false;
                    let store = keyframe
                        .load(registry)
                        .map_err(|error| self.damaged(keyframe.offset(), error.to_string()))?;
                    if let Some(value) = store.view().get::<T>(entity) {
                        series.push((keyframe.time, value.clone()));
                    }
                }
                Item::Keyframe(_) => {}
                Item::Commits(group) => {
                    for commit in group.commits() {
                        commands.clear();
                        commands
                            .decode(commit.payload)
                            .map_err(|error| self.undecodable(commit.revision.0, &error))?;
                        let rows = commands
                            .puts()
                            .filter_map(|(_, puts)| puts.as_any().downcast_ref::<trocar_scene::Puts<T>>());
                        for (of, value) in rows.flat_map(|puts| puts.rows()) {
                            if *of == entity {
                                series.push((commit.provenance.time, value.clone()));
                            }
                        }
                    }
                }
            }
        }
        Ok(series)
    }

    /// Checks that a session's components include those of the recording.
    ///
    /// # Errors
    /// [`RecordingError::UnknownComponents`].
    pub fn check_components(&self, registry: &Registry) -> Result<(), RecordingError> {
        let names = self.metadata.head.components.keys();
        let unknown: Vec<&str> =
            names.map(String::as_str).filter(|name| registry.by_name(name).is_err()).collect();
        if unknown.is_empty() {
            Ok(())
        } else {
            Err(RecordingError::UnknownComponents { file: self.path.clone(), names: unknown.join(", ") })
        }
    }

    fn items_from_chunk(&self, from: usize) -> impl Iterator<Item = Result<Item, RecordingError>> + '_ {
        (from..self.chunks.len()).flat_map(move |index| {
            // Damage between this chunk and the one before it.
            let before = if index == 0 { 0 } else { self.chunks[index - 1].offset };
            let between = before..self.chunks[index].offset;
            let damage =
                self.damage.iter().filter(move |(offset, _)| index > from && between.contains(offset));
            let mut items: Vec<_> =
                damage.map(|(offset, what)| Ok(chunk_items::damage(*offset, what))).collect();
            match self.read_chunk(index) {
                Ok(read) => items.extend(read.into_iter().map(Ok)),
                Err(error) => items.push(Err(error)),
            }
            items
        })
    }

    fn read_chunk(&self, index: usize) -> Result<Vec<Item>, RecordingError> {
        let chunk = self.chunks[index];
        Ok(parse_chunk(&self.chunk_body(chunk)?, self.unchecked, chunk.offset))
    }

    /// The messages for tools, in order, as channel, time and data; damaged chunks are left out.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn tool_messages(&self, visit: &mut dyn FnMut(u16, SimTime, &[u8])) -> Result<(), RecordingError> {
        for chunk in &self.tool_chunks {
            let Ok(records) = self.records(&self.chunk_body(*chunk)?) else { continue };
            for message in chunk_items::messages(&records).flatten() {
                visit(message.channel, message.time, message.data);
            }
        }
        Ok(())
    }

    /// Whether neither the first chunk nor the last has a checksum.
    fn has_no_checksums(&self) -> Result<bool, RecordingError> {
        for chunk in self.chunks.first().into_iter().chain(self.chunks.last()) {
            let head = ChunkPlace { length: 28, ..*chunk };
            if self.chunk_body(head)?.get(24..28) != Some(&[0; 4]) {
                return Ok(false);
            }
        }
        Ok(!self.chunks.is_empty())
    }

    /// The records of a chunk, unpacked and checked.
    pub(in crate::recorder) fn records(&self, body: &[u8]) -> Result<Vec<u8>, String> {
        chunk_items::records(body, self.unchecked)
    }

    pub(in crate::recorder) fn log_chunks(&self) -> &[ChunkPlace] {
        &self.chunks
    }
    pub(in crate::recorder) fn tool_chunks(&self) -> &[ChunkPlace] {
        &self.tool_chunks
    }

    pub(in crate::recorder) fn chunk_body(&self, chunk: ChunkPlace) -> Result<Vec<u8>, RecordingError> {
        let io_error = |source| RecordingError::Io { file: self.path.clone(), source };
        let mut file = File::open(&self.path).map_err(io_error)?;
        file.seek(SeekFrom::Start(chunk.offset + 9)).map_err(io_error)?;
        let mut body = Vec::new();
        file.take(chunk.length).read_to_end(&mut body).map_err(io_error)?;
        Ok(body)
    }

    pub(in crate::recorder) fn damaged(&self, offset: u64, message: String) -> RecordingError {
        RecordingError::Damaged { file: self.path.clone(), offset, message }
    }

    pub(in crate::recorder) fn undecodable(&self, revision: u64, error: &ComponentError) -> RecordingError {
        self.damaged(0, format!("the commit of revision {revision}: {error}"))
    }
}
