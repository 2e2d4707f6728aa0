//! A controller on another machine: its batches of commands, from a payload to what the Model checks.
//!
//! ```json
//! { "claim": "…", "sequence": 7, "based_on_secs": 12.34,
//!   "put": [{ "entity": "ring.1", "component": "velocity", "value": { "linear": [0, 0, 0.1] } }],
//!   "remove": [{ "entity": "ring.1", "component": "grasp" }],
//!   "events": [{ "name": "gust", "entity": "ring.1", "value": 1.5 }] }
//! ```
//!
//! A batch comes as it is or not at all. What a controller has not declared is refused by the Model itself, as of every
//! other writer; here are refused: somebody without the claim, a batch that is based on a scene too long ago, and what
//! cannot be read.

use serde::Deserialize;
use serde_json::{Value, json};
use trocar_scene::{Access, Commands, Entity, EntitySet, Registry, SimTime, Snapshot};

use crate::claim::{ClaimCode, Claims};
use crate::rights::{ControllerRight, RestingRow};

/// Longest batch \[bytes\].
pub const BATCH_MAX: usize = 256 * 1024;
/// Most commands of a batch.
pub const COMMANDS_MAX: usize = 256;
/// Longest refusal that is told \[bytes\].
const TOLD_MAX: usize = 512;

/// A batch as it arrives.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RemoteBatch {
    /// The claim.
    pub claim: String,
    /// Rises with each batch.
    pub sequence: u64,
    /// Time of the scene that it was computed from \[s\]; none: now.
    pub based_on_secs: Option<f64>,
    /// Rows that are put.
    pub put: Vec<RestingRow>,
    /// Rows that are removed.
    pub remove: Vec<RemovedRow>,
    /// Events.
    pub events: Vec<RemoteEvent>,
}

/// A row that is removed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemovedRow {
    /// Name of the entity.
    pub entity: String,
    /// The component.
    pub component: String,
}

/// An event.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RemoteEvent {
    /// Its name.
    pub name: String,
    /// What it is about.
    pub entity: String,
    /// A number.
    #[serde(default)]
    pub value: f64,
}

/// A controller elsewhere, as its session knows it.
pub struct RemoteController {
    right: ControllerRight,
    claims: Claims,
    silence: SimTime,
    accepted: u64,
    refused: u64,
    silences: u64,
    last_refusal: Option<String>,
}

impl RemoteController {
    /// Nobody has claimed it.
    pub fn new(right: ControllerRight) -> Self {
        let silence = SimTime::from_secs_f64(right.silence_secs);
        let claims = Claims::new(Some(silence));
        Self { right, claims, silence, accepted: 0, refused: 0, silences: 0, last_refusal: None }
    }

    /// What it may.
    pub fn right(&self) -> &ControllerRight {
        &self.right
    }

    /// What it declares to the Model, before anything of it is taken.
    ///
    /// # Errors
    /// A component or an entity that there is not.
    pub fn access(&self, scene: &Snapshot) -> Result<Access, String> {
        let registry = scene.registry();
        let place = |reason: String| format!("[[controller]] '{}': {reason}", self.right.name);
        let component = |name: &String| {
            let id = registry.by_name(name).map_err(|error| place(error.to_string()))?;
            Ok::<_, String>(registry.entry(id).name)
        };
        let mut entities = Vec::with_capacity(self.right.entities.len());
        for name in &self.right.entities {
            entities.push(find(scene, name).map_err(place)?);
        }
        let mut access = Access::new();
        for name in &self.right.reads {
            access.reads.push(component(name)?);
        }
        for name in &self.right.writes {
            access.writes.push((component(name)?, EntitySet::Of(entities.clone())));
        }
        // What it rests at is checked before it is needed.
        let mut probe = Commands::new(registry.clone(), trocar_scene::EntityAllocator::new(0, u16::MAX));
        self.rest(scene, &mut probe).map_err(place)?;
        Ok(access)
    }

    /// Gives it to who asks for it.
    ///
    /// # Errors
    /// In words.
    pub fn claim(&mut self, now: SimTime, code: ClaimCode) -> Result<u32, String> {
        self.claims.claim(now, code).map_err(|refusal| refusal.to_string())
    }

    /// Reads a batch of who has the claim.
    ///
    /// # Errors
    /// In words; it is counted, and told as its newest refusal.
    pub fn admit(
        &mut self,
        now: SimTime,
        scene_time: SimTime,
        payload: &[u8],
    ) -> Result<RemoteBatch, String> {
        let batch = parse(payload).and_then(|batch| {
            let code = ClaimCode::parse(&batch.claim).ok_or("the claim is not 16 hexadecimal digits")?;
            self.claims.admit(now, code, batch.sequence).map_err(|refusal| refusal.to_string())?;
            let age = batch.based_on_secs.map(|secs| scene_time.as_secs_f64() - secs);
            if let Some(age) = age.filter(|age| *age > self.silence.as_secs_f64()) {
                return Err(format!(
                    "it is based on the scene of {age:.3} s ago; at most {} s are allowed",
                    self.silence.as_secs_f64()
                ));
            }
            Ok(batch)
        });
        batch.inspect_err(|reason| self.refuse(reason))
    }

    /// A batch went to the Model, which applied it or named why not.
    pub fn judged(&mut self, outcome: Result<(), &str>) {
        match outcome {
            Ok(()) => self.accepted += 1,
            Err(reason) => self.refuse(reason),
        }
    }

    fn refuse(&mut self, reason: &str) {
        self.refused += 1;
        let end =
            reason.char_indices().map(|(at, _)| at).take_while(|at| *at <= TOLD_MAX).last().unwrap_or(0);
        self.last_refusal = Some(if reason.len() > TOLD_MAX { &reason[..end] } else { reason }.to_owned());
    }

    /// Fences it when it has been silent for too long; true when that happens.
    pub fn watch(&mut self, now: SimTime) -> bool {
        let fell_silent = self.claims.watch(now);
        self.silences += u64::from(fell_silent);
        fell_silent
    }

    /// When [`Self::watch`] has something to do.
    pub fn due(&self) -> Option<SimTime> {
        self.claims.due()
    }

    /// Writes what it rests at.
    ///
    /// # Errors
    /// In words.
    pub fn rest(&self, scene: &Snapshot, out: &mut Commands) -> Result<(), String> {
        self.right.rest.iter().try_for_each(|row| put(scene, row, out))
    }

    /// What is told of it.
    pub fn status(&self) -> Value {
        json!({
            "name": self.right.name,
            "claimed": self.claims.is_held(),
            "epoch": self.claims.epoch(),
            "accepted": self.accepted,
            "refused": self.refused,
            "silences": self.silences,
            "last_refusal": self.last_refusal,
        })
    }
}

fn parse(payload: &[u8]) -> Result<RemoteBatch, String> {
    if payload.is_empty() || payload.len() > BATCH_MAX {
        return Err(format!("a batch has 1 to {BATCH_MAX} bytes"));
    }
    let batch: RemoteBatch = serde_json::from_slice(payload).map_err(|error| error.to_string())?;
    let commands = batch.put.len() + batch.remove.len() + batch.events.len();
    if commands > COMMANDS_MAX {
        return Err(format!("{commands} commands; a batch has at most {COMMANDS_MAX}"));
    }
    Ok(batch)
}

impl RemoteBatch {
    /// Its commands.
    ///
    /// # Errors
    /// A name that there is not, or a value that its component refuses.
    pub fn write(&self, scene: &Snapshot, out: &mut Commands) -> Result<(), String> {
        self.put.iter().try_for_each(|row| put(scene, row, out))?;
        for row in &self.remove {
            let id = scene.registry().by_name(&row.component).map_err(|error| error.to_string())?;
            out.remove_component(id, find(scene, &row.entity)?);
        }
        for event in &self.events {
            out.event(event.name.clone(), find(scene, &event.entity)?, None, event.value);
        }
        Ok(())
    }
}

fn put(scene: &Snapshot, row: &RestingRow, out: &mut Commands) -> Result<(), String> {
    let registry: &Registry = scene.registry();
    let id = registry.by_name(&row.component).map_err(|error| error.to_string())?;
    let entity = find(scene, &row.entity)?;
    registry
        .put_json(id, out, entity, &row.value)
        .map_err(|error| format!("{} of '{}': {error}", row.component, row.entity))
}

/// The entity of a name, or of a number as `station:spawner:counter`.
fn find(scene: &Snapshot, name: &str) -> Result<Entity, String> {
    let number = || name.parse::<Entity>().ok().filter(|entity| scene.contains(*entity));
    scene.find(name).or_else(number).ok_or_else(|| format!("no entity is called '{name}'"))
}

#[cfg(test)]
#[path = "remote_controller_tests.rs"]
mod tests;
