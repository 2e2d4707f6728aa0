//! Commands: the writes of one tick, in buffers that are reused from tick to tick.

use std::borrow::Cow;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::column::{PAGES_MAX, encode, take};
use crate::component::{Component, ComponentError, RecordPolicy};
use crate::entity::{Entity, EntityAllocator};
use crate::event::Event;
use crate::puts::{ErasedPuts, Puts, RowOrder};
use crate::registry::{ComponentId, Registry};
use crate::time::{Revision, SimTime};

/// A writer: a controller with a name, numbered like its entities' spawner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WriterId(pub u16);

/// Provenance of a batch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Its writer.
    pub writer: WriterId,
    /// Epoch of the writer's life; older ones are fenced.
    pub epoch: u32,
    /// Number of the writer's tick.
    pub tick: u64,
    /// The tick's time.
    pub time: SimTime,
    /// The snapshot that the writer had read.
    pub based_on: Revision,
}

/// Precondition "this row has not changed since": if it does not hold, the batch is a conflict.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Condition {
    /// Component of the row.
    pub component: ComponentId,
    /// Entity of the row.
    pub entity: Entity,
    /// Latest acceptable revision.
    pub unchanged_since: Revision,
}

/// Transfer of the write access to a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Component of the row.
    pub component: ComponentId,
    /// Entity of the row.
    pub entity: Entity,
    /// The writer that owns it from the next batch on.
    pub to: WriterId,
}

/// Where the puts of one component lie in encoded commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PutSection {
    /// The component.
    pub component: ComponentId,
    /// Its first byte.
    pub start: u32,
    /// The byte after it.
    pub end: u32,
}

/// Where the sections of encoded commands lie, so that some can be taken without decoding the others.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SectionMap {
    /// Whether the commands create entities.
    pub spawns: bool,
    /// Where the puts begin, with their count; spawns, despawns and removes lie before.
    pub puts_at: u32,
    /// The byte after the puts; transfers and events lie behind.
    pub puts_end: u32,
    /// The puts of each component.
    pub puts: Vec<PutSection>,
}

/// An invalid command; the whole batch is refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CommandError {
    /// A type that no registry entry knows.
    #[error("component '{0}' is not registered in this session")]
    Unregistered(&'static str),
    /// A value that its component refuses.
    #[error("{component} of {entity}: {error}")]
    Value {
        /// Name of the component.
        component: &'static str,
        /// The entity.
        entity: Entity,
        /// Why.
        error: ComponentError,
    },
    /// An event with a number that is not finite.
    #[error("event '{0}': value is not finite")]
    Event(Cow<'static, str>),
    /// The writer has used all 2³² entities.
    #[error("the writer has used up its entities")]
    NoMoreEntities,
    /// Too many entities at once, or scattered too widely.
    #[error("the entities of the scene would take more than {PAGES_MAX} pages of 4,096 numbers")]
    NoRoom,
}

/// The writes of one tick.
pub struct Commands {
    registry: Arc<Registry>,
    allocator: EntityAllocator,
    now: SimTime,
    puts: Vec<Option<Box<dyn ErasedPuts>>>,
    touched: Vec<ComponentId>,
    removes: Vec<(ComponentId, Entity)>,
    spawns: Vec<Entity>,
    despawns: Vec<Entity>,
    events: Vec<Event>,
    conditions: Vec<Condition>,
    transfers: Vec<Transfer>,
    listed: Option<u64>,
    error: Option<CommandError>,
    order: RowOrder,
}

impl Commands {
    /// Empty buffers for the writer that owns `allocator`.
    pub fn new(registry: Arc<Registry>, allocator: EntityAllocator) -> Self {
        let puts = (0..registry.len()).map(|_| None).collect();
        Self {
            registry,
            allocator,
            now: SimTime::ZERO,
            puts,
            touched: Vec::new(),
            removes: Vec::new(),
            spawns: Vec::new(),
            despawns: Vec::new(),
            events: Vec::new(),
            conditions: Vec::new(),
            transfers: Vec::new(),
            listed: None,
            error: None,
            order: RowOrder::default(),
        }
    }

    /// Empty buffers of the same writer: both share one entity allocator.
    #[must_use]
    pub fn another(&self) -> Self {
        Self::new(self.registry.clone(), self.allocator.clone())
    }

    /// The components of the session.
    pub fn registry(&self) -> &Arc<Registry> {
        &self.registry
    }

    /// The writer's own entity, which carries its contributions and its resume state.
    pub fn me(&self) -> Entity {
        self.allocator.me()
    }

    /// Sets the time that events of this tick get; the host calls it.
    pub fn begin(&mut self, now: SimTime) {
        self.now = now;
    }

    /// Sets a component of an entity. Of two puts of one row in a batch the later one wins.
    pub fn put<T: Component>(&mut self, entity: Entity, value: T) {
        let Some(id) = self.registry.id::<T>() else {
            self.error.get_or_insert(CommandError::Unregistered(T::NAME));
            return;
        };
        if let Err(error) = value.check() {
            self.error.get_or_insert(CommandError::Value { component: T::NAME, entity, error });
        }
        let slot = &mut self.puts[usize::from(id.0)];
        let puts = slot.get_or_insert_with(self.registry.entry(id).new_puts);
        if let Some(puts) = puts.as_any_mut().downcast_mut::<Puts<T>>() {
            if puts.is_empty() {
                self.touched.push(id);
            }
            puts.push(entity, value);
        }
    }

    /// Sets this writer's contribution to a shared list; the Model removes it when the writer dies.
    pub fn contribute<T: Component>(&mut self, value: T) {
        if let Some(count) = value.listed() {
            self.listed = Some(self.listed.unwrap_or(0) + count);
        }
        self.put(self.allocator.me(), value);
    }

    /// Number of entries in this tick's contributions; `None` if it sets no contribution.
    pub fn listed(&self) -> Option<u64> {
        self.listed
    }

    /// Removes a component from an entity.
    pub fn remove<T: Component>(&mut self, entity: Entity) {
        match self.registry.id::<T>() {
            Some(id) => self.removes.push((id, entity)),
            None => {
                self.error.get_or_insert(CommandError::Unregistered(T::NAME));
            }
        }
    }

    /// [`Self::remove`] of a component by its number.
    pub fn remove_component(&mut self, component: ComponentId, entity: Entity) {
        self.removes.push((component, entity));
    }

    /// Creates an entity. Its id is known at once, without asking the Model.
    pub fn spawn(&mut self) -> Entity {
        match self.allocator.allocate() {
            Some(entity) => {
                self.spawns.push(entity);
                entity
            }
            None => {
                self.error.get_or_insert(CommandError::NoMoreEntities);
                self.allocator.me()
            }
        }
    }

    /// Creates an entity under the number that another station gave it: for a replica (see
    /// [`Access::replicates`](crate::Access::replicates)).
    pub fn adopt(&mut self, entity: Entity) {
        self.spawns.push(entity);
    }

    /// Removes an entity with all its components.
    pub fn despawn(&mut self, entity: Entity) {
        self.despawns.push(entity);
    }

    /// Emits an event.
    pub fn event(
        &mut self,
        name: impl Into<Cow<'static, str>>,
        subject: Entity,
        object: Option<Entity>,
        value: f64,
    ) {
        let name = name.into();
        if !value.is_finite() {
            self.error.get_or_insert(CommandError::Event(name));
            return;
        }
        self.events.push(Event { name, subject, object, value, at: self.now });
    }

    /// Makes the batch a conflict if the row has changed after `since`.
    pub fn require_unchanged<T: Component>(&mut self, entity: Entity, since: Revision) {
        match self.registry.id::<T>() {
            Some(component) => {
                self.conditions.push(Condition { component, entity, unchanged_since: since });
            }
            None => {
                self.error.get_or_insert(CommandError::Unregistered(T::NAME));
            }
        }
    }

    /// Transfers the write access to a row to another writer.
    pub fn transfer<T: Component>(&mut self, entity: Entity, to: WriterId) {
        match self.registry.id::<T>() {
            Some(component) => self.transfers.push(Transfer { component, entity, to }),
            None => {
                self.error.get_or_insert(CommandError::Unregistered(T::NAME));
            }
        }
    }

    /// Whether there are no commands.
    pub fn is_empty(&self) -> bool {
        self.touched.is_empty()
            && self.removes.is_empty()
            && self.spawns.is_empty()
            && self.despawns.is_empty()
            && self.events.is_empty()
            && self.transfers.is_empty()
            && self.error.is_none()
    }

    /// How many rows, entities and events are written.
    pub fn len(&self) -> usize {
        self.puts().map(|(_, puts)| puts.len()).sum::<usize>()
            + self.removes.len()
            + self.spawns.len()
            + self.despawns.len()
            + self.events.len()
            + self.transfers.len()
    }

    /// Empties the buffers and keeps their capacity.
    pub fn clear(&mut self) {
        for id in self.touched.drain(..) {
            if let Some(puts) = &mut self.puts[usize::from(id.0)] {
                puts.clear();
            }
        }
        self.removes.clear();
        self.spawns.clear();
        self.despawns.clear();
        self.events.clear();
        self.conditions.clear();
        self.transfers.clear();
        self.listed = None;
        self.error = None;
    }

    /// Brings the commands into canonical order (component NAME, then entity). The host calls it once
    /// after the tick; nothing is allocated when the order is canonical already.
    pub fn seal(&mut self) {
        self.touched.sort_unstable();
        for id in &self.touched {
            if let Some(puts) = &mut self.puts[usize::from(id.0)] {
                puts.seal(&mut self.order);
            }
        }
        self.removes.sort_unstable();
        self.removes.dedup();
        self.despawns.sort_unstable();
        self.despawns.dedup();
    }

    /// The first invalid command, if there is one.
    pub fn error(&self) -> Option<&CommandError> {
        self.error.as_ref()
    }
    /// The puts of each touched component, in NAME order once sealed.
    pub fn puts(&self) -> impl Iterator<Item = (ComponentId, &dyn ErasedPuts)> {
        self.touched.iter().filter_map(|id| self.puts[usize::from(id.0)].as_deref().map(|puts| (*id, puts)))
    }
    pub(crate) fn puts_mut(&mut self, mut visit: impl FnMut(ComponentId, &mut dyn ErasedPuts)) {
        for id in &self.touched {
            if let Some(puts) = &mut self.puts[usize::from(id.0)] {
                visit(*id, puts.as_mut());
            }
        }
    }
    /// Rows to remove.
    pub fn removes(&self) -> &[(ComponentId, Entity)] {
        &self.removes
    }
    /// Entities to create.
    pub fn spawns(&self) -> &[Entity] {
        &self.spawns
    }
    /// Entities to remove.
    pub fn despawns(&self) -> &[Entity] {
        &self.despawns
    }
    /// Events of the tick.
    pub fn events(&self) -> &[Event] {
        &self.events
    }
    /// Preconditions of the batch.
    pub fn conditions(&self) -> &[Condition] {
        &self.conditions
    }
    /// Transfers of write access.
    pub fn transfers(&self) -> &[Transfer] {
        &self.transfers
    }
    pub(crate) fn drain_events(&mut self) -> std::vec::Drain<'_, Event> {
        self.events.drain(..)
    }

    /// Appends the canonical encoding of everything that changes the scene: spawns, despawns, removes, puts
    /// (NAME order, entity order), transfers, events. Derived components are left out.
    ///
    /// Layout: six sections, each a postcard count followed by its items; a put section per component has
    /// the component's 32-bit key. [`Commands::decode`] reads it back.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), ComponentError> {
        self.encode_mapped(out, &mut SectionMap::default())
    }

    /// [`Self::encode`], and where the sections lie in what was appended.
    ///
    /// # Errors
    /// When a value cannot be encoded.
    pub fn encode_mapped(&self, out: &mut Vec<u8>, map: &mut SectionMap) -> Result<(), ComponentError> {
        let begin = out.len();
        let place = |out: &Vec<u8>| (out.len() - begin) as u32;
        map.puts.clear();
        map.spawns = !self.spawns.is_empty();
        let key = |id: ComponentId| self.registry.entry(id).key;
        encode(&self.spawns, out)?;
        encode(&self.despawns, out)?;
        let kept = |id: &ComponentId| self.registry.entry(*id).record != RecordPolicy::Derived;
        encode(&(self.removes.iter().filter(|(id, _)| kept(id)).count() as u32), out)?;
        for (id, entity) in self.removes.iter().filter(|(id, _)| kept(id)) {
            encode(&(key(*id), entity), out)?;
        }
        map.puts_at = place(out);
        encode(&(self.touched.iter().filter(|id| kept(id)).count() as u32), out)?;
        for (id, puts) in self.puts().filter(|(id, _)| kept(id)) {
            let start = place(out);
            encode(&(key(id), puts.len() as u32), out)?;
            puts.encode(out)?;
            map.puts.push(PutSection { component: id, start, end: place(out) });
        }
        map.puts_end = place(out);
        encode(&(self.transfers.len() as u32), out)?;
        for transfer in &self.transfers {
            encode(&(key(transfer.component), transfer.entity, transfer.to), out)?;
        }
        encode(&self.events, out)
    }

    /// Adds what [`Commands::encode`] wrote, and returns the bytes after it. What is added is proportional to the
    /// number of bytes read; [`crate::Store::check_room`] checks whether a scene has room for the rows.
    ///
    /// # Errors
    /// When the bytes are malformed, name an unknown component, or hold a refused value.
    pub fn decode<'a>(&mut self, bytes: &'a [u8]) -> Result<&'a [u8], ComponentError> {
        let registry = self.registry.clone();
        let (spawns, rest) = take::<Vec<Entity>>(bytes)?;
        let (despawns, rest) = take::<Vec<Entity>>(rest)?;
        self.spawns.extend(spawns);
        self.despawns.extend(despawns);
        let (count, mut rest) = take::<u32>(rest)?;
        for _ in 0..count {
            let ((key, entity), after) = take::<(u32, Entity)>(rest)?;
            self.removes.push((registry.require_key(key)?, entity));
            rest = after;
        }
        let (count, mut rest) = take::<u32>(rest)?;
        for _ in 0..count {
            let ((key, rows), mut after) = take::<(u32, u32)>(rest)?;
            let id = registry.require_key(key)?;
            for _ in 0..rows {
                let (entity, value) = take::<Entity>(after)?;
                after = registry.put_postcard(id, self, entity, value)?;
            }
            rest = after;
        }
        let (count, mut rest) = take::<u32>(rest)?;
        for _ in 0..count {
            let ((key, entity, to), after) = take::<(u32, Entity, WriterId)>(rest)?;
            self.transfers.push(Transfer { component: registry.require_key(key)?, entity, to });
            rest = after;
        }
        let (events, rest) = take::<Vec<Event>>(rest)?;
        if let Some(event) = events.iter().find(|event| !event.value.is_finite()) {
            let name = event.name.escape_default();
            return Err(ComponentError::Malformed(format!("event '{name}': value is not finite")));
        }
        self.events.extend(events);
        Ok(rest)
    }
}

/// The commands of one tick with their provenance; applied atomically.
pub struct Batch {
    /// Where it comes from.
    pub provenance: Provenance,
    /// What it writes.
    pub commands: Commands,
}
