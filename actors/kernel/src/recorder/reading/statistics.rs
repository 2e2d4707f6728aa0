//! Statistics of a recording: what its bytes are spent on.

use std::collections::BTreeMap;

use miniz_oxide::deflate::compress_to_vec;
use miniz_oxide::inflate::decompress_to_vec_with_limit;
use trocar_scene::SimTime;

use super::error::RecordingError;
use super::recording::Recording;
use crate::recorder::block::{self, HEADS, LEVEL};
use crate::recorder::columns::{History, RowDecoder};
use crate::recorder::format::channel;
use crate::recorder::head::channels;
use crate::recorder::reading::chunk_items::{Message, messages};

/// Things and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bytes {
    /// How many: rows, commits or messages.
    pub count: u64,
    /// Their bytes.
    pub bytes: u64,
}

impl Bytes {
    fn add(&mut self, count: u64, bytes: u64) {
        self.count += count;
        self.bytes += bytes;
    }
    fn parse(text: &str) -> Option<Self> {
        let (count, bytes) = text.split_once(' ')?;
        Some(Self { count: count.parse().ok()?, bytes: bytes.parse().ok()? })
    }
}

/// What a component takes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ComponentBytes {
    /// NAME of the component.
    pub name: String,
    /// How the recording keeps it.
    pub policy: String,
    /// What the session wrote of it, uncompressed; known after a clean close.
    pub committed: Option<Bytes>,
    /// Its rows in blocks, with its share of the compressed bytes.
    pub blocks: Bytes,
    /// Its rows in keyframes, likewise.
    pub keyframes: Bytes,
}

/// What the bytes of a recording are spent on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingStatistics {
    /// Bytes of the file.
    pub file: u64,
    /// The time that it spans.
    pub span: SimTime,
    /// Messages by topic, with their bytes in the file.
    pub topics: BTreeMap<String, Bytes>,
    /// Bytes of everything else: heads and indexes of chunks, metadata.
    pub framing: u64,
    /// Heads of commits in blocks.
    pub heads: Bytes,
    /// By component, those that take most first.
    pub components: Vec<ComponentBytes>,
    /// What each writer committed, uncompressed; known after a clean close.
    pub writers: BTreeMap<String, Bytes>,
    /// What the session committed in all; known after a clean close.
    pub committed: Option<u64>,
}

impl Recording {
    /// What its bytes are spent on. Reads the whole file; damaged chunks count as framing.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn statistics(&self) -> Result<RecordingStatistics, RecordingError> {
        let mut found =
            RecordingStatistics { file: self.size(), span: self.duration(), ..Default::default() };
        let mut components = self.named_components();
        for chunk in self.log_chunks() {
            let Ok(records) = self.records(&self.chunk_body(*chunk)?) else { continue };
            let mut history = History::default();
            for message in messages(&records).flatten() {
                let topic = found.topics.entry(topic(message.channel).to_owned()).or_default();
                topic.add(1, message.data.len() as u64);
                // What does not decode is counted as a message only.
                let _ = count_block(&message, &mut history, &mut found.heads, &mut components);
            }
        }
        for chunk in self.tool_chunks() {
            let body = self.chunk_body(*chunk)?;
            let Ok(records) = self.records(&body) else { continue };
            // Each message gets its share of the packed bytes.
            let share = body.len() as f64 / records.len().max(1) as f64;
            for message in messages(&records).flatten() {
                let topic = found.topics.entry(topic(message.channel).to_owned()).or_default();
                topic.add(1, (message.data.len() as f64 * share) as u64);
            }
        }
        let committed = self.committed_bytes();
        for (key, text) in committed {
            let Some(bytes) = Bytes::parse(text) else { continue };
            if let Some(name) = key.strip_prefix("writer.") {
                found.writers.insert(name.to_owned(), bytes);
            } else if let Some(name) = key.strip_prefix("component.")
                && let Some(component) = components.values_mut().find(|component| component.name == name)
            {
                component.committed = Some(bytes);
            }
        }
        if !committed.is_empty() {
            found.committed = Some(found.writers.values().map(|bytes| bytes.bytes).sum());
        }
        found.framing = found.file.saturating_sub(found.topics.values().map(|bytes| bytes.bytes).sum());
        found.components = components.into_values().collect();
        found.components.retain(|component| {
            component.committed.is_some() || component.blocks.count + component.keyframes.count > 0
        });
        found
            .components
            .sort_by_key(|component| std::cmp::Reverse(component.blocks.bytes + component.keyframes.bytes));
        Ok(found)
    }

    /// The unpacked bodies of its blocks and keyframes; for tests of the decoder.
    ///
    /// # Errors
    /// When the file cannot be read.
    #[doc(hidden)]
    pub fn bodies(&self) -> Result<Vec<Vec<u8>>, RecordingError> {
        let mut bodies = Vec::new();
        for chunk in self.log_chunks() {
            let Ok(records) = self.records(&self.chunk_body(*chunk)?) else { continue };
            for message in messages(&records).flatten() {
                let Ok((packed, length)) = block::packed_body(message.data) else { continue };
                bodies.extend(decompress_to_vec_with_limit(packed, length));
            }
        }
        Ok(bodies)
    }

    /// The components by their keys.
    fn named_components(&self) -> BTreeMap<u64, ComponentBytes> {
        let named = self.metadata().components.iter().filter_map(|(name, text)| {
            let (key, policy) = text.split_once(' ')?;
            let key = u64::from_str_radix(key, 16).ok()?;
            let (name, policy) = (name.clone(), policy.to_owned());
            Some((key, ComponentBytes { name, policy, ..Default::default() }))
        });
        named.collect()
    }
}

fn topic(number: u16) -> &'static str {
    channels().into_iter().find(|channel| channel.id == number).map_or("other", |channel| channel.topic)
}

/// Counts the parts of a block, each with its share of the block's compressed bytes.
fn count_block(
    message: &Message<'_>,
    history: &mut History,
    heads: &mut Bytes,
    components: &mut BTreeMap<u64, ComponentBytes>,
) -> Result<(), String> {
    let is_keyframe = message.channel == channel::KEYFRAMES;
    if !is_keyframe && message.channel != channel::COMMITS {
        return Ok(());
    }
    let (packed, length) = block::packed_body(message.data)?;
    let body = decompress_to_vec_with_limit(packed, length).map_err(|error| error.to_string())?;
    let mut parts = Vec::new();
    let mut decoder = RowDecoder::new(history, &body);
    let mut begin = 0;
    while let Some((key, rows)) = decoder.next()? {
        let end = body.len() - decoder.left();
        let alone = compress_to_vec(&body[begin..end], LEVEL).len();
        parts.push((key, rows.len() as u64, alone as f64));
        begin = end;
    }
    let all: f64 = parts.iter().map(|(_, _, alone)| alone).sum();
    for (key, rows, alone) in parts {
        let bytes = (packed.len() as f64 * alone / all.max(1.0)) as u64;
        if key == HEADS {
            heads.add(rows, bytes);
            continue;
        }
        let unnamed = || ComponentBytes { name: format!("{key:08x}"), ..Default::default() };
        let component = components.entry(key).or_insert_with(unnamed);
        let part = if is_keyframe { &mut component.keyframes } else { &mut component.blocks };
        part.add(rows, bytes);
    }
    Ok(())
}
