//! Entity ids: 64-bit numbers that each writer allocates without coordination.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// An entity of the scene: `{station: u16, spawner: u16, counter: u32}` packed into 64 bits.
///
/// Never reused, stable across restarts of its spawner. Counter 0 names the spawner itself, so that a writer has an
/// entity for its own contributions and restart state.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Entity(u64);

/// The spawner under which a scenario file's own entities are allocated.
pub const SCENARIO_SPAWNER: u16 = 0;

impl Entity {
    /// Packs the three parts.
    pub const fn new(station: u16, spawner: u16, counter: u32) -> Self {
        Self(((station as u64) << 48) | ((spawner as u64) << 32) | counter as u64)
    }
    /// The entity that stands for a writer itself.
    pub const fn of_writer(station: u16, spawner: u16) -> Self {
        Self::new(station, spawner, 0)
    }
    /// The 64 bits.
    pub const fn to_bits(self) -> u64 {
        self.0
    }
    /// From the 64 bits of [`Entity::to_bits`].
    pub const fn from_bits(bits: u64) -> Self {
        Self(bits)
    }
    /// The station that allocated it.
    pub const fn station(self) -> u16 {
        (self.0 >> 48) as u16
    }
    /// The writer that allocated it.
    pub const fn spawner(self) -> u16 {
        (self.0 >> 32) as u16
    }
    /// Its number within the spawner.
    pub const fn counter(self) -> u32 {
        self.0 as u32
    }
}

impl fmt::Display for Entity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.station(), self.spawner(), self.counter())
    }
}

impl fmt::Debug for Entity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Entity({self})")
    }
}

impl FromStr for Entity {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(':');
        let mut next = || parts.next().ok_or_else(|| format!("'{text}' is not station:spawner:counter"));
        let (station, spawner, counter) = (next()?, next()?, next()?);
        let bad = |what: &str| format!("'{text}': {what} is not a number in range");
        Ok(Self::new(
            station.parse().map_err(|_| bad("station"))?,
            spawner.parse().map_err(|_| bad("spawner"))?,
            counter.parse().map_err(|_| bad("counter"))?,
        ))
    }
}

thread_local! {
    static NAMES: RefCell<Option<BTreeMap<String, Entity>>> = const { RefCell::new(None) };
}

/// Runs `work` with these names accepted for entities in human-readable input.
///
/// This lets a scenario file write `instrument = "grasper.left"`.
pub fn with_entity_names<R>(names: BTreeMap<String, Entity>, work: impl FnOnce() -> R) -> R {
    struct Restore(Option<BTreeMap<String, Entity>>);
    impl Drop for Restore {
        fn drop(&mut self) {
            NAMES.with(|slot| *slot.borrow_mut() = self.0.take());
        }
    }
    let _restore = Restore(NAMES.with(|slot| slot.borrow_mut().replace(names)));
    work()
}

impl Serialize for Entity {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            serializer.collect_str(self)
        } else {
            serializer.serialize_u64(self.0)
        }
    }
}

impl<'de> Deserialize<'de> for Entity {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            return u64::deserialize(deserializer).map(Self);
        }
        let text = String::deserialize(deserializer)?;
        if let Ok(entity) = text.parse() {
            return Ok(entity);
        }
        NAMES.with(|slot| match &*slot.borrow() {
            Some(names) => names.get(&text).copied().ok_or_else(|| {
                let known: Vec<&str> = names.keys().map(String::as_str).collect();
                de::Error::custom(format!("no entity is named '{text}'; there are: {}", known.join(", ")))
            }),
            None => Err(de::Error::custom(format!("'{text}' is not an entity (station:spawner:counter)"))),
        })
    }
}

/// Allocator of a writer's entities. The counter survives restarts of the writer, so no id is reused.
#[derive(Clone, Debug)]
pub struct EntityAllocator {
    station: u16,
    spawner: u16,
    next: Arc<AtomicU32>,
}

impl EntityAllocator {
    /// Starts at counter 1; 0 is the writer itself.
    pub fn new(station: u16, spawner: u16) -> Self {
        Self { station, spawner, next: Arc::new(AtomicU32::new(1)) }
    }
    /// The entity of the writer itself.
    pub fn me(&self) -> Entity {
        Entity::of_writer(self.station, self.spawner)
    }
    /// The next entity, or `None` after 2³² − 1 of them.
    pub fn allocate(&self) -> Option<Entity> {
        self.next
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_add(1))
            .ok()
            .map(|counter| Entity::new(self.station, self.spawner, counter))
    }
    /// An independent allocator that continues from the same counter, for a branch of a session.
    #[must_use]
    pub fn fork(&self) -> Self {
        let next = AtomicU32::new(self.next.load(Ordering::Relaxed));
        Self { station: self.station, spawner: self.spawner, next: Arc::new(next) }
    }
    /// Continues above every counter already in use (after loading a snapshot).
    pub fn skip_to(&self, counter: u32) {
        self.next.fetch_max(counter, Ordering::Relaxed);
    }
}
