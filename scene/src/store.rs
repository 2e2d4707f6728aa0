//! The store: the only mutable copy of the scene. Its owner admits writes; see [`Store::validate`] for the rules.

use std::sync::Arc;

use thiserror::Error;

use crate::access::WriterRules;
use crate::column::{Column, ErasedColumn, PAGES_MAX, take};
use crate::commands::{CommandError, Commands};
use crate::component::ComponentError;
use crate::entity::Entity;
use crate::event::EventLog;
use crate::registry::{ComponentId, Registry};
use crate::snapshot::{Snapshot, Spawned};
use crate::time::{Revision, SimTime};

/// Why a batch was not applied; none of it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Refusal {
    /// A command is invalid.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The writer did not declare the row, or does not own it.
    #[error("{component} of {entity} is not the writer's to write")]
    NotDeclared {
        /// Name of the component.
        component: &'static str,
        /// The entity.
        entity: Entity,
    },
    /// The entity does not exist.
    #[error("entity {0} does not exist")]
    UnknownEntity(Entity),
    /// The entity exists already, or the writer may not create or remove it.
    #[error("entity {0} is not the writer's to create or remove")]
    NotOwner(Entity),
    /// A precondition no longer holds: not an error, the writer may try again.
    #[error("conflict: {component} of {entity} changed in revision {}", changed.0)]
    Conflict {
        /// Name of the component.
        component: &'static str,
        /// The entity.
        entity: Entity,
        /// When it changed.
        changed: Revision,
    },
}

impl Refusal {
    /// Whether it is a conflict rather than a fault.
    pub fn is_conflict(&self) -> bool {
        matches!(self, Refusal::Conflict { .. })
    }
}

/// The mutable scene.
pub struct Store {
    current: Snapshot,
}

impl Store {
    /// An empty scene.
    pub fn new(registry: Arc<Registry>) -> Self {
        let columns = registry.iter().map(|(_, entry)| (entry.new_column)()).collect();
        Self {
            current: Snapshot {
                registry,
                revision: Revision::ZERO,
                time: SimTime::ZERO,
                columns,
                alive: Arc::new(Column::default()),
                spawned: Arc::default(),
                events: Arc::new(EventLog::default()),
                retouches: 0,
            },
        }
    }

    /// Continues from a snapshot: recovery, or a branch. Costs one reference per column.
    pub fn from_snapshot(snapshot: &Snapshot) -> Self {
        Self { current: snapshot.clone() }
    }

    /// A snapshot of the current scene.
    pub fn snapshot(&self) -> Snapshot {
        self.current.clone()
    }
    /// Read access without sharing.
    pub fn view(&self) -> &Snapshot {
        &self.current
    }
    /// Number of batches applied.
    pub fn revision(&self) -> Revision {
        self.current.revision
    }

    /// Whether a sealed batch may be applied under the writer's rules.
    ///
    /// # Errors
    /// The first rule that it breaks.
    pub fn validate(&self, commands: &Commands, rules: &WriterRules) -> Result<(), Refusal> {
        if let Some(error) = commands.error() {
            return Err(error.clone().into());
        }
        let registry = &self.current.registry;
        for condition in commands.conditions() {
            let changed = self.current.erased_column(condition.component).revision(condition.entity);
            if let Some(changed) = changed.filter(|changed| *changed > condition.unchanged_since) {
                let component = registry.entry(condition.component).name;
                return Err(Refusal::Conflict { component, entity: condition.entity, changed });
            }
        }
        for entity in commands.spawns() {
            if !rules.may_spawn(*entity) || self.current.contains(*entity) {
                return Err(Refusal::NotOwner(*entity));
            }
        }
        if !self.current.alive.has_room(commands.spawns().iter().copied()) {
            return Err(CommandError::NoRoom.into());
        }
        for entity in commands.despawns() {
            if !self.current.contains(*entity) {
                return Err(Refusal::UnknownEntity(*entity));
            }
            if !rules.may_spawn(*entity) {
                return Err(Refusal::NotOwner(*entity));
            }
        }
        let may_touch = |id: ComponentId, entity: Entity| {
            if !rules.may_write(id, entity) {
                return Err(Refusal::NotDeclared { component: registry.entry(id).name, entity });
            }
            if rules.knows(entity) || self.current.contains(entity) || commands.spawns().contains(&entity) {
                Ok(())
            } else {
                Err(Refusal::UnknownEntity(entity))
            }
        };
        for (id, puts) in commands.puts() {
            for index in 0..puts.len() {
                may_touch(id, puts.entity(index))?;
            }
            puts.check().map_err(|(entity, error)| CommandError::Value {
                component: registry.entry(id).name,
                entity,
                error,
            })?;
        }
        for (id, entity) in commands.removes() {
            may_touch(*id, *entity)?;
        }
        for transfer in commands.transfers() {
            may_touch(transfer.component, transfer.entity)?;
        }
        Ok(())
    }

    /// Applies commands without access checks: those of the scenario, a replay, or a batch that [`Store::validate`]
    /// accepted. The values move out of the buffers.
    pub fn apply(&mut self, commands: &mut Commands, time: SimTime) -> Revision {
        self.apply_as(commands, time, Revision::ZERO)
    }

    /// [`Self::apply`] as a revision of that number, or as the next one where that is higher: revisions always grow.
    pub fn apply_as(&mut self, commands: &mut Commands, time: SimTime, number: Revision) -> Revision {
        let revision = self.current.revision.next().max(number);
        self.current.revision = revision;
        self.current.time = self.current.time.max(time);
        for entity in commands.spawns() {
            Arc::make_mut(&mut self.current.alive).put(*entity, (), revision);
            note_spawned(&mut self.current.spawned, *entity);
        }
        let columns = &mut self.current.columns;
        commands.puts_mut(|id, puts| puts.apply(exclusive(&mut columns[usize::from(id.0)]), revision));
        for (id, entity) in commands.removes() {
            exclusive(&mut self.current.columns[usize::from(id.0)]).remove(*entity, revision);
        }
        for entity in commands.despawns() {
            self.despawn(*entity, revision);
        }
        if !commands.events().is_empty() {
            let events = Arc::make_mut(&mut self.current.events);
            commands.drain_events().for_each(|event| events.push(event));
        }
        revision
    }

    /// Removes a writer's contributions, because it died or was fenced. Counts as a revision.
    pub fn remove_contributions(&mut self, rules: &WriterRules) -> Revision {
        let revision = self.current.revision.next();
        self.current.revision = revision;
        for id in rules.contributes() {
            exclusive(&mut self.current.columns[usize::from(id.0)]).remove(rules.me(), revision);
        }
        revision
    }

    fn despawn(&mut self, entity: Entity, revision: Revision) {
        Arc::make_mut(&mut self.current.alive).remove(entity, revision);
        for column in &mut self.current.columns {
            if column.revision(entity).is_some() {
                exclusive(column).remove(entity, revision);
            }
        }
    }

    /// Whether the rows that these commands add fit into the columns, whose pages are bounded. Commands of a
    /// live writer that [`Store::validate`] accepted always do; those of a file may not.
    ///
    /// # Errors
    /// [`ComponentError::Malformed`] names the component.
    pub fn check_room(&self, commands: &Commands) -> Result<(), ComponentError> {
        if !self.current.alive.has_room(commands.spawns().iter().copied()) {
            return Err(no_room("the list of entities"));
        }
        for (id, puts) in commands.puts() {
            let mut entities = (0..puts.len()).map(|index| puts.entity(index));
            if !self.current.erased_column(id).has_room(&mut entities) {
                return Err(no_room(self.current.registry.entry(id).name));
            }
        }
        Ok(())
    }

    /// Reads what [`Snapshot::encode`] wrote, in its canonical order. Its memory is proportional to the number of bytes
    /// read.
    ///
    /// # Errors
    /// When the bytes are malformed or out of order, or name unknown components.
    pub fn load<'a>(registry: &Arc<Registry>, bytes: &'a [u8]) -> Result<(Self, &'a [u8]), ComponentError> {
        let malformed = |what: String| Err(ComponentError::Malformed(what));
        let mut store = Self::new(registry.clone());
        let ((revision, time, entities), mut rest) = take::<(Revision, SimTime, u32)>(bytes)?;
        if revision.0 > NUMBER_MAX {
            return malformed(format!("revision {} is beyond {NUMBER_MAX}", revision.0));
        }
        let alive = Arc::make_mut(&mut store.current.alive);
        let mut last = None;
        for _ in 0..entities {
            let (entity, after) = take::<Entity>(rest)?;
            ascending("the list of entities", &mut last, entity)?;
            if !alive.has_room(std::iter::once(entity)) {
                return Err(no_room("the list of entities"));
            }
            alive.put(entity, (), revision);
            note_spawned(&mut store.current.spawned, entity);
            rest = after;
        }
        let (spawners, mut rest) = take::<u32>(rest)?;
        let mut last = None;
        for _ in 0..spawners {
            let ((station, spawner, counter), after) = take::<(u16, u16, u32)>(rest)?;
            let highest = Entity::new(station, spawner, counter);
            // Of two entities with one spawner the second has the higher counter, which is no order of spawners.
            ascending("the list of spawners", &mut last, Entity::of_writer(station, spawner))?;
            note_spawned(&mut store.current.spawned, highest);
            rest = after;
        }
        let allocator = crate::entity::EntityAllocator::new(0, crate::entity::SCENARIO_SPAWNER);
        let mut commands = Commands::new(registry.clone(), allocator);
        let (columns, mut rest) = take::<u32>(rest)?;
        let mut last_id = None;
        for _ in 0..columns {
            let ((key, rows), mut after) = take::<(u32, u32)>(rest)?;
            let id = registry.require_key(key)?;
            let name = registry.entry(id).name;
            if last_id.is_some_and(|last| last >= id) {
                return malformed(format!("component '{name}' comes again or out of order"));
            }
            last_id = Some(id);
            let mut last = None;
            for _ in 0..rows {
                let (entity, value) = take::<Entity>(after)?;
                ascending(name, &mut last, entity)?;
                after = registry.put_postcard(id, &mut commands, entity, value)?;
            }
            rest = after;
        }
        let ((first, events), rest) = take::<(u64, Vec<crate::event::Event>)>(rest)?;
        if first > NUMBER_MAX {
            return malformed(format!("event number {first} is beyond {NUMBER_MAX}"));
        }
        if let Some(event) = events.iter().find(|event| !event.value.is_finite()) {
            return malformed(format!("event '{}': value is not finite", event.name.escape_default()));
        }
        store.check_room(&commands)?;
        let columns = &mut store.current.columns;
        commands.puts_mut(|id, puts| puts.apply(exclusive(&mut columns[usize::from(id.0)]), revision));
        store.current.events = Arc::new(EventLog::restore(first, events));
        store.current.revision = revision;
        store.current.time = time;
        Ok((store, rest))
    }
}

/// Largest revision and event number that a file may state, so that counters cannot overflow.
const NUMBER_MAX: u64 = 1 << 62;

/// Remembers the counter of an entity, so that no other one gets it when this one is gone.
fn note_spawned(spawned: &mut Arc<Spawned>, entity: Entity) {
    let spawner = (entity.station(), entity.spawner());
    if spawned.get(&spawner).is_none_or(|highest| *highest < entity.counter()) {
        Arc::make_mut(spawned).insert(spawner, entity.counter());
    }
}

fn no_room(what: &str) -> ComponentError {
    ComponentError::Malformed(format!(
        "{what}: entity numbers are scattered over more than {PAGES_MAX} pages of 4,096"
    ))
}

/// Whether `entity` comes after the one before it.
fn ascending(what: &str, last: &mut Option<Entity>, entity: Entity) -> Result<(), ComponentError> {
    match last.replace(entity) {
        Some(before) if before >= entity => {
            Err(ComponentError::Malformed(format!("{what}: entity {entity} comes after {before}")))
        }
        _ => Ok(()),
    }
}

/// The column for writing; copied first (chunks shared) when a snapshot still holds it.
fn exclusive(column: &mut Arc<dyn ErasedColumn>) -> &mut dyn ErasedColumn {
    if Arc::get_mut(column).is_none() {
        *column = column.share();
    }
    Arc::get_mut(column).expect("a fresh copy has one owner")
}
