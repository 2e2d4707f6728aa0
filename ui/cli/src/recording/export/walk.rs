//! Everything that a recording holds, in order, as it is stored: each value with the time of the batch that wrote it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde_json::Value;
use trocar_kernel::recorder::{Item, Recording};
use trocar_scene::{
    Commands, ComponentId, Entity, EntityAllocator, Event, Registry, SimTime, Snapshot, Store, WriterId,
};

use crate::failure::Failure;

/// Something in a recording.
pub enum Met<'a> {
    /// A value.
    Value {
        /// When it was written.
        time: SimTime,
        /// The entity's name.
        entity: String,
        /// The component's name.
        component: &'static str,
        /// The value.
        value: &'a Value,
    },
    /// An event.
    Event {
        /// When it happened.
        time: SimTime,
        /// The subject's name.
        subject: String,
        /// The name of the other entity involved.
        object: Option<String>,
        /// The event.
        event: &'a Event,
    },
    /// Something that is not there.
    Missing {
        /// Where.
        time: SimTime,
        /// `gap`, `damage` or `cut`.
        kind: &'static str,
        /// The last revision before it.
        after: Option<u64>,
        /// The last revision in it.
        until: Option<u64>,
        /// In words.
        what: String,
    },
}

impl Met<'_> {
    /// When.
    pub fn time(&self) -> SimTime {
        match self {
            Met::Value { time, .. } | Met::Event { time, .. } | Met::Missing { time, .. } => *time,
        }
    }
}

/// Takes what is met.
type Visit<'a> = dyn FnMut(&Met<'_>) -> Result<(), Failure> + 'a;

/// Visits every event, every gap, and every stored value of the wanted components. Values before the first commit, and
/// after a gap, are those of a keyframe, at its time. Damage is met like a gap, and what is whole behind it is visited.
pub fn walk(
    recording: &Recording,
    registry: &Arc<Registry>,
    wanted: &BTreeMap<ComponentId, &'static str>,
    visit: &mut Visit<'_>,
) -> Result<(), Failure> {
    let mut walk = Walk {
        wanted,
        store: Store::new(registry.clone()),
        names: Names::default(),
        commands: Commands::new(registry.clone(), EntityAllocator::new(0, 0)),
        time: SimTime::ZERO,
        damage: Vec::new(),
    };
    let station = recording.metadata().station;
    let mut fresh = true;
    for item in recording.items() {
        match item.map_err(Failure::invalid)? {
            Item::Gap(gap) => {
                fresh = true;
                walk.time = walk.time.max(gap.time);
                visit(&Met::Missing {
                    time: gap.time,
                    kind: "gap",
                    after: Some(gap.after.0),
                    until: Some(gap.until.0),
                    what: format!("a gap until {:.3} s: {}", gap.time.as_secs_f64(), gap.reason),
                })?;
            }
            Item::Damage(what) => {
                fresh = true;
                walk.damaged(what, visit)?;
            }
            Item::Keyframe(keyframe) if fresh => match keyframe.load(registry) {
                Ok(store) => {
                    fresh = false;
                    walk.store = store;
                    walk.time = walk.time.max(keyframe.time);
                    walk.whole_scene(keyframe.time, visit)?;
                }
                Err(error) => walk.damaged(format!("at byte {}: {error}", keyframe.offset()), visit)?,
            },
            Item::Keyframe(_) => {}
            Item::Commits(group) => {
                for commit in group.commits() {
                    let time = commit.provenance.time;
                    walk.names.met(station, commit.provenance.writer, commit.writer, walk.store.view());
                    if let Err(what) = walk.decode(commit.payload) {
                        fresh = true;
                        walk.damaged(
                            format!("in the commit of revision {}: {what}", commit.revision.0),
                            visit,
                        )?;
                        continue;
                    }
                    walk.time = walk.time.max(time);
                    walk.commit(time, visit)?;
                }
            }
        }
    }
    let outside: Vec<String> = recording.damage().collect();
    for what in outside {
        walk.damaged(what, visit)?;
    }
    if let Some(what) = recording.truncation() {
        let what = format!("cut short: {what}; the first {:.2} s are whole", walk.time.as_secs_f64());
        visit(&Met::Missing { time: walk.time, kind: "cut", after: None, until: None, what })?;
    }
    Ok(())
}

/// The scene on the way through a recording.
struct Walk<'a> {
    wanted: &'a BTreeMap<ComponentId, &'static str>,
    store: Store,
    names: Names,
    commands: Commands,
    time: SimTime,
    damage: Vec<String>,
}

impl Walk<'_> {
    fn damaged(&mut self, what: String, visit: &mut Visit<'_>) -> Result<(), Failure> {
        if self.damage.contains(&what) {
            return Ok(());
        }
        self.damage.push(what.clone());
        let what = format!("damage {what}");
        visit(&Met::Missing { time: self.time, kind: "damage", after: None, until: None, what })
    }

    fn decode(&mut self, payload: &[u8]) -> Result<(), String> {
        self.commands.clear();
        self.commands.decode(payload).map_err(|error| error.to_string())?;
        self.commands.seal();
        self.store.check_room(&self.commands).map_err(|error| error.to_string())
    }

    /// Visits the wanted values of the whole scene.
    fn whole_scene(&mut self, time: SimTime, visit: &mut Visit<'_>) -> Result<(), Failure> {
        for (id, component) in self.wanted {
            let mut entities = Vec::new();
            self.store.view().erased_column(*id).for_each_entity(&mut |entity| entities.push(entity));
            for entity in entities {
                self.value(time, (*id, component), entity, visit)?;
            }
        }
        Ok(())
    }

    /// Applies the decoded commands, and visits what they wrote.
    fn commit(&mut self, time: SimTime, visit: &mut Visit<'_>) -> Result<(), Failure> {
        let mut written = Vec::new();
        for (id, puts) in self.commands.puts() {
            if let Some(component) = self.wanted.get(&id) {
                written.extend((0..puts.len()).map(|index| ((id, *component), puts.entity(index))));
            }
        }
        let events = self.commands.events().to_vec();
        self.store.apply(&mut self.commands, time);
        for (component, entity) in written {
            self.value(time, component, entity, visit)?;
        }
        for event in &events {
            let subject = self.names.of(self.store.view(), event.subject);
            let object = event.object.map(|object| self.names.of(self.store.view(), object));
            visit(&Met::Event { time: event.at, subject, object, event })?;
        }
        Ok(())
    }

    fn value(
        &mut self,
        time: SimTime,
        (id, component): (ComponentId, &'static str),
        entity: Entity,
        visit: &mut Visit<'_>,
    ) -> Result<(), Failure> {
        // A commit that puts a row and removes its entity leaves none.
        let Some(value) = self.store.view().erased_column(id).row_json(entity) else { return Ok(()) };
        let entity = self.names.of(self.store.view(), entity);
        visit(&Met::Value { time, entity, component, value: &value })
    }
}

/// Names by which entities can be told apart: with their numbers where several have one name.
#[derive(Default)]
struct Names {
    names: BTreeMap<Entity, String>,
    writers: BTreeSet<Entity>,
}

impl Names {
    /// The entity of a writer has the writer's name.
    fn met(&mut self, station: u16, writer: WriterId, name: &str, scene: &Snapshot) {
        let entity = Entity::of_writer(station, writer.0);
        if self.writers.insert(entity) {
            let is_taken = scene.find(name).is_some();
            self.names.insert(entity, if is_taken { format!("{name} ({entity})") } else { name.to_owned() });
        }
    }

    fn of(&mut self, scene: &Snapshot, entity: Entity) -> String {
        let name = self.names.entry(entity).or_insert_with(|| {
            let name = scene.name(entity);
            let is_taken = scene.find(&name).is_some_and(|first| first != entity);
            if is_taken { format!("{name} ({entity})") } else { name }
        });
        name.clone()
    }
}
