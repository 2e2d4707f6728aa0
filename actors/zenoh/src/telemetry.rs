//! Telemetry: what a session tells of itself, read from snapshots, at bounded rates.
//!
//! | key | rate | payload |
//! |---|---|---|
//! | `pose/ENTITY` | 30 Hz while it moves | as `foxglove.FrameTransform` in recordings, in the world |
//! | `hand/HAND/force` | 30 Hz | as `trocar.Hand` in recordings |
//! | `task/ENTITY` | on change, 10 Hz at most | as `trocar.Task` in recordings |
//! | `row/COMPONENT/ENTITY` | on change, 60 Hz at most | the component's JSON, as in scenario files |
//! | `health`, `roster` | on change, 2 Hz at most | lists |
//!
//! Everything is told again each second, for who comes late or has missed something. Nothing is queued: a node that is late
//! tells the newest.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use serde_json::{Map, Value, json};
use trocar_scene::{
    ComponentId, DeviceForce, DeviceState, Entity, Hand, InstrumentForce, JawState, Pose, Registry, Revision,
    SimTime, Snapshot, Station, TaskState,
};

use crate::keys::SessionKeys;

/// Most poses, and most rows of a component, that are told.
pub const ENTITIES_MAX: usize = 1_024;
/// From one look at poses and forces to the next.
const POSES: SimTime = SimTime(33_333_333);
/// The same of exercises.
const TASKS: SimTime = SimTime::from_millis(100);
/// The same of rows.
const ROWS: SimTime = SimTime(16_666_667);
/// The same of lists.
const LISTS: SimTime = SimTime::from_millis(500);
/// When everything is told again.
const ANEW: SimTime = SimTime::from_millis(1_000);
/// A smaller motion is none \[m\], \[rad\].
const MOTION_MIN: f64 = 1e-6;

/// Takes a message: its key, and its payload.
pub type Message<'a> = dyn FnMut(&str, &Value) + 'a;

/// When something is due, without drift and without a burst after a delay.
#[derive(Clone, Copy, Debug)]
struct Cadence {
    period: SimTime,
    next: SimTime,
}

impl Cadence {
    fn new(period: SimTime) -> Self {
        Self { period, next: SimTime::ZERO }
    }

    fn is_due(&mut self, now: SimTime) -> bool {
        if now < self.next {
            return false;
        }
        let late = now.since(self.next).0 / self.period.0;
        self.next = SimTime(self.next.0 + (late + 1) * self.period.0);
        true
    }
}

/// What has been told of a session.
pub struct Telemetry {
    keys: SessionKeys,
    /// Components of which rows are told, with their names.
    rows: Vec<(ComponentId, &'static str)>,
    poses: BTreeMap<Entity, Isometry3<f64>>,
    tasks_since: Revision,
    rows_since: Revision,
    health: Value,
    roster: Value,
    due: [Cadence; 5],
}

impl Telemetry {
    /// Of a session. `reads` are names of components whose rows are told.
    ///
    /// # Errors
    /// A name that no component has.
    pub fn new<'a>(
        keys: SessionKeys,
        registry: &Registry,
        reads: impl IntoIterator<Item = &'a str>,
    ) -> Result<Self, String> {
        let mut rows = Vec::new();
        for name in reads {
            let id = registry.by_name(name).map_err(|error| error.to_string())?;
            if !rows.iter().any(|(known, _)| *known == id) {
                rows.push((id, registry.entry(id).name));
            }
        }
        Ok(Self {
            keys,
            rows,
            poses: BTreeMap::new(),
            tasks_since: Revision::ZERO,
            rows_since: Revision::ZERO,
            health: Value::Null,
            roster: Value::Null,
            due: [POSES, TASKS, ROWS, LISTS, ANEW].map(Cadence::new),
        })
    }

    /// Tells what is due at `now`, by a clock that goes on while the session is paused. `health` are the actors of the session
    /// with how they do.
    pub fn tell(
        &mut self,
        scene: &Snapshot,
        now: SimTime,
        health: &[(String, String)],
        message: &mut Message<'_>,
    ) {
        let [poses, tasks, rows, lists, anew] = self.due.each_mut().map(|cadence| cadence.is_due(now));
        if anew {
            self.poses.clear();
            (self.tasks_since, self.rows_since) = (Revision::ZERO, Revision::ZERO);
            (self.health, self.roster) = (Value::Null, Value::Null);
        }
        if poses || anew {
            self.tell_poses(scene, message);
            self.tell_forces(scene, message);
        }
        if tasks || anew {
            self.tell_tasks(scene, message);
        }
        if rows || anew {
            self.tell_rows(scene, message);
        }
        if lists || anew {
            let told = health_list(health);
            if self.health != told {
                message(&self.keys.health(), &told);
                self.health = told;
            }
            let told = roster(scene);
            if self.roster != told {
                message(&self.keys.roster(), &told);
                self.roster = told;
            }
        }
    }

    fn tell_poses(&mut self, scene: &Snapshot, message: &mut Message<'_>) {
        self.poses.retain(|entity, _| scene.contains(*entity));
        for (entity, _) in scene.iter::<Pose>().take(ENTITIES_MAX) {
            let world_from_entity = scene.world_pose(entity);
            let rests = self.poses.get(&entity).is_some_and(|told| {
                let moved = (told.translation.vector - world_from_entity.translation.vector).norm();
                moved < MOTION_MIN && told.rotation.angle_to(&world_from_entity.rotation) < MOTION_MIN
            });
            if rests {
                continue;
            }
            let name = scene.name(entity);
            let (at, turned) = (world_from_entity.translation.vector, world_from_entity.rotation.coords);
            let told = json!({
                "timestamp": stamp(scene.time()),
                "parent_frame_id": "world",
                "child_frame_id": name,
                "translation": { "x": at.x, "y": at.y, "z": at.z },
                "rotation": { "x": turned.x, "y": turned.y, "z": turned.z, "w": turned.w },
            });
            message(&self.keys.pose(&name), &told);
            self.poses.insert(entity, world_from_entity);
        }
    }

    fn tell_forces(&self, scene: &Snapshot, message: &mut Message<'_>) {
        for (entity, hand) in scene.iter::<Hand>() {
            let Some(device) = scene.get::<DeviceState>(entity) else { continue };
            let commanded = scene.get::<DeviceForce>(entity).map(|force| force.force).unwrap_or_default();
            let contact = scene.get::<InstrumentForce>(hand.instrument).map(|force| force.force);
            let name = scene.name(entity);
            let mut told = json!({
                "timestamp": stamp(scene.time()),
                "hand": name,
                "side": hand.side.as_str(),
                "instrument": scene.name(hand.instrument),
                "applied": vector(&device.applied_force),
                "applied_norm": device.applied_force.norm(),
                "commanded": vector(&commanded),
                "commanded_norm": commanded.norm(),
                "gripper": device.gripper,
                "buttons": device.buttons,
                "connected": device.connected,
            });
            if let Some(contact) = contact {
                told["contact"] = vector(&contact);
            }
            if let Some(jaw) = scene.get::<JawState>(hand.instrument) {
                told["jaw"] = json!(jaw.angle);
            }
            message(&self.keys.hand(name.strip_prefix("hand.").unwrap_or(&name), "force"), &told);
        }
    }

    fn tell_tasks(&mut self, scene: &Snapshot, message: &mut Message<'_>) {
        for (entity, task) in scene.iter_changed::<TaskState>(self.tasks_since) {
            let exercise = scene.name(entity);
            let mut told = json!({
                "timestamp": stamp(scene.time()),
                "exercise": exercise,
                "task": task.task,
                "phase": task.phase,
                "done": task.done,
                "steps": task.steps,
                "seconds": task.seconds,
                "score_kind": task.score_kind(),
                "errors": task.errors.len(),
                "over": task.over,
                "completed": task.completed,
                "cut_off": task.cut_off,
            });
            // Before the end a score is a forecast.
            if let Some(score) = task.score.filter(|_| task.over) {
                told["score"] = json!(score);
            }
            if let Some(error) = task.errors.last() {
                told["last_error"] = json!(error.kind);
            }
            message(&self.keys.task(&exercise), &told);
        }
        self.tasks_since = scene.revision();
    }

    fn tell_rows(&mut self, scene: &Snapshot, message: &mut Message<'_>) {
        for (id, name) in &self.rows {
            let (column, mut changed) = (scene.erased_column(*id), Vec::new());
            column.for_each_changed(self.rows_since, &mut |entity| {
                if changed.len() < ENTITIES_MAX {
                    changed.push(entity);
                }
            });
            for entity in changed {
                if let Some(row) = column.row_json(entity) {
                    message(&self.keys.row(name, &scene.name(entity)), &row);
                }
            }
        }
        self.rows_since = scene.revision();
    }
}

/// The stations of a session; one that nobody joined has none.
pub fn roster(scene: &Snapshot) -> Value {
    let mut stations: Vec<&Station> = scene
        .iter::<Station>()
        .filter(|(entity, _)| entity.station() == 0)
        .map(|(_, station)| station)
        .collect();
    stations.sort_by_key(|station| station.number);
    stations
        .into_iter()
        .map(|station| {
            json!({
                "number": station.number,
                "name": station.name,
                "role": station.role,
                "here": station.here,
                "hands": station.hands,
                "protected": station.protected,
            })
        })
        .collect()
}

fn health_list(health: &[(String, String)]) -> Value {
    Value::Object(health.iter().map(|(name, how)| (name.clone(), json!(how))).collect::<Map<_, _>>())
}

fn stamp(at: SimTime) -> Value {
    json!({ "sec": at.0 / 1_000_000_000, "nsec": at.0 % 1_000_000_000 })
}

fn vector(vector: &nalgebra::Vector3<f64>) -> Value {
    json!({ "x": vector.x, "y": vector.y, "z": vector.z })
}

#[cfg(test)]
#[path = "telemetry_tests.rs"]
mod tests;
