//! Head of a recording: its metadata, its schemas and its channels.

use trocar_scene::{RecordPolicy, Snapshot};

use super::format::{COMMITS, COMPONENT, GAPS, KEYFRAMES, META, META_DEVICES, SCENARIO, SCHEMA, channel};
use super::mcap::container::Container;
use super::mcap::records::{Channel, Schema};
use super::options::RecordingHead;
use super::{block_message, tool_channels};

/// Appends the head of a recording.
pub(super) fn write_head(
    container: &mut Container,
    head: &RecordingHead,
    scene: &Snapshot,
    exact: bool,
    out: &mut Vec<u8>,
) {
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
            RecordPolicy::Sampled(_) if exact => RecordPolicy::Exact,
            policy => policy,
        };
        meta.insert(format!("{COMPONENT}{}", entry.name), format!("{:08x} {policy}", entry.key));
    }
    container.metadata(META, &meta, out);
    let devices = head.devices.iter().map(|(name, device)| (name.clone(), device.to_string())).collect();
    container.metadata(META_DEVICES, &devices, out);
    container.attachment(SCENARIO, "application/toml", head.scenario_text.as_bytes(), out);
}

/// Number of the schema of blocks.
const BLOCK_SCHEMA: u16 = 8;

/// Every schema of a recording.
pub(super) fn schemas() -> Vec<Schema> {
    let (name, data) = (block_message::NAME, block_message::schema());
    let block = Schema { id: BLOCK_SCHEMA, name, encoding: "protobuf", data };
    tool_channels::schemas().into_iter().chain([block]).collect()
}

/// Every channel of a recording. Their numbers are part of the format.
pub(super) fn channels() -> Vec<Channel> {
    let channel = |id, schema, topic, encoding| Channel { id, schema, topic, encoding };
    let own = [
        channel(channel::COMMITS, BLOCK_SCHEMA, COMMITS, "protobuf"),
        channel(channel::KEYFRAMES, BLOCK_SCHEMA, KEYFRAMES, "protobuf"),
        channel(channel::GAPS, 0, GAPS, "json"),
    ];
    own.into_iter().chain(tool_channels::channels()).collect()
}
