//! What stands beside the chunks of a recording: metadata at its head and its end, and the scenario's text.

use std::collections::BTreeMap;

use trocar_scene::SimTime;

use crate::recorder::format::{COMPONENT, META, META_BYTES, META_DEVICES, META_END, SCENARIO};
use crate::recorder::mcap::bytes::Bytes;
use crate::recorder::mcap::container::{CHECKSUM, checksum};
use crate::recorder::mcap::records::op;

/// Metadata at the head of a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RecordingMetadata {
    /// Version of trocar that wrote it.
    pub version: String,
    /// Name of the scenario.
    pub scenario: String,
    /// The scenario's text.
    pub scenario_text: String,
    /// The session's seed.
    pub seed: u64,
    /// The station's number.
    pub station: u16,
    /// How it was run.
    pub mode: String,
    /// NAME → key and policy of every component of the session.
    pub components: BTreeMap<String, String>,
    /// Capabilities of each device, as JSON.
    pub devices: BTreeMap<String, String>,
    /// Further metadata.
    pub extra: BTreeMap<String, String>,
}

/// Final metadata of a clean close.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingEnd {
    /// The last revision.
    pub revision: u64,
    /// The hash of what is stored, at the end.
    pub hash: String,
    /// The Model's hash at the end.
    pub state_hash: String,
    /// The time at the end.
    pub time: SimTime,
    /// Whether the recording has no gaps.
    pub complete: bool,
}

/// All of it, as far as it has been read.
#[derive(Debug, Default)]
pub(super) struct Metadata {
    /// What stands at the head.
    pub head: RecordingMetadata,
    /// Bytes of all commits by component and writer.
    pub bytes: BTreeMap<String, String>,
    /// What stands at the end.
    pub end: Option<RecordingEnd>,
    /// The version of the format.
    pub schema: Option<String>,
}

impl Metadata {
    /// Takes in a metadata record or an attachment.
    ///
    /// # Errors
    /// What is wrong with it.
    pub(super) fn note(&mut self, opcode: u8, body: &[u8]) -> Result<(), String> {
        if opcode == op::METADATA { self.note_metadata(body) } else { self.note_attachment(body) }
    }

    fn note_metadata(&mut self, body: &[u8]) -> Result<(), String> {
        let (name, mut map) = metadata_record(body)?;
        let number = |map: &mut BTreeMap<String, String>, key: &str| {
            let text = map.remove(key).unwrap_or_default();
            text.parse::<u64>().map_err(|_| format!("metadata '{name}': {key} is '{text}', not a number"))
        };
        match name.as_str() {
            META => {
                self.schema = Some(map.remove("schema").unwrap_or_default());
                self.head.version = map.remove("version").unwrap_or_default();
                self.head.scenario = map.remove("scenario").unwrap_or_default();
                self.head.mode = map.remove("mode").unwrap_or_default();
                self.head.seed = number(&mut map, "seed")?;
                let station = number(&mut map, "station")?;
                self.head.station =
                    u16::try_from(station).map_err(|_| format!("metadata '{name}': station is {station}"))?;
                for (key, value) in map {
                    match key.strip_prefix(COMPONENT) {
                        Some(name) => self.head.components.insert(name.to_owned(), value),
                        None => self.head.extra.insert(key, value),
                    };
                }
            }
            META_DEVICES => self.head.devices = map,
            META_BYTES => self.bytes = map,
            META_END => {
                self.end = Some(RecordingEnd {
                    revision: number(&mut map, "revision")?,
                    time: SimTime(number(&mut map, "time_ns")?),
                    hash: map.remove("hash").unwrap_or_default(),
                    state_hash: map.remove("state_hash").unwrap_or_default(),
                    complete: map.remove("complete").as_deref() == Some("true"),
                });
            }
            _ => {}
        }
        Ok(())
    }

    fn note_attachment(&mut self, body: &[u8]) -> Result<(), String> {
        let mut body = Bytes(body);
        body.take(16)?;
        let name = body.text()?;
        let _media_type = body.text()?;
        let length = body.u64()?;
        let data = body.take(length)?;
        if name == SCENARIO {
            self.head.scenario_text = String::from_utf8_lossy(data).into_owned();
        }
        Ok(())
    }
}

/// Name and pairs of a metadata record, checked by the checksum among them.
pub(in crate::recorder) fn metadata_record(
    body: &[u8],
) -> Result<(String, BTreeMap<String, String>), String> {
    let mut body = Bytes(body);
    let name = body.text()?;
    let length = body.u32()?;
    let mut pairs = Bytes(body.take(u64::from(length))?);
    let mut map = BTreeMap::new();
    while !pairs.0.is_empty() {
        map.insert(pairs.text()?, pairs.text()?);
    }
    match map.remove(CHECKSUM) {
        Some(found) if found != checksum(&map) => Err(format!("metadata '{name}': its checksum is wrong")),
        _ => Ok((name, map)),
    }
}
