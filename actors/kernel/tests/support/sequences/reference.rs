//! The Model's rules over plain maps, in the most obvious way: every question is answered by looking at
//! everything.

use std::collections::{BTreeMap, BTreeSet};

use trocar_scene::{Entity, EntitySet};

use super::steps::{Claim, Write};
use super::values::{Fuse, Kind, Row};

pub const PUBLISH_BATCHES_MAX: u32 = 32;
pub const PUBLISH_AGE_MAX_NS: u64 = 200_000;

/// What can be said against a batch. Those of an earlier class are told first; within a class any may be told.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Objection {
    Stranger,
    Stale,
    Malformed(&'static str),
    Conflict(Kind, Entity),
    NotOwner(Entity),
    UnknownEntity(Entity),
    NotDeclared(Kind, Entity),
    UnknownHeir(u16),
    OwnEntity(Kind, Entity),
    Unencodable,
}

impl Objection {
    fn class(&self) -> u8 {
        match self {
            Self::Stranger => 0,
            Self::Stale => 1,
            Self::Malformed(_) => 2,
            Self::Conflict(..) => 3,
            Self::NotOwner(_) | Self::UnknownEntity(_) | Self::NotDeclared(..) => 4,
            Self::UnknownHeir(_) | Self::OwnEntity(..) => 5,
            Self::Unencodable => 6,
        }
    }
    pub fn is_conflict(&self) -> bool {
        matches!(self, Self::Conflict(..))
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub applied: u64,
    pub rejected: u64,
    pub conflicts: u64,
    pub quarantined: u64,
    pub undone: u64,
}

#[derive(Clone, Debug)]
pub struct Writer {
    pub claim: Claim,
    pub epoch: u32,
    pub counts: Counts,
}

/// One entry of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    pub is_fence: bool,
    pub writer: u16,
    pub epoch: u32,
    pub tick: u64,
    pub time_ns: u64,
    pub revision: u64,
}

/// What readers see.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Scene {
    pub revision: u64,
    pub time_ns: u64,
    pub alive: BTreeSet<Entity>,
    pub rows: BTreeMap<(Kind, Entity), Row>,
    pub events: Vec<u8>,
}

/// What a fall-back goes back to.
#[derive(Clone, Default)]
struct Committed {
    scene: Scene,
    owners: BTreeMap<(Kind, Entity), u16>,
    log: usize,
}

#[derive(Clone, Default)]
pub struct Reference {
    pub scene: Scene,
    /// Who rows were handed to.
    owners: BTreeMap<(Kind, Entity), u16>,
    pub writers: BTreeMap<u16, Writer>,
    pub log: Vec<Entry>,
    unpublished: BTreeMap<u16, u64>,
    pending: u32,
    first_pending_ns: u64,
    /// Fences that readers have not seen.
    fences: Vec<Fenced>,
    committed: Committed,
}

/// Whose lives were ended when, and which contributions went with them.
#[derive(Clone)]
struct Fenced {
    writer: u16,
    epoch: u32,
    now_ns: u64,
    contributes: Vec<Kind>,
}

pub fn me(writer: u16) -> Entity {
    Entity::of_writer(0, writer)
}

fn is_of(entity: Entity, writer: u16) -> bool {
    entity.station() == 0 && entity.spawner() == writer
}

impl Claim {
    fn covers(&self, writer: u16, kind: Kind, entity: Entity) -> bool {
        (entity == me(writer) && self.contributes.contains(&kind))
            || self.writes.iter().any(|(of, set)| {
                *of == kind
                    && match set {
                        EntitySet::All => true,
                        EntitySet::Own => is_of(entity, writer),
                        EntitySet::Of(list) => list.contains(&entity),
                    }
            })
    }
}

impl Reference {
    /// A writer comes, or comes again with another claim; `false` when a row of `universe` would have two writers.
    pub fn declare(&mut self, writer: u16, claim: &Claim, universe: &[Entity]) -> bool {
        let others = || self.writers.iter().filter(|(id, _)| **id != writer);
        let clash = super::values::KINDS.iter().any(|kind| {
            universe.iter().any(|entity| {
                claim.covers(writer, *kind, *entity)
                    && others().any(|(id, other)| other.claim.covers(*id, *kind, *entity))
            })
        });
        if clash {
            return false;
        }
        let fresh = Writer { claim: claim.clone(), epoch: 1, counts: Counts::default() };
        self.writers.entry(writer).or_insert(fresh).claim = claim.clone();
        true
    }

    pub fn may_write(&self, writer: u16, kind: Kind, entity: Entity) -> bool {
        match self.owners.get(&(kind, entity)) {
            Some(heir) => *heir == writer,
            None => self.writers[&writer].claim.covers(writer, kind, entity),
        }
    }

    /// Everything that can be said against a batch, of the first class of which anything can.
    pub fn objections(&self, id: u16, epoch: u32, writes: &[Write], fuse: Option<Fuse>) -> Vec<Objection> {
        let Some(writer) = self.writers.get(&id) else { return vec![Objection::Stranger] };
        let mut all = Vec::new();
        if epoch != writer.epoch {
            all.push(Objection::Stale);
        }
        let malformed = writes.iter().find_map(|write| match write {
            Write::Unregistered => Some("unregistered"),
            Write::NotFinite(_) => Some("value"),
            Write::Event { finite: false, .. } => Some("event"),
            _ => None,
        });
        all.extend(malformed.map(Objection::Malformed));
        let spawned: BTreeSet<Entity> = writes
            .iter()
            .filter_map(|w| if let Write::Spawn(entity) = w { Some(*entity) } else { None })
            .collect();
        let exists = |entity| self.scene.alive.contains(&entity);
        let creates = |entity| writer.claim.spawns && is_of(entity, id) && entity != me(id);
        let mut bombs = false;
        for write in writes {
            let row = match write {
                Write::Put(kind, entity, _) | Write::Remove(kind, entity) => Some((*kind, *entity)),
                Write::Contribute(kind, _) => Some((*kind, me(id))),
                Write::Transfer(kind, entity, to) => {
                    if !self.writers.contains_key(to) {
                        all.push(Objection::UnknownHeir(*to));
                    }
                    if entity.counter() == 0 {
                        all.push(Objection::OwnEntity(*kind, *entity));
                    }
                    Some((*kind, *entity))
                }
                Write::Spawn(entity) => {
                    if !creates(*entity) || exists(*entity) {
                        all.push(Objection::NotOwner(*entity));
                    }
                    None
                }
                Write::Despawn(entity) => {
                    if !exists(*entity) {
                        all.push(Objection::UnknownEntity(*entity));
                    }
                    if !creates(*entity) {
                        all.push(Objection::NotOwner(*entity));
                    }
                    None
                }
                Write::Require(kind, entity, since) => {
                    if self.scene.rows.get(&(*kind, *entity)).is_some_and(|row| row.revision > *since) {
                        all.push(Objection::Conflict(*kind, *entity));
                    }
                    None
                }
                Write::Unregistered | Write::NotFinite(_) | Write::Event { .. } => None,
            };
            bombs |= matches!(write, Write::Put(Kind::Bomb, ..) | Write::Contribute(Kind::Bomb, _));
            if let Some((kind, entity)) = row {
                if !self.may_write(id, kind, entity) {
                    all.push(Objection::NotDeclared(kind, entity));
                }
                if entity != me(id) && !exists(entity) && !spawned.contains(&entity) {
                    all.push(Objection::UnknownEntity(entity));
                }
            }
        }
        if bombs && fuse == Some(Fuse::EncodeFails) {
            all.push(Objection::Unencodable);
        }
        let first = all.iter().map(Objection::class).min();
        all.retain(|objection| Some(objection.class()) == first);
        all
    }

    /// Whether an accepted batch takes away or replaces a bomb: one that lies in the scene, or its own.
    pub fn disturbs_a_bomb(&self, id: u16, writes: &[Write]) -> bool {
        let put = |write: &Write| match write {
            Write::Put(Kind::Bomb, entity, _) => Some(*entity),
            Write::Contribute(Kind::Bomb, _) => Some(me(id)),
            _ => None,
        };
        let puts: BTreeSet<Entity> = writes.iter().filter_map(put).collect();
        let lies = |entity: &Entity| self.scene.rows.contains_key(&(Kind::Bomb, *entity));
        puts.iter().any(lies)
            || writes.iter().any(|write| match write {
                Write::Remove(Kind::Bomb, entity) | Write::Despawn(entity) => {
                    lies(entity) || puts.contains(entity)
                }
                _ => false,
            })
    }

    pub fn apply(&mut self, id: u16, tick: u64, time_ns: u64, writes: &[Write], now_ns: u64) {
        let scene = &mut self.scene;
        scene.revision += 1;
        scene.time_ns = scene.time_ns.max(time_ns);
        let revision = scene.revision;
        let put = |scene: &mut Scene, kind: Kind, entity, value| {
            scene.rows.insert((kind, entity), Row { value: kind.shown(value), revision });
        };
        for write in writes {
            match write {
                Write::Spawn(entity) => drop(scene.alive.insert(*entity)),
                Write::Put(kind, entity, value) => put(scene, *kind, *entity, *value),
                Write::Contribute(kind, value) => put(scene, *kind, me(id), *value),
                Write::Transfer(kind, entity, to) => drop(self.owners.insert((*kind, *entity), *to)),
                Write::Event { value, .. } => scene.events.push(*value),
                _ => {}
            }
        }
        for write in writes {
            if let Write::Remove(kind, entity) = write {
                scene.rows.remove(&(*kind, *entity));
            }
        }
        for write in writes {
            if let Write::Despawn(entity) = write {
                scene.alive.remove(entity);
                scene.rows.retain(|(_, of), _| of != entity);
                self.owners.retain(|(_, of), _| of != entity);
            }
        }
        let Some(writer) = self.writers.get_mut(&id) else { return };
        writer.counts.applied += 1;
        *self.unpublished.entry(id).or_default() += 1;
        let epoch = writer.epoch;
        self.log.push(Entry { is_fence: false, writer: id, epoch, tick, time_ns, revision });
        self.changed(now_ns);
    }

    fn changed(&mut self, now_ns: u64) {
        if self.pending == 0 {
            self.first_pending_ns = now_ns;
        }
        self.pending += 1;
    }

    /// Ends a writer's lives before `epoch`; whether anything was to be done.
    pub fn fence(&mut self, id: u16, epoch: u32, now_ns: u64) -> bool {
        let Some(writer) = self.writers.get_mut(&id).filter(|writer| writer.epoch < epoch) else {
            return false;
        };
        writer.epoch = epoch;
        if writer.claim.is_onlooker() {
            return true;
        }
        let fenced = Fenced { writer: id, epoch, now_ns, contributes: writer.claim.contributes.clone() };
        self.end_lives(&fenced);
        self.fences.push(fenced);
        true
    }

    fn end_lives(&mut self, fenced: &Fenced) {
        let Fenced { writer, epoch, now_ns, ref contributes } = *fenced;
        self.scene.revision += 1;
        self.scene.rows.retain(|(kind, entity), _| *entity != me(writer) || !contributes.contains(kind));
        let (revision, tick) = (self.scene.revision, u64::from(epoch));
        self.log.push(Entry { is_fence: true, writer, epoch, tick, time_ns: now_ns, revision });
        self.changed(now_ns);
    }

    pub fn publish(&mut self) {
        let (scene, owners, log) = (self.scene.clone(), self.owners.clone(), self.log.len());
        self.committed = Committed { scene, owners, log };
        self.unpublished.clear();
        self.fences.clear();
        self.pending = 0;
    }

    pub fn is_publish_due(&self, now_ns: u64, drained: bool) -> bool {
        let old = now_ns.saturating_sub(self.first_pending_ns) >= PUBLISH_AGE_MAX_NS;
        self.pending > 0 && (drained || self.pending >= PUBLISH_BATCHES_MAX || old)
    }

    pub fn published(&self) -> &Scene {
        &self.committed.scene
    }

    /// Back to what readers have seen; but who was fenced since stays so, and nothing of it comes back.
    pub fn fall_back(&mut self) {
        let committed = self.committed.clone();
        self.scene = committed.scene;
        self.owners = committed.owners;
        self.log.truncate(committed.log);
        self.pending = 0;
        for (id, lost) in std::mem::take(&mut self.unpublished) {
            if let Some(writer) = self.writers.get_mut(&id) {
                writer.counts.undone += lost;
            }
        }
        for fenced in self.fences.clone() {
            self.end_lives(&fenced);
        }
    }
}
