//! Joints of rigid bodies: placed in their bodies where those are at first, kept there, and their loads written to the
//! scene.

use std::collections::BTreeMap;

use trocar_scene::commands::Commands;
use trocar_scene::components::{Joint, JointFrame, JointFrames, JointLoad, JointState, Joints, Pose};
use trocar_scene::entity::Entity;
use trocar_scene::snapshot::Snapshot;

use super::RigidBodiesController;
use crate::rigid_world::{BodyJoint, World, WorldError};

/// The joints of a controller's bodies.
#[derive(Default)]
pub(super) struct JointKeeper {
    /// Entities whose rows it may write, sorted; `None`: all.
    writable: Option<Vec<Entity>>,
    /// Where they sit, by the entity that lists them.
    placed: BTreeMap<Entity, PlacedJoints>,
    /// Whether bodies were built or removed since the world was given the joints.
    bodies_changed: bool,
    /// Those that the world has, entity by entity.
    given: Vec<BodyJoint>,
    /// Buffer of a tick.
    loads: Vec<JointLoad>,
}

struct PlacedJoints {
    frames: JointFrames,
    /// Whether the scene has them.
    is_told: bool,
    /// Whether their last loads were zero, and the scene has that.
    was_idle: bool,
}

impl JointKeeper {
    /// Writes the joints of those entities that list some now, or of all.
    pub(super) fn new(scene: &Snapshot, claims_all: bool) -> Self {
        let writable = (!claims_all).then(|| {
            let mut jointed: Vec<Entity> = scene.iter::<Joints>().map(|(entity, _)| entity).collect();
            jointed.sort_unstable();
            jointed
        });
        Self { writable, ..Self::default() }
    }

    /// Bodies were built or removed: the world needs its joints again.
    pub(super) fn bodies_changed(&mut self) {
        self.bodies_changed = !self.placed.is_empty();
    }

    /// Gives the world its joints, if bodies were built or removed.
    pub(super) fn hand_over(&mut self, world: &mut impl World) -> Result<(), WorldError> {
        if std::mem::take(&mut self.bodies_changed) {
            world.set_joints(&self.given)?;
        }
        Ok(())
    }
}

impl<W: World> RigidBodiesController<W> {
    /// Reads the joints of the scene that have changed.
    pub(super) fn take_joints(&mut self, scene: &Snapshot) -> Result<(), WorldError> {
        let known = self.joints.placed.len();
        self.joints.placed.retain(|entity, _| scene.get::<Joints>(*entity).is_some());
        let mut is_changed = known != self.joints.placed.len();
        for (entity, joints) in scene.iter_changed::<Joints>(self.seen) {
            let known = self.joints.placed.get(&entity);
            if known.is_some_and(|known| is_of(&known.frames, joints)) {
                continue;
            }
            let told = scene.get::<JointFrames>(entity).filter(|told| is_of(told, joints));
            let frames = match (told, known) {
                (Some(told), None) => told.clone(),
                _ => {
                    let place = |joint: &Joint| self.place(scene, entity, joint);
                    JointFrames { joints: joints.0.iter().map(place).collect() }
                }
            };
            let is_told = told.is_some_and(|told| *told == frames);
            self.joints.placed.insert(entity, PlacedJoints { frames, is_told, was_idle: false });
            is_changed = true;
        }
        if is_changed {
            self.joints.given.clear();
            let all = self.joints.placed.iter().flat_map(|(entity, placed)| {
                placed.frames.joints.iter().map(|frame| BodyJoint {
                    body: *entity,
                    other: frame.joint.to,
                    kind: frame.joint.kind,
                    body_from_joint: frame.in_body.isometry(),
                    other_from_joint: frame.in_other.isometry(),
                })
            });
            self.joints.given.extend(all);
            self.joints.bodies_changed = true;
        }
        self.joints.hand_over(&mut self.world)
    }

    /// Where a joint sits in its bodies, as they are now.
    fn place(&self, scene: &Snapshot, entity: Entity, joint: &Joint) -> JointFrame {
        let pose =
            |of: Entity| self.world.pose(of).map_or_else(|| scene.world_pose(of), |pose| pose.isometry());
        let world_from_joint = joint.frame_in_world();
        let within = |of: Entity| Pose::from(pose(of).inverse() * world_from_joint);
        JointFrame {
            joint: *joint,
            in_body: within(entity),
            in_other: joint.to.map_or_else(|| world_from_joint.into(), within),
        }
    }

    pub(super) fn write_joints(&mut self, out: &mut Commands) {
        let JointKeeper { placed, loads, writable, .. } = &mut self.joints;
        if placed.is_empty() {
            return;
        }
        self.world.joint_loads(loads);
        let mut rest = &loads[..];
        for (entity, placed) in placed {
            let count = placed.frames.joints.len().min(rest.len());
            let own;
            (own, rest) = rest.split_at(count);
            if writable.as_ref().is_some_and(|rows| rows.binary_search(entity).is_err()) {
                continue;
            }
            if !std::mem::replace(&mut placed.is_told, true) {
                out.put(*entity, placed.frames.clone());
            }
            let is_idle = own.iter().all(|load| *load == JointLoad::default());
            if !(is_idle && placed.was_idle) {
                out.put(*entity, JointState { joints: own.to_vec() });
            }
            placed.was_idle = is_idle;
        }
    }
}

/// Whether these are the places of those joints.
fn is_of(frames: &JointFrames, joints: &Joints) -> bool {
    frames.joints.len() == joints.0.len()
        && frames.joints.iter().zip(&joints.0).all(|(frame, joint)| frame.joint == *joint)
}
