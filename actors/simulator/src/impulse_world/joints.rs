//! Joints of the impulse world's bodies, as its solver has them.

use nalgebra::Isometry3;
use trocar_dynamics::rigid_world::{BodyJoint, WorldError};
use trocar_scene::{Entity, JointLoad};

use super::world::ImpulseWorld;
use crate::rigid::{BodyJoint as SolverJoint, JointEnd, RigidError};

/// Maximum number of joints.
pub const JOINTS_MAX: usize = 4096;

/// The joints of a world.
#[derive(Clone, Debug, Default)]
pub(super) struct WorldJoints {
    given: Vec<BodyJoint>,
    /// Of each, the joint of the solver: the sign of its impulse on the body.
    active: Vec<Option<(usize, f64)>>,
    /// Bodies of active joints, sorted.
    jointed: Vec<Entity>,
    /// Pairs that do not collide, each in ascending order; sorted.
    pub joined: Vec<(Entity, Entity)>,
    /// Whether the solver has to be given them again.
    pub is_stale: bool,
}

impl WorldJoints {
    /// Whether a joint moves this body: then it does not sleep, because the forces on it act elsewhere.
    pub fn holds(&self, entity: Entity) -> bool {
        self.jointed.binary_search(&entity).is_ok()
    }
}

impl ImpulseWorld {
    pub(super) fn replace_joints(&mut self, joints: &[BodyJoint]) -> Result<(), WorldError> {
        if let Some(first) = joints.get(JOINTS_MAX) {
            return Err(WorldError::TooManyJoints {
                entity: first.body,
                joints: joints.len(),
                what: "are in the scene",
                max: JOINTS_MAX,
            });
        }
        let known = &mut self.joints;
        known.given.clear();
        known.given.extend_from_slice(joints);
        known.joined.clear();
        let pairs = joints.iter().filter_map(|joint| Some((joint.body, joint.other?)));
        known.joined.extend(pairs.map(|(a, b)| (a.min(b), a.max(b))));
        known.joined.sort_unstable();
        known.joined.dedup();
        self.resolve_joints()
    }

    /// Gives the solver the joints of the bodies that are there now.
    pub(super) fn resolve_joints(&mut self) -> Result<(), WorldError> {
        let Self { joints: known, bodies, solver, .. } = self;
        known.is_stale = false;
        known.active.clear();
        known.jointed.clear();
        let mut all = Vec::new();
        for joint in &known.given {
            let own = bodies.get(&joint.body);
            let other = joint.other.map(|other| bodies.get(&other));
            let (Some(own), Some(other)) = (own, other.map_or(Some(None), |other| other.map(Some))) else {
                known.active.push(None);
                continue;
            };
            let in_own = own.principal.inverse() * joint.body_from_joint;
            let other_slot = other.and_then(|other| other.slot);
            let in_other = other.map_or_else(Isometry3::identity, |other| other.principal.inverse())
                * joint.other_from_joint;
            let still = |pose: Isometry3<f64>| JointEnd::World([pose; 2]);
            let (body, body_from_joint, end, sign) = match (own.slot, other_slot) {
                (Some(slot), Some(other)) => {
                    (slot, in_own, JointEnd::Body { body: other as u32, body_from_joint: in_other }, 1.0)
                }
                (Some(slot), None) => {
                    let pose = other.map_or_else(Isometry3::identity, |other| other.pose);
                    (slot, in_own, still(pose * joint.other_from_joint), 1.0)
                }
                (None, Some(slot)) => (slot, in_other, still(own.pose * joint.body_from_joint), -1.0),
                (None, None) => {
                    known.active.push(None);
                    continue;
                }
            };
            known.active.push(Some((all.len(), sign)));
            all.push(SolverJoint { body: body as u32, body_from_joint, other: end, kind: joint.kind });
            known.jointed.extend([Some(joint.body), joint.other].into_iter().flatten());
        }
        known.jointed.sort_unstable();
        known.jointed.dedup();
        for entity in &known.jointed {
            if let Some(body) = bodies.get_mut(entity) {
                (body.sleeps, body.still_secs) = (false, 0.0);
            }
        }
        solver.set_joints(&all).map_err(|error| {
            let entity = known.given.first().map_or(super::world::NOBODY, |joint| joint.body);
            let (joints, max) = match error {
                RigidError::Joints { products, most } => (products, most),
                _ => (all.len(), JOINTS_MAX),
            };
            WorldError::TooManyJoints { entity, joints, what: "hang together too densely", max }
        })
    }

    /// Tells the solver where the world's side of each joint goes in this step.
    pub(super) fn lead_joints(&mut self) {
        let Self { joints: known, bodies, solver, .. } = self;
        for (joint, active) in known.given.iter().zip(&known.active) {
            let Some((index, sign)) = *active else { continue };
            let (leader, frame) = match (sign > 0.0, joint.other) {
                (true, Some(other)) => (other, joint.other_from_joint),
                (true, None) => continue,
                (false, _) => (joint.body, joint.body_from_joint),
            };
            if let Some(body) = bodies.get(&leader).filter(|body| body.slot.is_none()) {
                solver.lead_joint(index, [body.pose * frame, body.pose_after_step() * frame]);
            }
        }
    }

    pub(super) fn loads_of_joints(&self, loads: &mut Vec<JointLoad>) {
        let step_secs = self.settings.substep_secs;
        loads.clear();
        loads.extend(self.joints.active.iter().map(|active| {
            let Some((index, sign)) = *active else { return JointLoad::default() };
            let [position_error, angle_error] = self.solver.joint_errors(index);
            let impulse = self.solver.joint_impulses().get(index).copied().unwrap_or_default();
            JointLoad {
                force: impulse.impulse * (sign / step_secs),
                torque: impulse.turn * (sign / step_secs),
                position_error,
                angle_error,
            }
        }));
    }
}
