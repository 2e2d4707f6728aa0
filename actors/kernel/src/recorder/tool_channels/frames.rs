//! `/tf`: poses as frames. Every entity with a pose is one, and so is each jaw of an instrument.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use trocar_scene::shapes::instrument_from_hinge;
use trocar_scene::{Entity, Instrument, JawState, Parent, Pose, Revision, SimTime, Snapshot};

use super::super::format::channel;
use super::Message;
use super::cadence::Cadence;
use super::numbers::{POSE, quaternion, rounded, stamp, vector};

/// Parent of every frame that has none.
const WORLD: &str = "world";
/// Longest chain of parents that is followed; a cycle ends there.
const DEPTH_MAX: usize = 64;
/// Places after the point of a jaw's angle \[rad\]: a smaller change is not told.
const JAW_PLACES: i32 = 3;

/// The frames of the jaws: their sides as [`instrument_from_hinge`] takes them, and the ends of their names.
pub(super) const JAWS: [(f64, &str); 2] = [(1.0, "jaw_a"), (-1.0, "jaw_b")];

/// Names of entities as frames: looked up once, as names hardly ever change.
#[derive(Default)]
pub(super) struct FrameNames {
    names: BTreeMap<Entity, String>,
}

impl FrameNames {
    /// Entities that are gone need no names.
    pub(super) fn forget_absent(&mut self, scene: &Snapshot) {
        // Bounded by the number of entities: only those with a pose or a body are looked up.
        self.names.retain(|entity, _| scene.contains(*entity));
    }

    /// The entity's name, with its number where another entity, or the world, has the same one.
    pub(super) fn name(&mut self, scene: &Snapshot, entity: Entity) -> &str {
        self.names.entry(entity).or_insert_with(|| {
            let name = scene.name(entity);
            let is_taken = name == WORLD || scene.find(&name).is_some_and(|first| first != entity);
            if is_taken { format!("{name} ({entity})") } else { name }
        })
    }

    /// The frame in which the entity lies: its own, or that of the nearest of its parents that has a pose.
    pub(super) fn frame(&mut self, scene: &Snapshot, entity: Option<Entity>) -> &str {
        let mut current = entity;
        for _ in 0..DEPTH_MAX {
            let Some(entity) = current else { break };
            if scene.get::<Pose>(entity).is_some() {
                return self.name(scene, entity);
            }
            current = scene.get::<Parent>(entity).map(|parent| parent.0);
        }
        WORLD
    }
}

/// What has been told of the frames.
pub(super) struct Transforms {
    cadence: Cadence,
    since: Revision,
    /// Angles of jaws as they were told, in units of their last place.
    jaws: BTreeMap<Entity, i64>,
}

impl Transforms {
    pub(super) fn new(period: SimTime) -> Self {
        Self { cadence: Cadence::new(period), since: Revision::ZERO, jaws: BTreeMap::new() }
    }

    pub(super) fn begin_anew(&mut self) {
        self.since = Revision::ZERO;
        self.jaws.clear();
    }

    /// Tells the frames that have changed.
    pub(super) fn tell(
        &mut self,
        names: &mut FrameNames,
        scene: &Snapshot,
        now: SimTime,
        message: &mut Message<'_>,
    ) {
        if !self.cadence.is_due(now) {
            return;
        }
        names.forget_absent(scene);
        let mut transforms = Vec::new();
        for (entity, pose) in scene.iter_changed::<Pose>(self.since) {
            let parent = scene.get::<Parent>(entity).map(|parent| parent.0);
            let parent = names.frame(scene, parent).to_owned();
            let child = names.name(scene, entity);
            transforms.push(transform(now, &parent, child, &pose.translation, &pose.rotation));
        }
        self.jaws.retain(|entity, _| scene.get::<Instrument>(*entity).is_some());
        for (entity, jaws) in scene.iter_changed::<JawState>(self.since) {
            self.tell_jaws(names, scene, now, (entity, jaws.angle), &mut transforms);
        }
        // An instrument whose jaws nobody moves has them all the same.
        for (entity, _) in scene.iter_changed::<Instrument>(self.since) {
            let angle = scene.get::<JawState>(entity).map_or(0.0, |jaws| jaws.angle);
            self.tell_jaws(names, scene, now, (entity, angle), &mut transforms);
        }
        if !transforms.is_empty() {
            message(channel::TF, &json!({"transforms": transforms}));
        }
        self.since = scene.revision();
    }

    /// The frames of the jaws of an instrument whose opening has changed.
    fn tell_jaws(
        &mut self,
        names: &mut FrameNames,
        scene: &Snapshot,
        now: SimTime,
        (entity, angle): (Entity, f64),
        transforms: &mut Vec<Value>,
    ) {
        let Some(instrument) = scene.get::<Instrument>(entity) else { return };
        let told = (angle * 10_f64.powi(JAW_PLACES)).round() as i64;
        if !instrument.kind.has_jaws() || self.jaws.insert(entity, told) == Some(told) {
            return;
        }
        let name = names.frame(scene, Some(entity)).to_owned();
        for (side, jaw) in JAWS {
            let Isometry3 { translation, rotation } =
                instrument_from_hinge(instrument.jaw_length, side, rounded(angle, JAW_PLACES));
            let child = format!("{}/{jaw}", names.name(scene, entity));
            transforms.push(transform(now, &name, &child, &translation.vector, &rotation));
        }
    }
}

/// `parent_from_child`.
fn transform(
    now: SimTime,
    parent: &str,
    child: &str,
    translation: &Vector3<f64>,
    rotation: &UnitQuaternion<f64>,
) -> Value {
    json!({
        "timestamp": stamp(now),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(translation, POSE),
        "rotation": quaternion(rotation.quaternion(), POSE)
    })
}
