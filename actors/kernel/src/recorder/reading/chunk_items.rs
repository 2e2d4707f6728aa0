//! Items of a recording, and their decoding from the chunks of an MCAP file.

use std::sync::Arc;

use trocar_scene::{ComponentError, Registry, Revision, SimTime, Store};

use crate::recorder::block;
use crate::recorder::columns::History;
use crate::recorder::format::{Gap, Group, channel};
use crate::recorder::mcap::bytes::Bytes;
use crate::recorder::mcap::records::op;
use crate::state_hash::StateHash;

/// Longest unpacked chunk of messages for tools.
const UNPACKED_MAX: u64 = 256 << 20;

/// The whole scene at one revision.
#[derive(Clone, Debug)]
pub struct Keyframe {
    /// The revision.
    pub revision: Revision,
    /// The hash of what is stored, at that revision.
    pub hash: StateHash,
    /// The Model's hash of that revision.
    pub state_hash: StateHash,
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
    /// The scene as [`Snapshot::encode`](trocar_scene::Snapshot::encode) wrote it.
    pub fn scene(&self) -> &[u8] {
        &self.scene
    }
    /// Its offset in the file.
    pub fn offset(&self) -> u64 {
        self.offset
    }
}

/// An item of a recording, in order.
#[derive(Clone, Debug)]
pub enum Item {
    /// What is kept of the commits of one block.
    Commits(Group),
    /// The whole scene.
    Keyframe(Keyframe),
    /// A gap; a keyframe follows.
    Gap(Gap),
    /// A damaged part of the file; what follows is whole, but up to the next keyframe it lacks what was lost here.
    Damage(String),
}

/// The records of a chunk, unpacked and checked.
///
/// `unchecked` accepts a checksum of zero, which in MCAP says that there is none.
pub(in crate::recorder) fn records(body: &[u8], unchecked: bool) -> Result<Vec<u8>, String> {
    let mut body = Bytes(body);
    body.take(16)?;
    let unpacked = body.u64()?;
    let crc = body.u32()?;
    let compression = body.text()?;
    let length = body.u64()?;
    let packed = body.take(length)?;
    if !body.0.is_empty() {
        return Err("the lengths of the chunk do not agree".to_owned());
    }
    let records = match compression.as_str() {
        "" => packed.to_vec(),
        "lz4" => {
            // LZ4 makes at most 255 bytes of one.
            if unpacked > UNPACKED_MAX || unpacked > 255 * (packed.len() as u64 + 1) {
                return Err(format!("a chunk of {unpacked} bytes in {} packed ones", packed.len()));
            }
            let mut records = Vec::new();
            let decoder = lz4_flex::frame::FrameDecoder::new(packed);
            std::io::Read::read_to_end(&mut std::io::Read::take(decoder, unpacked + 1), &mut records)
                .map_err(|error| format!("the chunk does not unpack: {error}"))?;
            records
        }
        other => return Err(format!("a chunk is compressed with '{other}'; valid: lz4, or not at all")),
    };
    if records.len() as u64 != unpacked {
        return Err("the lengths of the chunk do not agree".to_owned());
    }
    if !(crc == 0 && unchecked) && crc32fast::hash(&records) != crc {
        return Err("the checksum of the chunk is wrong".to_owned());
    }
    Ok(records)
}

/// A message of a chunk.
pub(in crate::recorder) struct Message<'a> {
    pub(in crate::recorder) channel: u16,
    pub(in crate::recorder) time: SimTime,
    pub(in crate::recorder) data: &'a [u8],
}

/// The messages among the records of a chunk.
pub(in crate::recorder) fn messages(records: &[u8]) -> impl Iterator<Item = Result<Message<'_>, String>> {
    let mut records = Bytes(records);
    std::iter::from_fn(move || {
        while !records.0.is_empty() {
            match message(&mut records) {
                Ok(None) => {}
                Ok(Some(message)) => return Some(Ok(message)),
                Err(error) => {
                    records.0 = &[];
                    return Some(Err(error));
                }
            }
        }
        None
    })
}

fn message<'a>(records: &mut Bytes<'a>) -> Result<Option<Message<'a>>, String> {
    let opcode = records.u8()?;
    let length = records.u64()?;
    let mut record = Bytes(records.take(length)?);
    if opcode != op::MESSAGE {
        return Ok(None);
    }
    let channel = record.u16()?;
    let _sequence = record.u32()?;
    let time = SimTime(record.u64()?);
    let _published = record.u64()?;
    Ok(Some(Message { channel, time, data: record.0 }))
}

/// The items of a chunk that begins at `offset` of its file. What is behind a damaged message is read as far as it can be.
pub(in crate::recorder) fn parse_chunk(body: &[u8], unchecked: bool, offset: u64) -> Vec<Item> {
    let records = match records(body, unchecked) {
        Ok(records) => records,
        Err(error) => return vec![damage(offset, &error)],
    };
    let (mut items, mut history) = (Vec::new(), History::default());
    for message in messages(&records) {
        let item = message.and_then(|message| parse_message(&message, &mut history, offset));
        match item {
            Ok(item) => items.extend(item),
            Err(error) => {
                items.push(damage(offset, &error));
                break;
            }
        }
    }
    items
}

pub(in crate::recorder) fn damage(offset: u64, what: &str) -> Item {
    Item::Damage(format!("at byte {offset}: {what}"))
}

/// Parses a message of our own channels; the others are for other tools.
pub(in crate::recorder) fn parse_message(
    message: &Message<'_>,
    history: &mut History,
    offset: u64,
) -> Result<Option<Item>, String> {
    Ok(Some(match message.channel {
        channel::COMMITS => Item::Commits(Group::new(block::decode(message.data, history)?)),
        channel::KEYFRAMES => {
            let block = block::decode(message.data, history)?;
            let (hash, state_hash, time) = (block.stored, block.state, message.time);
            let scene = block.commits.into_iter().next().ok_or("a keyframe without a scene")?;
            let (revision, scene) = (scene.revision, scene.payload);
            Item::Keyframe(Keyframe { revision, hash, state_hash, time, scene, offset })
        }
        channel::GAPS => {
            Item::Gap(serde_json::from_slice(message.data).map_err(|error| format!("a gap: {error}"))?)
        }
        _ => return Ok(None),
    }))
}
