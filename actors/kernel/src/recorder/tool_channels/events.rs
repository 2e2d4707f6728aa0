//! `/events`: what happened, by name.

use serde_json::{Value, json};
use trocar_scene::{Event, Snapshot};

use super::writers::WriterNames;

/// An event for people and tools to read.
pub(super) fn event(scene: &Snapshot, writers: &WriterNames, event: &Event) -> Value {
    json!({
        "name": event.name,
        "subject": writers.name(scene, event.subject),
        "object": event.object.map(|object| writers.name(scene, object)),
        "value": event.value,
        "at_secs": event.at.as_nanos() as f64 / 1e9
    })
}
