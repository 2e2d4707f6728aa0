//! Items of a recording, and their decoding from the chunks of an MCAP file.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::{ComponentError, Registry, SimTime, Store};

use super::bytes::Bytes;
use super::format::{COMMITS, GAPS, Gap, Group, KEYFRAMES, decode_keyframe_header};
use super::mcap_records::op;
use crate::state_hash::StateHash;

/// The whole scene at one revision.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// The state hash of that revision.
    pub hash: StateHash,
    /// The time at which it was written.
    pub time: SimTime,
    scene: Vec<u8>,
    offset: u64,
}

impl Keyframe {
    /// The scene.
    ///
    /// # Errors
    /// When it cannot be decoded.
    pub fn load(&self, registry: &Arc<Registry>) -> Result<Store, ComponentError> {
        let (store, rest) = Store::load(registry, &self.scene)?;
        if rest.is_empty() {
            Ok(store)
        } else {
            Err(ComponentError::Malformed(format!("{} bytes too many in a keyframe", rest.len())))
        }
    }
    /// Its offset in the file.
    pub fn offset(&self) -> u64 {
        self.offset
    }
}

/// An item of a recording, in order.
#[derive(Clone, Debug)]
pub enum Item {
    /// The commits of one publication.
    Commits(Group),
    /// The whole scene.
    Keyframe(Keyframe),
    /// A gap; a keyframe follows.
    Gap(Gap),
}

/// The records of a chunk, after its checksum.
fn records(body: &[u8]) -> Result<&[u8], String> {
    let mut body = Bytes(body);
    body.take(16)?;
    let _uncompressed = body.u64()?;
    let crc = body.u32()?;
    let compression = body.text()?;
    if !compression.is_empty() {
        return Err(format!("compressed with '{compression}'; recordings of trocar are not compressed"));
    }
    let length = body.u64()?;
    let records = body.take(length)?;
    if crc != 0 && crc32fast::hash(records) != crc {
        return Err("the checksum of the chunk is wrong".to_owned());
    }
    Ok(records)
}

/// Map of channels to topics, read from the first chunk.
pub(super) fn parse_topics(body: &[u8]) -> Result<BTreeMap<u16, String>, String> {
    let mut records = Bytes(records(body)?);
    let mut topics = BTreeMap::new();
    while !records.0.is_empty() {
        let opcode = records.u8()?;
        let length = records.u64()?;
        let mut record = Bytes(records.take(length)?);
        if opcode == op::CHANNEL {
            let id = record.u16()?;
            let _schema = record.u16()?;
            topics.insert(id, record.text()?);
        }
    }
    Ok(topics)
}

/// The items of a chunk that begins at `offset` of its file.
pub(super) fn parse_chunk(
    body: &[u8],
    topics: &BTreeMap<u16, String>,
    offset: u64,
) -> Result<Vec<Item>, String> {
    let mut records = Bytes(records(body)?);
    let mut items = Vec::new();
    while !records.0.is_empty() {
        let opcode = records.u8()?;
        let length = records.u64()?;
        let mut record = Bytes(records.take(length)?);
        if opcode == op::MESSAGE {
            let channel = record.u16()?;
            let _sequence = record.u32()?;
            let time = SimTime(record.u64()?);
            let _published = record.u64()?;
            let topic = topics.get(&channel).map(String::as_str);
            items.extend(parse_message(topic, time, record.0, offset)?);
        }
    }
    Ok(items)
}

/// Parses a message of our own topics; other topics are for other tools.
fn parse_message(
    topic: Option<&str>,
    time: SimTime,
    data: &[u8],
    offset: u64,
) -> Result<Option<Item>, String> {
    Ok(Some(match topic {
        Some(COMMITS) => Item::Commits(Group::decode(data)?),
        Some(KEYFRAMES) => {
            let (hash, scene) = decode_keyframe_header(data)?;
            Item::Keyframe(Keyframe { hash, time, scene: scene.to_vec(), offset })
        }
        Some(GAPS) => Item::Gap(serde_json::from_slice(data).map_err(|error| format!("a gap: {error}"))?),
        _ => return Ok(None),
    }))
}
