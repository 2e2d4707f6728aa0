//! Names of writers: the entity of a writer has no name of its own in the scene.

use std::collections::BTreeMap;

use trocar_scene::{Entity, Snapshot, WriterId};

/// The writers whose commits have been recorded.
#[derive(Default)]
pub(super) struct WriterNames(BTreeMap<u16, String>);

impl WriterNames {
    pub(super) fn met(&mut self, writer: WriterId, name: &str) {
        self.0.entry(writer.0).or_insert_with(|| name.to_owned());
    }

    /// The name of an entity, or of the writer that it stands for, or its number.
    pub(super) fn name(&self, scene: &Snapshot, entity: Entity) -> String {
        let writer = self.0.get(&entity.spawner()).filter(|_| entity.counter() == 0);
        writer.map_or_else(|| scene.name(entity), String::clone)
    }
}
