//! Access control: the rows that each controller may write, declared by it and checked at the start and for every
//! batch.

use std::borrow::Cow;

use thiserror::Error;

use crate::component::Component;
use crate::entity::Entity;
use crate::registry::{ComponentId, Registry, RegistryError};

/// Entities covered by a declaration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EntitySet {
    /// Every entity.
    All,
    /// The entities that the writer spawned itself.
    Own,
    /// These.
    Of(Vec<Entity>),
}

/// Declared access of a controller; checked by the Model, drawn by `trocar graph`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Access {
    /// Components it reads, by NAME.
    pub reads: Vec<&'static str>,
    /// Components it writes, by NAME, and on which entities.
    pub writes: Vec<(&'static str, EntitySet)>,
    /// Components that it contributes on its own entity.
    pub contributes: Vec<&'static str>,
    /// Whether it creates entities; it may put any declared component on them, and despawn them.
    pub spawns: bool,
    /// Whether it keeps the copy of other stations' part of the scene; see [`Access::replicates`].
    pub replicates: bool,
    /// Whether it also writes there what others claim; see [`Access::repairs`].
    pub repairs: bool,
}

impl Access {
    /// Reads and writes nothing.
    pub fn new() -> Self {
        Self::default()
    }
    /// Also reads `T`.
    #[must_use]
    pub fn reads<T: Component>(mut self) -> Self {
        self.reads.push(T::NAME);
        self
    }
    /// Also reads the components of these names.
    #[must_use]
    pub fn reads_named(mut self, names: impl IntoIterator<Item = &'static str>) -> Self {
        self.reads.extend(names);
        self
    }
    /// Also writes `T` on these entities.
    #[must_use]
    pub fn writes<T: Component>(mut self, on: EntitySet) -> Self {
        self.writes.push((T::NAME, on));
        self
    }
    /// Also contributes a `T`.
    #[must_use]
    pub fn contributes<T: Component>(mut self) -> Self {
        self.contributes.push(T::NAME);
        self
    }
    /// Also creates entities.
    #[must_use]
    pub fn spawns(mut self) -> Self {
        self.spawns = true;
        self
    }
    /// Also keeps the copy of what other stations own: it creates and removes entities of other stations, and writes
    /// every row on them that no other writer of this station claims.
    #[must_use]
    pub fn replicates(mut self) -> Self {
        self.replicates = true;
        self
    }
    /// Also writes, in that copy, rows that other writers of this station claim: what its owner says of a body is right, and
    /// whoever computed it here is built anew.
    #[must_use]
    pub fn repairs(mut self) -> Self {
        self.repairs = true;
        self
    }
}

/// Two writers that claim the same rows.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("'{first}' and '{second}' both write {component} of {entities}")]
pub struct AccessOverlap {
    /// One writer.
    pub first: String,
    /// The other.
    pub second: String,
    /// The component.
    pub component: &'static str,
    /// The entities in both sets, in words.
    pub entities: String,
}

/// An [`Access`] compiled for fast checks.
#[derive(Clone, Debug)]
pub struct WriterRules {
    me: Entity,
    spawns: bool,
    replicates: bool,
    repairs: bool,
    /// What other writers claim of the rows that a replica writes; see [`Self::reserve`].
    reserved: Vec<(ComponentId, EntitySet)>,
    unrestricted: bool,
    /// Own entities of other writers, sorted: they exist without having been spawned.
    known: Vec<Entity>,
    contributes: Vec<ComponentId>,
    /// Sorted by component; entity lists sorted.
    writes: Vec<(ComponentId, EntitySet)>,
    granted: Vec<(ComponentId, Entity)>,
    revoked: Vec<(ComponentId, Entity)>,
}

impl WriterRules {
    /// Resolves names.
    ///
    /// # Errors
    /// When a component is not registered; reads count as well.
    pub fn compile(access: &Access, registry: &Registry, me: Entity) -> Result<Self, RegistryError> {
        for name in &access.reads {
            registry.by_name(name)?;
        }
        let mut writes = Vec::with_capacity(access.writes.len());
        for (name, set) in &access.writes {
            let mut set = set.clone();
            if let EntitySet::Of(list) = &mut set {
                list.sort_unstable();
            }
            writes.push((registry.by_name(name)?, set));
        }
        writes.sort_by_key(|(id, _)| *id);
        let mut contributes = Vec::with_capacity(access.contributes.len());
        for name in &access.contributes {
            contributes.push(registry.by_name(name)?);
        }
        let Access { spawns, replicates, repairs, .. } = *access;
        Ok(Self { contributes, writes, spawns, replicates, repairs, ..Self::none(me) })
    }

    /// May write every component of every entity, create entities, and remove those that it has created: for an
    /// operator outside the session. It claims no rows, so it conflicts with no writer.
    pub fn unrestricted(me: Entity) -> Self {
        Self { spawns: true, unrestricted: true, ..Self::none(me) }
    }

    fn none(me: Entity) -> Self {
        Self {
            me,
            spawns: false,
            replicates: false,
            repairs: false,
            reserved: Vec::new(),
            unrestricted: false,
            known: Vec::new(),
            contributes: Vec::new(),
            writes: Vec::new(),
            granted: Vec::new(),
            revoked: Vec::new(),
        }
    }

    /// The writer's own entity.
    pub fn me(&self) -> Entity {
        self.me
    }
    /// Whether it may create this entity, and remove it again (its own entity not included).
    pub fn may_spawn(&self, entity: Entity) -> bool {
        (self.spawns && self.owns(entity)) || (self.replicates && self.is_foreign(entity))
    }
    /// Whether it keeps the copy of other stations' part of the scene.
    pub fn replicates(&self) -> bool {
        self.replicates
    }
    /// Components it contributes.
    pub fn contributes(&self) -> &[ComponentId] {
        &self.contributes
    }
    /// Whether it spawned the entity (its own entity not included).
    pub fn owns(&self, entity: Entity) -> bool {
        entity.station() == self.me.station() && entity.spawner() == self.me.spawner() && entity != self.me
    }
    /// Lets an unrestricted writer also write on another writer's own entity.
    pub fn acquaint(&mut self, writer: Entity) {
        if let Err(at) = self.known.binary_search(&writer)
            && self.unrestricted
        {
            self.known.insert(at, writer);
        }
    }
    /// Leaves to their writers the rows that these rules claim: a replica does not write them, unless it repairs.
    pub fn reserve(&mut self, of: &Self) {
        if self.repairs {
            return;
        }
        self.reserved.extend(of.claims().map(|(id, set)| (id, set.into_owned())));
    }
    /// Drops what [`Self::reserve`] added.
    pub fn clear_reserved(&mut self) {
        self.reserved.clear();
    }
    /// Whether this is its own entity, a writer's entity added by [`Self::acquaint`], or for a replica a writer's entity of
    /// another station: these exist without having been spawned.
    pub fn knows(&self, entity: Entity) -> bool {
        entity == self.me
            || self.known.binary_search(&entity).is_ok()
            || (self.replicates && entity.counter() == 0 && self.is_foreign(entity))
    }
    /// Whether it may write everything.
    pub fn is_unrestricted(&self) -> bool {
        self.unrestricted
    }
    /// Whether it may write this row now.
    pub fn may_write(&self, component: ComponentId, entity: Entity) -> bool {
        if self.unrestricted {
            return true;
        }
        if entity == self.me && self.contributes.contains(&component) {
            return true;
        }
        if !self.granted.is_empty() && self.granted.contains(&(component, entity)) {
            return true;
        }
        if !self.revoked.is_empty() && self.revoked.contains(&(component, entity)) {
            return false;
        }
        let covers = |(id, set): &(ComponentId, EntitySet), own: bool| {
            *id == component
                && match set {
                    EntitySet::All => true,
                    EntitySet::Own => own,
                    EntitySet::Of(list) => list.binary_search(&entity).is_ok(),
                }
        };
        self.writes.iter().any(|claim| covers(claim, self.is_own(entity)))
            // No entity of another station is a local writer's own.
            || (self.replicates && self.is_foreign(entity) && !self.reserved.iter().any(|claim| covers(claim, false)))
    }
    /// Lets it write a row that another writer transferred.
    pub fn grant(&mut self, component: ComponentId, entity: Entity) {
        self.revoked.retain(|row| *row != (component, entity));
        if !self.granted.contains(&(component, entity)) {
            self.granted.push((component, entity));
        }
    }
    /// Drops transfers of rows of a removed entity.
    pub fn forget(&mut self, entity: Entity) {
        self.granted.retain(|(_, of)| *of != entity);
        self.revoked.retain(|(_, of)| *of != entity);
    }
    /// Revokes the right to a row.
    pub fn revoke(&mut self, component: ComponentId, entity: Entity) {
        self.granted.retain(|row| *row != (component, entity));
        if !self.revoked.contains(&(component, entity)) {
            self.revoked.push((component, entity));
        }
    }
    /// A component and the entities that both may write, if there are any.
    pub fn overlap(&self, other: &Self) -> Option<(ComponentId, String)> {
        for (component, mine) in self.claims() {
            for (_, theirs) in other.claims().filter(|(id, _)| *id == component) {
                let shared = match (&*mine, &*theirs) {
                    (EntitySet::All, EntitySet::All) => Some("all entities".to_owned()),
                    (EntitySet::All, EntitySet::Of(list)) | (EntitySet::Of(list), EntitySet::All) => {
                        list.first().map(|entity| format!("entity {entity}"))
                    }
                    (EntitySet::Of(a), EntitySet::Of(b)) => {
                        a.iter().find(|entity| b.contains(entity)).map(|entity| format!("entity {entity}"))
                    }
                    (EntitySet::All, EntitySet::Own) => Some("what the second one spawns".to_owned()),
                    (EntitySet::Own, EntitySet::All) => Some("what the first one spawns".to_owned()),
                    (EntitySet::Own, EntitySet::Of(list)) => {
                        list.iter().find(|e| self.is_own(**e)).map(|entity| format!("entity {entity}"))
                    }
                    (EntitySet::Of(list), EntitySet::Own) => {
                        list.iter().find(|e| other.is_own(**e)).map(|entity| format!("entity {entity}"))
                    }
                    (EntitySet::Own, EntitySet::Own) => None,
                };
                if let Some(shared) = shared {
                    return Some((component, shared));
                }
            }
        }
        None
    }

    /// What it writes; a contribution is a row on its own entity.
    fn claims(&self) -> impl Iterator<Item = (ComponentId, Cow<'_, EntitySet>)> {
        let contributed = || Cow::Owned(EntitySet::Of(vec![self.me]));
        let writes = self.writes.iter().map(|(id, set)| (*id, Cow::Borrowed(set)));
        writes.chain(self.contributes.iter().map(move |id| (*id, contributed())))
    }

    fn is_own(&self, entity: Entity) -> bool {
        self.owns(entity) || entity == self.me
    }

    fn is_foreign(&self, entity: Entity) -> bool {
        entity.station() != self.me.station()
    }
}
