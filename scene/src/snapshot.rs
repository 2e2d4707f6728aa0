//! Snapshots: the scene at one revision, shared and immutable.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Isometry3;

use crate::column::{Column, ErasedColumn, Rows, encode};
use crate::component::{Component, ComponentError};
use crate::components::{Name, Parent, Pose};
use crate::entity::Entity;
use crate::event::EventLog;
use crate::registry::{ComponentId, Registry};
use crate::soft_body::SoftAbilities;
use crate::time::{Revision, SimTime};

/// Longest chain of parents that is followed; a cycle ends there.
const MAX_DEPTH: usize = 64;

/// The highest counter that each spawner of a station has ever given to an entity.
pub(crate) type Spawned = BTreeMap<(u16, u16), u32>;

/// The scene at one revision. Cloning it shares everything.
#[derive(Clone)]
pub struct Snapshot {
    pub(crate) registry: Arc<Registry>,
    pub(crate) revision: Revision,
    pub(crate) time: SimTime,
    pub(crate) columns: Vec<Arc<dyn ErasedColumn>>,
    pub(crate) alive: Arc<Column<()>>,
    pub(crate) spawned: Arc<Spawned>,
    pub(crate) events: Arc<EventLog>,
    pub(crate) retouches: u64,
}

impl Snapshot {
    /// Number of batches applied so far.
    pub fn revision(&self) -> Revision {
        self.revision
    }
    /// Time of the latest batch.
    pub fn time(&self) -> SimTime {
        self.time
    }
    /// The number of the last [`Snapshot::retouch`], 0 for what the Model published: with the revision, it tells two
    /// snapshots of a session apart.
    pub fn retouches(&self) -> u64 {
        self.retouches
    }
    /// The components of the session.
    pub fn registry(&self) -> &Arc<Registry> {
        &self.registry
    }
    /// Recent events.
    pub fn events(&self) -> &EventLog {
        &self.events
    }
    /// The column of a component; `None` when the component is not registered.
    #[inline]
    pub fn column<T: Component>(&self) -> Option<&Column<T>> {
        let id = self.registry.id::<T>()?;
        self.columns[usize::from(id.0)].as_any().downcast_ref()
    }
    /// A type-erased column.
    pub fn erased_column(&self, id: ComponentId) -> &dyn ErasedColumn {
        self.columns[usize::from(id.0)].as_ref()
    }
    /// A component of an entity.
    #[inline]
    pub fn get<T: Component>(&self, entity: Entity) -> Option<&T> {
        self.column::<T>()?.get(entity)
    }
    /// Every entity with this component, in entity order.
    pub fn iter<T: Component>(&self) -> Rows<'_, T> {
        self.column::<T>().map_or_else(Rows::none, Column::iter)
    }
    /// Every entity whose component changed after `since`, in entity order.
    pub fn iter_changed<T: Component>(&self, since: Revision) -> Rows<'_, T> {
        self.column::<T>().map_or_else(Rows::none, |column| column.iter_changed(since))
    }
    /// The revision in which a component of an entity last changed.
    pub fn changed<T: Component>(&self, entity: Entity) -> Option<Revision> {
        self.column::<T>()?.revision(entity)
    }
    /// Whether the entity exists.
    pub fn contains(&self, entity: Entity) -> bool {
        self.alive.get(entity).is_some()
    }
    /// Every entity, in order.
    pub fn entities(&self) -> impl Iterator<Item = Entity> {
        self.alive.iter().map(|(entity, ())| entity)
    }
    /// The first counter above all those that entities of this spawner have ever had, also of those that are gone: a
    /// session that continues from a snapshot must not reuse an id.
    pub fn first_free(&self, station: u16, spawner: u16) -> u32 {
        self.spawned.get(&(station, spawner)).map_or(1, |highest| highest.saturating_add(1))
    }
    /// The entity of that name; the lowest one if several have it. Walks all names: not for a hot path.
    pub fn find(&self, name: &str) -> Option<Entity> {
        self.iter::<Name>().find(|(_, candidate)| candidate.0 == name).map(|(entity, _)| entity)
    }
    /// The entity's name, or its number.
    pub fn name(&self, entity: Entity) -> String {
        self.get::<Name>(entity).map_or_else(|| entity.to_string(), |name| name.0.clone())
    }
    /// `world_from_entity`: the entity's pose through all its parents; identity without any pose.
    pub fn world_pose(&self, entity: Entity) -> Isometry3<f64> {
        let mut world_from_entity = Isometry3::identity();
        let mut current = Some(entity);
        for _ in 0..MAX_DEPTH {
            let Some(entity) = current else { break };
            if let Some(pose) = self.get::<Pose>(entity) {
                world_from_entity = pose.isometry() * world_from_entity;
            }
            current = self.get::<Parent>(entity).map(|parent| parent.0);
        }
        world_from_entity
    }
    /// Replaces values of existing rows, for display only: interpolated states of a slow writer. They count as changed
    /// after every published revision; `number` becomes [`Snapshot::retouches`], and must be larger than that of any
    /// snapshot shown before. The cost depends on the rows, not on the scene's size.
    pub fn retouch<T: Component>(&mut self, number: u64, rows: impl IntoIterator<Item = (Entity, T)>) {
        self.retouches = number;
        let Some(id) = self.registry.id::<T>() else { return };
        let slot = &mut self.columns[usize::from(id.0)];
        let Some(column) = slot.as_any().downcast_ref::<Column<T>>() else { return };
        let mut column = column.clone();
        let mut any = false;
        for (entity, value) in rows {
            if column.get(entity).is_some() {
                column.put(entity, value, self.revision.next());
                any = true;
            }
        }
        if any {
            *slot = Arc::new(column);
        }
    }
    /// Shows the whole column of a component as it is in another snapshot of the session, for display only: rows of a later
    /// time in an earlier scene. Returns whether that is another column than before; see [`Self::renumber`].
    pub fn show_column<T: Component>(&mut self, from: &Self) -> bool {
        let Some(id) = self.registry.id::<T>().filter(|_| Arc::ptr_eq(&self.registry, &from.registry)) else {
            return false;
        };
        let (own, other) = (&mut self.columns[usize::from(id.0)], &from.columns[usize::from(id.0)]);
        let differs = !Arc::ptr_eq(own, other);
        if differs {
            own.clone_from(other);
        }
        differs
    }
    /// Sets [`Snapshot::retouches`], for display only: with a lower number than that of the snapshot shown before, viewers
    /// look at everything anew.
    pub fn renumber(&mut self, number: u64) {
        self.retouches = number;
    }
    /// Name of the component of a soft body's method, and the body's abilities; `None` for other entities.
    pub fn soft_body(&self, entity: Entity) -> Option<(&'static str, SoftAbilities)> {
        let all = self.registry.soft_bodies().iter();
        let mut carried = all.filter(|(id, _)| self.erased_column(*id).revision(entity).is_some());
        carried.next().map(|(id, of)| (self.registry.entry(*id).name, *of))
    }
    /// Whether there is a soft body with an ability.
    pub fn has_soft_body_that(&self, can: impl Fn(&SoftAbilities) -> bool) -> bool {
        let mut those = self.registry.soft_bodies().iter().filter(|(_, of)| can(of));
        those.any(|(id, _)| !self.erased_column(*id).is_empty())
    }
    /// The entities coupled to the body of that name, in order.
    pub fn partners_of(&self, name: &str) -> Vec<Entity> {
        let all = self.registry.iter();
        let mut those: Vec<Entity> =
            all.flat_map(|(id, _)| self.registry.named_by(id, self.erased_column(id), name)).collect();
        those.sort_unstable();
        those
    }
    /// All components of an entity as a JSON object, for people to read.
    pub fn entity_json(&self, entity: Entity) -> serde_json::Value {
        let rows = self.registry.iter().filter_map(|(id, entry)| {
            Some((entry.name.to_owned(), self.erased_column(id).row_json(entity)?))
        });
        serde_json::Value::Object(rows.collect())
    }

    /// Appends the whole scene in canonical order: revision, time, entities, spawners, then for each component that
    /// has rows its key, their number, and (entity, value) each. [`crate::Store::load`] reads it back.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), ComponentError> {
        self.encode_entities(out)?;
        let filled: Vec<_> =
            self.registry.iter().filter(|(id, _)| !self.erased_column(*id).is_empty()).collect();
        encode(&(filled.len() as u32), out)?;
        for (id, entry) in filled {
            let column = self.erased_column(id);
            encode(&(entry.key, column.len() as u32), out)?;
            let mut result = Ok(());
            column.for_each_entity(&mut |entity| {
                if result.is_ok() {
                    result = encode(&entity, out).and_then(|()| column.encode_row(entity, out).map(|_| ()));
                }
            });
            result?;
        }
        self.encode_events(out)
    }

    /// The part of [`Self::encode`] before the components: revision, time, entities, and the highest counter of each
    /// spawner.
    ///
    /// # Errors
    /// When memory is short.
    pub fn encode_entities(&self, out: &mut Vec<u8>) -> Result<(), ComponentError> {
        encode(&(self.revision, self.time, self.alive.len() as u32), out)?;
        self.entities().try_for_each(|entity| encode(&entity, out))?;
        encode(&*self.spawned, out)
    }

    /// The part of [`Self::encode`] behind the components: the recent events.
    ///
    /// # Errors
    /// When an event cannot be encoded.
    pub fn encode_events(&self, out: &mut Vec<u8>) -> Result<(), ComponentError> {
        let events: Vec<_> = self.events.since(0).map(|(_, event)| event.clone()).collect();
        encode(&(self.events.first(), events), out)
    }
}
