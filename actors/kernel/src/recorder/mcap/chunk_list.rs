//! List of a recording's chunks: from the summary at the end of the file, or, where there is none, from a walk through
//! its records. Behind damage the walk goes on at the next chunk.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

use trocar_scene::SimTime;

use crate::recorder::format::channel;
use crate::recorder::mcap::bytes::Bytes;
use crate::recorder::mcap::records::{MAGIC, op};

/// Longest chunk that is read into memory; ours are about 1 MiB unless one keyframe is larger.
pub(in crate::recorder) const CHUNK_MAX: u64 = 1 << 30;
/// Longest other record that is read.
const RECORD_MAX: u64 = 64 << 20;
/// Bytes of a record before its content.
const HEAD: u64 = 9;
/// Bytes of the footer with the closing magic.
const FOOTER: u64 = HEAD + 20 + 8;
/// Bytes that are searched at a time behind damage.
const WINDOW: usize = 1 << 20;

/// A chunk of the file.
#[derive(Clone, Copy, Debug)]
pub(in crate::recorder) struct ChunkPlace {
    pub(in crate::recorder) offset: u64,
    /// Bytes of its content.
    pub(in crate::recorder) length: u64,
    pub(in crate::recorder) start: SimTime,
    pub(in crate::recorder) end: SimTime,
    /// Whether it holds blocks, keyframes or gaps.
    pub(in crate::recorder) is_log: bool,
    /// Whether it begins with a keyframe.
    pub(in crate::recorder) is_keyframe: bool,
}

/// What a file holds at its top level.
#[derive(Debug, Default)]
pub(in crate::recorder) struct Contents {
    pub(in crate::recorder) chunks: Vec<ChunkPlace>,
    /// Metadata and attachments: opcode, offset and content.
    pub(in crate::recorder) records: Vec<(u8, u64, Vec<u8>)>,
    /// Where the file was cut off.
    pub(in crate::recorder) truncation: Option<String>,
    /// Damaged places, with their offsets.
    pub(in crate::recorder) damage: Vec<(u64, String)>,
}

/// Finds the chunks and the other parts.
pub(in crate::recorder) fn contents(file: &mut File, size: u64) -> io::Result<Contents> {
    match from_summary(file, size)? {
        Some(contents) => Ok(contents),
        None => from_walk(file, size),
    }
}

fn read_at(file: &mut File, offset: u64, length: u64) -> io::Result<Vec<u8>> {
    file.seek(SeekFrom::Start(offset))?;
    let mut bytes = Vec::new();
    file.take(length).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Reads the summary; `None` when there is none, or it is not whole.
fn from_summary(file: &mut File, size: u64) -> io::Result<Option<Contents>> {
    if size < 8 + FOOTER {
        return Ok(None);
    }
    let footer = read_at(file, size - FOOTER, FOOTER)?;
    if footer[0] != op::FOOTER || footer[FOOTER as usize - 8..] != *MAGIC {
        return Ok(None);
    }
    let mut fields = Bytes(&footer[HEAD as usize..]);
    let (Ok(start), Ok(_), Ok(crc)) = (fields.u64(), fields.u64(), fields.u32()) else { return Ok(None) };
    let end = size - FOOTER;
    if start == 0 || start >= end || end - start > RECORD_MAX {
        return Ok(None);
    }
    let summary = read_at(file, start, end - start)?;
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&summary);
    // The checksum covers the footer as well, up to itself.
    hasher.update(&footer[..HEAD as usize + 16]);
    if hasher.finalize() != crc {
        return Ok(None);
    }
    let mut contents = Contents::default();
    if read_summary(&summary, size, &mut contents).is_err() {
        return Ok(None);
    }
    for (opcode, offset, length) in indexed(&summary) {
        if !(HEAD..=RECORD_MAX).contains(&length) {
            continue;
        }
        let record = read_at(file, offset, length)?;
        let is_whole = record.len() as u64 == length
            && record[0] == opcode
            && record[1..HEAD as usize] == (length - HEAD).to_le_bytes();
        if is_whole {
            contents.records.push((opcode, offset, record[HEAD as usize..].to_vec()));
        } else {
            contents.damage.push((offset, "a record is not where the summary says".to_owned()));
        }
    }
    Ok(Some(contents))
}

fn records_of(mut summary: Bytes<'_>) -> impl Iterator<Item = (u8, Bytes<'_>)> {
    std::iter::from_fn(move || {
        let opcode = summary.u8().ok()?;
        let length = summary.u64().ok()?;
        Some((opcode, Bytes(summary.take(length).ok()?)))
    })
}

/// Reads the indexes of the chunks.
fn read_summary(summary: &[u8], size: u64, contents: &mut Contents) -> Result<(), String> {
    for (_, mut index) in records_of(Bytes(summary)).filter(|(opcode, _)| *opcode == op::CHUNK_INDEX) {
        let (start, end) = (SimTime(index.u64()?), SimTime(index.u64()?));
        let (offset, length) = (index.u64()?, index.u64()?);
        let length_of_map = index.u32()?;
        let mut channels = Bytes(index.take(u64::from(length_of_map))?);
        let (mut is_log, mut is_keyframe) = (false, false);
        while !channels.0.is_empty() {
            let channel = channels.u16()?;
            channels.u64()?;
            note_channel(channel, &mut is_log, &mut is_keyframe);
        }
        let whole =
            length.checked_sub(HEAD).filter(|_| offset.checked_add(length).is_some_and(|end| end <= size));
        let length = whole.ok_or("a chunk outside the file")?;
        contents.chunks.push(ChunkPlace { offset, length, start, end, is_log, is_keyframe });
    }
    contents.chunks.sort_by_key(|chunk| chunk.offset);
    Ok(())
}

fn note_channel(channel: u16, is_log: &mut bool, is_keyframe: &mut bool) {
    *is_log |= matches!(channel, channel::COMMITS | channel::KEYFRAMES | channel::GAPS);
    *is_keyframe |= channel == channel::KEYFRAMES;
}

/// Opcode, offset and length of the metadata and attachments that a summary lists.
fn indexed(summary: &[u8]) -> Vec<(u8, u64, u64)> {
    let places = records_of(Bytes(summary)).filter_map(|(opcode, mut index)| match opcode {
        op::METADATA_INDEX => Some((op::METADATA, index.u64().ok()?, index.u64().ok()?)),
        op::ATTACHMENT_INDEX => Some((op::ATTACHMENT, index.u64().ok()?, index.u64().ok()?)),
        _ => None,
    });
    places.collect()
}

/// Walks through the records.
fn from_walk(file: &mut File, size: u64) -> io::Result<Contents> {
    let mut contents = Contents::default();
    let mut offset = MAGIC.len() as u64;
    let mut has_footer = false;
    while !has_footer {
        if offset + HEAD > size {
            contents.truncation = Some(format!("the file ends at byte {size} without a footer"));
            break;
        }
        let head = read_at(file, offset, HEAD)?;
        let length = Bytes(&head[1..]).u64().unwrap_or(u64::MAX);
        let is_known = (op::HEADER..=op::DATA_END).contains(&head[0]);
        let is_long = head[0] == op::CHUNK || head[0] == op::MESSAGE_INDEX;
        let is_sound = is_known && length <= if is_long { CHUNK_MAX } else { RECORD_MAX };
        if !is_sound || length > size - offset - HEAD {
            // A length that is too large is damage, or the last record of a file that was cut off.
            let next = next_chunk(file, offset + 1, size)?;
            if next.is_none() && is_sound {
                let what = format!("the file ends at byte {size} in the middle of the record at {offset}");
                contents.truncation = Some(what);
                break;
            }
            contents.damage.push((offset, "no record begins here".to_owned()));
            let Some(next) = next else {
                contents.truncation = Some(format!("the file ends at byte {size} without a footer"));
                break;
            };
            offset = next;
            continue;
        }
        match head[0] {
            op::FOOTER => has_footer = true,
            op::CHUNK => {
                let times = read_at(file, offset + HEAD, 16)?;
                let mut fields = Bytes(&times);
                let (start, end) = (fields.u64().unwrap_or(0), fields.u64().unwrap_or(0));
                let (start, end) = (SimTime(start), SimTime(end));
                let place = ChunkPlace { offset, length, start, end, is_log: false, is_keyframe: false };
                contents.chunks.push(place);
            }
            op::MESSAGE_INDEX => {
                let fields = read_at(file, offset + HEAD, 2)?;
                if let (Some(chunk), Ok(channel)) = (contents.chunks.last_mut(), Bytes(&fields).u16()) {
                    note_channel(channel, &mut chunk.is_log, &mut chunk.is_keyframe);
                }
            }
            op::METADATA | op::ATTACHMENT => {
                contents.records.push((head[0], offset, read_at(file, offset + HEAD, length)?));
            }
            _ => {}
        }
        offset += HEAD + length;
    }
    if has_footer && offset + MAGIC.len() as u64 > size {
        contents.truncation = Some(format!("the file ends at byte {size} behind the footer"));
    }
    // The indexes behind a chunk may be what is lost: only its content says what it is.
    for chunk in contents.chunks.iter_mut().filter(|chunk| !chunk.is_log) {
        let body = read_at(file, chunk.offset + HEAD, 64)?;
        let compression = Bytes(&body).take(28).ok().and_then(|_| Bytes(&body[28..]).text().ok());
        chunk.is_log = compression.is_some_and(|compression| compression.is_empty());
        chunk.is_keyframe = chunk.is_log;
    }
    Ok(contents)
}

/// The offset of the next chunk at or behind `from`, by the fields that every chunk of a recording has.
fn next_chunk(file: &mut File, from: u64, size: u64) -> io::Result<Option<u64>> {
    /// Opcode, length, times, size, checksum, and the text of the compression.
    const FIELDS: usize = 9 + 8 + 8 + 8 + 4 + 4 + 3 + 8;
    let mut offset = from;
    while offset + FIELDS as u64 <= size {
        let window = read_at(file, offset, WINDOW as u64)?;
        let last = window.len().saturating_sub(FIELDS);
        for at in 0..=last {
            if window[at] == op::CHUNK && is_chunk(&window[at..], size - offset - at as u64) {
                return Ok(Some(offset + at as u64));
            }
        }
        offset += last as u64 + 1;
    }
    Ok(None)
}

fn is_chunk(bytes: &[u8], left: u64) -> bool {
    let mut fields = Bytes(&bytes[1..]);
    let mut read = || -> Result<bool, crate::recorder::mcap::bytes::UnexpectedEnd> {
        let length = fields.u64()?;
        let (start, end, _size, _crc) = (fields.u64()?, fields.u64()?, fields.u64()?, fields.u32()?);
        let compression = fields.u32()?;
        let named = fields.take(u64::from(compression.min(4)))?;
        let packed = fields.u64()?;
        let rest = 8 + 8 + 8 + 4 + 4 + u64::from(compression) + 8;
        let is_named = named.is_empty() || named == b"lz4";
        Ok(is_named
            && start <= end
            && length <= left.saturating_sub(HEAD)
            && length.checked_sub(rest) == Some(packed))
    };
    read().unwrap_or(false)
}
