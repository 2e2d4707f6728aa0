//! `/tf` and `/tf_static`: poses as frames. Every entity with a pose is one, and so is each jaw of an instrument.
//!
//! A frame stands on `/tf_static` until it has moved, and from then on in every message on `/tf`.

use std::collections::{BTreeMap, BTreeSet};

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

/// Most frames in a message.
const FRAMES_MAX: usize = 2_000;

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

/// A frame: an entity's own, or that of one of its [`JAWS`].
type Frame = (Entity, Option<usize>);

/// What has been told of the frames.
pub(super) struct Transforms {
    cadence: Cadence,
    /// What has been told; `None` before anything was.
    since: Option<Revision>,
    is_anew: bool,
    /// Frames that have not moved, as they were told.
    resting: BTreeMap<Frame, Value>,
    /// Frames that have moved since the recording began, or came later.
    moving: BTreeSet<Frame>,
}

impl Transforms {
    pub(super) fn new(period: SimTime) -> Self {
        let (resting, moving) = (BTreeMap::new(), BTreeSet::new());
        Self { cadence: Cadence::new(period), since: None, is_anew: true, resting, moving }
    }

    pub(super) fn begin_anew(&mut self) {
        self.is_anew = true;
    }

    /// Tells the frames that have moved.
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
        let is_first = self.since.is_none();
        let since = self.since.filter(|_| !self.is_anew).unwrap_or(Revision::ZERO);
        let mut is_told = self.is_anew;
        let mut resting = BTreeMap::new();
        for frame in changed(scene, since) {
            if self.moving.contains(&frame) {
                is_told = true;
                continue;
            }
            let Some(place) = place(names, scene, frame) else { continue };
            if is_first || self.resting.get(&frame) == Some(&place) {
                resting.insert(frame, place);
            } else {
                self.moving.insert(frame);
                is_told = true;
            }
        }
        if self.is_anew {
            self.resting = resting;
            self.moving.retain(|frame| place(names, scene, *frame).is_some());
            let transforms = self.resting.values().take(FRAMES_MAX).map(|place| stamped(place.clone(), now));
            tell_all(channel::TF_STATIC, transforms, message);
        }
        if is_told {
            let moving = self.moving.iter().take(FRAMES_MAX);
            let transforms = moving.filter_map(|frame| Some(stamped(place(names, scene, *frame)?, now)));
            tell_all(channel::TF, transforms, message);
        }
        (self.since, self.is_anew) = (Some(scene.revision()), false);
    }
}

fn tell_all(channel: u16, transforms: impl Iterator<Item = Value>, message: &mut Message<'_>) {
    let transforms: Vec<Value> = transforms.collect();
    if !transforms.is_empty() {
        message(channel, &json!({"transforms": transforms}));
    }
}

/// The frames that something was written to.
fn changed(scene: &Snapshot, since: Revision) -> BTreeSet<Frame> {
    let poses = scene.iter_changed::<Pose>(since).map(|(entity, _)| entity);
    let parents = scene.iter_changed::<Parent>(since).map(|(entity, _)| entity);
    // An instrument whose jaws nobody moves has them all the same.
    let jaws = scene.iter_changed::<JawState>(since).map(|(entity, _)| entity);
    let instruments = scene.iter_changed::<Instrument>(since).map(|(entity, _)| entity);
    let jaws = jaws.chain(instruments).flat_map(|entity| (0..JAWS.len()).map(move |jaw| (entity, Some(jaw))));
    poses.chain(parents).map(|entity| (entity, None)).chain(jaws).collect()
}

/// Where a frame lies, without the time; `None` when there is no such frame.
fn place(names: &mut FrameNames, scene: &Snapshot, (entity, jaw): Frame) -> Option<Value> {
    let Some(jaw) = jaw else {
        let pose = scene.get::<Pose>(entity)?;
        let parent = scene.get::<Parent>(entity).map(|parent| parent.0);
        let parent = names.frame(scene, parent).to_owned();
        return Some(transform(&parent, names.name(scene, entity), &pose.translation, &pose.rotation));
    };
    let instrument = scene.get::<Instrument>(entity).filter(|instrument| instrument.kind.has_jaws())?;
    let angle = scene.get::<JawState>(entity).map_or(0.0, |jaws| rounded(jaws.angle, JAW_PLACES));
    let (side, name) = JAWS[jaw];
    let Isometry3 { translation, rotation } = instrument_from_hinge(instrument.jaw_length, side, angle);
    let parent = names.frame(scene, Some(entity)).to_owned();
    let child = format!("{}/{name}", names.name(scene, entity));
    Some(transform(&parent, &child, &translation.vector, &rotation))
}

/// `parent_from_child`.
fn transform(parent: &str, child: &str, translation: &Vector3<f64>, rotation: &UnitQuaternion<f64>) -> Value {
    json!({
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": vector(translation, POSE),
        "rotation": quaternion(rotation.quaternion(), POSE)
    })
}

fn stamped(mut transform: Value, now: SimTime) -> Value {
    transform["timestamp"] = stamp(now);
    transform
}
