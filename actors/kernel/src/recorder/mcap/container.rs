//! State of the MCAP file written so far: length, checksum and index. Plain data, so that a life that continues after a
//! failure needs nothing else from its predecessor.

use std::collections::BTreeMap;

use crate::recorder::mcap::records::{
    self as records, AttachmentEntry, Channel, ChunkEntry, Compression, MAGIC, MetadataEntry, Schema,
    Statistics, op,
};

/// An open chunk: messages as records, with the data for the chunk's index.
#[derive(Default)]
pub(in crate::recorder) struct OpenChunk {
    records: Vec<u8>,
    /// Channel, time \[ns\] and offset in `records` of each message.
    messages: Vec<(u16, u64, u64)>,
}

/// A position in an open chunk for a roll-back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::recorder) struct Mark {
    bytes: usize,
    messages: usize,
}

impl OpenChunk {
    pub(in crate::recorder) fn message(&mut self, channel: u16, sequence: u32, time: u64, data: &[u8]) {
        self.messages.push((channel, time, self.records.len() as u64));
        records::message(channel, sequence, time, data, &mut self.records);
    }
    pub(in crate::recorder) fn len(&self) -> usize {
        self.records.len()
    }
    /// Whether it holds a declared gap and nothing else, or nothing.
    pub(in crate::recorder) fn holds_only_a_gap(&self) -> bool {
        self.messages.iter().all(|(channel, ..)| *channel == crate::recorder::format::channel::GAPS)
    }
    pub(in crate::recorder) fn mark(&self) -> Mark {
        Mark { bytes: self.records.len(), messages: self.messages.len() }
    }
    /// Removes everything since `mark`, including partial records.
    pub(in crate::recorder) fn roll_back(&mut self, mark: Mark) {
        self.records.truncate(mark.bytes);
        self.messages.truncate(mark.messages);
    }
}

/// A file's length, checksum and index.
pub(in crate::recorder) struct Container {
    schemas: Vec<Schema>,
    channels: Vec<Channel>,
    position: u64,
    crc: crc32fast::Hasher,
    chunks: Vec<ChunkEntry>,
    attachments: Vec<AttachmentEntry>,
    metadata: Vec<MetadataEntry>,
    counts: BTreeMap<u16, u64>,
    bounds: Option<(u64, u64)>,
}

impl Container {
    /// A new file; appends its first bytes to `out`, and schemas and channels to the first chunk.
    pub(in crate::recorder) fn begin(
        (profile, library): (&str, &str),
        schemas: Vec<Schema>,
        channels: Vec<Channel>,
        chunk: &mut OpenChunk,
        out: &mut Vec<u8>,
    ) -> Self {
        schemas.iter().for_each(|schema| records::schema(schema, &mut chunk.records));
        channels.iter().for_each(|channel| records::channel(channel, &mut chunk.records));
        let mut container = Self {
            schemas,
            channels,
            position: 0,
            crc: crc32fast::Hasher::new(),
            chunks: Vec::new(),
            attachments: Vec::new(),
            metadata: Vec::new(),
            counts: BTreeMap::new(),
            bounds: None,
        };
        container.append(out, |out| {
            out.extend_from_slice(MAGIC);
            records::header(profile, library, out);
        });
        container
    }

    /// Lets `body` append to the data section; returns offset and length of the appended bytes.
    fn append(&mut self, out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) -> (u64, u64) {
        let from = out.len();
        body(out);
        let (offset, length) = (self.position, (out.len() - from) as u64);
        self.crc.update(&out[from..]);
        self.position += length;
        (offset, length)
    }

    pub(in crate::recorder) fn metadata(
        &mut self,
        name: &str,
        pairs: &BTreeMap<String, String>,
        out: &mut Vec<u8>,
    ) {
        // MCAP has no checksum for metadata.
        let mut pairs = pairs.clone();
        pairs.insert(CHECKSUM.to_owned(), checksum(&pairs));
        let (offset, length) = self.append(out, |out| records::metadata(name, &pairs, out));
        self.metadata.push(MetadataEntry { offset, length, name: name.to_owned() });
    }

    pub(in crate::recorder) fn attachment(
        &mut self,
        name: &str,
        media_type: &str,
        data: &[u8],
        out: &mut Vec<u8>,
    ) {
        let (offset, length) = self.append(out, |out| records::attachment(name, media_type, data, out));
        self.attachments.push(AttachmentEntry {
            offset,
            length,
            size: data.len() as u64,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
        });
    }

    /// Closes a chunk: appends it with its message indexes to `out` and leaves it empty.
    pub(in crate::recorder) fn seal(
        &mut self,
        chunk: &mut OpenChunk,
        compression: Compression,
        out: &mut Vec<u8>,
    ) {
        if chunk.records.is_empty() {
            return;
        }
        let times = || chunk.messages.iter().map(|(_, time, _)| *time);
        let bounds = (times().min().unwrap_or(0), times().max().unwrap_or(0));
        let mut by_channel = BTreeMap::<u16, Vec<(u64, u64)>>::new();
        for (channel, time, offset) in &chunk.messages {
            by_channel.entry(*channel).or_default().push((*time, *offset));
        }
        let mut packed = 0;
        let (offset, length) =
            self.append(out, |out| packed = records::chunk(bounds, &chunk.records, compression, out));
        let mut indexes = BTreeMap::new();
        for (channel, entries) in &by_channel {
            let (at, _) = self.append(out, |out| records::message_index(*channel, entries, out));
            indexes.insert(*channel, at);
            *self.counts.entry(*channel).or_default() += entries.len() as u64;
        }
        if !chunk.messages.is_empty() {
            let (first, last) = self.bounds.unwrap_or(bounds);
            self.bounds = Some((first.min(bounds.0), last.max(bounds.1)));
        }
        self.chunks.push(ChunkEntry {
            start: bounds.0,
            end: bounds.1,
            offset,
            length,
            indexes_length: self.position - offset - length,
            indexes,
            compression,
            size: chunk.records.len() as u64,
            packed,
        });
        chunk.roll_back(Mark::default());
    }

    /// Appends the end of the file: the summary and the footer.
    pub(in crate::recorder) fn finish(self, out: &mut Vec<u8>) {
        records::data_end(self.crc.clone().finalize(), out);
        let (from, summary_start) = (out.len(), self.position + DATA_END_LENGTH);
        let place = |out: &Vec<u8>| summary_start + (out.len() - from) as u64;
        let mut offsets: Vec<(u8, u64, u64)> = Vec::new();
        let mut group = |opcode: u8, out: &mut Vec<u8>, body: &dyn Fn(&mut Vec<u8>)| {
            let start = place(out);
            body(out);
            if place(out) > start {
                offsets.push((opcode, start, place(out) - start));
            }
        };
        group(op::SCHEMA, out, &|out| self.schemas.iter().for_each(|each| records::schema(each, out)));
        group(op::CHANNEL, out, &|out| self.channels.iter().for_each(|each| records::channel(each, out)));
        let statistics = Statistics {
            schemas: self.schemas.len() as u16,
            channels: self.channels.len() as u32,
            attachments: self.attachments.len() as u32,
            metadata: self.metadata.len() as u32,
            chunks: self.chunks.len() as u32,
            bounds: self.bounds.unwrap_or((0, 0)),
            messages: &self.counts,
        };
        group(op::STATISTICS, out, &|out| records::statistics(&statistics, out));
        group(op::CHUNK_INDEX, out, &|out| {
            self.chunks.iter().for_each(|each| records::chunk_index(each, out));
        });
        group(op::ATTACHMENT_INDEX, out, &|out| {
            self.attachments.iter().for_each(|each| records::attachment_index(each, out));
        });
        group(op::METADATA_INDEX, out, &|out| {
            self.metadata.iter().for_each(|each| records::metadata_index(each, out));
        });
        let offsets_start = place(out);
        for (opcode, start, length) in offsets {
            records::summary_offset(opcode, start, length, out);
        }
        records::footer(from, summary_start, offsets_start, out);
    }
}

/// Key of the checksum of a metadata record.
pub(in crate::recorder) const CHECKSUM: &str = "crc32";

/// The checksum of the other pairs of a metadata record.
pub(in crate::recorder) fn checksum(pairs: &BTreeMap<String, String>) -> String {
    let mut hasher = crc32fast::Hasher::new();
    for text in pairs.iter().flat_map(|(key, value)| [key, value]) {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    }
    format!("{:08x}", hasher.finalize())
}

/// A DataEnd record: opcode, length, checksum.
const DATA_END_LENGTH: u64 = 1 + 8 + 4;
