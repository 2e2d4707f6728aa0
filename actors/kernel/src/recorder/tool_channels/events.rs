//! `/events`: what happened, by name.

use serde_json::{Value, json};
use trocar_scene::{Event, Snapshot};

/// An event for people and tools to read.
pub(super) fn event(scene: &Snapshot, event: &Event) -> Value {
    json!({
        "name": event.name,
        "subject": scene.name(event.subject),
        "object": event.object.map(|object| scene.name(object)),
        "value": event.value,
        "at_secs": event.at.as_nanos() as f64 / 1e9
    })
}
