//! Encoder of MCAP records (<https://mcap.dev/spec>) for an append-only file.
//!
//! The `mcap` crate's writer keeps the file's index private and finishes the file when it is dropped, so a failed
//! recorder could not be continued. Here each record is a function of plain data. The tests check the result with the
//! crate's reader.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Write;

/// First and last bytes of every file.
pub(in crate::recorder) const MAGIC: &[u8; 8] = b"\x89MCAP0\r\n";

/// Opcodes of the records that are used here.
pub(in crate::recorder) mod op {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const ATTACHMENT_INDEX: u8 = 0x0a;
    pub(crate) const STATISTICS: u8 = 0x0b;
    pub(crate) const METADATA: u8 = 0x0c;
    pub(crate) const METADATA_INDEX: u8 = 0x0d;
    pub(crate) const SUMMARY_OFFSET: u8 = 0x0e;
    pub(crate) const DATA_END: u8 = 0x0f;
}

/// A schema of messages.
pub(in crate::recorder) struct Schema {
    pub(in crate::recorder) id: u16,
    pub(in crate::recorder) name: &'static str,
    pub(in crate::recorder) encoding: &'static str,
    pub(in crate::recorder) data: Vec<u8>,
}

/// A topic; schema 0 means none.
pub(in crate::recorder) struct Channel {
    pub(in crate::recorder) id: u16,
    pub(in crate::recorder) schema: u16,
    pub(in crate::recorder) topic: &'static str,
    pub(in crate::recorder) encoding: &'static str,
}

/// Position and contents of a chunk.
pub(in crate::recorder) struct ChunkEntry {
    pub(in crate::recorder) start: u64,
    pub(in crate::recorder) end: u64,
    pub(in crate::recorder) offset: u64,
    pub(in crate::recorder) length: u64,
    /// Bytes of the message indexes behind it, and the offset of each channel's index.
    pub(in crate::recorder) indexes_length: u64,
    pub(in crate::recorder) indexes: BTreeMap<u16, u64>,
    pub(in crate::recorder) compression: Compression,
    /// Bytes of its records, and in the file.
    pub(in crate::recorder) size: u64,
    pub(in crate::recorder) packed: u64,
}

/// How the records of a chunk are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::recorder) enum Compression {
    /// Not at all: messages of blocks are compressed themselves.
    None,
    /// As an LZ4 frame.
    Lz4,
}

impl Compression {
    pub(in crate::recorder) fn name(self) -> &'static str {
        match self {
            Self::None => "",
            Self::Lz4 => "lz4",
        }
    }
}

/// Position of an attachment.
pub(in crate::recorder) struct AttachmentEntry {
    pub(in crate::recorder) offset: u64,
    pub(in crate::recorder) length: u64,
    pub(in crate::recorder) size: u64,
    pub(in crate::recorder) name: String,
    pub(in crate::recorder) media_type: String,
}

/// Position of a metadata record.
pub(in crate::recorder) struct MetadataEntry {
    pub(in crate::recorder) offset: u64,
    pub(in crate::recorder) length: u64,
    pub(in crate::recorder) name: String,
}

/// Appends one record: its opcode, its length and what `body` appends.
fn record(opcode: u8, out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    out.push(opcode);
    let at = out.len();
    u64(0, out);
    body(out);
    let length = (out.len() - at - 8) as u64;
    out[at..at + 8].copy_from_slice(&length.to_le_bytes());
}

/// Appends the output of `body`, prefixed with its 32-bit length.
fn prefixed(out: &mut Vec<u8>, body: impl FnOnce(&mut Vec<u8>)) {
    let at = out.len();
    u32(0, out);
    body(out);
    let length = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&length.to_le_bytes());
}

fn u16(value: u16, out: &mut Vec<u8>) {
    out.extend_from_slice(&value.to_le_bytes());
}
fn u32(value: u32, out: &mut Vec<u8>) {
    out.extend_from_slice(&value.to_le_bytes());
}
fn u64(value: u64, out: &mut Vec<u8>) {
    out.extend_from_slice(&value.to_le_bytes());
}
fn text(value: &str, out: &mut Vec<u8>) {
    prefixed(out, |out| out.extend_from_slice(value.as_bytes()));
}

pub(in crate::recorder) fn header(profile: &str, library: &str, out: &mut Vec<u8>) {
    record(op::HEADER, out, |out| {
        text(profile, out);
        text(library, out);
    });
}

pub(in crate::recorder) fn schema(schema: &Schema, out: &mut Vec<u8>) {
    record(op::SCHEMA, out, |out| {
        u16(schema.id, out);
        text(schema.name, out);
        text(schema.encoding, out);
        prefixed(out, |out| out.extend_from_slice(&schema.data));
    });
}

pub(in crate::recorder) fn channel(channel: &Channel, out: &mut Vec<u8>) {
    record(op::CHANNEL, out, |out| {
        u16(channel.id, out);
        u16(channel.schema, out);
        text(channel.topic, out);
        text(channel.encoding, out);
        prefixed(out, |_| {});
    });
}

/// `time` \[ns\] is both that of the log and that of the publication.
pub(in crate::recorder) fn message(channel: u16, sequence: u32, time: u64, data: &[u8], out: &mut Vec<u8>) {
    record(op::MESSAGE, out, |out| {
        u16(channel, out);
        u32(sequence, out);
        u64(time, out);
        u64(time, out);
        out.extend_from_slice(data);
    });
}

pub(in crate::recorder) fn metadata(name: &str, pairs: &BTreeMap<String, String>, out: &mut Vec<u8>) {
    record(op::METADATA, out, |out| {
        text(name, out);
        prefixed(out, |out| {
            for (key, value) in pairs {
                text(key, out);
                text(value, out);
            }
        });
    });
}

pub(in crate::recorder) fn attachment(name: &str, media_type: &str, data: &[u8], out: &mut Vec<u8>) {
    record(op::ATTACHMENT, out, |out| {
        let begin = out.len();
        // Log and creation time: the beginning of the session.
        u64(0, out);
        u64(0, out);
        text(name, out);
        text(media_type, out);
        u64(data.len() as u64, out);
        out.extend_from_slice(data);
        u32(crc32fast::hash(&out[begin..]), out);
    });
}

/// A chunk with these records in it, the times of whose messages \[ns\] lie between `start` and `end`. Returns how many
/// bytes the records take.
pub(in crate::recorder) fn chunk(
    (start, end): (u64, u64),
    records: &[u8],
    compression: Compression,
    out: &mut Vec<u8>,
) -> u64 {
    let packed = match compression {
        Compression::None => Cow::Borrowed(records),
        Compression::Lz4 => Cow::Owned(lz4(records)),
    };
    record(op::CHUNK, out, |out| {
        u64(start, out);
        u64(end, out);
        u64(records.len() as u64, out);
        u32(crc32fast::hash(records), out);
        text(compression.name(), out);
        u64(packed.len() as u64, out);
        out.extend_from_slice(&packed);
    });
    packed.len() as u64
}

fn lz4(records: &[u8]) -> Vec<u8> {
    let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
    // Writing into memory does not fail.
    let _ = encoder.write_all(records);
    encoder.finish().unwrap_or_default()
}

/// Time \[ns\] and offset in its chunk of each message of a channel.
pub(in crate::recorder) fn message_index(channel: u16, entries: &[(u64, u64)], out: &mut Vec<u8>) {
    record(op::MESSAGE_INDEX, out, |out| {
        u16(channel, out);
        prefixed(out, |out| {
            for (time, offset) in entries {
                u64(*time, out);
                u64(*offset, out);
            }
        });
    });
}

pub(in crate::recorder) fn chunk_index(entry: &ChunkEntry, out: &mut Vec<u8>) {
    record(op::CHUNK_INDEX, out, |out| {
        u64(entry.start, out);
        u64(entry.end, out);
        u64(entry.offset, out);
        u64(entry.length, out);
        prefixed(out, |out| {
            for (channel, offset) in &entry.indexes {
                u16(*channel, out);
                u64(*offset, out);
            }
        });
        u64(entry.indexes_length, out);
        text(entry.compression.name(), out);
        u64(entry.packed, out);
        u64(entry.size, out);
    });
}

pub(in crate::recorder) fn attachment_index(entry: &AttachmentEntry, out: &mut Vec<u8>) {
    record(op::ATTACHMENT_INDEX, out, |out| {
        u64(entry.offset, out);
        u64(entry.length, out);
        u64(0, out);
        u64(0, out);
        u64(entry.size, out);
        text(&entry.name, out);
        text(&entry.media_type, out);
    });
}

pub(in crate::recorder) fn metadata_index(entry: &MetadataEntry, out: &mut Vec<u8>) {
    record(op::METADATA_INDEX, out, |out| {
        u64(entry.offset, out);
        u64(entry.length, out);
        text(&entry.name, out);
    });
}

/// Counts for the statistics record.
pub(in crate::recorder) struct Statistics<'a> {
    pub(in crate::recorder) schemas: u16,
    pub(in crate::recorder) channels: u32,
    pub(in crate::recorder) attachments: u32,
    pub(in crate::recorder) metadata: u32,
    pub(in crate::recorder) chunks: u32,
    /// Times of the first and the last message \[ns\].
    pub(in crate::recorder) bounds: (u64, u64),
    pub(in crate::recorder) messages: &'a BTreeMap<u16, u64>,
}

pub(in crate::recorder) fn statistics(counts: &Statistics<'_>, out: &mut Vec<u8>) {
    record(op::STATISTICS, out, |out| {
        u64(counts.messages.values().sum(), out);
        u16(counts.schemas, out);
        u32(counts.channels, out);
        u32(counts.attachments, out);
        u32(counts.metadata, out);
        u32(counts.chunks, out);
        u64(counts.bounds.0, out);
        u64(counts.bounds.1, out);
        prefixed(out, |out| {
            for (channel, count) in counts.messages {
                u16(*channel, out);
                u64(*count, out);
            }
        });
    });
}

pub(in crate::recorder) fn data_end(crc: u32, out: &mut Vec<u8>) {
    record(op::DATA_END, out, |out| u32(crc, out));
}

pub(in crate::recorder) fn summary_offset(opcode: u8, start: u64, length: u64, out: &mut Vec<u8>) {
    record(op::SUMMARY_OFFSET, out, |out| {
        out.push(opcode);
        u64(start, out);
        u64(length, out);
    });
}

/// The footer and the closing magic. `summary` is where in `out` the summary begins: the footer's checksum covers
/// everything from there.
pub(in crate::recorder) fn footer(summary: usize, summary_start: u64, offsets_start: u64, out: &mut Vec<u8>) {
    record(op::FOOTER, out, |out| {
        u64(summary_start, out);
        u64(offsets_start, out);
        u32(0, out);
    });
    let at = out.len() - 4;
    // The checksum includes the record's length, which is already written.
    let crc = crc32fast::hash(&out[summary..at]);
    out[at..].copy_from_slice(&crc.to_le_bytes());
    out.extend_from_slice(MAGIC);
}
