//! JSON channels for standard tools: poses and events.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use trocar_scene::{Entity, Event, Parent, Pose, Revision, SimTime, Snapshot};

/// Name of the schema of `/tf`, known to viewers.
pub(super) const TF_SCHEMA: &str = "foxglove.FrameTransforms";
/// Name of the schema of `/events`.
pub(super) const EVENT_SCHEMA: &str = "trocar.Event";
/// Parent of every frame that has none.
const WORLD: &str = "world";

/// The JSON schema of `/tf`.
pub(super) fn tf_schema() -> Value {
    let number = |names: &[&str]| {
        let properties: BTreeMap<_, _> =
            names.iter().map(|name| (*name, json!({"type": "number"}))).collect();
        json!({"type": "object", "properties": properties})
    };
    json!({
        "title": TF_SCHEMA,
        "description": "An array of FrameTransform messages",
        "$comment": "Lengths in metres, rotations as unit quaternions.",
        "type": "object",
        "properties": { "transforms": { "type": "array", "items": {
            "title": "foxglove.FrameTransform",
            "type": "object",
            "properties": {
                "timestamp": {
                    "type": "object", "title": "time",
                    "properties": {
                        "sec": {"type": "integer", "minimum": 0},
                        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}
                    }
                },
                "parent_frame_id": {"type": "string"},
                "child_frame_id": {"type": "string"},
                "translation": number(&["x", "y", "z"]),
                "rotation": number(&["x", "y", "z", "w"])
            }
        }}}
    })
}

/// The JSON schema of `/events`.
pub(super) fn event_schema() -> Value {
    json!({
        "title": EVENT_SCHEMA,
        "type": "object",
        "properties": {
            "name": {"type": "string"},
            "subject": {"type": "string"},
            "object": {"type": ["string", "null"]},
            "value": {"type": "number"},
            "at_secs": {"type": "number"}
        }
    })
}

/// Names of entities as frames: looked up once, as names hardly ever change.
#[derive(Default)]
pub(super) struct Frames {
    names: BTreeMap<Entity, String>,
}

impl Frames {
    fn name(&mut self, scene: &Snapshot, entity: Entity) -> &str {
        // Bounded by the number of entities: only those with a pose are looked up.
        self.names.entry(entity).or_insert_with(|| scene.name(entity))
    }

    /// The poses that changed after `since`, or `None` when none did.
    pub(super) fn transforms(&mut self, scene: &Snapshot, since: Revision, now: SimTime) -> Option<Value> {
        self.names.retain(|entity, _| scene.contains(*entity));
        let mut transforms = Vec::new();
        for (entity, pose) in scene.iter_changed::<Pose>(since) {
            let parent = scene.get::<Parent>(entity).map(|parent| parent.0);
            let parent = parent.map_or_else(|| WORLD.to_owned(), |p| self.name(scene, p).to_owned());
            let (t, r) = (&pose.translation, pose.rotation.coords);
            transforms.push(json!({
                "timestamp": {"sec": now.0 / 1_000_000_000, "nsec": now.0 % 1_000_000_000},
                "parent_frame_id": parent,
                "child_frame_id": self.name(scene, entity),
                "translation": {"x": t.x, "y": t.y, "z": t.z},
                "rotation": {"x": r.x, "y": r.y, "z": r.z, "w": r.w}
            }));
        }
        (!transforms.is_empty()).then(|| json!({"transforms": transforms}))
    }
}

/// An event for people and tools to read.
pub(super) fn event(scene: &Snapshot, event: &Event) -> Value {
    json!({
        "name": event.name,
        "subject": scene.name(event.subject),
        "object": event.object.map(|object| scene.name(object)),
        "value": event.value,
        "at_secs": event.at.as_secs_f64()
    })
}
