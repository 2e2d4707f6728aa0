//! Messages for standard tools: what a recording tells, as JSON with schemas, to programs that know nothing of Trocar.
//!
//! | topic | schema | when |
//! |---|---|---|
//! | `/tf` | `foxglove.FrameTransforms` | 30 Hz while something moves: every frame that has moved so far |
//! | `/tf_static` | `foxglove.FrameTransforms` | with each keyframe: every frame that has not moved so far |
//! | `/events` | `trocar.Event` | as they happen |
//! | `/hands/left`, `/hands/right` | `trocar.Hand` | 30 Hz |
//! | `/task` | `trocar.Task` | on change, 10 Hz at most; what is judged at once |
//! | `/task/phases` | `trocar.TaskPhase` | as they begin |
//! | `/measured` | `trocar.Measured` | on change, 5 Hz at most |
//! | `/scene` | `foxglove.SceneUpdate` | bodies of a fixed form: with each keyframe, and when they change |
//! | `/scene/deforming` | `foxglove.SceneUpdate` | bodies that change their form: on change, once a second at most |
//!
//! No replay depends on them. A viewer that is led to a time reads the last message of each topic before it: so every
//! message on a topic with frames or bodies shows all of its kind, and none adds to the one before.

mod cadence;
mod coarse;
mod decimate;
mod drawing;
mod events;
mod frames;
mod hands;
mod measured;
mod meshes;
mod numbers;
mod scene;
mod schemas;
mod task;
#[cfg(test)]
mod tests;
mod writers;

use serde_json::Value;
use trocar_scene::{SimTime, Snapshot, WriterId};

use frames::{FrameNames, Transforms};
use hands::Hands;
use measured::Measurements;
use meshes::Meshes;
use scene::Bodies;
use task::Tasks;
use writers::WriterNames;

use super::format::{
    EVENTS, HAND_LEFT, HAND_RIGHT, MEASURED, PHASES, SCENE, SCENE_DEFORMING, TASK, TF, TF_STATIC, channel,
};
use super::mcap::records::{Channel, Schema};

/// Takes a message of a channel.
pub(super) type Message<'a> = dyn FnMut(u16, &Value) + 'a;

/// A message without the fields that have no value.
fn without_nulls(mut message: Value) -> Value {
    if let Value::Object(fields) = &mut message {
        fields.retain(|_, value| !value.is_null());
    }
    message
}

/// A schema and the channels whose messages keep to it.
struct Form {
    /// Its number, which is part of the format.
    id: u16,
    name: &'static str,
    schema: fn() -> Value,
    /// Their numbers, which are part of the format, and topics.
    channels: &'static [(u16, &'static str)],
}

const FORMS: [Form; 7] = [
    Form {
        id: 1,
        name: schemas::TRANSFORMS,
        schema: schemas::transforms,
        channels: &[(channel::TF, TF), (channel::TF_STATIC, TF_STATIC)],
    },
    Form { id: 2, name: schemas::EVENT, schema: schemas::event, channels: &[(channel::EVENTS, EVENTS)] },
    Form {
        id: 3,
        name: schemas::HAND,
        schema: schemas::hand,
        channels: &[(channel::HAND_LEFT, HAND_LEFT), (channel::HAND_RIGHT, HAND_RIGHT)],
    },
    Form { id: 4, name: schemas::TASK, schema: schemas::task, channels: &[(channel::TASK, TASK)] },
    Form { id: 5, name: schemas::PHASE, schema: schemas::phase, channels: &[(channel::PHASES, PHASES)] },
    Form {
        id: 6,
        name: schemas::MEASURED,
        schema: schemas::measured,
        channels: &[(channel::MEASURED, MEASURED)],
    },
    Form {
        id: 7,
        name: schemas::SCENE,
        schema: schemas::scene,
        channels: &[(channel::SCENE, SCENE), (channel::SCENE_DEFORMING, SCENE_DEFORMING)],
    },
];

/// The schemas.
pub(super) fn schemas() -> Vec<Schema> {
    let schema = |form: &Form| Schema {
        id: form.id,
        name: form.name,
        encoding: "jsonschema",
        data: (form.schema)().to_string().into_bytes(),
    };
    FORMS.iter().map(schema).collect()
}

/// The channels.
pub(super) fn channels() -> impl Iterator<Item = Channel> {
    FORMS.iter().flat_map(|form| {
        let channel =
            |(id, topic): &(u16, &'static str)| Channel { id: *id, schema: form.id, topic, encoding: "json" };
        form.channels.iter().map(channel)
    })
}

/// What has been told, and when the next of each is due: plain data, which survives a restart of the recorder.
pub(super) struct ToolChannels {
    event_cursor: u64,
    writers: WriterNames,
    transforms: Transforms,
    hands: Hands,
    tasks: Tasks,
    measured: Measurements,
    bodies: Bodies,
}

/// What can be found out again: each life of the recorder has its own.
#[derive(Default)]
pub(super) struct ToolCache {
    names: FrameNames,
    meshes: Meshes,
}

impl ToolChannels {
    /// From the scene with which a recording begins.
    pub(super) fn new(scene: &Snapshot, tf_period: SimTime) -> Self {
        Self {
            event_cursor: scene.events().next(),
            writers: WriterNames::default(),
            transforms: Transforms::new(tf_period),
            hands: Hands::default(),
            tasks: Tasks::default(),
            measured: Measurements::default(),
            bodies: Bodies::new(scene.revision()),
        }
    }

    /// A commit of this writer is recorded.
    pub(super) fn met(&mut self, writer: WriterId, name: &str) {
        self.writers.met(writer, name);
    }

    /// A reader may begin here: everything that it needs is told again.
    pub(super) fn begin_anew(&mut self) {
        self.transforms.begin_anew();
        self.tasks.begin_anew();
        self.measured.begin_anew();
        self.bodies.begin_anew();
    }

    /// Events of a gap are not told.
    pub(super) fn skip_events(&mut self, scene: &Snapshot) {
        self.event_cursor = scene.events().next();
    }

    /// Tells what is due of a publication.
    pub(super) fn tell(
        &mut self,
        cache: &mut ToolCache,
        scene: &Snapshot,
        now: SimTime,
        message: &mut Message<'_>,
    ) {
        for (_, event) in scene.events().since(self.event_cursor) {
            message(channel::EVENTS, &without_nulls(events::event(scene, &self.writers, event)));
        }
        self.event_cursor = scene.events().next();
        self.transforms.tell(&mut cache.names, scene, now, message);
        self.hands.tell(scene, now, message);
        self.tasks.tell(scene, &self.writers, now, message);
        self.measured.tell(scene, &self.writers, now, message);
        self.bodies.tell(cache, scene, now, message);
    }

    /// Tells how the session ended, whatever is due.
    pub(super) fn end(&mut self, scene: &Snapshot, message: &mut Message<'_>) {
        self.tasks.tell_all(scene, &self.writers, message);
        self.measured.tell_all(scene, &self.writers, message);
    }
}
